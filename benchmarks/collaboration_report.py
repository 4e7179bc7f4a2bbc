"""Figures, table and picture of the closed-loop benchmark (benchmarks.collaboration)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from kinecast.evaluation.plots import INK, STYLE, method_style, save_figure
from kinecast.robot.episode import Outcome

SHOWN = (
    "contacts", "contacts_moving", "least_distance", "violation", "time_to_done", "stops", "stopped", "replans",
    "false_replans", "forecast_error", "forecast_held",
)  # fmt: skip
TIMES = ("latency_p50", "latency_p99", "planning_p50", "planning_p99")
OURS, OTHERS = "kinecast", ("none", "zero_velocity", "damped_velocity", "oracle", "reachable")
PANELS = (
    ("time_to_done", "Time to done, s"), ("stops", "Stops"), ("stopped", "Time in stops, s"),
    ("violation", "Nearer than S_p, s"),
)  # fmt: skip

Results = Mapping[str, Mapping[int, Outcome]]


def summarise(results: Results) -> dict[str, Any]:
    """Mean and standard error of each figure by predictor, and of the differences in the same episodes."""
    names = [name for name, rows in results.items() if rows]
    summary = {name: _summary(results[name]) for name in names}
    pairs = [(OURS, other) for other in OTHERS if OURS in names and other in names]
    return {
        "summary": summary,
        "differences": {f"{ours} - {other}": _difference(results[ours], results[other]) for ours, other in pairs},
    }


def _summary(rows: Mapping[int, Outcome]) -> dict[str, Any]:
    table: dict[str, Any] = {"episodes": len(rows), "done": sum(each.result == "done" for each in rows.values())}
    for key in SHOWN:
        values = _values(rows, key)
        table[key] = {**_mean(values), "sum": float(np.nansum(values))}
    for key in TIMES:
        table[key] = float(np.nanmedian(_values(rows, key)))
    return table


def _difference(ours: Mapping[int, Outcome], others: Mapping[int, Outcome]) -> dict[str, Any]:
    """Of what both have been through: episode by episode; and the share of the other's time to done that is saved."""
    seeds = sorted(set(ours) & set(others))
    table: dict[str, Any] = {"episodes": len(seeds)}
    if not seeds:
        return table
    both = {seed: ours[seed] for seed in seeds}, {seed: others[seed] for seed in seeds}
    for key in SHOWN:
        table[key] = _mean(_values(both[0], key) - _values(both[1], key))
    table["time_saved"] = float(1.0 - _values(both[0], "time_to_done").sum() / _values(both[1], "time_to_done").sum())
    return table


def _values(rows: Mapping[int, Outcome], key: str) -> Float[np.ndarray, " N"]:
    return np.array([getattr(each, key) for _, each in sorted(rows.items())], dtype=np.float64)


def _mean(values: Float[np.ndarray, " N"]) -> dict[str, float | None]:
    known = values[np.isfinite(values)]  # a time that was never foretold is no time
    error = float(known.std(ddof=1) / np.sqrt(len(known))) if len(known) > 1 else None
    return {"mean": float(known.mean()) if len(known) else None, "error": error}


def report(result: Mapping[str, Any]) -> None:
    """Prints the tables."""
    _table("predictor", {name: (f"{row['done']}/{row['episodes']}", row) for name, row in result["summary"].items()})
    _table("difference", {name: (str(row["episodes"]), row) for name, row in result["differences"].items()})
    for name, row in result["differences"].items():
        if "time_saved" in row:
            print(f"{name}: time to done is shorter by {100 * row['time_saved']:.1f} %")
    for name, row in result["summary"].items():
        print(f"{name}: frame to decision p50 {row['latency_p50']:.1f}, p99 {row['latency_p99']:.1f} ms, "
              f"a plan p50 {row['planning_p50']:.1f}, p99 {row['planning_p99']:.1f} ms")  # fmt: skip


def _table(title: str, rows: Mapping[str, tuple[str, Mapping[str, Any]]]) -> None:
    if not rows:
        return
    print(f"{title:26}{'done':>8}" + "".join(f"{key[:15]:>16}" for key in SHOWN))
    for name, (count, row) in rows.items():
        cells = "".join(
            f"{_number(row[key]['mean']):9.3f} ±{_number(row[key]['error']):5.2f}" for key in SHOWN if key in row
        )
        print(f"{name:26}{count:>8}{cells}")


def _number(value: float | None) -> float:
    return np.nan if value is None else value


def save_plot(results: Results, path: Path) -> None:
    """A dot for every episode, and mean ± standard error, for each predictor."""
    names = [name for name in (OURS, *reversed(OTHERS)) if results.get(name)]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 0.5 * len(names) + 1.4), layout="constrained")
        for column, (axes, (key, title)) in enumerate(zip(figure.subplots(1, len(PANELS)), PANELS, strict=True)):
            _panel(axes, {name: _values(results[name], key) for name in names}, title)
            if column:
                axes.tick_params(labelleft=False)
    save_figure(figure, path)


def _panel(axes: Axes, values: Mapping[str, Float[np.ndarray, " N"]], title: str) -> None:
    """One figure of all predictors, a row each."""
    rng = np.random.default_rng(0)
    for row, (name, each) in enumerate(reversed(values.items())):
        colour = method_style(name).colour
        mean, error = _mean(each)["mean"], _mean(each)["error"] or 0.0
        axes.scatter(each, row + rng.uniform(-0.28, 0.28, len(each)), s=7, color=colour, alpha=0.35, linewidths=0)
        axes.errorbar([mean], [row], xerr=[error], fmt="|", color=INK, markersize=13, capsize=3, zorder=3)
        axes.annotate(
            f"{mean:.3g}", (mean, row + 0.3), ha="center", va="bottom", fontsize=8.5, color=INK,
            bbox={"facecolor": "white", "alpha": 0.7, "linewidth": 0, "pad": 0.5},
        )  # fmt: skip
    axes.set_yticks(range(len(values)), list(reversed(values)))
    axes.set_ylim(-0.6, len(values) - 0.2)
    axes.set_title(title)
    axes.grid(axis="x")
    axes.set_axisbelow(True)
