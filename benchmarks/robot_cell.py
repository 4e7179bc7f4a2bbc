"""The arm beside a person, every predictor in the same episodes.

python -m benchmarks.robot_cell [--episodes N] [--predictors A,B] [--data FOLDER] [--samples S] [--limit S] [--out JSON]

Every other episode replays a recorded person (the Vicon recordings, on which the shipped models were trained), where
there are recordings; the others are generated. Both stop short of an arm that is in their way, as
people do. What is measured: kinecast.evaluation.outcome.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import facts, save
from kinecast.datasets.loading import load
from kinecast.datasets.recording import Recording
from kinecast.evaluation.collaboration import PREDICTORS, Forecasters, generated_person, replayed_person
from kinecast.evaluation.outcome import Outcome, outcome_of
from kinecast.robot.camera import Camera, CameraOptions
from kinecast.robot.cell import Cell
from kinecast.robot.person import MindfulPerson
from kinecast.robot.simulation import Simulation

SHOWN = (
    "contacts", "contacts_moving", "least_distance", "violation", "time_to_done", "stops", "stopped", "replans",
    "false_replans",
)  # fmt: skip


def main() -> None:
    """Runs, prints, writes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--predictors", default=",".join(PREDICTORS))
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("KINECAST_DATA", "../shared/data")))
    parser.add_argument("--samples", type=int, default=200)
    parser.add_argument("--limit", type=float, default=60.0)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    before = facts()
    takes = recordings(arguments.data)
    names = arguments.predictors.split(",")
    results: dict[str, list[Outcome]] = {name: [] for name in names}
    forecasters = Forecasters(arguments.samples)
    for seed in range(arguments.episodes):  # saved after each, so that a run cut short is not lost
        run(seed, results, forecasters, takes, arguments.limit)
        summary = {name: summarise(outcomes) for name, outcomes in results.items()}
        result = {
            "episodes": seed + 1,
            "replayed_takes": len(takes),
            "samples": arguments.samples,
            "limit_s": arguments.limit,
            "summary": summary,
            "outcomes": {name: [dataclasses.asdict(each) for each in rows] for name, rows in results.items()},
        }
        save("robot_cell", result, arguments.out, before)
    report(summary)


def recordings(folder: Path) -> list[Recording]:
    """Takes of people who work at something, or none."""
    paths = sorted((folder / "human_robot_animations").glob("*/[0-9]*.csv.xz"))
    return [recording for path in paths[::3] for recording in load(path)]


def person(seed: int, takes: Sequence[Recording], cell: Cell) -> MindfulPerson:
    """Who comes in an episode: generated for even seeds, replayed for odd ones where there are takes."""
    if seed % 2 == 0 or not takes:
        return MindfulPerson(generated_person(seed, cell))
    take = takes[(seed // 2) % len(takes)]
    start = float(np.random.default_rng(seed).uniform(0.0, 0.3 * take.duration))
    return MindfulPerson(replayed_person(take, cell, start))


def run(
    seed: int, results: dict[str, list[Outcome]], forecasters: Forecasters, takes: Sequence[Recording], limit: float
) -> None:
    """Every predictor in one episode."""
    line = []
    for name, outcomes in results.items():
        began, cell = time.perf_counter(), Cell()
        people = [person(seed, takes, cell)]
        camera = Camera(CameraOptions(seed=seed))
        simulation = Simulation(people, forecasters.make(name, people), camera, cell, limit=limit)
        outcome = outcome_of(simulation.run(), people, cell)
        outcomes.append(outcome)
        line.append(
            f"{name} {outcome.result} {outcome.time_to_done:.1f} s, contacts {outcome.contacts}, "
            f"violation {outcome.violation:.2f} s, stops {outcome.stops} ({time.perf_counter() - began:.0f} s)"
        )
    print(f"{seed}: " + "; ".join(line), flush=True)


def summarise(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Mean and standard error of each figure."""
    table: dict[str, Any] = {"done": sum(each.result == "done" for each in outcomes), "count": len(outcomes)}
    for key in SHOWN:
        values = np.array([getattr(each, key) for each in outcomes], dtype=np.float64)
        values = values[np.isfinite(values)]
        error = values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else float("nan")
        table[key] = {"mean": float(values.mean()), "error": float(error), "sum": float(values.sum())}
    for key in ("latency_p50", "latency_p99", "planning_p50", "planning_p99"):
        table[key] = float(np.nanmedian([getattr(each, key) for each in outcomes]))
    return table


def report(summary: dict[str, dict[str, Any]]) -> None:
    """Prints the table."""
    print(
        f"{'predictor':16}{'done':>8}",
        "".join(f"{key[:14]:>16}" for key in SHOWN),
        f"{'p99 ms':>8}{'plan p99':>9}",
        sep="",
    )
    for name, row in summary.items():
        cells = "".join(f"{row[key]['mean']:9.2f} ±{row[key]['error']:5.2f}" for key in SHOWN)
        count = f"{row['done']}/{row['count']}"
        print(f"{name:16}{count:>8}{cells}{row['latency_p99']:8.1f}{row['planning_p99']:9.1f}")


if __name__ == "__main__":
    main()
