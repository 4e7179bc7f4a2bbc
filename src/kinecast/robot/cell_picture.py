"""The cell as a picture: arm, person, cubes, the region where wrists are predicted, and where the arm is going."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from kinecast.errors import MissingExtraError
from kinecast.evaluation.plots import INK
from kinecast.evaluation.scenery import Camera, draw_obstacles, visible_faces
from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Box
from kinecast.robot.cell import Cell
from kinecast.robot.episode import Pose, Scenery
from kinecast.robot.ur5 import UR5

try:
    from matplotlib.axes import Axes
    from matplotlib.colors import to_rgb
    from matplotlib.patches import Circle, FancyArrowPatch, Polygon
    from matplotlib.patheffects import Normal, Stroke
except ImportError as error:
    raise MissingExtraError("drawing", "train") from error

__all__ = ["CELL_VIEW", "COLOURS", "draw_cell"]

COLOURS = {"red": "#d4362c", "green": "#2a9d4b", "blue": "#2566c8"}
"""Of cubes, and of the arrow to each."""
REGION, REGION_EDGE = "#ffd23c", "#d99a00"
ARM, ARM_EDGE, GRIPPER = "#c3cad3", "#39424e", "#5d6875"
SKIN, SHIRT = "#e0b08c", "#8fa3b8"
HELD = 0.9
"""Share of the predicted wrists that the region holds."""
WIDE, HIGH = (-0.92, 1.12), (-0.60, 0.98)
"""What the picture shows [m on the page]."""


def _view() -> Camera:
    """From the arm's right and above, so that the arm is on the left and the person on the right."""
    towards = np.array([-0.25, -0.82, 0.62])
    towards /= np.linalg.norm(towards)
    right = np.cross([0.0, 0.0, 1.0], towards)
    right /= np.linalg.norm(right)
    return Camera(np.array([0.5, 0.0, 0.15]), np.stack([right, np.cross(towards, right), towards]), distance=4.0)


CELL_VIEW = _view()


def draw_cell(axes: Axes, arm: UR5, cell: Cell, scene: Scenery, scale: float = 1.0) -> None:
    """Draw one moment.

    Args:
        axes: to draw on.
        arm: the arm.
        cell: the table, and where cubes are to go.
        scene: the moment.
        scale: of line widths.
    """
    axes.set_axis_off()
    axes.set_aspect("equal")
    axes.set_xlim(*WIDE)
    axes.set_ylim(*HIGH)
    corners = cell.table.center + cell.table.size / 2 * np.array([[1, 1, 1], [-1, -1, 1.0]])
    draw_obstacles(axes, CELL_VIEW, Scene((cell.table,)), 0.0, 0.0, corners)
    for cube in cell.cubes:
        _place(axes, cube.place, cube.size, COLOURS.get(cube.name, INK))
    page = float(axes.get_window_extent().width) / (WIDE[1] - WIDE[0]) * 72 / axes.figure.dpi  # points per metre
    for name, position in scene.cubes.items():
        _cube(axes, position, cell.cube(name).size, COLOURS.get(name, INK))
    for person in scene.people:
        _person(axes, person, page)
    _region(axes, scene.region, scale)
    _arm(axes, arm, scene.q, page)
    _arrow(axes, scene, scale)


def _place(axes: Axes, point: Float[np.ndarray, "3"], size: float, colour: str) -> None:
    """An outline on the table."""
    half = 0.6 * size
    square = np.array([[half, half, 0], [half, -half, 0], [-half, -half, 0], [-half, half, 0]])
    flat = CELL_VIEW.page(point - [0.0, 0.0, size / 2] + square)
    axes.add_patch(Polygon(flat, fc="white", ec=colour, lw=1.4, alpha=0.8, zorder=1.5))


def _cube(axes: Axes, center: Float[np.ndarray, "3"], size: float, colour: str) -> None:
    """A cube with its visible faces."""
    base, rotation = np.array(to_rgb(colour)), Box(center, np.full(3, size)).rotation
    depth = 3.0 + 0.1 * float(CELL_VIEW.depth(center))
    for normal, corners in visible_faces(CELL_VIEW, center, rotation, np.full(3, size / 2)):
        light = 1.0 if normal[2] > 0.5 else 0.82 if abs(normal[1]) > 0.5 else 0.68
        face = CELL_VIEW.page(corners)
        axes.add_patch(Polygon(face, fc=tuple(base * light), ec="#00000055", lw=0.5, zorder=depth))


