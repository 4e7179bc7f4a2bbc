"""The tables of an evaluation: as HTML cells for the report, and as text for a terminal.

Everything that comes from outside (names of methods and recordings, settings) is escaped. A value that is
missing, null or not finite is a dash.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any, TypeGuard

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from kinecast.evaluation.palette import method_style

__all__ = [
    "coverage_table",
    "format_table",
    "limits_table",
    "main_table",
    "mapping",
    "moving_table",
    "number",
    "recordings_scores_table",
    "recordings_table",
    "settings_table",
]

Metrics = Mapping[str, Any]

UNKNOWN = "–"
LEVELS = ("0.5", "0.8", "0.9", "0.95", "0.99")
LIMITS = ("position", "speed", "scene")


@dataclass(frozen=True)
class _Score:
    """A column of the main table.

    Attributes:
        title, unit: of its head.
        path: keys that lead to the value in a method's metrics.
        digits: after the point.
        times: factor, e.g. 100 for per cent.
        stderr: key of its standard error.
        ideal: the value nearest to this is best: −inf for less is better; None for no best.
    """

    title: str
    unit: str
    path: tuple[str, ...]
    digits: int
    times: float = 1.0
    stderr: str = ""
    ideal: float | None = -math.inf


SCORES = (
    _Score("MPJPE", "mm", ("mpjpe_mm",), 1, stderr="mpjpe_mm_stderr"),
    _Score("moving", "mm", ("moving_mpjpe_mm",), 1),
    _Score("final wrist", "mm", ("wrist_final_mm",), 1),
    _Score("NLL", "nats", ("nll",), 2, stderr="nll_stderr"),
    _Score("KDE-NLL", "nats", ("kde_nll",), 2),
    _Score("CRPS", "mm", ("crps_mm",), 1),
    _Score("energy", "mm", ("energy_score_mm",), 1),
    _Score("coverage", "at 90 %", ("coverage", "0.9"), 1, times=100.0, ideal=90.0),
    _Score("region", "litres", ("calibrated_region_litres", "0.9", "typical"), 2),
    _Score("accepted", "%", ("accepted_fraction",), 1, times=100.0, ideal=None),
    _Score("effective", "samples", ("effective_sample_size",), 0, ideal=None),
    _Score("latency", "ms, p50", ("latency_ms", "p50"), 1, ideal=None),
    _Score("latency", "ms, p99", ("latency_ms", "p99"), 1, ideal=None),
)


def format_table(metrics: Metrics) -> str:
    """The main table as plain text for a terminal, 100 columns or so wide."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("method")
    columns = (*SCORES[:8], *SCORES[9:10], *SCORES[12:])
    for score in columns:
        table.add_column(Text(f"{score.title}\n{score.unit}"), justify="right", no_wrap=True)
    for name, each in mapping(metrics, "methods").items():
        table.add_row(Text(name), *[Text(_cell_text(score, each)) for score in columns])
    stream = io.StringIO()
    Console(file=stream, width=200, color_system=None, legacy_windows=False).print(table)
    return "\n".join(line.rstrip() for line in stream.getvalue().rstrip().splitlines())


def main_table(methods: Metrics) -> str:
    heads = [f"{escape(score.title)}<small>{escape(score.unit)}</small>" for score in SCORES]
    best = [_best(score, methods) for score in SCORES]
    rows = []
    for name, each in methods.items():
        cells = []
        for score, winners in zip(SCORES, best, strict=True):
            value, _, error = _cell_text(score, each).partition(" ± ")
            strong = f'<span class="best">{value}</span>' if name in winners else value
            cells.append(strong + (f" <small>± {error}</small>" if error else ""))
        rows.append([_method(name), *cells])
    return _table(["method", *heads], rows)


def coverage_table(methods: Metrics) -> str:
    rows = [
        [_method(name), *(_percent(_value(each, ("coverage", level))) for level in LEVELS)]
        for name, each in methods.items()
    ]
    return _table(["inside [%]", *(f"{100 * float(level):g} %" for level in LEVELS)], rows)


def limits_table(metrics: Metrics, methods: Metrics) -> str:
    measured = mapping(metrics, "ground_truth_violations")
    rows = [["measured", *(_percent(measured.get(limit), 2) for limit in LIMITS)]]
    for name, each in methods.items():
        rows.append([_method(name), *(_percent(_value(each, ("violations", limit)), 2) for limit in LIMITS)])
    return _table(["steps [%]", "outside joint range", "too fast", "in an obstacle"], rows)


