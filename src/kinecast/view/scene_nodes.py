"""Obstacles and goals of a scene in the browser."""

from __future__ import annotations

import numpy as np

from kinecast.errors import MissingExtraError
from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Box, Capsule, Shape, Sphere
from kinecast.geometry.transforms import to_quaternion
from kinecast.view.colours import Colour
from kinecast.view.nodes import CapsulesNode

try:
    from viser import SceneApi
except ImportError as error:  # pragma: no cover - the tests install it
    raise MissingExtraError("the browser view", "view") from error

__all__ = ["draw_scene"]

OBSTACLE: Colour = (150, 140, 125)
GOAL: Colour = (70, 150, 220)
FAINT = 0.2


def draw_scene(api: SceneApi, scene: Scene) -> None:
    """Draws what stands still and has an end: half-spaces and moving obstacles are left out."""
    for k, obstacle in enumerate(scene.obstacles):
        if isinstance(obstacle, Shape):
            _draw(api, f"/scene/obstacles/{k}", obstacle, OBSTACLE, None)
    for k, goal in enumerate(scene.goals.values()):
        _draw(api, f"/scene/goals/{k}", goal, GOAL, FAINT)


def _draw(api: SceneApi, name: str, shape: Shape, colour: Colour, opacity: float | None) -> None:
    if isinstance(shape, Box):
        turn = to_quaternion(shape.rotation)
        api.add_box(name, colour, tuple(shape.size), position=shape.center, wxyz=turn, opacity=opacity)
    elif isinstance(shape, Sphere):
        api.add_icosphere(name, shape.radius, colour, position=shape.center, opacity=opacity)
    elif isinstance(shape, Capsule):
        CapsulesNode(api, name, colour, opacity).show(shape.start[None], shape.end[None], np.array([shape.radius]))
