"""Predictions in motion, as GIFs: one and what came of it, or a recording predicted frame by frame."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from kinecast.errors import MissingExtraError, OptionError
from kinecast.evaluation.output import write_atomically
from kinecast.evaluation.palette import INK, RED
from kinecast.evaluation.pictures import (
    BODY,
    Moment,
    draw_moment,
    draw_time_bar,
    draw_title,
    fit,
    perspective,
    surroundings,
)
from kinecast.evaluation.plots import STYLE
from kinecast.evaluation.scenery import OBSTACLE
from kinecast.geometry.scene import Scene

try:
    import matplotlib as mpl
    from matplotlib.axes import Axes
    from matplotlib.colors import to_rgb
    from matplotlib.figure import Figure
    from PIL import Image
except ImportError as error:
    raise MissingExtraError("drawing", "train") from error

__all__ = ["animate_motion", "animate_prediction", "write_gif"]

SLOWER = 3.0
"""One prediction is played so many times slower than life."""

SAMPLES = 80
COLOURS = 128
LARGEST = 3_000_000
"""Bytes of a GIF: what a page loads without a pause."""


def animate_prediction(path: Path, moment: Moment, scene: Scene | None = None, title: str = "") -> None:
    """Play one moment as GIF, three times slower than life: the window seen, the prediction, what happened.

    Args:
        path: of the GIF, at most 3 MB.
        moment: what to play; without truth the mean alone goes on.
        scene: obstacles around the person.
        title: above the picture; any text.
    """
    seen, steps = len(moment.observed), len(moment.mean)
    camera, around = perspective([moment]), surroundings([moment])

    def figures() -> Iterator[Figure]:
        for frame in range(1, seen):
            figure, axes = _stage(title, moment.horizon, (frame - seen) * moment.dt)
            draw_moment(axes, camera, moment, scene, around, seen=frame)
            fit([axes], [camera], around)
            yield figure
        for step in range(-1, steps):
            figure, axes = _stage(title, moment.horizon, (step + 1) * moment.dt)
            draw_moment(axes, camera, moment, scene, around, most=SAMPLES, step=step)
            fit([axes], [camera], around)
            yield figure

    slow = SLOWER * moment.dt
    write_gif(path, figures(), [slow] * (seen - 1) + [6 * slow] + [slow] * (steps - 1) + [12 * slow])


def animate_motion(path: Path, moments: Sequence[Moment], scene: Scene | None = None, title: str = "") -> None:
    """Play a motion as GIF at its own speed, with the prediction made at every moment.

    Args:
        path: of the GIF, at most 3 MB.
        moments: one per picture, their stamps evenly apart.
        scene: obstacles around the person.
        title: above the picture; any text.

    Raises:
        OptionError: no moments.
    """
    if not moments:
        raise OptionError("moments: a picture needs at least one, found none")
    camera, around = perspective(moments), surroundings(moments)
    between = moments[1].stamp - moments[0].stamp if len(moments) > 1 else moments[0].dt

    def figures() -> Iterator[Figure]:
        for moment in moments:
            figure, axes = _stage(title, moment.horizon)
            draw_moment(axes, camera, moment, scene, around, most=SAMPLES)
            fit([axes], [camera], around)
            yield figure

    write_gif(path, figures(), [between] * len(moments))


def _stage(title: str, horizon: float, now: float | None = None) -> tuple[Figure, Axes]:
    """An empty picture; with the time now [s] it says what is going on."""
    figure = Figure(figsize=(6.4, 5.0), dpi=100, facecolor="white")
    axes = figure.add_axes((0.01, 0.11, 0.98, 0.80))
    axes.set_axis_off()
    draw_title(figure, title, 11.0)
    draw_time_bar(figure, (0.05, 0.065, 0.25, 0.018), horizon, now)
    if now is not None:
        what = "seen" if now < 0 else "prediction and what happened" if now > 0 else "prediction"
        figure.text(0.96, 0.055, f"{what}   {now:+.2f} s".replace("-", "−"), ha="right", fontsize=9.5)
    return figure, axes


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
    rgba = np.frombuffer(stream.getvalue(), np.uint8).reshape(height, width, 4)
    return Image.fromarray(np.ascontiguousarray(rgba[..., :3]))
