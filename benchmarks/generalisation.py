"""How well methods do where they were not trained: other people, tasks, cameras and rates.

python -m benchmarks.generalisation --data FOLDER [--only NAME ...] [--models FOLDER] [--old FILE] [--motions]
    [--methods a,b,c] [--out JSON] [--table]

FOLDER holds the recordings as docs/datasets.md names them. Each set that may train is tested by models trained on all
others, those in `ONLY_TESTED` by models trained on all that may train, each Vicon task by the five others, HA4M clip
V002 by V001. Everything is at 30 Hz, 6 frames seen, 0.5 s ahead; methods follow every frame. --models: `kinecast` is
read from NAME.npz there, NAME being `all`, `without_SET`, `without_TASK` or `HA4M_V001`, and trained where there is no
such file. --old: one more model, whatever it was trained on. Results are added to the JSON file method by method, so
that a run can be continued. --table prints what the file holds, for docs/generalisation.md, and runs nothing.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.generalisation_scores import DERIVATIVES, TUBES, Watched, motions_summary, summary
from benchmarks.machine import RESULTS, facts, save
from kinecast.body.limits import JointLimits
from kinecast.datasets.loading import load
from kinecast.datasets.recording import Recording
from kinecast.datasets.windows import WindowOptions
from kinecast.evaluation.scoring import EvaluationOptions, TestRecording, evaluate
from kinecast.pipeline import training_windows
from kinecast.prediction.gaussian import PositionGaussian
from kinecast.prediction.linear import damped
from kinecast.prediction.method import Method
from kinecast.prediction.methods import read_method, train

VICON, HA4M = "human_robot_animations", "ha4m_features_demo/UpSkel"
TASKS = ("CollaborativeHammering", "CollaborativeLifting", "CollaborativeStacking", "HumanRobotHandover",
         "PickPlaceCloseHuman", "TossTheCan")  # fmt: skip
ALONE = (VICON, "human_assembly_data", "kth_handover_sample", "react_idle", "precog", "cmu")
SETS = {name: [name] for name in ALONE} | {"ui_prmd": ["ui_prmd_vicon", "ui_prmd_kinect"]}  # the same people twice
"""Folders of each set that may train."""
ONLY_TESTED = (HA4M, "mhad", "handover_zed")
TRIVIAL = ("zero_velocity", "constant_velocity", "damped_velocity", "damped_085")
METHODS = (*TRIVIAL, "kalman", "ridge", "kinecast")
SHOWN = ("old", "kinecast")
FADES = 0.85
"""What is left of the velocity after each frame in `damped_085`."""
GAINS = ("mpjpe_mm", "moving_mpjpe_mm", "crps_mm")
KEPT = ("mpjpe_mm", "mpjpe_mm_stderr", "moving_mpjpe_mm", "wrist_final_mm", "mpjpe_mm_by_step", "crps_mm", "nll",
        "energy_score_mm", "nll_stderr", "coverage", "moving", "violations")  # fmt: skip
OPTIONS = WindowOptions(rate=30.0, window=0.2, horizon=0.5)
TRAINED = 1.0
"""Horizon that methods are trained for [s]; half of it is scored."""
RECORDINGS = 240
"""Most recordings of a set that are scored, unless it has more pairs of subject and task."""
SEED = 0
"""Of the windows that are scored."""
FITTED = 40_000
"""Most windows that baselines are fitted on: every n-th."""


@dataclass(frozen=True)
class Split:
    """What is trained on and tested, as paths below the data folder; splits of one `model` train on the same."""

    name: str
    model: str
    training: tuple[str, ...]
    tested: str


def splits(permitted: Sequence[str] = tuple(SETS)) -> Iterator[Split]:
    """All of them, those of one model together; only the permitted sets train where sets are left out."""

    def others(name: str) -> tuple[str, ...]:
        return tuple(folder for other in permitted if other != name for folder in SETS[other])

    for name, folders in SETS.items():
        for folder in folders:
            yield Split(folder, f"without_{name}", others(name), folder)
    for folder in ONLY_TESTED:
        yield Split(folder.partition("/")[0], "all", others(""), folder)
    for task in TASKS:
        yield Split(task, f"without_{task}", tuple(f"{VICON}/{t}" for t in TASKS if t != task), f"{VICON}/{task}")
    yield Split("HA4M V002", "HA4M_V001", (f"{HA4M}/IDU001V001.npy",), f"{HA4M}/IDU001V002.npy")


@dataclass(frozen=True)
class Trained:
    """Methods trained on some recordings.

    Attributes:
        methods: by name.
        limits: found in training.
        windows: how many, and how many of them baselines were fitted on.
        seconds: it took.
    """

    methods: dict[str, Method[Any]]
    limits: JointLimits
    windows: tuple[int, int]
    seconds: float


def fit(names: Sequence[str], recordings: Sequence[Recording]) -> Trained:
    """Methods trained on recordings: `kinecast` on every window, baselines on every n-th.

    The one place that trains. Methods may predict further than is scored: `Watched` cuts them.
    """
    started = time.perf_counter()
    data = training_windows(recordings, replace(OPTIONS, horizon=TRAINED))
    some = data.take(np.arange(0, len(data), -(-len(data) // FITTED)))
    methods = train([name for name in names if name not in ("damped_085", "kinecast")], some)
    if "damped_085" in names:
        frames, steps, _ = some.shape
        velocity = np.zeros(frames)
        velocity[[-1, -3]] = 0.5, -0.5  # the last two intervals, as for constant velocity
        fading = damped(velocity, -1.0 / np.log(FADES), steps)
        methods["damped_085"] = PositionGaussian.fit(lambda *_: fading, some, some.noise)
    if "kinecast" in names:
        methods |= train(["kinecast"], data)
    return Trained(methods, data.limits, (len(data), len(some)), time.perf_counter() - started)


def spread(recordings: Sequence[Recording], most: int = RECORDINGS) -> list[Recording]:
    """All recordings, or equally many, evenly spaced, of each subject at each task: at most so many if that can be."""
    if len(recordings) <= most:
        return list(recordings)
    cells = defaultdict(list)
    for place, recording in enumerate(recordings):
        cells[recording.subject, recording.task].append(place)
    each = max(1, most // len(cells))
    chosen = {cell[k] for cell in cells.values() for k in np.linspace(0, len(cell) - 1, each).round().astype(int)}
    return [recordings[place] for place in sorted(chosen)]


def scored_on(found: Sequence[Recording], windows: int) -> tuple[list[TestRecording], dict[str, Any]]:
    """So many windows, drawn from all of recordings spread over subjects and tasks; how they were chosen.

    Drawn by chance: every n-th would take the first window of every recording, of somebody not yet followed, and of
    short recordings little else.
    """
    chosen = spread(found)
    every = TestRecording.of(chosen, replace(OPTIONS, stride=1))
    ends = np.cumsum([len(each.frames) for each in every])
    drawn = np.random.default_rng(SEED).choice(ends[-1], min(windows, ends[-1]), replace=False)
    parts = zip(every, np.split(np.sort(drawn), np.searchsorted(np.sort(drawn), ends[:-1])), ends, strict=True)
    recordings = []
    for each, rows, end in parts:
        rows = rows - (end - len(each.frames))
        if len(rows):
            recordings.append(replace(each, future=each.future[rows], frames=each.frames[rows]))
    about = {"windows": len(drawn), "windows_of": int(ends[-1]), "recordings": len(recordings)}
    about["recordings_of"] = len(found)
    return recordings, about | ({"names": [r.name for r in recordings]} if len(chosen) < len(found) else {})


def score(
    method: Method[Any], recordings: Sequence[TestRecording], options: EvaluationOptions, motions: bool
) -> dict[str, Any]:
    """One method's entry: the evaluation's figures and those of `generalisation_scores`."""
    started = time.perf_counter()
    truths: dict[int, np.ndarray] = {}
    for recording in recordings:
        rows = {frame: row for row, frame in enumerate(recording.frames.tolist())}
        truths |= {id(seen): recording.future[rows[at]] for at, seen, _ in recording.history if at in rows}
    watched = Watched(method, OPTIONS.predicted_steps, truths, motions)
    results, _ = evaluate({"it": watched}, recordings, None, options)
    since = np.concatenate([r.frames - r.history[0][0] for r in recordings]) * method.dt
    entry = {name: results["methods"]["it"][name] for name in KEPT} | summary(watched.notes, since)
    entry["violations_of_truth"] = results["ground_truth_violations"]
    if motions:
        owner = np.concatenate([np.full(len(r.observations), k) for k, r in enumerate(recordings)])
        entry["motions"] = motions_summary(watched.notes, owner, method.dt)
    return entry | {"seconds": time.perf_counter() - started}


def gains(methods: dict[str, Any]) -> dict[str, dict[str, float]]:
    """Of each method that is not trivial: its figure over the least of the trivial ones, by hindsight, less one."""
    found: dict[str, dict[str, float]] = defaultdict(dict)
    for figure in GAINS:
        values = {name: each[figure] for name, each in methods.items() if each[figure] is not None}
        trivial = [values[name] for name in TRIVIAL if name in values]
        for name in values.keys() - set(TRIVIAL) if trivial else ():
            found[name][figure] = values[name] / min(trivial) - 1.0
    return dict(found)


def run(arguments: argparse.Namespace, results: dict[str, Any]) -> None:
    """Scores what is missing in the results and writes them after each method."""
    trained: dict[str, Trained] = {}  # the newest alone, by its model's name
    before, asked = facts(), arguments.methods.split(",") + (["old"] if arguments.old else [])
    protocol = {"rate": OPTIONS.rate, "window": OPTIONS.window, "horizon": OPTIONS.horizon}
    for split in splits(arguments.train):
        entry = results.get(split.name, {"methods": {}})
        names = [name for name in asked if name and name not in entry["methods"]]
        if (arguments.only and split.name not in arguments.only) or not names:
            continue
        files = {"old": arguments.old, "kinecast": arguments.models and arguments.models / f"{split.model}.npz"}
        given = {name: read_method(files[name])[1] for name in names if files.get(name) and files[name].exists()}
        needed = [name for name in names if name not in given]
        if split.model not in trained or not set(needed) <= trained[split.model].methods.keys():
            trained = {split.model: fit(needed, load([arguments.data / path for path in split.training]))}
        fitted = trained[split.model]
        recordings, about = scored_on(load([arguments.data / split.tested]), arguments.windows)
        about |= {"samples": arguments.samples, "trained_on": list(split.training)}
        if entry.get("test", about) != about:
            raise SystemExit(
                f"{split.name}: {arguments.out} holds other windows, samples or training; give another --out"
            )
        entry |= {"model": split.model, "training_windows": fitted.windows, "training_seconds": fitted.seconds}
        entry["test"] = about
        limits = getattr(given.get("kinecast"), "limits", None) or fitted.limits  # those it holds, where it was read
        options = EvaluationOptions(samples=arguments.samples, repeats=0, limits=limits)
        for name, method in ((name, (fitted.methods | given)[name]) for name in names):
            entry["methods"][name] = score(method, recordings, options, arguments.motions)
            entry["gains"] = gains(entry["methods"])
            results[split.name] = entry
            save("generalisation", {"protocol": protocol, "splits": results}, arguments.out, before)
            print(f"{split.name:24} {name:18} {entry['methods'][name]['mpjpe_mm']:6.1f} mm", flush=True)


def table(results: dict[str, Any]) -> str:
    """Results as markdown: errors of all methods, what distributions are worth, how drawn motions move."""
    names = [name for name in (*METHODS[:-1], *SHOWN) if any(name in each["methods"] for each in results.values())]
    errors = [["tested on", "windows", *names, *(f"{name}: gain [%], moving, CRPS" for name in SHOWN)]]
    worth = [["tested on", "method", "CRPS", "energy", "NLL", "in 50/80/90/95/99 %", "in 90 %: rest/slow/fast",
              "in 50 %", "violations, truth's [%]", *(f"arms in {100 * each:g} % tube" for each in TUBES),
              "arms in reach", "tubes / reach [%]"]]  # fmt: skip
    motions = [["tested on", "of", *(f"{name} [{unit}] at 50/95/99.9 %" for name, unit in DERIVATIVES.items()), "AUC"]]
    for split, each in results.items():
        found, gain = each["methods"], each["gains"]
        won = [slashed(gain[name].values(), 1, 100) if name in gain else "" for name in SHOWN]
        means = [slashed([found[name]["mpjpe_mm"]], 1) if name in found else "" for name in names]
        errors.append([split, str(each["test"]["windows"]), *means, *won])
        for name, it in ((name, found[name]) for name in SHOWN if name in found):
            speeds, tubes = it["coverage_by_speed"].values(), it["tubes"].values()
            broken = [it[key]["position"] + it[key]["speed"] for key in ("violations", "violations_of_truth")]
            shares = [tube["median_share_of_reach"] for tube in tubes]
            worth.append([split, name, *(slashed([it[key]], 1) for key in ("crps_mm", "energy_score_mm")),
                          slashed([it["nll"]], 2), slashed(it["coverage"].values(), 0, 100),
                          *(slashed([speed[level] for speed in speeds], 0, 100) for level in ("0.9", "0.5")),
                          slashed(broken, 2, 100), *(slashed([tube["arms"]], 2, 100) for tube in tubes),
                          slashed(shares[:-1], 2, 100)])  # fmt: skip
            for of in ("truth", "drawn") if "motions" in it else ():
                rows = [f"{slashed(moves.values(), 2)}" for moves in it["motions"][of].values()]
                auc = [it["motions"]["auc"]] if of == "drawn" else []
                motions.append([split, of if of == "truth" else name, *rows, slashed(auc, 2)])
    return "\n\n".join(
        "\n".join("| " + " | ".join(row) + " |" for row in (rows[0], ["---"] * len(rows[0]), *rows[1:]))
        for rows in (errors, worth, motions)
    )


def slashed(values: Iterable[float | None], digits: int, times: float = 1.0) -> str:
    return " / ".join("–" if value is None else f"{times * value:.{digits}f}" for value in values)


def main() -> None:
    """Runs what is missing in the results file, or prints its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--only", nargs="*", default=[], choices=[split.name for split in splits()], metavar="NAME")
    parser.add_argument("--train", nargs="*", default=list(SETS), choices=SETS, help="sets that may train")
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--models", type=Path, help="folder of trained models")
    parser.add_argument("--old", type=Path, help="file of one more model")
    parser.add_argument("--motions", action="store_true", help="hold drawn motions beside true ones")
    parser.add_argument("--windows", type=int, default=1500, help="windows of each set")
    parser.add_argument("--samples", type=int, default=1000)
    parser.add_argument("--out", type=Path, default=RESULTS / "generalisation.json")
    parser.add_argument("--table", action="store_true", help="only print what the results hold")
    arguments = parser.parse_args()
    results = json.loads(arguments.out.read_text()).get("splits", {}) if arguments.out.exists() else {}
    if not arguments.table:
        run(arguments, results)
    print(table(results))


if __name__ == "__main__":
    main()
