"""The arm beside a person, closed loop: every predictor in the same seeded episodes.

python -m benchmarks.collaboration [--episodes N] [--first SEED] [--predictors A,B] [--jobs N] [--samples S] [--limit S]
                                   [--cell lab|camera|certified] [--data FOLDER] [--out JSON] [--plot PNG]

Every fourth person is generated; the others are recorded, of sets that the shipped models were not trained on, and
played forth and back: at work at a table (HA4M), giving something, and walking up to take it (both handover_zed). All
stop short of an arm that is in their way, as people do. `none` is monitoring alone on the straight ways;
`zero_velocity` and `damped_velocity` are the same planner without a prediction worth the name. What is measured:
kinecast.robot.episode. A run that was cut short goes on where it stopped, if settings and code are the same. Seeds 0 to
99 are for figures that are stated; settings were chosen on seeds from 1000.
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import json
import math
import os
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numba
import numpy as np

import kinecast
from benchmarks.collaboration_report import report, save_plot, summarise
from benchmarks.machine import RESULTS, facts, save
from kinecast.datasets.loading import load
from kinecast.datasets.recording import Recording
from kinecast.robot.cell import CELLS, Cell, cell_named
from kinecast.robot.collaboration import generated_person, predictor_named, replayed_person
from kinecast.robot.episode import Outcome
from kinecast.robot.simulated_person import Camera, PlayedPerson, ReactivePerson
from kinecast.robot.simulation import Simulation

PREDICTORS = ("kinecast", "none", "zero_velocity", "damped_velocity", "oracle", "reachable")

Results = dict[str, dict[int, Outcome]]
"""What came of each seed, by predictor."""


@dataclasses.dataclass(frozen=True)
class Settings:
    """What an outcome depends on, besides its seed and predictor.

    Attributes:
        samples: drawn per prediction.
        limit: when an episode is over at the latest [s].
        data: folder of the recordings.
        cell: name of the cell.
    """

    samples: int
    limit: float
    data: str
    cell: str


def main() -> None:
    """Runs, prints, writes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--predictors", default=",".join(PREDICTORS))
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--samples", type=int, default=200)
    parser.add_argument("--limit", type=float, default=120.0)
    parser.add_argument("--data", default=os.environ.get("KINECAST_DATA", "../shared/data"))
    parser.add_argument("--cell", default="camera", choices=tuple(CELLS))
    parser.add_argument("--out", type=Path)
    parser.add_argument("--plot", type=Path)
    arguments = parser.parse_args()
    settings = Settings(arguments.samples, arguments.limit, arguments.data, arguments.cell)
    out = arguments.out or RESULTS / f"collaboration_{arguments.cell}.json"
    stated = described(settings)
    results = resumed(out, stated)
    before = facts()
    seeds = range(arguments.first, arguments.first + arguments.episodes)
    wanted = [
        (seed, name) for seed in seeds for name in arguments.predictors.split(",")
        if seed not in results.setdefault(name, {})
    ]  # fmt: skip
    for seed, name, outcome, seconds in outcomes(wanted, settings, arguments.jobs):
        results[name][seed] = outcome
        print(
            f"{seed:5d} {name:15} {outcome.result} after {outcome.time_to_done:.1f} s, "
            f"contacts {outcome.contacts_moving}, violation {outcome.violation:.2f} s, "
            f"stops {outcome.stops} ({seconds:.0f} s of processor time)",
            flush=True,
        )
        save("collaboration", written(stated, results), out, before)  # so that a run cut short is not lost
    summary = summarise(results)
    report(summary)
    if arguments.plot is not None:
        save_plot(results, arguments.plot)


def outcomes(
    wanted: Sequence[tuple[int, str]], settings: Settings, jobs: int
) -> Iterator[tuple[int, str, Outcome, float]]:
    """Seed, predictor, what came of it and its processor time [s], as they are done, in so many processes."""
    if jobs == 1:
        for seed, name in wanted:
            yield seed, name, *episode(seed, name, settings)
        return
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        pending = {pool.submit(episode, seed, name, settings): (seed, name) for seed, name in wanted}
        for done in as_completed(pending):
            yield *pending[done], *done.result()


