"""A prediction drawn over a real motion: what was seen, where the arms may go, where they went."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from kinecast.errors import MissingExtraError
from kinecast.evaluation.output import write_atomically
from kinecast.evaluation.palette import BLUE, INK, MUTED, RED
from kinecast.evaluation.plots import STYLE, drawable
from kinecast.evaluation.scenery import OBSTACLE, Camera, draw_obstacles
from kinecast.geometry.scene import Scene

try:
    import matplotlib as mpl
    from matplotlib.axes import Axes
    from matplotlib.collections import LineCollection
    from matplotlib.colors import LinearSegmentedColormap, to_rgba
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Polygon
    from matplotlib.patheffects import Normal, Stroke
except ImportError as error:
    raise MissingExtraError("drawing", "train") from error

__all__ = ["Moment", "draw_prediction"]

BODY = "#e6e9ed"
AHEAD = LinearSegmentedColormap.from_list("ahead", ["#86cdee", BLUE, "#43278c"])
"""Colour of a predicted point: light soon, dark late."""

DASHES = (0, (2.2, 1.3))

WRISTS = (2, 5)
SHOULDERS = (0, 3)
MOST_SAMPLES = 150
"""Drawing more samples than this adds ink, not knowledge."""

TALL = 0.4
"""The head ends so far above the shoulders [m]."""


@dataclass(frozen=True)
class Moment:
    """One instant: the window seen, the prediction made from it, and what came of it.

    Attributes:
        observed: (N, 6, 3) arm joints over the window [m]; the last frame is now.
        samples: (S, T, 6, 3) predicted motions [m].
        mean: (T, 6, 3) their mean [m].
        dt: time between steps [s].
        truth: (T, 6, 3) what happened [m], NaN where unknown; None if nothing is known.
        outside: (S, T), or (S, T, 6) joint by joint: True where a sample breaks a limit. From there on
            both arms, or the one concerned, are drawn in the colour of errors.
        stamp: time now on the clock of moving obstacles [s].
    """

    observed: Float[np.ndarray, "N 6 3"]
    samples: Float[np.ndarray, "S T 6 3"]
    mean: Float[np.ndarray, "T 6 3"]
    dt: float
    truth: Float[np.ndarray, "T 6 3"] | None = None
    outside: Bool[np.ndarray, "S T"] | Bool[np.ndarray, "S T 6"] | None = None
    stamp: float = 0.0

    @property
    def now(self) -> Float[np.ndarray, "6 3"]:
        """(6, 3) the last frame seen [m]."""
        last: np.ndarray = self.observed[-1]
        return last

    @property
    def horizon(self) -> float:
        """Time from now to the last predicted step [s]."""
        return self.dt * len(self.mean)

    @property
    def body(self) -> Float[np.ndarray, "3 3"]:
        """Rows: the person's forward and left, both level, and up."""
        across = (self.now[0] - self.now[3]) * (1.0, 1.0, 0.0)
        length = float(np.linalg.norm(across))
        left: np.ndarray = across / length if length > 1e-6 else np.array([0.0, 1.0, 0.0])
        up = np.array([0.0, 0.0, 1.0])
        return np.stack([np.cross(left, up), left, up])


def draw_prediction(path: Path, moment: Moment, scene: Scene | None = None, title: str = "") -> None:
    """Draw one moment as PNG: in perspective, from the front and from above.

    Args:
        path: of the PNG.
        moment: what to draw; at most 150 of its samples are.
        scene: obstacles around the person.
        title: above the picture; any text.
    """
    around = surroundings([moment])
    forward, left, up = moment.body
    foot = moment.now[list(SHOULDERS)].mean(axis=0) * (1.0, 1.0, 0.0)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.4, 5.9))
        main = figure.add_axes((0.01, 0.11, 0.64, 0.81))
        main.set_axis_off()
        camera = perspective([moment])
        draw_moment(main, camera, moment, scene, around)
        fit([main], [camera], around)

        front, above = figure.add_axes((0.725, 0.56, 0.26, 0.36)), figure.add_axes((0.725, 0.1, 0.26, 0.36))
        cameras = Camera(foot, np.stack([left, up, forward])), Camera(foot, np.stack([left, forward, up]))
        for axes, camera in zip((front, above), cameras, strict=True):
            draw_moment(axes, camera, moment, scene, around, scale=0.5)
            axes.tick_params(labelsize=8.5)
        fit([front, above], cameras, around)
        front.set_title("From the front", fontsize=9.5)
        front.set_ylabel("height [m]")
        front.tick_params(labelbottom=False)
        above.set_title("From above", fontsize=9.5)
        above.set_ylabel("forward [m]")
        above.set_xlabel("to the person's left [m]")
        above.invert_yaxis()  # the person faces the reader here as in the view from the front

        draw_title(figure, title, 13.0)
        _legend(figure, moment, scene)
        draw_time_bar(figure, (0.03, 0.075, 0.15, 0.016), moment.horizon)
        stream = io.BytesIO()
        figure.savefig(stream, format="png", facecolor="white")
    write_atomically(path, stream.getvalue())


