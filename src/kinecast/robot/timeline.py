"""An episode over time: distance and what is asked of it, speed, state, and what the person is after."""

from __future__ import annotations

import io
from itertools import pairwise
from pathlib import Path

import numpy as np

from kinecast.errors import MissingExtraError, OptionError
from kinecast.evaluation.output import write_atomically
from kinecast.evaluation.plots import INK, MUTED, RED, STYLE
from kinecast.robot.cell_picture import COLOURS
from kinecast.robot.episode import Episode
from kinecast.types import RobotState

try:
    import matplotlib as mpl
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch
except ImportError as error:
    raise MissingExtraError("drawing", "train") from error

__all__ = ["draw_timeline"]

STATES = {
    RobotState.MOVING: "#9fd3a8",
    RobotState.GRASPING: "#7fb4e6",
    RobotState.PLACING: "#b9a5e3",
    RobotState.SLOWED: "#f3e08a",
    RobotState.REPLANNING: "#f4b46a",
    RobotState.WAITING: "#c9ced4",
    RobotState.STOPPED: "#e78a7f",
    RobotState.DONE: "#ffffff",
}
"""Colour of each state's band."""
FARTHEST = 1.0
"""Distances are drawn up to here [m]."""


def draw_timeline(path: Path, episode: Episode, title: str = "") -> None:
    """Draw an episode over time as PNG.

    Args:
        path: of the PNG.
        episode: what happened.
        title: above the picture.

    Raises:
        OptionError: an episode without a step.
    """
    if not episode.ticks:
        raise OptionError("an episode without a step has no timeline")
    ticks = episode.ticks
    stamps = np.array([tick.stamp for tick in ticks])
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.5, 6.4), dpi=110)
        grid = figure.add_gridspec(4, 1, height_ratios=(0.35, 3, 1.4, 1.6), hspace=0.22, left=0.075, right=0.985,
                                   top=0.86, bottom=0.085)  # fmt: skip
        band, near, pace, chance = (figure.add_subplot(grid[row]) for row in range(4))
        near.plot(
            stamps,
            np.minimum([tick.distance for tick in ticks], FARTHEST),
            color=INK,
            lw=1.6,
            label="distance arm to person",
        )
        near.plot(stamps, np.minimum([tick.limit for tick in ticks], FARTHEST), color=RED, lw=1.2,
                  label="S_p that monitoring asks for")  # fmt: skip
        near.axhline(0.0, color=MUTED, lw=0.8)
        near.set_ylim(-0.02, FARTHEST + 0.02)
        near.set_ylabel("metres")
        near.legend(loc="upper right", frameon=False, fontsize=8.5, ncols=2)
        pace.fill_between(stamps, [tick.speed for tick in ticks], color="#9fd3a8", lw=0, step="post")
        pace.set_ylim(0, 1.05)
        pace.set_ylabel("speed share")
        seen = [scene.stamp for scene in episode.scenes]
        for name, colour in COLOURS.items():
            values = [scene.decision.taken.get(name, 0.0) for scene in episode.scenes]
            chance.plot(seen, values, color=colour, lw=1.5, label=name)
        chance.set_ylim(-0.03, 1.05)
        chance.set_ylabel("P(person\ntakes it)")
        chance.set_xlabel("seconds")
        edges = [
            0,
            *(np.flatnonzero([a.state is not b.state for a, b in pairwise(ticks)]) + 1),
            len(ticks),
        ]
        for first, last in pairwise(edges):
            end = stamps[min(last, len(ticks) - 1)]
            band.axvspan(stamps[first], end, color=STATES[ticks[first].state], lw=0)
        band.set_yticks([])
        for decision in episode.decisions:
            if decision.reaction is not None:
                for axes in (near, pace, chance):
                    axes.axvline(decision.stamp, color=MUTED, lw=1.0, ls=(0, (3, 2)))
                near.text(decision.stamp + 0.05, 0.86 * FARTHEST, decision.reaction.name.replace("_", " ").lower(),
                          fontsize=8, color=INK)  # fmt: skip
        for axes in (band, near, pace, chance):
            axes.set_xlim(stamps[0], stamps[-1])
            axes.tick_params(labelbottom=axes is chance, length=2)
        figure.legend(
            handles=[Patch(fc=colour, ec=MUTED, lw=0.4, label=state.name.lower()) for state, colour in STATES.items()],
            loc="upper left", bbox_to_anchor=(0.065, 0.945), ncols=8, frameon=False, fontsize=8.5, handlelength=1.1,
            columnspacing=1.2,
        )  # fmt: skip
        figure.text(0.02, 0.965, title, fontsize=12, weight="bold", va="center", color=INK)
        stream = io.BytesIO()
        figure.savefig(stream, format="png", facecolor="white")
    write_atomically(path, stream.getvalue())