def _capsule(
    axes: Axes,
    start: Float[np.ndarray, "3"],
    end: Float[np.ndarray, "3"],
    width: float,
    colour: str,
    edge: str,
    zorder: float,
) -> None:
    """A thick round line with an edge; width in points."""
    flat = CELL_VIEW.page(np.stack([start, end + 1e-4]))
    effects = [Stroke(linewidth=width + 1.6, foreground=edge), Normal()]
    axes.plot(*flat.T, color=colour, lw=width, solid_capstyle="round", path_effects=effects, zorder=zorder)


def _arm(axes: Axes, arm: UR5, q: Float[np.ndarray, "6"], page: float) -> None:
    """Base and links, the farthest first."""
    start, end, radius = arm.pedestal
    capsules = arm.capsules(q[None])
    links = [(start, end, radius, ARM)]
    for a, b, r, k in zip(
        capsules.start[0], capsules.end[0], capsules.radius, range(len(capsules.radius)), strict=True
    ):
        links.append((a, b, float(r), ARM if k < len(capsules.radius) - 3 else GRIPPER))
    for a, b, r, colour in sorted(links, key=lambda link: float(CELL_VIEW.depth((link[0] + link[1]) / 2))):
        _capsule(axes, a, b, 1.5 * r * page, colour, ARM_EDGE, 5.0 + 0.1 * float(CELL_VIEW.depth((a + b) / 2)))


def _person(axes: Axes, person: Pose, page: float) -> None:
    """Trunk, head and arms."""
    places = dict(zip(person.joints, person.positions, strict=True))
    left, right = places["left_shoulder"], places["right_shoulder"]
    middle = (left + right) / 2
    hips = places.get("pelvis", middle - [0.0, 0.0, 0.5])
    head = places.get("head", middle + np.array([0.0, 0.0, 0.26]))
    _capsule(axes, middle - [0.0, 0.0, 0.05], hips, 0.26 * page, SHIRT, "#5f7286", 2.0)
    _capsule(axes, left, right, 0.13 * page, SHIRT, "#5f7286", 2.05)
    x, y = CELL_VIEW.page(head)
    axes.add_patch(Circle((float(x), float(y)), 0.085, fc=SKIN, ec="#8a6a52", lw=0.9, zorder=2.6))
    for side in ("left", "right"):
        shoulder, elbow, wrist = (places[f"{side}_{part}"] for part in ("shoulder", "elbow", "wrist"))
        line = wrist - elbow
        palm = wrist + 0.1 * line / max(float(np.linalg.norm(line)), 1e-6)
        near = 0.3 * float(CELL_VIEW.depth((elbow + wrist) / 2))
        _capsule(axes, shoulder, elbow, 0.085 * page, SHIRT, "#5f7286", 4.0 + near)
        _capsule(axes, elbow, wrist, 0.065 * page, SKIN, "#8a6a52", 4.1 + near)
        _capsule(axes, wrist, palm, 0.075 * page, SKIN, "#8a6a52", 4.2 + near)


def _region(axes: Axes, region: Float[np.ndarray, "S T 2 3"], scale: float) -> None:
    """The outline that holds most predicted wrists, one for each hand."""
    for hand in range(2):
        if region.size == 0:
            continue
        points = region[:, :, hand].astype(np.float64)
        if not np.isfinite(points).all():
            continue
        off = np.linalg.norm(points - points.mean(axis=0), axis=-1)
        kept = points[off <= np.quantile(off, HELD, axis=0)]
        flat = CELL_VIEW.page(kept)
        try:
            outline = flat[ConvexHull(flat).vertices]
        except QhullError:  # all in one place
            continue
        axes.add_patch(Polygon(outline, fc=REGION, ec="none", alpha=0.5, zorder=4.9))
        axes.add_patch(Polygon(outline, fill=False, ec=REGION_EDGE, lw=1.2 * scale, zorder=6.5))


def _arrow(axes: Axes, scene: Scenery, scale: float) -> None:
    """Where the fingertips are going, in the colour of the cube they go for."""
    if len(scene.way) < 2 or np.linalg.norm(scene.way[-1] - scene.way[0]) < 0.03:
        return
    colour = COLOURS.get(scene.decision.target or "", INK)
    flat = CELL_VIEW.page(scene.way)
    moved = np.linalg.norm(np.diff(flat, axis=0), axis=1) > 1e-4
    flat = flat[np.concatenate([[True], moved])]
    effects = [Stroke(linewidth=5.2 * scale, foreground="white"), Normal()]
    axes.plot(*flat[:-1].T, color=colour, lw=2.8 * scale, path_effects=effects, solid_capstyle="butt", zorder=7.5)
    head = FancyArrowPatch(
        tuple(flat[-2]), tuple(flat[-1]), arrowstyle="-|>", mutation_scale=17 * scale, color=colour, lw=2.8 * scale,
        shrinkA=0, shrinkB=0, zorder=7.6,
    )  # fmt: skip
    axes.add_patch(head)
