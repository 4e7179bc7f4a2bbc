"""Pictures of episodes: five moments of each, like the paper's figure; a GIF; and everything over time."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from kinecast.errors import MissingExtraError
from kinecast.evaluation.pictures import write_gif
from kinecast.evaluation.plots import INK, MUTED, RED, STYLE, save_figure
from kinecast.evaluation.scenery import Camera, draw_obstacles, visible_faces
from kinecast.geometry.scene import Scene
from kinecast.robot.body import TRUE_BODY, body_capsules
from kinecast.robot.cell import Cell
from kinecast.robot.colours import CUBE_COLOURS, SHIRT, SKIN, SKIN_PARTS, STATES, cube_colour, hex_of
from kinecast.robot.episode import Episode, SceneSnapshot
from kinecast.robot.ur5 import UR5
from kinecast.types import Decision, RobotState

try:
    import matplotlib as mpl
    from matplotlib.axes import Axes
    from matplotlib.colors import ListedColormap, to_rgb
    from matplotlib.figure import Figure
    from matplotlib.patches import FancyArrowPatch, Patch, Polygon
    from matplotlib.path import Path as PagePath
    from matplotlib.patheffects import Normal, Stroke
except ImportError as error:
    raise MissingExtraError("drawing", "train") from error

REGION, REGION_EDGE = "#ffd23c", "#d99a00"
ARM, GRIPPER, EDGE = "#c3cad3", "#5d6875", "#39424e"
HELD = 0.9  # share of the predicted wrists that the region holds
WIDE, HIGH = (-0.92, 1.12), (-0.60, 0.98)  # what the picture shows [m on the page]
SQUARE = np.array([[0.6, 0.6, -0.5], [0.6, -0.6, -0.5], [-0.6, -0.6, -0.5], [-0.6, 0.6, -0.5]])
"""Corners of a cube's place, of its edges."""
TOWARDS = np.array([-0.25, -0.82, 0.62]) / np.linalg.norm([-0.25, -0.82, 0.62])
RIGHT = np.array([0.82, -0.25, 0.0]) / np.hypot(0.82, 0.25)
VIEW = Camera(np.array([0.5, 0.0, 0.15]), np.stack([RIGHT, np.cross(TOWARDS, RIGHT), TOWARDS]), distance=4.0)
"""From the arm's right and above, so that the arm is on the left and the person on the right."""
MOMENTS = 5
RATE = 6.0  # pictures per second of a GIF
FARTHEST = 1.0  # distances are drawn up to here [m]


def key_moments(episode: Episode) -> list[SceneSnapshot]:
    """Five scenes: before the first reaction, at it, on the way, and when the next cube is grasped.

    Without a reaction they are evenly apart.
    """
    stamps = np.array([scene.stamp for scene in episode.scenes])
    reacted = _reaction(episode)
    times = np.linspace(stamps[0], stamps[-1], MOMENTS)
    if reacted is not None:
        closings = (each.stamp for each in episode.decisions if each.stamp > reacted.stamp
                    and each.state is RobotState.GRASPING and "Closing" in each.reason)  # fmt: skip
        way = next(closings, stamps[-1]) - reacted.stamp
        times = reacted.stamp + np.array([-0.45, 0.12, 0.3 * way, 0.6 * way, way + 0.1])
    return [episode.scenes[int(np.abs(stamps - time).argmin())] for time in times]


def _reaction(episode: Episode) -> Decision | None:
    """The first decision that changed cube or path."""
    return next((each for each in episode.decisions if each.reaction is not None), None)


def draw_storyboard(path: Path, episodes: Mapping[str, Episode], cell: Cell) -> None:
    """Draw episodes by their titles below one another, five moments each, as PNG."""
    arm, high, foot = UR5(), 3.05, 0.45  # heights of a row and the legend [inches]
    total = len(episodes) * high + foot
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(MOMENTS * high, total))
        for row, (title, episode) in enumerate(episodes.items()):
            top, reacted = 1.0 - row * high / total, _reaction(episode)
            figure.text(0.008, top - 0.20 / total, title, fontsize=11.5, weight="bold", va="center")
            for column, scene in enumerate(key_moments(episode)):
                left, bottom = column / MOMENTS + 0.004, top - (high - 0.42) / total
                axes = figure.add_axes((left, bottom, 1 / MOMENTS - 0.008, (high - 0.78) / total))
                draw_cell(axes, arm, cell, scene)
                said = reacted if reacted is not None and column == 1 else scene.decision
                name = f"({row + 1}{'abcde'[column]}) {scene.stamp:.1f} s  "
                caption = textwrap.fill(name + textwrap.shorten(said.reason, 92, placeholder=" …"), 50)
                figure.text(left + 0.004, bottom - 0.05 / total, caption, fontsize=7.6, va="top")
        handles = [Patch(fc=REGION, ec=REGION_EDGE, label="where the wrists are predicted, next 0.5 s")]
        handles += [Patch(fc=hex_of(colour), label=f"arrow: on its way for {name}")
                    for name, colour in CUBE_COLOURS.items()]  # fmt: skip
        figure.legend(handles=handles, loc="lower center", ncols=4, frameon=False, fontsize=9)
    save_figure(figure, path)


