"""The robot's cell: a table, three cubes, where each is to be put, and the constants of its camera and monitoring.

`lab` flatters whoever waits and sees: a tracker that is off by 2 cm, a reaction of 30 ms. `camera`, the default, is a
cell watched by fused depth cameras. `certified` takes everybody to walk towards the arm, always.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from kinecast.errors import OptionError
from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Box
from kinecast.geometry.transforms import rotation_z, transform
from kinecast.robot.separation import SeparationOptions

TABLE_TOP = -0.02  # height of the table's surface [m]: the arm stands on a plate, whose top is the origin
TABLE_HEIGHT = 0.9  # of the surface above the floor [m]


@dataclass(frozen=True, eq=False)
class Cube:
    """One thing to be moved."""

    name: str  # also its colour
    position: Float[np.ndarray, " 3"]  # where it stands, its centre [m]
    place: Float[np.ndarray, " 3"]  # where it is to stand [m]
    size: ClassVar[float] = 0.05  # length of an edge [m]


def _cubes(apart: float = 0.38, first: float = 0.0) -> tuple[Cube, ...]:
    """Red, green and blue in a row across the table, so far apart; their places in a row at the arm's side."""
    height = TABLE_TOP + 0.025
    return tuple(
        Cube(name, np.array([0.46, y, height]), np.array([first - k * 0.12, -0.5, height]))
        for k, (name, y) in enumerate((("red", apart), ("green", 0.0), ("blue", -apart)))
    )


CAMERA = SeparationOptions(reaction=0.1, braking=1.5, intrusion=0.1, person_error=0.08, robot_error=0.01)
"""Of a cell watched by fused cameras.

T_r: three control cycles and a camera's period beyond the delay that stamps tell. a: what a planned motion surely
brakes with (kinecast.robot.execution), far below the 11 m/s² of the maker's own stop at full reach (UR5/CB3 user
manual 3.4.5, appendix A.1: 3.19 rad/s in 0.244 s). Z_d: 95 % of fused joints are nearer to the truth
(benchmarks.fusion: 77 mm, 85 mm with a view hidden). C: a hand that reaches over what is tracked (ISO 13855:2010,
6.2.3, less what the hand's capsule holds already).
"""


@dataclass(frozen=True, eq=False)
class Cell:
    """Everything that stands still, in the frame of the arm's base: x to the person, z up [m]."""

    table: ClassVar[Box] = Box(np.array([0.29, 0.0, TABLE_TOP - 0.02]), np.array([1.3, 1.7, 0.04]))
    hover: ClassVar[float] = 0.14  # height of the fingertips above a cube before and after it is taken [m]
    grip: ClassVar[float] = 0.015  # how far below a cube's top the fingertips close [m]
    rest: ClassVar[Float[np.ndarray, "3"]] = np.array([0.22, -0.42, 0.3])  # of the fingertips, with nothing to do [m]
    cubes: tuple[Cube, ...] = field(default_factory=_cubes)  # in the order in which they are to be moved
    person: Float[np.ndarray, "4 4"] = field(default_factory=lambda: standing_at(1.33, 0.0))
    """T_cell_person, where somebody at the table stands: on the floor, x forward, z up."""
    separation: SeparationOptions = CAMERA  # constants of speed and separation monitoring
    delay: float = 0.05  # of the camera, from taking a shot to knowing it [s]

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
        T[2, 3] += Cube.size / 2 - self.grip + above
        return T


def standing_at(x: float, y: float) -> Float[np.ndarray, "4 4"]:
    """T_cell_person of somebody who stands at x, y [m] and looks at the arm."""
    return transform(rotation_z(math.atan2(-y, -x)), np.array([x, y, TABLE_TOP - TABLE_HEIGHT]))


CELLS: dict[str, Callable[[], Cell]] = {
    "lab": lambda: Cell(_cubes(0.32, 0.12), person=standing_at(1.15, 0.0), separation=SeparationOptions(), delay=0.04),
    "camera": Cell,
    "certified": lambda: Cell(separation=CAMERA._replace(least_speed=1.6)),
}
"""Cells by name; `certified` takes v_h to be 1.6 m/s (ISO 13855:2010, clause 5) whatever is measured."""


def cell_named(name: str) -> Cell:
    """One of CELLS.

    Raises:
        OptionError: there is none of that name.
    """
    if name not in CELLS:
        raise OptionError(f"cell {name!r} is none of {', '.join(CELLS)}")
    return CELLS[name]()