def perspective(shown: Sequence[Moment]) -> Camera:
    """Seen from in front, a little to the person's left and from above; one camera for all moments."""
    forward, left, up = shown[len(shown) // 2].body
    turn, rise = np.radians(32.0), np.radians(21.0)
    towards = np.cos(rise) * (np.cos(turn) * forward + np.sin(turn) * left) + np.sin(rise) * up
    right = np.cross(up, towards) / np.cos(rise)
    middle = np.mean([moment.now.mean(axis=0) for moment in shown], axis=0)
    return Camera(middle, np.stack([right, np.cross(towards, right), towards]), distance=3.2)


def surroundings(shown: Sequence[Moment]) -> Float[np.ndarray, "K 3"]:
    """(K, 3) what a picture must hold [m]: poses seen, predicted and true, heads, most samples."""
    parts = []
    for moment in shown:
        head = moment.now[list(SHOULDERS)] + np.array([0.0, 0.0, TALL])
        parts += [moment.observed, moment.mean, head[None]]
        if len(moment.samples):
            parts.append(np.quantile(moment.samples, (0.02, 0.98), axis=0))
        if moment.truth is not None:
            parts.append(moment.truth)
    points = np.concatenate([part.reshape(-1, 3) for part in parts])
    known: np.ndarray = points[np.isfinite(points).all(axis=-1)]
    return known


def fit(pages: Sequence[Axes], cameras: Sequence[Camera], around: Float[np.ndarray, "K 3"]) -> None:
    """Choose limits that hold all points around, with one scale for all pages, which are equally large."""
    flat = [camera.page(around) for camera in cameras]
    half = np.max([places.max(axis=0) - places.min(axis=0) for places in flat], axis=0) / 2
    half = half + 0.12 * half.max()
    page = np.diff(pages[0].get_position().get_points() * pages[0].figure.bbox.size, axis=0)[0]
    half = page * np.max(half / page)
    for axes, places in zip(pages, flat, strict=True):
        middle = (places.max(axis=0) + places.min(axis=0)) / 2
        axes.set_aspect("equal")
        axes.set_xlim(middle[0] - half[0], middle[0] + half[0])
        axes.set_ylim(middle[1] - half[1], middle[1] + half[1])


def draw_moment(
    axes: Axes,
    camera: Camera,
    moment: Moment,
    scene: Scene | None,
    around: Float[np.ndarray, "K 3"],
    *,
    scale: float = 1.0,
    most: int = MOST_SAMPLES,
    seen: int | None = None,
    step: int | None = None,
) -> None:
    """Draw a moment as a camera sees it.

    Args:
        axes: to draw on.
        camera: the view.
        moment: what to draw.
        scene: obstacles, where they are at the time that is shown.
        around: (K, 3) what else the picture holds [m]: endless planes are drawn around it.
        scale: of line widths.
        most: samples to draw.
        seen: only the first so many frames of the window, and no prediction.
        step: only the poses predicted and measured at this step, −1 for now; None for all in one picture.
    """
    observed = moment.observed if seen is None else moment.observed[:seen]
    now = observed[-1]
    ahead = 0.0 if seen is not None else moment.horizon if step is None else (step + 1) * moment.dt
    if scene is not None:
        draw_obstacles(axes, camera, scene, moment.stamp, moment.stamp + ahead, around)
    if seen is None and step is not None and step >= 0 and moment.truth is not None:
        now = moment.truth[step]
    _silhouette(axes, camera, now, scale)
    for age, pose in enumerate(observed[-2::-1]):
        _arms(axes, camera, pose, MUTED, 2.0 * scale, alpha=0.45 * 0.75**age)
    if seen is None:
        shown = len(moment.mean) - 1 if step is None else step
        _samples(axes, camera, moment, shown, scale, most)
        _mean(axes, camera, moment, shown, scale)
        if step is None and moment.truth is not None:
            _truth(axes, camera, moment, moment.truth, scale)
    _arms(axes, camera, now, INK, 4.5 * scale, halo=True, joints=True)


def draw_title(figure: Figure, title: str, size: float) -> None:
    """Write a title at the top left, smaller where it would not fit."""
    room = 72 * 0.96 * figure.get_figwidth() / (0.7 * max(len(title), 1))  # a bold letter is 0.7 of its size wide
    figure.text(0.02, 0.955, drawable(title), fontsize=min(size, room), weight="bold", va="center")


def draw_time_bar(
    figure: Figure, place: tuple[float, float, float, float], horizon: float, now: float | None = None
) -> None:
    """The colours of the time ahead, with a mark where the picture is.

    Args:
        figure: to draw on.
        place: left, bottom, width, height on it.
        horizon: of the prediction [s].
        now: time of the picture [s]; no mark for None or before 0.
    """
    axes = figure.add_axes(place)
    axes.imshow(np.linspace(0, 1, 256)[None], cmap=AHEAD, aspect="auto", extent=(0, horizon, 0, 1))
    axes.set_yticks([])
    axes.set_xticks([0, horizon], ["now", f"{horizon:.2g} s ahead"], fontsize=8.5)
    axes.tick_params(length=0, pad=3)
    axes.spines[:].set_visible(False)
    if now is not None and now >= 0:
        axes.plot([now], [1.5], "v", color=INK, ms=7, clip_on=False)
    axes.set_xlim(0, horizon)
    axes.set_ylim(0, 1)


def _samples(axes: Axes, camera: Camera, moment: Moment, shown: int, scale: float, most: int) -> None:
    """Wrist paths of the samples, coloured by time; dots, or crosses outside limits, at the step shown."""
    every = max(1, -(-len(moment.samples) // most))
    samples = moment.samples[::every]
    count, steps = samples.shape[:2]
    outside = np.zeros((count, steps, 6), bool)
    if moment.outside is not None:
        outside |= np.atleast_3d(moment.outside[::every])
    faint = min(1.0, 30.0 / max(count, 1))
    for wrist in WRISTS:
        broken = np.maximum.accumulate(outside[..., wrist - 2 : wrist + 1].any(axis=-1), axis=1)
        paths = camera.page(_from_now(moment, samples, wrist))
        pieces = np.stack([paths[:, :-1], paths[:, 1:]], axis=2).reshape(-1, 2, 2)
        colours = np.tile(AHEAD(np.linspace(0, 1, steps)), (count, 1, 1))
        colours[..., 3] = faint
        colours[broken] = to_rgba(RED, min(1.0, 2 * faint))
        order = np.argsort((broken * steps + np.arange(steps)).ravel(), kind="stable")  # late and red on top
        lines = LineCollection(list(pieces[order]), colors=colours.reshape(-1, 4)[order], lw=1.1 * scale, zorder=4)
        axes.add_collection(lines)
        if shown >= 0:
            ends, bad = paths[:, shown + 1], broken[:, shown]
            colour = AHEAD((shown + 1) / steps)
            axes.plot(*ends[~bad].T, "o", color=colour, ms=3 * scale, mew=0, alpha=0.4, zorder=4)
            axes.plot(*ends[bad].T, "x", color=RED, ms=5 * scale, mew=1.2 * scale, alpha=0.85, zorder=8)


def _mean(axes: Axes, camera: Camera, moment: Moment, shown: int, scale: float) -> None:
    """Wrist paths of the mean, and its arms at the step shown."""
    steps = len(moment.mean)
    for wrist in WRISTS:
        path = camera.page(_from_now(moment, moment.mean, wrist))
        pieces = list(np.stack([path[:-1], path[1:]], axis=1))
        axes.plot(*path.T, color="white", lw=5 * scale, alpha=0.8, zorder=5)
        axes.add_collection(LineCollection(pieces, colors=AHEAD(np.linspace(0, 1, steps)), lw=2.6 * scale, zorder=5))
    if shown >= 0:
        colour = AHEAD((shown + 1) / steps)
        _arms(axes, camera, moment.mean[shown], colour, 3.0 * scale, halo=True, zorder=5)


def _truth(axes: Axes, camera: Camera, moment: Moment, truth: Float[np.ndarray, "T 6 3"], scale: float) -> None:
    """Wrist paths that came, and the arms at their end, dashed."""
    for wrist in WRISTS:
        path = camera.page(_from_now(moment, truth, wrist))
        axes.plot(*path.T, color="white", lw=3.4 * scale, zorder=6)
        axes.plot(*path.T, color=INK, lw=1.6 * scale, ls=DASHES, zorder=6)
    _arms(axes, camera, truth[-1], INK, 1.6 * scale, zorder=6, dashed=True)


def _arms(
    axes: Axes,
    camera: Camera,
    pose: Float[np.ndarray, "6 3"],
    colour: str | tuple[float, ...],
    width: float,
    *,
    alpha: float = 1.0,
    zorder: int = 7,
    halo: bool = False,
    joints: bool = False,
    dashed: bool = False,
) -> None:
    """Both arms of one pose as lines; what is NaN is left out."""
    effects = [Stroke(linewidth=width + 2.2, foreground="white"), Normal()] if halo else []
    flat = camera.page(pose)
    for arm in (flat[:3], flat[3:]):
        axes.plot(
            *arm.T, color=colour, lw=width, alpha=alpha, zorder=zorder, path_effects=effects,
            ls=DASHES if dashed else "-", solid_joinstyle="round",
        )  # fmt: skip
    if joints:
        size, edge = 1.5 * width, 0.36 * width
        axes.plot(*flat.T, "o", mfc="white", mec=colour, ms=size, mew=edge, zorder=zorder)


def _silhouette(axes: Axes, camera: Camera, pose: Float[np.ndarray, "6 3"], scale: float) -> None:
    """A head and a trunk in light grey, to help the eye: a sketch from the shoulders, not tracked."""
    left, right = pose[list(SHOULDERS)]
    if not np.isfinite([left, right]).all():
        return
    middle, across, up = (left + right) / 2, (left - right) / 2, np.array([0.0, 0.0, 1.0])
    trunk = np.stack([
        left, left - 0.5 * up - 0.3 * across, right - 0.5 * up + 0.3 * across, right,
        middle + 0.06 * up - 0.7 * across, middle + 0.06 * up + 0.7 * across,
    ])  # fmt: skip
    flat, (neck, crown) = camera.page(trunk), camera.page(np.stack([middle, middle + 0.27 * up]))
    turn = np.linspace(0, 2 * np.pi, 60)
    head = crown + np.stack([0.078 * np.cos(turn), 0.1 * np.sin(turn)], axis=-1)
    for outline in (flat, np.stack([neck, crown]), head):
        axes.add_patch(Polygon(outline, fc=BODY, ec=BODY, lw=14 * scale, joinstyle="round", zorder=2))


def _from_now(moment: Moment, motion: Float[np.ndarray, "*S T 6 3"], joint: int) -> Float[np.ndarray, "*S T+1 3"]:
    """The path of one joint, from where it is now."""
    path = motion[..., joint, :]
    start = np.broadcast_to(moment.now[joint], (*path.shape[:-2], 1, 3))
    return np.concatenate([start, path], axis=-2)


def _legend(figure: Figure, moment: Moment, scene: Scene | None) -> None:
    """Names for what is drawn, at the foot."""
    handles = [
        Line2D([], [], color=INK, lw=4, label="now"),
        Line2D([], [], color=MUTED, lw=2, alpha=0.7, label="before"),
        Line2D([], [], color=BLUE, lw=1, alpha=0.7, label="samples"),
        Line2D([], [], color=AHEAD(1.0), lw=3, label="mean"),
    ]
    if moment.truth is not None:
        handles.append(Line2D([], [], color=INK, lw=1.6, ls=DASHES, label="what happened"))
    if moment.outside is not None and moment.outside.any():
        handles.append(Line2D([], [], color=RED, lw=1.2, marker="x", ms=5, label="breaks a limit"))
    if scene is not None and scene.obstacles:
        handles.append(Line2D([], [], color=OBSTACLE, lw=7, label="obstacle"))
    figure.legend(
        handles=handles, loc="lower left", bbox_to_anchor=(0.225, 0.0), ncols=4, frameon=False,
        fontsize=9, handlelength=1.6, columnspacing=1.6, handletextpad=0.6,
    )  # fmt: skip
