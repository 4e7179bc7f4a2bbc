"""Predictions drawn over a real motion: what was seen, where the arms may go, where they went; one, or a GIF."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float

from kinecast.errors import MissingExtraError
from kinecast.evaluation.metrics import WRISTS
from kinecast.evaluation.plots import BLUE, INK, MUTED, RED, STYLE, drawable, save_figure
from kinecast.evaluation.scenery import OBSTACLE, Camera, draw_obstacles
from kinecast.geometry.scene import Scene
from kinecast.output import write_atomically

try:
    import matplotlib as mpl
    from matplotlib.axes import Axes
    from matplotlib.collections import LineCollection
    from matplotlib.colors import LinearSegmentedColormap, to_rgb
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Polygon
    from matplotlib.patheffects import Normal, Stroke
    from PIL import Image
except ImportError as error:
    raise MissingExtraError("drawing", "train") from error

BODY = "#e6e9ed"
AHEAD = LinearSegmentedColormap.from_list("ahead", ["#86cdee", BLUE, "#43278c"])
"""Colour of a predicted point: light soon, dark late."""

TRUTH = RED
"""What happened: far from every colour of the prediction."""

SHOULDERS = (0, 3)
UP = np.array([0.0, 0.0, 1.0])

TALL = 0.4
"""The head ends so far above the shoulders [m]."""

SLOWER = 1.5
"""A GIF plays so many times slower than life: 20 pictures a second at 30 Hz."""

COLOURS = 256
LARGEST = 3_000_000
"""Bytes of a GIF: what a page loads without a pause."""


@dataclass(frozen=True)
class Moment:
    """One instant: the window seen, the prediction made from it, and what came of it.

    Attributes:
        observed: (N, 6, 3) arm joints over the window [m]; the last frame is now.
        samples: (S, T, 6, 3) predicted motions [m].
        mean: (T, 6, 3) their mean [m].
        truth: (T, 6, 3) what happened [m], NaN where unknown.
        dt: time between steps [s].
        stamp: time now on the clock of moving obstacles [s].
    """

    observed: Float[np.ndarray, "N 6 3"]
    samples: Float[np.ndarray, "S T 6 3"]
    mean: Float[np.ndarray, "T 6 3"]
    truth: Float[np.ndarray, "T 6 3"]
    dt: float
    stamp: float = 0.0

    @property
    def now(self) -> Float[np.ndarray, "6 3"]:
        """(6, 3) the last frame seen [m]."""
        return np.asarray(self.observed[-1])

    @property
    def horizon(self) -> float:
        """Time from now to the last predicted step [s]."""
        return self.dt * len(self.mean)

    @property
    def body(self) -> Float[np.ndarray, "3 3"]:
        """Rows: the person's forward and left, both level, and up."""
        across = (self.now[0] - self.now[3]) * (1.0, 1.0, 0.0)
        length = float(np.linalg.norm(across))
        left = across / length if length > 1e-6 else np.array([0.0, 1.0, 0.0])
        return np.stack([np.cross(left, UP), left, UP])

    @cached_property
    def around(self) -> Float[np.ndarray, "K 3"]:
        """(K, 3) what a picture must hold [m]: poses seen, predicted and true, the head, most samples."""
        parts = [self.observed, self.mean, self.truth, self.now[list(SHOULDERS)] + TALL * UP]
        if len(self.samples):
            parts.append(np.quantile(self.samples, (0.1, 0.9), axis=0))
        points = np.concatenate([part.reshape(-1, 3) for part in parts])
        return np.asarray(points[np.isfinite(points).all(axis=-1)])


