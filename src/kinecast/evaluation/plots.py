"""Charts of an evaluation: error over the horizon, NLL, coverage, violations. One look for every method.

Figures are built without a display and without global state. `save_figure` writes them; `figure_svg` gives
one for a web page, its ink following the page's text colour.
"""

from __future__ import annotations

import html
import io
import math
import re
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
from jaxtyping import Float

from kinecast.errors import MissingExtraError
from kinecast.output import write_atomically

try:
    import matplotlib as mpl
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.font_manager import findfont, get_font
except ImportError as error:
    raise MissingExtraError("drawing", "train") from error

INK = "#1b1f24"
"""Colour of text and axes; `figure_svg` turns it into the page's own."""

MUTED = "#808890"
"""Grid lines, references and remarks: legible on white and on black."""

# Okabe and Ito's colour-blind safe hues at a lightness for white and black pages. Trivial baselines are grey.
GREY, GOLD, GREEN, PINK, ORANGE, RED, SKY, BLUE, VIOLET = (
    "#878f99", "#a8862a", "#0f9d76", "#c0709c", "#d9901a", "#d95f1e", "#3f9fd6", "#1f78c8", "#8a6fd1",
)  # fmt: skip

LEAST_SPREAD = 0.01
"""Half the width of a histogram of values that hardly differ [nats]: a method without randomness repeats itself."""

with resources.as_file(resources.files("kinecast") / "data" / "plots.mplstyle") as _path:
    STYLE: dict[Any, Any] = mpl.rc_params_from_file(_path, use_default_template=False)

UNKNOWN = "–"
"""Shown for a value that is missing or not finite."""


@dataclass(frozen=True)
class MethodStyle:
    """How one method looks in every chart. Shape tells methods apart where colour does not."""

    colour: str
    marker: str
    dashes: tuple[float, ...] = ()
    width: float = 1.7


METHODS = {
    "zero_velocity": MethodStyle(GREY, "o", (1.0, 2.0)),
    "constant_velocity": MethodStyle(GREY, "s", (4.0, 2.0)),
    "damped_velocity": MethodStyle(GREY, "D"),
    "kalman": MethodStyle(GOLD, "v"),
    "ridge": MethodStyle(GREEN, "^"),
    "gp_xyz": MethodStyle(PINK, "P", (6.0, 2.0)),
    "gp_angles": MethodStyle(ORANGE, "X", (6.0, 2.0)),
    "gp_constrained": MethodStyle(RED, "*"),
    "kinecast": MethodStyle(BLUE, "o", width=2.6),
}
SPARE = tuple(
    MethodStyle(colour, marker, dashes)
    for dashes in ((), (2.0, 1.5))
    for colour, marker in ((SKY, "h"), (VIOLET, "d"), (GREEN, "<"), (PINK, ">"), (GOLD, "p"))
)


def method_style(name: str) -> MethodStyle:
    """The look of a method: always the same for the same name. `x_constrained` is x with dashes."""
    if name in METHODS:
        return METHODS[name]
    base = METHODS.get(name.removesuffix("_constrained"))
    if base is not None:
        return MethodStyle(base.colour, base.marker, (3.0, 1.5), base.width)
    return SPARE[zlib.crc32(name.encode()) % len(SPARE)]