def animate_episode(path: Path, episode: Episode, cell: Cell, title: str) -> None:
    """Play the moments around the first reaction as GIF, at their own speed."""
    arm, moments = UR5(), key_moments(episode)
    chosen: list[SceneSnapshot] = []
    for scene in episode.scenes:
        around = moments[0].stamp - 1.0 <= scene.stamp <= moments[-1].stamp + 0.8
        if around and (not chosen or scene.stamp - chosen[-1].stamp >= 1.0 / RATE - 1e-6):
            chosen.append(scene)

    def figures() -> Iterator[Figure]:
        for scene in chosen:
            figure, decision = Figure(figsize=(6.2, 5.2), dpi=80, facecolor="white"), scene.decision
            draw_cell(figure.add_axes((0.0, 0.14, 1.0, 0.78)), arm, cell, scene)
            chance = "   ".join(f"{name} {100 * p:.0f} %" for name, p in decision.taken.items())
            reason = textwrap.shorten(decision.reason, 92, placeholder=" …")
            figure.text(0.02, 0.955, title, fontsize=11, weight="bold", va="center")
            state = f"{scene.stamp:5.1f} s   {decision.state.name.lower()}"
            figure.text(0.02, 0.115, state, fontsize=10, weight="bold")
            figure.text(0.02, 0.062, reason, fontsize=9)
            figure.text(0.02, 0.018, f"the person takes: {chance}", fontsize=8.5, color=MUTED)
            yield figure

    write_gif(path, figures(), [1.0 / RATE] * (len(chosen) - 1) + [1.5])


def draw_timeline(path: Path, episode: Episode, title: str) -> None:
    """Draw an episode over time as PNG: state, distance and what is asked of it, speed, what the person is after."""
    ticks, scenes, states = episode.ticks, episode.scenes, list(STATES)
    stamps = np.array([tick.stamp for tick in ticks])
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.5, 6.4))
        shape = {"height_ratios": (0.35, 3, 1.4, 1.6), "hspace": 0.22, "left": 0.075, "right": 0.985, "top": 0.86,
                 "bottom": 0.085}  # fmt: skip
        band, near, pace, chance = rows = figure.subplots(4, sharex=True, gridspec_kw=shape)
        band.imshow([[states.index(tick.state) for tick in ticks]], ListedColormap([hex_of(STATES[k]) for k in states]),
                    aspect="auto", extent=(stamps[0], stamps[-1], 0, 1), vmin=0, vmax=len(states) - 1)  # fmt: skip
        band.set_yticks([])
        for metres, colour, label in (
            ([tick.distance for tick in ticks], INK, "distance arm to person"),
            ([tick.limit for tick in ticks], RED, "S_p that monitoring asks for"),
        ):
            near.plot(stamps, np.minimum(metres, FARTHEST), color=colour, lw=1.4, label=label)
        near.set(ylim=(-0.02, FARTHEST + 0.02), ylabel="metres")
        near.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), frameon=False, fontsize=8.5, ncols=2)
        pace.fill_between(stamps, [tick.speed for tick in ticks], color=hex_of(STATES[RobotState.MOVING]), lw=0,
                          alpha=0.5, step="post")  # fmt: skip
        pace.set(ylim=(0, 1.05), ylabel="speed share")
        for name, rgb in CUBE_COLOURS.items():
            values = [scene.decision.taken.get(name, 0.0) for scene in scenes]
            chance.plot([scene.stamp for scene in scenes], values, color=hex_of(rgb), lw=1.5)
        chance.set(ylim=(-0.03, 1.05), ylabel="P(person\ntakes it)", xlabel="seconds", xlim=stamps[[0, -1]])
        for stamp, reaction in ((each.stamp, each.reaction) for each in episode.decisions):
            if reaction is not None:
                for axes in rows[1:]:
                    axes.axvline(stamp, color=MUTED, lw=1.0, ls=(0, (3, 2)))
                near.text(stamp + 0.05, 0.86 * FARTHEST, reaction.name.replace("_", " ").lower(), fontsize=8)
        figure.legend(
            handles=[Patch(fc=hex_of(colour), label=state.name.lower()) for state, colour in STATES.items()],
            loc="upper left", bbox_to_anchor=(0.065, 0.945), ncols=8, frameon=False, fontsize=8.5, handlelength=1.1,
            columnspacing=1.2,
        )  # fmt: skip
        figure.text(0.02, 0.965, title, fontsize=12, weight="bold", va="center")
    save_figure(figure, path)


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
    outlined = [Stroke(linewidth=4.5, foreground="white"), Normal()]
    axes.add_patch(FancyArrowPatch(
        path=PagePath(flat), arrowstyle="-|>", mutation_scale=15, color=hex_of(cube_colour(scene.decision.target)),
        lw=2.5, capstyle="butt", fill=True, path_effects=outlined, zorder=9.0,
    ))  # fmt: skip
