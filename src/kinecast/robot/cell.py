"""The robot's cell: a table, three cubes on it, and where each of them is to be put."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from kinecast.errors import OptionError
from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Box

__all__ = ["Cell", "Cube"]

TABLE_TOP = -0.02
"""Height of the table's surface [m]: the arm stands on a plate, whose top is the origin."""
TABLE_HEIGHT = 0.9
"""Of the surface above the floor [m]."""


@dataclass(frozen=True, eq=False)
class Cube:
    """One thing to be moved.

    Attributes:
        name: also its colour.
        position: (3,) where it stands, its centre [m].
        place: (3,) where it is to stand [m].
        size: length of an edge [m].
    """

    name: str
    position: Float[np.ndarray, " 3"]
    place: Float[np.ndarray, " 3"]
    size: float = 0.05


def _cubes() -> tuple[Cube, ...]:
    """Red, green and blue in a row across the table; their places in a row at the arm's side."""
    height = TABLE_TOP + 0.025
    return tuple(
        Cube(name, np.array([0.46, y, height]), np.array([x, -0.5, height]))
        for name, y, x in (("red", 0.32, 0.12), ("green", 0.0, 0.0), ("blue", -0.32, -0.12))
    )


@dataclass(frozen=True, eq=False)
class Cell:
    """Everything that stands still, in the frame of the arm's base: x to the person, z up [m].

    Attributes:
        cubes: in the order in which they are to be moved.
        table: under arm and cubes.
        hover: height of the fingertips above a cube before and after it is taken [m].
        grip: how far below a cube's top the fingertips close [m].
        rest: (3,) fingertips while nothing is to be done [m].
        person: (4, 4) T_cell_person, where somebody at the table stands: on the floor, x forward, z up.
    """

    cubes: tuple[Cube, ...] = field(default_factory=_cubes)
    table: Box = field(default_factory=lambda: Box(np.array([0.29, 0.0, TABLE_TOP - 0.02]), np.array([1.3, 1.7, 0.04])))
    hover: float = 0.14
    grip: float = 0.015
    rest: Float[np.ndarray, " 3"] = field(default_factory=lambda: np.array([0.22, -0.42, 0.3]))
    person: Float[np.ndarray, "4 4"] = field(default_factory=lambda: standing_at(1.15, 0.0))

    def __post_init__(self) -> None:
        names = [cube.name for cube in self.cubes]
        if not names or len(set(names)) < len(names):
            raise OptionError(f"cubes {names}: at least one is needed, each with a name of its own")

    @property
    def order(self) -> tuple[str, ...]:
        """Names of the cubes in the order in which they are to be moved."""
        return tuple(cube.name for cube in self.cubes)

    def cube(self, name: str) -> Cube:
        """The cube of that name."""
        return next(cube for cube in self.cubes if cube.name == name)

    @property
    def scene(self) -> Scene:
        """What a planned path keeps clear of: the table."""
        return Scene((self.table,))

    def grasp(self, point: Float[np.ndarray, " 3"], above: float = 0.0) -> Float[np.ndarray, "4 4"]:
        """T_cell_tool to hold a cube whose centre is at a point, fingers down.

        Args:
            point: (3,) [m].
            above: how much higher [m].
        """
        T = np.diag([1.0, -1.0, -1.0, 1.0])
        T[:3, 3] = point
        T[2, 3] += self.cubes[0].size / 2 - self.grip + above
        return T


def standing_at(x: float, y: float) -> Float[np.ndarray, "4 4"]:
    """T_cell_person of somebody who stands at x, y [m] and looks at the arm."""
    forward = -np.array([x, y]) / np.hypot(x, y)
    T = np.eye(4)
    T[:2, 0] = forward
    T[:2, 1] = -forward[1], forward[0]
    T[:3, 3] = x, y, TABLE_TOP - TABLE_HEIGHT
    return T