def draw_prediction(path: Path, moment: Moment, scene: Scene | None = None, title: str = "") -> None:
    """Draw one moment as PNG: in perspective, from the front and from above.

    Args:
        path: of the PNG.
        moment: what to draw; at most 100 of its samples are.
        scene: obstacles around the person.
        title: above the picture; any text.
    """
    forward, left, up = moment.body
    foot = moment.now[list(SHOULDERS)].mean(axis=0) * (1.0, 1.0, 0.0)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.4, 5.9))
        main = figure.add_axes((0.01, 0.11, 0.64, 0.81))
        main.set_axis_off()
        camera = perspective(moment)
        _draw_moment(main, camera, moment, scene)
        _fit([main], [camera], moment.around)

        front, above = figure.add_axes((0.725, 0.56, 0.26, 0.36)), figure.add_axes((0.725, 0.1, 0.26, 0.36))
        cameras = Camera(foot, np.stack([left, up, forward])), Camera(foot, np.stack([left, forward, up]))
        for axes, camera in zip((front, above), cameras, strict=True):
            _draw_moment(axes, camera, moment, scene, scale=0.5)
            axes.tick_params(labelsize=8.5)
            axes.locator_params(nbins=5)
        _fit([front, above], cameras, moment.around)
        front.set_title("From the front", fontsize=9.5)
        front.set_ylabel("height [m]")
        front.tick_params(labelbottom=False)
        above.set_title("From above", fontsize=9.5)
        above.set_ylabel("forward [m]")
        above.set_xlabel("to the person's left [m]")
        above.invert_yaxis()  # the person faces the reader here as in the view from the front

        _draw_title(figure, title, 13.0)
        _legend(figure, scene, 0.225)
        _draw_time_bar(figure, (0.03, 0.075, 0.15, 0.016), moment.horizon)
    save_figure(figure, path)


def animate_predictions(path: Path, moments: Sequence[Moment], scene: Scene | None = None, title: str = "") -> None:
    """Play successive moments as GIF, a little slower than life, through a camera that stands still.

    Args:
        path: of the GIF, at most 3 MB.
        moments: what to play, one after another, `dt` apart.
        scene: obstacles around the person.
        title: above the picture; any text.
    """
    middle = moments[len(moments) // 2]
    camera, around = perspective(middle), np.concatenate([moment.around for moment in moments])

    def figures() -> Iterator[Figure]:
        for moment in moments:
            figure = Figure(figsize=(6.4, 5.0), dpi=130, facecolor="white")
            axes = figure.add_axes((0.01, 0.13, 0.98, 0.79))
            axes.set_axis_off()
            _draw_title(figure, title, 11.0)
            figure.text(0.97, 0.955, f"{moment.stamp:.2f} s", ha="right", va="center", fontsize=9.5)
            _draw_moment(axes, camera, moment, scene, scale=0.8, most=60)
            _fit([axes], [camera], around)
            _legend(figure, scene, 0.36)
            _draw_time_bar(figure, (0.05, 0.075, 0.22, 0.018), moment.horizon)
            yield figure

    write_gif(path, figures(), [SLOWER * middle.dt] * (len(moments) - 1) + [1.0])


def perspective(moment: Moment) -> Camera:
    """Seen from in front, a little to the person's left and from above."""
    forward, left, up = moment.body
    turn, rise = np.radians(32.0), np.radians(21.0)
    towards = np.cos(rise) * (np.cos(turn) * forward + np.sin(turn) * left) + np.sin(rise) * up
    right = np.cross(up, towards) / np.cos(rise)
    return Camera(moment.now.mean(axis=0), np.stack([right, np.cross(towards, right), towards]), distance=3.2)


def write_gif(path: Path, figures: Iterable[Figure], seconds: Sequence[float]) -> None:
    """Write figures as a looping GIF, smaller where that is needed to stay under the largest size."""
    with mpl.rc_context(STYLE):
        pictures = [_pixels(figure) for figure in figures]
    times = [max(20, round(100 * second) * 10) for second in seconds]  # a GIF counts in hundredths
    for shrink in (1.0, 0.8, 0.64, 0.5, 0.4):
        width, height = (round(shrink * side) for side in pictures[0].size)
        scaled = [picture.resize((width, height)) for picture in pictures] if shrink < 1.0 else pictures
        palette = _palette(scaled)
        frames = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in scaled]
        stream = io.BytesIO()
        frames[0].save(stream, "GIF", save_all=True, append_images=frames[1:], duration=times, loop=0, optimize=False)
        if stream.tell() <= LARGEST:
            break
    write_atomically(path, stream.getvalue())


