"""The cell as a picture: arm, person, cubes, the region where wrists are predicted, and where the arm is going."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from kinecast.errors import MissingExtraError
from kinecast.evaluation.scenery import Camera, draw_obstacles, visible_faces
from kinecast.geometry.scene import Scene
from kinecast.robot.body import TRUE_BODY, body_capsules
from kinecast.robot.cell import Cell
from kinecast.robot.colours import SHIRT, SKIN, SKIN_PARTS, cube_colour, hex_of
from kinecast.robot.episode import SceneSnapshot
from kinecast.robot.ur5 import UR5

try:
    from matplotlib.axes import Axes
    from matplotlib.colors import to_rgb
    from matplotlib.patches import FancyArrowPatch, Polygon
    from matplotlib.path import Path
    from matplotlib.patheffects import Normal, Stroke
except ImportError as error:
    raise MissingExtraError("drawing", "train") from error

__all__ = ["REGION", "REGION_EDGE", "draw_cell"]

REGION, REGION_EDGE = "#ffd23c", "#d99a00"
ARM, GRIPPER, EDGE = "#c3cad3", "#5d6875", "#39424e"
HELD = 0.9
"""Share of the predicted wrists that the region holds."""
WIDE, HIGH = (-0.92, 1.12), (-0.60, 0.98)
"""What the picture shows [m on the page]."""
SQUARE = np.array([[0.6, 0.6, -0.5], [0.6, -0.6, -0.5], [-0.6, -0.6, -0.5], [-0.6, 0.6, -0.5]])
"""Corners of a cube's place, of its edges."""
TOWARDS = np.array([-0.25, -0.82, 0.62]) / np.linalg.norm([-0.25, -0.82, 0.62])
RIGHT = np.array([0.82, -0.25, 0.0]) / np.hypot(0.82, 0.25)
VIEW = Camera(np.array([0.5, 0.0, 0.15]), np.stack([RIGHT, np.cross(TOWARDS, RIGHT), TOWARDS]), distance=4.0)
"""From the arm's right and above, so that the arm is on the left and the person on the right."""


def draw_cell(axes: Axes, arm: UR5, cell: Cell, scene: SceneSnapshot) -> None:
    """Draw one moment of an arm in a cell on axes."""
    axes.set_axis_off()
    axes.set(aspect="equal", xlim=WIDE, ylim=HIGH)
    corners = cell.table.center + cell.table.size / 2 * np.array([[1, 1, 1], [-1, -1, 1.0]])
    draw_obstacles(axes, VIEW, Scene((cell.table,)), 0.0, 0.0, corners)
    for cube in cell.cubes:
        colour = hex_of(cube_colour(cube.name))
        axes.add_patch(
            Polygon(VIEW.page(cube.place + cube.size * SQUARE), fc="white", ec=colour, lw=1.4, alpha=0.8, zorder=1.5)
        )
        _cube(axes, scene.cubes[cube.name], cube.size, colour)
    links, colours = arm.capsules(scene.q), [hex_of(SKIN if bare else SHIRT) for bare in SKIN_PARTS]
    _capsules(axes, np.concatenate([arm.pedestal[None], links]), [ARM] * (len(links) - 2) + [GRIPPER] * 3)
    for joints, positions in scene.people:
        _capsules(axes, body_capsules(joints, positions, TRUE_BODY), colours)
    for hand in range(2):
        _region(axes, scene.region[:, :, hand].astype(np.float64))
    _arrow(axes, scene)


def _height(point: Float[np.ndarray, "3"]) -> float:
    """Where a thing comes in the order of drawing: the nearer to the viewer the later."""
    return 5.0 + float(VIEW.depth(point))


def _cube(axes: Axes, center: Float[np.ndarray, "3"], size: float, colour: str) -> None:
    """A cube with its visible faces."""
    for normal, corners in visible_faces(VIEW, center, np.eye(3), np.full(3, size / 2)):
        light = 1.0 if normal[2] > 0.5 else 0.82 if abs(normal[1]) > 0.5 else 0.68
        shade = tuple(light * np.array(to_rgb(colour)))
        axes.add_patch(Polygon(VIEW.page(corners), fc=shade, ec="#00000055", lw=0.5, zorder=_height(center)))


def _capsules(axes: Axes, capsules: Float[np.ndarray, "K 7"], colours: Iterable[str]) -> None:
    """As thick round lines with an edge."""
    points = float(axes.get_window_extent().width) / (WIDE[1] - WIDE[0]) * 72 / axes.figure.dpi  # per metre
    for row, colour in zip(capsules, colours, strict=True):
        if not np.isfinite(row).all():
            continue
        start, end = row[:3], row[3:6]
        flat, width = VIEW.page(np.stack([start, end + 1e-4])), 1.7 * row[6] * points
        effects = [Stroke(linewidth=width + 1.6, foreground=EDGE), Normal()]
        axes.plot(*flat.T, color=colour, lw=width, solid_capstyle="round", path_effects=effects,
                  zorder=_height((start + end) / 2))  # fmt: skip


def _region(axes: Axes, points: Float[np.ndarray, "S T 3"]) -> None:
    """The outline that holds most predicted places of a wrist."""
    if points.size == 0 or not np.isfinite(points).all():
        return
    off = np.linalg.norm(points - points.mean(axis=0), axis=-1)
    flat = VIEW.page(points[off <= np.quantile(off, HELD, axis=0)])
    try:
        outline = flat[ConvexHull(flat).vertices]
    except QhullError:  # all in one place
        return
    axes.add_patch(Polygon(outline, fc=REGION, ec="none", alpha=0.4, zorder=8.0))
    axes.add_patch(Polygon(outline, fill=False, ec=REGION_EDGE, zorder=8.0))


def _arrow(axes: Axes, scene: SceneSnapshot) -> None:
    """Where the fingertips are going, in the colour of the cube they go for."""
    if len(scene.way) < 2 or np.linalg.norm(scene.way[-1] - scene.way[0]) < 0.03:
        return
    flat = VIEW.page(scene.way)
    flat = flat[np.append(True, np.linalg.norm(np.diff(flat, axis=0), axis=1) > 1e-4)]
    axes.add_patch(FancyArrowPatch(
        path=Path(flat), arrowstyle="-|>", mutation_scale=15, color=hex_of(cube_colour(scene.decision.target)), lw=2.5,
        capstyle="butt", fill=True, path_effects=[Stroke(linewidth=4.5, foreground="white"), Normal()], zorder=9.0,
    ))  # fmt: skip
