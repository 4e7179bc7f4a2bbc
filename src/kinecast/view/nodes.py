"""Capsules and people as nodes of a scene in the browser."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from kinecast.errors import MissingExtraError
from kinecast.robot.body import TRUE_BODY, body_capsules
from kinecast.view.colours import Colour
from kinecast.view.solids import capsule_faces, capsule_vertices

try:
    from viser import SceneApi
except ImportError as error:  # pragma: no cover - the tests install it
    raise MissingExtraError("the browser view", "view") from error

__all__ = ["LATE", "OPACITY", "REGION", "SOON", "CapsulesNode", "People"]

SHIRT, SKIN = (112, 132, 156), (224, 176, 140)
REGION, OPACITY = (255, 190, 40), 0.17
SOON, LATE = np.array([255.0, 205.0, 60.0]), np.array([235.0, 90.0, 20.0])
"""What is predicted, from now to the end of the horizon."""
SKIN_PARTS = np.array([1, 2, 4, 5, 8])
SHIRT_PARTS = np.array([0, 3, 6, 7])
"""Of kinecast.robot.body.body_capsules: forearms, hands and head; upper arms, shoulders and trunk."""


class CapsulesNode:
    """Capsules of one colour, as many as there are at a time.

    Args:
        scene: of the server.
        name: of the node.
        colour: of all.
        opacity: None for solid ones.
    """

    def __init__(self, scene: SceneApi, name: str, colour: Colour, opacity: float | None = None) -> None:
        self._scene, self._name, self._colour, self._opacity = scene, name, colour, opacity
        self._node: Any = None
        self._count = 0

    def show(
        self, start: Float[np.ndarray, "K 3"], end: Float[np.ndarray, "K 3"], radius: Float[np.ndarray, " K"]
    ) -> None:
        """Puts them there; one that is not finite is left out."""
        corners = capsule_vertices(start, end, radius).astype(np.float32)
        if self._node is None or self._count != len(radius):
            self.remove()
            solid, self._count = self._opacity is None, len(radius)
            self._node = self._scene.add_mesh_simple(
                self._name, corners, capsule_faces(self._count), color=self._colour, opacity=self._opacity,
                cast_shadow=solid, receive_shadow=solid,
            )  # fmt: skip
        else:
            self._node.vertices = corners
        self._node.visible = True

    @property
    def visible(self) -> bool:
        """Whether they are shown."""
        return self._node is not None and bool(self._node.visible)

    def hide(self) -> None:
        """Until they are shown again."""
        if self._node is not None:
            self._node.visible = False

    def remove(self) -> None:
        """For good."""
        if self._node is not None:
            self._node.remove()
            self._node = None


class People:
    """Bodies around measured joints.

    Args:
        scene: of the server.
    """

    def __init__(self, scene: SceneApi) -> None:
        self._scene = scene
        self._bodies: list[tuple[CapsulesNode, CapsulesNode]] = []

    def show(self, people: Sequence[tuple[tuple[str, ...], Float[np.ndarray, "J 3"]]]) -> None:
        """Everybody who is there: canonical names and positions (J, 3) of their joints [m], NaN where not known."""
        while len(self._bodies) < len(people):
            name = f"/people/{len(self._bodies)}"
            self._bodies.append(
                (CapsulesNode(self._scene, f"{name}/skin", SKIN), CapsulesNode(self._scene, f"{name}/shirt", SHIRT))
            )
        for k, nodes in enumerate(self._bodies):
            for node, parts in zip(nodes, (SKIN_PARTS, SHIRT_PARTS), strict=True):
                if k < len(people):
                    body = body_capsules(*people[k], TRUE_BODY)
                    node.show(body.start[parts], body.end[parts], body.radius[parts])
                else:
                    node.hide()
