"""An episode in five moments, like the paper's figure, and as a GIF."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinecast.errors import MissingExtraError, OptionError
from kinecast.evaluation.output import write_atomically
from kinecast.evaluation.pictures import write_gif
from kinecast.evaluation.plots import INK, MUTED, STYLE
from kinecast.robot.cell import Cell
from kinecast.robot.cell_picture import COLOURS, REGION, REGION_EDGE, draw_cell
from kinecast.robot.episode import Episode, Scenery
from kinecast.robot.ur5 import UR5
from kinecast.types import RobotState

try:
    import matplotlib as mpl
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch
except ImportError as error:
    raise MissingExtraError("drawing", "train") from error

__all__ = ["Row", "animate_episode", "draw_storyboard", "key_moments"]

MOMENTS = 5


@dataclass(frozen=True)
class Row:
    """One episode of a storyboard: its title and what happened."""

    title: str
    episode: Episode


def key_moments(episode: Episode) -> list[Scenery]:
    """Five scenes: before the first reaction, at it, on the way, and when the next cube is grasped.

    Without a reaction they are evenly apart.

    Raises:
        OptionError: an episode without a scene.
    """
    scenes = episode.scenes
    if not scenes:
        raise OptionError("an episode without a shot has no moments to show")
    stamps = np.array([scene.stamp for scene in scenes])
    reacted = next((each for each in episode.decisions if each.reaction is not None), None)
    if reacted is None:
        times = np.linspace(stamps[0], stamps[-1], MOMENTS)
    else:
        grasped = next(
            (
                each.stamp
                for each in episode.decisions
                if each.stamp > reacted.stamp and each.state is RobotState.GRASPING and "Closing" in each.reason
            ),
            float(stamps[-1]),
        )
        way = grasped - reacted.stamp
        times = reacted.stamp + np.array([-0.45, 0.12, 0.3 * way, 0.6 * way, way + 0.1])
    return [scenes[int(np.abs(stamps - time).argmin())] for time in times]


def draw_storyboard(path: Path, rows: Sequence[Row], cell: Cell, arm: UR5) -> None:
    """Draw episodes below one another, five moments each, as PNG.

    Args:
        path: of the PNG.
        rows: at least one.
        cell, arm: what is drawn.

    Raises:
        OptionError: no rows, or an episode without a scene.
    """
    if not rows:
        raise OptionError("a storyboard needs at least one episode")
    with mpl.rc_context(STYLE):
        width, high, foot = 3.05, 3.05, 0.45
        figure = Figure(figsize=(MOMENTS * width, len(rows) * high + foot), dpi=110)
        total = len(rows) * high + foot
        for place, row in enumerate(rows):
            top = 1.0 - place * high / total
            figure.text(0.008, top - 0.20 / total, row.title, fontsize=11.5, weight="bold", va="center", color=INK)
            reason = next((each.reason for each in row.episode.decisions if each.reaction is not None), None)
            for column, scene in enumerate(key_moments(row.episode)):
                left, bottom = column / MOMENTS, top - (high - 0.42) / total
                axes = figure.add_axes(
                    (left + 0.004, bottom, 1 / MOMENTS - 0.008, (high - 0.78) / total), label=f"{place}{column}"
                )
                draw_cell(axes, arm, cell, scene, 0.85)
                name = f"({place + 1}{'abcde'[column]})"
                said = textwrap.shorten(
                    reason if column == 1 and reason else scene.decision.reason, 92, placeholder=" …"
                )
                caption = "\n".join(textwrap.wrap(f"{name} {scene.stamp:.1f} s  {said}", 50))
                figure.text(left + 0.008, bottom - 0.05 / total, caption, fontsize=7.6, va="top", color=INK)
        _legend(figure, foot / total)
        stream = io.BytesIO()
        figure.savefig(stream, format="png", facecolor="white")
    write_atomically(path, stream.getvalue())


def animate_episode(path: Path, episode: Episode, cell: Cell, arm: UR5, title: str = "", rate: float = 6.0) -> None:
    """Play the moments around the first reaction as GIF, at their own speed.

    Args:
        path: of the GIF.
        episode: what to play.
        cell, arm: what is drawn.
        title: above the picture.
        rate: pictures per second.
    """
    moments = key_moments(episode)
    chosen: list[Scenery] = []
    for scene in episode.scenes:
        if moments[0].stamp - 1.0 <= scene.stamp <= moments[-1].stamp + 0.8 and (
            not chosen or scene.stamp - chosen[-1].stamp >= 1.0 / rate - 1e-6
        ):
            chosen.append(scene)

    def figures() -> Iterator[Figure]:
        for scene in chosen:
            figure = Figure(figsize=(6.2, 5.2), dpi=80, facecolor="white")
            axes = figure.add_axes((0.0, 0.14, 1.0, 0.78))
            draw_cell(axes, arm, cell, scene, 0.9)
            figure.text(0.02, 0.955, title, fontsize=11, weight="bold", va="center", color=INK)
            decision = scene.decision
            figure.text(
                0.02,
                0.115,
                f"{scene.stamp:5.1f} s   {decision.state.name.lower()}",
                fontsize=10,
                weight="bold",
                color=INK,
            )
            figure.text(0.02, 0.062, textwrap.shorten(decision.reason, 92, placeholder=" …"), fontsize=9, color=INK)
            chance = "   ".join(f"{name} {100 * p:.0f} %" for name, p in decision.taken.items())
            figure.text(0.02, 0.018, f"the person takes: {chance}", fontsize=8.5, color=MUTED)
            yield figure

    write_gif(path, figures(), [1.0 / rate] * (len(chosen) - 1) + [1.5])


def _legend(figure: Figure, foot: float) -> None:
    """What the colours mean."""
    handles = [Patch(fc=REGION, ec=REGION_EDGE, label="where the wrists are predicted, next 0.5 s")]
    handles += [Patch(fc=colour, label=f"arrow: on its way for {name}") for name, colour in COLOURS.items()]
    figure.legend(
        handles=handles, loc="lower center", bbox_to_anchor=(0.5, 0.1 * foot), ncols=4, frameon=False, fontsize=9
    )
