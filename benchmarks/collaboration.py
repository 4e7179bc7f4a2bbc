"""The arm beside a person, closed loop: every predictor in the same seeded episodes.

python -m benchmarks.collaboration [--episodes N] [--first SEED] [--predictors A,B] [--jobs N] [--samples S] [--limit S]
                                   [--data FOLDER] [--out JSON] [--plot PNG]

Even seeds: a generated person. Odd ones: a recorded one, played forth and back (the Vicon takes, on which the shipped
models were trained; without them all are generated). Both stop short of an arm that is in their way, as people do. What
is measured: kinecast.robot.outcome. A run that was cut short goes on where it stopped, if settings and code are
the same; the first three predictors come first. Seeds 0 to 99 are for figures that are stated; settings were chosen on
others.
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import json
import os
import time
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
from kinecast.robot.camera import Camera, CameraOptions
from kinecast.robot.cell import Cell
from kinecast.robot.collaboration import Forecasters, forth_and_back, generated_person, replayed_person
from kinecast.robot.outcome import Outcome, outcome_of
from kinecast.robot.person import MindfulPerson
from kinecast.robot.simulation import Simulation

PREDICTORS = ("kinecast", "zero_velocity", "reachable", "none", "oracle", "gp_constrained")
FIRST = 3
"""So many predictors go through all episodes before the others begin."""

Results = dict[str, dict[int, Outcome]]
"""What came of each seed, by predictor."""


@dataclasses.dataclass(frozen=True)
class Settings:
    """What an outcome depends on, besides its seed and predictor.

    Attributes:
        samples: drawn per prediction.
        limit: when an episode is over at the latest [s].
        data: folder of the recordings.
    """

    samples: int
    limit: float
    data: str


def main() -> None:
    """Runs, prints, writes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--predictors", default=",".join(PREDICTORS))
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--samples", type=int, default=200)
    parser.add_argument("--limit", type=float, default=60.0)
    parser.add_argument("--data", default=os.environ.get("KINECAST_DATA", "../shared/data"))
    parser.add_argument("--out", type=Path, default=RESULTS / "collaboration.json")
    parser.add_argument("--plot", type=Path)
    arguments = parser.parse_args()
    settings = Settings(arguments.samples, arguments.limit, arguments.data)
    stated = described(settings)
    results = resumed(arguments.out, stated)
    before = facts()
    seeds = range(arguments.first, arguments.first + arguments.episodes)
    wanted = [
        (seed, name) for seed, name in order(seeds, arguments.predictors.split(","))
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
        save("collaboration", written(stated, results), arguments.out, before)  # so that a run cut short is not lost
    summary = summarise(results)
    report(summary)
    if arguments.plot is not None:
        save_plot(results, arguments.plot)


def order(seeds: Sequence[int], names: Sequence[str]) -> Iterator[tuple[int, str]]:
    """Episodes of the first predictors, seed by seed, then those of the others."""
    for some in (names[:FIRST], names[FIRST:]):
        for seed in seeds:
            for name in some:
                yield seed, name


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
    cell = Cell()
    people = [person(seed, recordings(settings.data), cell)]
    camera = Camera(CameraOptions(seed=seed))
    predict = forecasters(settings.samples).make(name, people)
    simulation = Simulation(people, predict, camera, cell, limit=settings.limit)
    return outcome_of(simulation.run(), people, cell), time.process_time() - began


@cache
def forecasters(samples: int) -> Forecasters:
    """The shipped models, read once a process."""
    return Forecasters(samples)


@cache
def recordings(folder: str) -> tuple[Recording, ...]:
    """Every third take of people who work at something, or none."""
    paths = sorted((Path(folder) / "human_robot_animations").glob("*/[0-9]*.csv.xz"))
    return tuple(recording for path in paths[::3] for recording in load(path))


def person(seed: int, takes: Sequence[Recording], cell: Cell) -> MindfulPerson:
    """Who comes in an episode: generated for even seeds, replayed for odd ones where there are takes."""
    if seed % 2 == 0 or not takes:
        return MindfulPerson(generated_person(seed, cell))
    take = takes[(seed // 2) % len(takes)]
    start = float(np.random.default_rng(seed).uniform(0.0, 0.3 * take.duration))
    return MindfulPerson(forth_and_back(replayed_person(take, cell, start)))


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
        "takes": [take.name for take in recordings(settings.data)],
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