def episode(seed: int, name: str, settings: Settings) -> tuple[Outcome, float]:
    """One predictor in one episode, on one core; and the processor time it took [s]."""
    began = time.process_time()
    numba.set_num_threads(1)
    cell = cell_named(settings.cell)
    people = [person(seed, recordings(settings.data), cell)]
    camera = Camera(delay=cell.delay, seed=seed)
    predict = predictor_named(name, people, settings.samples)
    simulation = Simulation(people, predict, camera, cell, limit=settings.limit)
    deque(simulation.steps(), maxlen=0)
    return simulation.outcome(), time.process_time() - began


@cache
def recordings(folder: str) -> tuple[tuple[Recording, ...], ...]:
    """Takes of sets that the shipped models were not trained on: at work at a table, giving, and walking up to take."""
    handovers = load([Path(folder) / "handover_zed"]) if (Path(folder) / "handover_zed").is_dir() else []
    return (
        tuple(load([Path(folder) / "ha4m_features_demo"])) if (Path(folder) / "ha4m_features_demo").is_dir() else (),
        tuple(each for each in handovers if each.person == "giver"),
        tuple(each for each in handovers if each.person == "receiver"),
    )


def person(seed: int, sets: Sequence[Sequence[Recording]], cell: Cell) -> ReactivePerson:
    """Who comes in an episode: every fourth is generated, or all where there are no recordings; the others replayed."""
    kind = seed % 4
    if kind == 0 or not sets[kind - 1]:
        return ReactivePerson(generated_person(seed, cell))
    takes = sets[kind - 1]
    take = takes[(seed // 4) % len(takes)]
    start = float(np.random.default_rng(seed).uniform(0.0, 0.3 * take.duration))
    return ReactivePerson(forth_and_back(replayed_person(take, cell), start, 125.0))


def forth_and_back(person: PlayedPerson, start: float, duration: float) -> PlayedPerson:
    """Somebody who does what was recorded from a start [s] on, at its end backwards, and so on for so long [s]."""
    kept = person.stamps >= start
    since, positions = person.stamps[kept] - person.stamps[kept][0], person.positions[kept]
    parts, times = [positions[:1]], [since[:1]]
    for turn in range(math.ceil(duration / since[-1])):
        ahead = turn % 2 == 0
        parts.append(positions[1:] if ahead else positions[-2::-1])
        times.append(turn * since[-1] + (since[1:] if ahead else since[-1] - since[-2::-1]))
    return PlayedPerson(person.name, person.joints, np.concatenate(times), np.concatenate(parts))


def described(settings: Settings) -> dict[str, Any]:
    """What must be equal for figures to go together: settings, takes, code and models."""
    package = Path(kinecast.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(path for path in package.rglob("*") if path.suffix in {".py", ".npz", ".json", ".urdf"}):
        digest.update(path.read_bytes())
    digest.update(Path(__file__).read_bytes())
    return {
        "samples": settings.samples,
        "limit_s": settings.limit,
        "cell": settings.cell,
        "takes": [len(takes) for takes in recordings(settings.data)],
        "code": digest.hexdigest()[:16],
    }


def resumed(path: Path, stated: Mapping[str, Any]) -> Results:
    """What an earlier run with the same settings left.

    Raises:
        SystemExit: the file is of other settings or other code.
    """
    if not path.exists():
        return {}
    earlier = json.loads(path.read_text())
    other = [key for key, value in stated.items() if earlier["settings"].get(key) != value]
    if other:
        raise SystemExit(f"{path} was made with other {', '.join(other)}: move it away, or name another with --out.")
    return {
        name: {int(seed): Outcome(**dict(zip(earlier["fields"], row, strict=True))) for seed, row in rows.items()}
        for name, rows in earlier["outcomes"].items()
    }


def written(stated: Mapping[str, Any], results: Results) -> dict[str, Any]:
    """A result as it is kept."""
    fields = [field.name for field in dataclasses.fields(Outcome)]
    return {
        "settings": stated,
        **summarise(results),
        "fields": fields,
        "outcomes": {
            name: {
                seed: [round(v, 6) if isinstance(v := getattr(rows[seed], key), float) else v for key in fields]
                for seed in sorted(rows)
            }
            for name, rows in results.items()
        },
    }


if __name__ == "__main__":
    main()