def plot_over_horizon(
    values: Mapping[str, Sequence[float | None]], horizon: float, title: str, should_be: float | None = None
) -> Figure:
    """A line per method over the time ahead up to the horizon [s], None where unknown; one where values should be."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 4.2), layout="constrained")
        axes = figure.subplots()
        for name, heights in values.items():
            _line(axes, name, np.arange(1, len(heights) + 1) * horizon / len(heights), _floats(heights))
        if should_be is None:
            axes.set_ylim(bottom=0)
        else:
            axes.axhline(should_be, color=MUTED, lw=1, zorder=0)
        axes.set_xlim(left=0)
        axes.set_title(title)
        axes.set_xlabel("time ahead [s]")
        axes.grid(axis="y")
        _legend(axes)
    return figure


def plot_nll_histograms(nll: Mapping[str, Float[np.ndarray, "..."]], stderr: Mapping[str, float | None]) -> Figure:
    """Negative log likelihood by method: mean with standard error, and the histogram around that mean.

    Methods differ by far more than repeats of one method do, so each histogram is drawn around its own
    mean, all on the same scales, counts on a logarithmic one.

    Args:
        nll: by method, the values whose spread is to be shown: one per repeat, or per window.
        stderr: standard error of the mean, by method; where it is unknown that of the values.
    """
    rows = {name: values[np.isfinite(values)] for name, values in nll.items()}
    rows = {name: values for name, values in rows.items() if len(values)}
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 1.25 + 0.46 * max(len(rows), 1)), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(1.15, 1))
        _method_rows(left, list(rows))
        left.set_title("Mean NLL per joint [nats]")
        left.grid(axis="x")
        for row, (name, values) in enumerate(rows.items()):
            style = method_style(name)
            error = stderr.get(name)
            if error is None or not np.isfinite(error):
                error = float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else 0.0
            mean = float(values.mean())
            left.errorbar(mean, row, xerr=error, fmt=style.marker, color=style.colour, capsize=3, ms=6)
            text = f"{mean:.2f} ± {error:.2f}".replace("-", "−")
            left.annotate(text, (mean, row), (0, 7), textcoords="offset points", ha="center", fontsize=8)
        left.margins(x=0.18)
        _histogram_rows(right, rows)
    return figure


def plot_coverage(coverage: Mapping[str, Mapping[str, float | None]]) -> Figure:
    """Share of truths inside the region that should hold it, against that nominal share, e.g. `{"0.9": 0.87}`."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 4.6), layout="constrained")
        axes = figure.subplots()
        axes.plot([0.5, 1], [0.5, 1], color=MUTED, lw=1)
        axes.text(0.03, 0.97, "too cautious", color=MUTED, va="top")
        axes.text(0.97, 0.03, "too sure of itself", color=MUTED, ha="right")
        for name, shares in coverage.items():
            levels = sorted(shares, key=float)
            _line(axes, name, np.array(levels, float), _floats([shares[level] for level in levels]))
        axes.set_xlim(0, 1)
        axes.set_ylim(0, 1)
        axes.set_aspect("equal")
        axes.set_xlabel("share the region should hold")
        axes.set_title("Share of true positions inside")
        axes.grid()
        _legend(axes)
    return figure


def plot_violations(violations: Mapping[str, Mapping[str, float | None]], truth: Mapping[str, float | None]) -> Figure:
    """Share of steps outside position, speed and scene limits, per method and for what was measured."""
    rows = {"measured": truth, **violations}
    kinds = {"position": "out of range [%]", "speed": "too fast [%]", "scene": "in an obstacle [%]"}
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 1.2 + 0.32 * len(rows)), layout="constrained")
        panels = figure.subplots(1, 3, sharey=True)
        for axes, (kind, title) in zip(panels, kinds.items(), strict=True):
            drawn = np.nan_to_num(100 * _floats([shares.get(kind) for shares in rows.values()]), posinf=0.0)
            for row, (name, shares) in enumerate(rows.items()):
                face, edge = ("none", INK) if row == 0 else (method_style(name).colour, "none")
                axes.barh(row, drawn[row], height=0.62, facecolor=face, edgecolor=edge)
                axes.annotate(
                    percent(shares.get(kind)), (drawn[row], row), (4, 0), textcoords="offset points",
                    va="center", fontsize=8.5,
                )  # fmt: skip
            axes.set_xlim(0, 1.3 * drawn.max(initial=0.0) or 1.0)
            axes.set_title(title)
            axes.spines["bottom"].set_visible(False)
            axes.set_xticks([])
            _method_rows(axes, list(rows))
    return figure


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG on white, all or nothing."""
    with mpl.rc_context(STYLE):
        stream = io.BytesIO()
        figure.savefig(stream, format="png", facecolor="white")
    write_atomically(path, stream.getvalue())


def figure_svg(figure: Figure, title: str) -> str:
    """The figure as an `<svg>` element in the page's font and text colour; the title, any text, is read out instead."""
    stream = io.StringIO()
    with mpl.rc_context({**STYLE, "svg.hashsalt": title}):
        nothing = {"Date": None, "Creator": None, "Format": None, "Type": None}
        figure.savefig(stream, format="svg", transparent=True, metadata=nothing)
    svg = stream.getvalue()
    svg = svg[svg.index("<svg") :].replace(INK, "currentColor")
    svg = re.sub(r"font-family: [^;\"]*", "font-family: inherit", svg)
    svg = re.sub(r' id="[a-z0-9.]+_\d+"', "", svg)  # names of groups, which would repeat on a page
    svg = re.sub(r'width="[^"]*" height="[^"]*"', "", svg, count=1)
    width = f"max-width: {6.4 * figure.get_figwidth():.1f}rem"  # text as large as the page's small print
    return svg.replace("<svg ", f'<svg role="img" aria-label="{html.escape(title)}" style="{width}" ', 1)