def _palette(pictures: Sequence[Image.Image]) -> Image.Image:
    """A picture with the colours of all, found on three of them; large areas keep theirs exactly."""
    sheet = np.concatenate([np.asarray(pictures[k]) for k in (0, len(pictures) // 2, -1)])
    exact = [round(255 * value) for colour in ("white", BODY, OBSTACLE, INK, RED) for value in to_rgb(colour)]
    others = Image.fromarray(sheet).quantize(COLOURS - len(exact) // 3, method=Image.Quantize.MAXCOVERAGE)
    palette = Image.new("P", (1, 1))
    palette.putpalette([*exact, *(others.getpalette() or [])][: 3 * COLOURS])
    return palette


def _pixels(figure: Figure) -> Image.Image:
    """A figure as it looks."""
    stream = io.BytesIO()
    figure.savefig(stream, format="rgba", dpi=figure.dpi)
    width, height = (round(side) for side in figure.bbox.size)
    return Image.frombytes("RGBA", (width, height), stream.getvalue()).convert("RGB")


def _fit(pages: Sequence[Axes], cameras: Sequence[Camera], around: Float[np.ndarray, "K 3"]) -> None:
    """Choose limits that hold all points, with one scale for all pages, which are equally large."""
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


def _draw_moment(
    axes: Axes, camera: Camera, moment: Moment, scene: Scene | None, *, scale: float = 1.0, most: int = 100
) -> None:
    """Draw a moment, and obstacles where they are at its end, as a camera sees them.

    Args:
        scale: of line widths.
        most: samples to draw; more of them would add ink, not knowledge.
    """
    if scene is not None:
        draw_obstacles(axes, camera, scene, moment.stamp, moment.stamp + moment.horizon, moment.around)
    _silhouette(axes, camera, moment.now, scale)
    for age, pose in enumerate(moment.observed[-2::-1]):
        _arms(axes, camera, pose, MUTED, 2.0 * scale, alpha=0.45 * 0.75**age)
    _samples(axes, camera, moment, scale, most)
    _mean(axes, camera, moment, scale)
    _truth(axes, camera, moment, scale)
    _arms(axes, camera, moment.now, INK, 4.5 * scale, halo=True, joints=True)


def _draw_title(figure: Figure, title: str, size: float) -> None:
    """Write a title at the top left, smaller where it would not fit."""
    room = 72 * 0.96 * figure.get_figwidth() / (0.7 * max(len(title), 1))  # a bold letter is 0.7 of its size wide
    figure.text(0.02, 0.955, drawable(title), fontsize=min(size, room), weight="bold", va="center")


def _draw_time_bar(figure: Figure, place: tuple[float, float, float, float], horizon: float) -> None:
    """The colours of the time ahead [s]."""
    axes = figure.add_axes(place)
    axes.imshow(np.linspace(0, 1, 256)[None], cmap=AHEAD, aspect="auto", extent=(0, horizon, 0, 1))
    axes.set_yticks([])
    axes.set_xticks([0, horizon], ["now", f"{horizon:.2g} s ahead"], fontsize=8.5)
    axes.tick_params(length=0, pad=3)
    axes.spines[:].set_visible(False)


def _samples(axes: Axes, camera: Camera, moment: Moment, scale: float, most: int) -> None:
    """Wrist paths of the samples, coloured by time, and dots at their ends."""
    samples = moment.samples[:: max(1, -(-len(moment.samples) // most))]
    count, steps = samples.shape[:2]
    colours = np.tile(AHEAD(np.linspace(0, 1, steps)), (count, 1, 1))
    colours[..., 3] = min(1.0, 25.0 / max(count, 1))
    for wrist in WRISTS:
        paths = camera.page(_from_now(moment, samples, wrist))
        pieces = np.stack([paths[:, :-1], paths[:, 1:]], axis=2).swapaxes(0, 1).reshape(-1, 2, 2)  # late ones on top
        inks = colours.swapaxes(0, 1).reshape(-1, 4)
        axes.add_collection(LineCollection(list(pieces), colors=inks, lw=0.9 * scale, zorder=4))
        axes.plot(*paths[:, -1].T, "o", color=AHEAD(1.0), ms=3 * scale, mew=0, alpha=0.4, zorder=4)


def _mean(axes: Axes, camera: Camera, moment: Moment, scale: float) -> None:
    """Wrist paths of the mean, and its arms at their end."""
    colours = AHEAD(np.linspace(0, 1, len(moment.mean)))
    for wrist in WRISTS:
        path = camera.page(_from_now(moment, moment.mean, wrist))
        axes.plot(*path.T, color="white", lw=5 * scale, alpha=0.8, zorder=5)
        pieces = list(np.stack([path[:-1], path[1:]], axis=1))
        axes.add_collection(LineCollection(pieces, colors=colours, lw=2.6 * scale, zorder=5))
    _arms(axes, camera, moment.mean[-1], AHEAD(1.0), 3.0 * scale, halo=True, zorder=5)


def _truth(axes: Axes, camera: Camera, moment: Moment, scale: float) -> None:
    """Wrist paths that came, and the arms at their end."""
    for wrist in WRISTS:
        path = camera.page(_from_now(moment, moment.truth, wrist))
        axes.plot(*path.T, color="white", lw=3.8 * scale, zorder=6)
        axes.plot(*path.T, color=TRUTH, lw=1.8 * scale, zorder=6)
    _arms(axes, camera, moment.truth[-1], TRUTH, 2.4 * scale, zorder=6, halo=True)


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
) -> None:
    """Both arms of one pose as lines; what is NaN is left out."""
    effects = [Stroke(linewidth=width + 2.2, foreground="white"), Normal()] if halo else []
    flat = camera.page(pose)
    for arm in (flat[:3], flat[3:]):
        axes.plot(
            *arm.T, color=colour, lw=width, alpha=alpha, zorder=zorder, path_effects=effects, solid_joinstyle="round",
        )  # fmt: skip
    if joints:
        size, edge = 1.5 * width, 0.36 * width
        axes.plot(*flat.T, "o", mfc="white", mec=colour, ms=size, mew=edge, zorder=zorder)


def _silhouette(axes: Axes, camera: Camera, pose: Float[np.ndarray, "6 3"], scale: float) -> None:
    """A head and a trunk in light grey, to help the eye: a sketch from the shoulders, not tracked."""
    left, right = pose[list(SHOULDERS)]
    if not np.isfinite([left, right]).all():
        return
    middle, across = (left + right) / 2, (left - right) / 2
    trunk = np.stack([
        left, left - 0.5 * UP - 0.3 * across, right - 0.5 * UP + 0.3 * across, right,
        middle + 0.06 * UP - 0.7 * across, middle + 0.06 * UP + 0.7 * across,
    ])  # fmt: skip
    flat, (neck, crown) = camera.page(trunk), camera.page(np.stack([middle, middle + 0.27 * UP]))
    turn = np.linspace(0, 2 * np.pi, 60)
    head = crown + np.stack([0.078 * np.cos(turn), 0.1 * np.sin(turn)], axis=-1)
    for outline in (flat, np.stack([neck, crown]), head):
        axes.add_patch(Polygon(outline, fc=BODY, ec=BODY, lw=14 * scale, joinstyle="round", zorder=2))


def _from_now(moment: Moment, motion: Float[np.ndarray, "*S T 6 3"], joint: int) -> Float[np.ndarray, "*S T+1 3"]:
    """The path of one joint, from where it is now."""
    path = motion[..., joint, :]
    start = np.broadcast_to(moment.now[joint], (*path.shape[:-2], 1, 3))
    return np.concatenate([start, path], axis=-2)


def _legend(figure: Figure, scene: Scene | None, left: float) -> None:
    """Names for what is drawn, at the foot, from `left` on."""
    handles = [
        Line2D([], [], color=INK, lw=4, label="now"),
        Line2D([], [], color=MUTED, lw=2, alpha=0.7, label="before"),
        Line2D([], [], color=BLUE, lw=1, alpha=0.7, label="samples"),
        Line2D([], [], color=AHEAD(1.0), lw=3, label="mean"),
        Line2D([], [], color=TRUTH, lw=2.4, label="what happened"),
    ]
    if scene is not None and scene.obstacles:
        handles.append(Line2D([], [], color=OBSTACLE, lw=7, label="obstacle"))
    figure.legend(
        handles=handles, loc="lower left", bbox_to_anchor=(left, 0.0), ncols=3, frameon=False,
        fontsize=9, handlelength=1.6, columnspacing=1.6, handletextpad=0.6,
    )  # fmt: skip