def moving_table(methods: Metrics) -> str:
    columns = (("mpjpe_mm", 1), ("crps_mm", 1), ("nll", 2))
    rows = [
        [_method(name), *(number(_value(each, ("moving", key)), digits) for key, digits in columns)]
        for name, each in methods.items()
    ]
    return _table(["method", "MPJPE<small>mm</small>", "CRPS<small>mm</small>", "NLL<small>nats</small>"], rows)


def recordings_table(methods: Metrics, names: Sequence[str]) -> str:
    rows = []
    for recording in names:
        entries = {name: mapping(mapping(each, "recordings"), recording) for name, each in methods.items()}
        values = {name: entry.get("mpjpe_mm") for name, entry in entries.items()}
        least = min((value for value in values.values() if _known(value)), default=None)
        cells = [
            f'<span class="best">{number(value, 1)}</span>' if value == least is not None else number(value, 1)
            for value in values.values()
        ]
        windows = next((entry.get("windows") for entry in entries.values()), None)
        rows.append([escape(recording), number(windows, 0), *cells])
    return _table(["recording", "windows", *(escape(name) for name in methods)], rows)


def recordings_scores_table(methods: Metrics, names: Sequence[str]) -> str:
    rows = []
    for recording in names:
        cells = []
        for each in methods.values():
            entry = mapping(mapping(each, "recordings"), recording)
            cells.append(
                f"{number(entry.get('crps_mm'), 1)} <small>· {number(entry.get('nll'), 2)} "
                f"· {_percent(_value(entry, ('coverage', '0.9')))}</small>"
            )
        rows.append([escape(recording), *cells])
    return _table(["recording", *(escape(name) for name in methods)], rows)


def settings_table(settings: Metrics) -> str:
    return _table(["setting", "value"], [[escape(str(key)), _setting(value)] for key, value in settings.items()])


def _setting(value: object) -> str:
    if isinstance(value, Mapping):
        return "<br>".join(f"{escape(str(key))}: {_setting(item)}" for key, item in value.items())
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "<br>".join(_setting(item) for item in value)
    return UNKNOWN if value is None else escape(str(value))


def _table(heads: Iterable[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of HTML cells; the first of each row names it."""
    head = "".join(f'<th scope="col">{cell}</th>' for cell in heads)
    body = "\n".join(
        f'<tr><th scope="row">{row[0]}</th>' + "".join(f"<td>{cell}</td>" for cell in row[1:]) + "</tr>" for row in rows
    )
    return f"<table><thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody></table>"


def _method(name: str) -> str:
    """A method's name behind a dot of its colour."""
    return f'<span class="swatch" style="background:{method_style(name).colour}"></span>{escape(name)}'


def _cell_text(score: _Score, method: Metrics) -> str:
    value = _value(method, score.path)
    text = number(score.times * value if _known(value) else None, score.digits)
    error = method.get(score.stderr)
    return f"{text} ± {number(error, score.digits)}" if _known(error) and text != UNKNOWN else text


def _best(score: _Score, methods: Metrics) -> list[str]:
    """The methods that share the best value as it is shown; none if all do."""
    if score.ideal is None:
        return []
    shown = {name: _value(each, score.path) for name, each in methods.items()}
    values = {name: round(score.times * value, score.digits) for name, value in shown.items() if _known(value)}
    away = {name: value if score.ideal == -math.inf else abs(value - score.ideal) for name, value in values.items()}
    if len(set(away.values())) < 2:
        return []
    return [name for name, value in away.items() if value == min(away.values())]


def mapping(parent: Metrics, key: str) -> Metrics:
    """The mapping under a key, empty where it is missing or null."""
    child = parent.get(key)
    return child if isinstance(child, Mapping) else {}


def _value(method: Metrics, path: Sequence[str]) -> Any:
    for key in path[:-1]:
        method = mapping(method, key)
    return method.get(path[-1])


def _known(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and math.isfinite(value)


def number(value: Any, digits: int) -> str:
    return f"{value:.{digits}f}".replace("-", "−") if _known(value) else UNKNOWN


def _percent(value: Any, digits: int = 1) -> str:
    """Per cent; what would be rounded to zero without being it says so."""
    if not _known(value):
        return UNKNOWN
    if 0 < value < 0.5 * 10.0 ** (-digits - 2):
        return f"&lt; {10.0**-digits:g}"
    return "0" if value == 0 else number(100 * value, digits)