def number(value: Any, digits: int) -> str:
    """The value with so many digits after the point; a dash where it is unknown."""
    return f"{value:.{digits}f}".replace("-", "−") if known(value) else UNKNOWN


def percent(share: Any, digits: int = 1) -> str:
    """A share in per cent; what would be rounded to zero without being it says so."""
    if known(share) and 0 < share < 0.5 * 10.0 ** (-digits - 2):
        return f"< {10.0**-digits:g}"
    return "0" if share == 0 else number(100 * share if known(share) else None, digits)


def known(value: object) -> TypeGuard[float]:
    """Whether a value is a finite number."""
    return isinstance(value, int | float) and math.isfinite(value)


def drawable(text: str) -> str:
    """The text with what the font cannot draw, control characters included, as boxes."""
    known = _letters()
    return "".join(letter if letter.isprintable() and ord(letter) in known else "□" for letter in text)


@cache
def _letters() -> frozenset[int]:
    """Code points the font can draw."""
    return frozenset(get_font(findfont(STYLE["font.family"][0])).get_charmap())


def _line(axes: Axes, name: str, x: Float[np.ndarray, " K"], y: Float[np.ndarray, " K"]) -> None:
    """One method's line through the values that are known."""
    known, style = np.isfinite(y), method_style(name)
    if known.any():
        axes.plot(
            x[known], y[known], style.marker, ls="-", ms=5, color=style.colour, lw=style.width,
            dashes=style.dashes or (None, None), label=drawable(name),
        )  # fmt: skip


def _legend(axes: Axes) -> None:
    """Names of lines, beside the axes."""
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, labelcolor="linecolor")


def _floats(values: Sequence[float | None]) -> Float[np.ndarray, " K"]:
    """Numbers, NaN for what is unknown."""
    return np.array([np.nan if value is None else float(value) for value in values])


def _method_rows(axes: Axes, names: Sequence[str]) -> None:
    """One row per name, the first on top."""
    axes.set_yticks(range(len(names)), [drawable(name) for name in names])
    axes.set_ylim(len(names) - 0.4, -0.75)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)


def _histogram_rows(axes: Axes, rows: Mapping[str, Float[np.ndarray, "..."]]) -> None:
    """A histogram per row, around its own mean, on common scales; heights grow with the count's logarithm."""
    away = {name: values - values.mean() for name, values in rows.items()}
    reach = max((float(np.quantile(np.abs(values), 0.995)) for values in away.values()), default=0.0)
    reach = max(reach, LEAST_SPREAD)
    edges = np.linspace(-1.08 * reach, 1.08 * reach, 42)
    counts = {name: np.histogram(values, edges)[0] for name, values in away.items()}
    tallest = max((int(count.max()) for count in counts.values()), default=1)
    for row, (name, count) in enumerate(counts.items()):
        height = 0.8 * np.log1p(count) / np.log1p(max(tallest, 1))
        axes.stairs(row + 0.3 - height, edges, baseline=row + 0.3, fill=True, color=method_style(name).colour)
        axes.axhline(row + 0.3, color=MUTED, lw=0.6)
    axes.set_ylim(len(rows) - 0.4, -0.75)
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)
    axes.set_title("Spread [nats], log counts")
    axes.grid(axis="x")
