"""The page a picture is drawn on: a camera, and the obstacles of a scene as it sees them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from kinecast.errors import MissingExtraError
from kinecast.geometry.distances import HALF_SPACE
from kinecast.geometry.scene import Scene

try:
    from matplotlib.axes import Axes
    from matplotlib.colors import to_rgb
    from matplotlib.patches import Polygon
except ImportError as error:
    raise MissingExtraError("drawing", "train") from error

OBSTACLE = "#ecd7ad"
EDGE = "#a9874a"

PATCH = 0.85
"""Half the side of the patch drawn of an endless plane [m]."""

THICKNESS = 0.03
"""The patch is drawn as a slab as thick as this [m]."""

SPHERE = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 12)] * 3), axis=-1).reshape(-1, 3)
SPHERE = SPHERE[np.abs(SPHERE).max(axis=1) == 1.0]
SPHERE = SPHERE / np.linalg.norm(SPHERE, axis=1, keepdims=True)
"""Unit vectors all around: the points of a cube's faces."""

NEAR = 0.6
"""Planes farther than this from everything shown are not drawn [m]: the floor under a seated person."""


@dataclass(frozen=True)
class Camera:
    """Carries world points to the page: orthographic, or with a distance in perspective.

    Attributes:
        origin: (3,) the point of the world that is at (0, 0) on the page [m].
        axes: (3, 3) rows: right on the page, up on the page, towards the viewer.
        distance: from the origin to the viewer [m].
    """

    origin: Float[np.ndarray, " 3"]
    axes: Float[np.ndarray, "3 3"]
    distance: float = float("inf")

    def page(self, points: Float[np.ndarray, "*b 3"]) -> Float[np.ndarray, "*b 2"]:
        """(…, 2) places on the page [m where the origin is]."""
        seen = (points - self.origin) @ self.axes.T
        return np.asarray(
            seen[..., :2] / np.maximum(1.0 - seen[..., 2:] / self.distance, 0.1)
        )  # in front of the viewer

    def depth(self, points: Float[np.ndarray, "*b 3"]) -> Float[np.ndarray, "*b"]:
        """(…) how much nearer to the viewer than the origin [m]."""
        return np.asarray((points - self.origin) @ self.axes[2])

    def towards(self, point: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
        """Direction from a point to the viewer."""
        away = self.axes[2] + (self.origin - point) / self.distance
        return np.asarray(away / np.linalg.norm(away))


def draw_obstacles(
    axes: Axes, camera: Camera, scene: Scene, start: float, end: float, shown: Float[np.ndarray, "K 3"]
) -> None:
    """Draw every obstacle where it is at the end, with a dashed outline where it was if it moved.

    Args:
        start, end: times on the scene's clock [s].
        shown: (K, 3) what else is on the picture [m]: planes are cut to a patch around it.
    """
    before, after = scene.rows(np.array([start, end]))
    for was, row in zip(before, after, strict=True):
        if not np.allclose(was, row):
            _solid(axes, camera, was, ghost=True)
    solids = [_patch(row, shown) if row[0] == HALF_SPACE else row for row in after]

    def order(row: Float[np.ndarray, " 17"]) -> tuple[int, float]:
        """What stands on something is drawn after it; then what is nearer after what is farther."""
        bottom = row[3] - np.abs(row[10:13]) @ row[13:16] - row[16]
        return round(50 * float(bottom)), float(camera.depth(row[1:4]))

    for solid in sorted((row for row in solids if row is not None), key=order):
        _solid(axes, camera, solid)


def _patch(row: Float[np.ndarray, " 17"], shown: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, " 17"] | None:
    """A half-space as the row of a flat box around what is shown; None if it is too far away to matter."""
    normal = row[4:7]
    above = (shown - row[1:4]) @ normal
    if np.nanmin(above, initial=np.inf) > NEAR:
        return None
    centre = np.nanmean(shown, axis=0)
    centre = centre - ((centre - row[1:4]) @ normal + THICKNESS / 2) * normal
    side = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    side /= np.linalg.norm(side)
    rotation = np.column_stack([side, np.cross(normal, side), normal])
    return np.concatenate([[1.0], centre, rotation.ravel(), [PATCH, PATCH, THICKNESS / 2, 0.0]])


def visible_faces(
    camera: Camera, centre: Float[np.ndarray, " 3"], rotation: Float[np.ndarray, "3 3"], half: Float[np.ndarray, " 3"]
) -> Iterator[tuple[Float[np.ndarray, " 3"], Float[np.ndarray, "4 3"]]]:
    """Outward normal and corners of each face that the camera sees of a box, `half` half its sides [m]."""
    for axis in range(3):
        for sign in (-1.0, 1.0):
            normal = sign * rotation[:, axis]
            middle = centre + half[axis] * normal
            if camera.towards(middle) @ normal <= 1e-9:
                continue
            u, v = (rotation[:, other] * half[other] for other in range(3) if other != axis)
            yield normal, np.stack([middle + u + v, middle + u - v, middle - u - v, middle - u + v])


def _solid(axes: Axes, camera: Camera, row: Float[np.ndarray, " 17"], ghost: bool = False) -> None:
    """A rounded box: its visible faces where it has no radius, else its outline."""
    centre, rotation, half, radius = row[1:4], row[4:13].reshape(3, 3), row[13:16], row[16]
    if radius == 0.0 and not ghost:
        for normal, corners in visible_faces(camera, centre, rotation, half):
            light = 0.86 + 0.14 * max(normal[2], 0.0)  # from above
            axes.add_patch(_polygon(camera.page(corners), light))
        return
    signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    corners = centre + signs * half @ rotation.T
    surface = (corners[:, None] + radius * SPHERE).reshape(-1, 3)
    flat = camera.page(surface)
    try:
        outline = flat[ConvexHull(flat).vertices]
    except QhullError:  # seen as a line or a point
        outline = flat
    axes.add_patch(_polygon(outline, 0.92, ghost))


def _polygon(corners: Float[np.ndarray, "K 2"], light: float, ghost: bool = False) -> Polygon:
    """A filled outline in the obstacles' colour, or a dashed one for a ghost."""
    if ghost:
        return Polygon(corners, fill=False, ec=EDGE, lw=1.0, ls=(0, (2, 2)), zorder=1.2)
    return Polygon(corners, fc=light * np.array(to_rgb(OBSTACLE)), ec=EDGE, lw=0.8, joinstyle="round", zorder=1)
