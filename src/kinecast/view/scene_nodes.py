"""What scenes in the browser are made of: capsules, people, predictions, obstacles, the floor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8
from viser import SceneApi

from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Box, Capsule, Sphere
from kinecast.geometry.transforms import to_quaternion
from kinecast.robot.body import TRUE_BODY, body_capsules
from kinecast.robot.colours import SHIRT, SKIN, SKIN_PARTS, Colour

AROUND, UP = 20, 12
"""Corners around a capsule's axis; rings from one cap's pole to the other's, half of them on each cap."""
OBSTACLE: Colour = (150, 140, 125)
GOAL: Colour = (70, 150, 220)
REGION: Colour = (255, 190, 40)
SOON, LATE = np.array([255.0, 205.0, 60.0]), np.array([235.0, 90.0, 20.0])
"""What is predicted, from now to the end of the horizon."""
SKIN_ROWS, SHIRT_ROWS = np.flatnonzero(SKIN_PARTS), np.flatnonzero(np.logical_not(SKIN_PARTS))


def capsule_vertices(rows: Float[np.ndarray, "K 7"]) -> Float[np.ndarray, "W 3"]:
    """(K V, 3) corners of K capsules [m], in the order of `capsule_faces`, from start, end and radius (K, 7) [m].

    A capsule that is not finite shrinks to a point at the origin.
    """
    rows = np.where(np.isfinite(rows).all(axis=1, keepdims=True), rows, 0.0)
    start, along, radius = rows[:, :3], rows[:, 3:6] - rows[:, :3], rows[:, 6]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    z = np.where(length > 1e-9, along / np.maximum(length, 1e-9), [0.0, 0.0, 1.0])
    y = np.cross(z, np.where(np.abs(z[:, :1]) < 0.8, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]))
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    latitude = np.concatenate([np.linspace(-np.pi / 2, 0.0, UP // 2), np.linspace(0.0, np.pi / 2, UP // 2)])
    longitude = np.linspace(0.0, 2 * np.pi, AROUND, endpoint=False)
    up, around = (each.ravel() for each in np.meshgrid(latitude, longitude, indexing="ij"))
    directions = np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])
    ball = np.einsum("aki,av->kvi", np.stack([np.cross(y, z), y, z]), directions) * radius[:, None, None]
    at_end = (np.arange(len(up)) >= len(up) // 2)[None, :, None]
    return (start[:, None] + at_end * along[:, None] + ball).reshape(-1, 3)


def capsule_faces(count: int) -> Int[np.ndarray, "F 3"]:
    """(F, 3) corners of each triangle of so many capsules, counter-clockwise from outside."""
    ring, column = np.meshgrid(np.arange(UP - 1), np.arange(AROUND), indexing="ij")
    a, b = ring * AROUND + column, ring * AROUND + (column + 1) % AROUND
    one = np.stack([a, b, b + AROUND, a, b + AROUND, a + AROUND], axis=-1).reshape(-1, 3)
    return (one + UP * AROUND * np.arange(count)[:, None, None]).reshape(-1, 3)


class CapsulesNode:
    """Capsules of one colour, as many as there are at a time; with an opacity they are not solid."""

    def __init__(self, scene: SceneApi, name: str, colour: Colour, opacity: float | None = None) -> None:
        self._scene, self._name, self._colour, self._opacity = scene, name, colour, opacity
        self._node: Any = None
        self._count = 0

    @property
    def visible(self) -> bool:
        """Whether there are any."""
        return self._node is not None and bool(self._node.visible)

    def show(self, rows: Float[np.ndarray, "K 7"]) -> None:
        """These and no others: start, end and radius [m]; one that is not finite is left out."""
        corners = capsule_vertices(rows)
        if len(rows) not in (0, self._count):
            solid, self._count = self._opacity is None, len(rows)
            self._node = self._scene.add_mesh_simple(
                self._name, corners, capsule_faces(self._count), color=self._colour, opacity=self._opacity,
                cast_shadow=solid, receive_shadow=solid,
            )  # fmt: skip
        elif len(rows):
            self._node.vertices = corners
        if self._node is not None:
            self._node.visible = len(rows) > 0


class People:
    """Bodies around measured joints."""

    def __init__(self, scene: SceneApi) -> None:
        self.skin = CapsulesNode(scene, "/people/skin", SKIN)
        self.shirts = CapsulesNode(scene, "/people/shirts", SHIRT)

    def show(self, people: Sequence[tuple[tuple[str, ...], Float[np.ndarray, "J 3"]]]) -> None:
        """Everybody who is there: canonical names and positions (J, 3) of their joints [m], NaN where not known."""
        rows = np.array([body_capsules(*person, TRUE_BODY) for person in people]).reshape(-1, 9, 7)
        self.skin.show(rows[:, SKIN_ROWS].reshape(-1, 7))
        self.shirts.show(rows[:, SHIRT_ROWS].reshape(-1, 7))


def tubes(scene: SceneApi) -> CapsulesNode:
    """Where limbs may be."""
    return CapsulesNode(scene, "/region/tubes", REGION, 0.17)


def ahead(points: Float[np.ndarray, "T K M 3"]) -> UInt8[np.ndarray, "T K M 3"]:
    """Colours of points at T predicted steps."""
    share = np.linspace(0.0, 1.0, len(points))[:, None, None, None]
    return np.broadcast_to(SOON + share * (LATE - SOON), points.shape).astype(np.uint8)


def draw_floor(scene: SceneApi, place: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
    """A grid with lines every quarter of a metre."""
    scene.add_grid(
        "/floor", 6.0, 6.0, position=place, cell_size=0.25, cell_color=(226, 229, 233), section_size=1.0,
        section_color=(208, 213, 219), shadow_opacity=0.12,
    )  # fmt: skip


def draw_scene(api: SceneApi, scene: Scene) -> None:
    """Draws what stands still and has an end: half-spaces and moving obstacles are left out."""
    shapes = [(f"/scene/obstacles/{k}", each, OBSTACLE, None) for k, each in enumerate(scene.obstacles)]
    goals = [(f"/scene/goals/{k}", each, GOAL, 0.2) for k, each in enumerate(scene.goals.values())]
    for name, shape, colour, opacity in (*shapes, *goals):
        if isinstance(shape, Box):
            turn = to_quaternion(shape.rotation)
            api.add_box(name, colour, tuple(shape.size), position=shape.center, wxyz=turn, opacity=opacity)
        elif isinstance(shape, Sphere):
            api.add_icosphere(name, shape.radius, colour, position=shape.center, opacity=opacity)
        elif isinstance(shape, Capsule):
            row = np.concatenate([shape.start, shape.end, [shape.radius]])
            CapsulesNode(api, name, colour, opacity).show(row[None])
