"""`kinecast evaluate --cluster`: one worker beside two, the same scores, a worker killed, and what AMASS would take.

python -m benchmarks.cluster --data FOLDER [--only speed kill estimate] [--test TASK] [--methods a,b,c]
    [--samples S] [--repeats R] [--rounds N] [--windows W] [--out JSON]

FOLDER holds the Vicon recordings: a folder of takes a task. Methods are trained on every task but one and scored on
that one. `speed` runs the command as a user does: in one process, with one worker, with two, N times in turn, since
machines have slower and faster minutes. `kill` runs it with two workers once more and kills one in the middle.
`estimate` times every kind of task on W and on a quarter of the training windows, takes their cost as linear between,
and adds up what 45 hours on 64 workers would take.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from benchmarks.machine import facts, save
from kinecast.datasets.loading import load
from kinecast.datasets.windows import WindowOptions
from kinecast.evaluation.scoring import EvaluationOptions, TestRecording, evaluate
from kinecast.pipeline import training_windows
from kinecast.prediction.kinecast.experts import FeatureScale, arm_views
from kinecast.prediction.methods import train
from kinecast.prediction.training_windows import TrainingWindows
from kinecast.tasks import Serial

METHODS = "zero_velocity,constant_velocity,damped_velocity,kalman,ridge,kinecast"
"""Those of benchmarks.generalisation."""
COMMAND = (sys.executable, "-c", "from kinecast.cli import main; main()", "evaluate")
RUNS = {"one process": (), "1 worker": ("--cluster", "local:1"), "2 workers": ("--cluster", "local:2")}

HOURS, TESTED, RATE, WORKERS = 45.0, 0.1, 30.0, 64
"""AMASS's length [h], the share of it that is tested on, frames per second, and workers."""
STRIDE = 5
STAGES = (
    ("cut windows", ("resampled_windows",)),
    ("fit experts and baselines",
     ("fit_gaussian", "network", "feature_scale", "joined")),
    ("examples for the gate", ("gate_examples",)),
    ("fit the gate", ("gate",)),
    ("examples for the error model", ("error_examples",)),
    ("fit the error model", ("error_model",)),
    ("score", ("broken_by_truth", "score_recording")),
)  # fmt: skip
"""Kinds of tasks that wait for those before them."""
SPREAD = {"resampled_windows", "gate_examples", "error_examples", "broken_by_truth", "score_recording"}
"""Tasks of one recording: more data are more of them. The others see all data: more data make them longer."""


@dataclass
class Cost:
    """Of all tasks of one kind in a run: how many, and processor seconds of all and of the longest."""

    count: int = 0
    seconds: float = 0.0
    longest: float = 0.0


class Timed(Serial):
    """This process, with a stopwatch."""

    def __init__(self) -> None:
        super().__init__()
        self.costs: dict[str, Cost] = defaultdict(Cost)

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Any:
        name = (function.func if isinstance(function, partial) else function).__name__.strip("_")
        return super().submit(partial(self._timed, name, function), *arguments)

    def _timed(self, name: str, function: Callable[..., Any], *arguments: Any) -> Any:
        started = time.process_time()
        result = function(*arguments)
        seconds = time.process_time() - started
        cost = self.costs[name]
        cost.count, cost.seconds, cost.longest = cost.count + 1, cost.seconds + seconds, max(cost.longest, seconds)
        return result


def command(data: Path, arguments: argparse.Namespace, out: Path, more: Sequence[str]) -> list[str]:
    """`kinecast evaluate` on one task, trained on the others: test recordings are left out by content."""
    return [
        *COMMAND, "--train", str(data), "--test", str(data / arguments.test), "--methods", arguments.methods,
        "--samples", str(arguments.samples), "--repeats", str(arguments.repeats), "--out", str(out), *more,
    ]  # fmt: skip


def run(line: Sequence[str], out: Path, kill_after: float | None = None) -> dict[str, Any]:
    """Runs a command: seconds, scores without latencies, and which process was killed after some time."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    started = time.perf_counter()
    killed = None
    with subprocess.Popen(line, stdout=subprocess.DEVNULL, env={**os.environ, "JAX_PLATFORMS": "cpu"}) as process:
        if kill_after is not None:
            try:
                process.wait(kill_after)
            except subprocess.TimeoutExpired:
                killed = _kill_a_worker(process.pid)
        process.wait()
    wall = time.perf_counter() - started
    now = resource.getrusage(resource.RUSAGE_CHILDREN)
    if process.returncode:
        raise SystemExit(f"{' '.join(line)} ended with {process.returncode}")
    cpu = now.ru_utime + now.ru_stime - used.ru_utime - used.ru_stime
    metrics = json.loads((out / "metrics.json").read_text())
    for scores in metrics["methods"].values():
        del scores["latency_ms"]
    return {"wall_s": wall, "cpu_s": cpu, "killed": killed, "scores": json.dumps(metrics)}


def _kill_a_worker(parent: int) -> int:
    """Kills the busiest worker process of a command."""
    workers = [
        child for child in psutil.Process(parent).children(recursive=True) if "spawn_main" in " ".join(child.cmdline())
    ]
    victim = max(workers, key=lambda worker: sum(worker.cpu_times()[:2]))
    victim.kill()
    return int(victim.pid)


def speed(data: Path, arguments: argparse.Namespace, folder: Path) -> dict[str, list[dict[str, Any]]]:
    """The three runs in turn, forwards and backwards."""
    runs: dict[str, list[dict[str, Any]]] = {name: [] for name in RUNS}
    for turn in range(arguments.rounds):
        for name, more in list(RUNS.items())[:: -1 if turn % 2 else 1]:
            out = folder / f"{name} {turn}"
            runs[name].append(run(command(data, arguments, out, more), out))
            told(name, runs[name][-1])
    return runs


def told(name: str, found: dict[str, Any]) -> None:
    """A run on the terminal."""
    killed = "" if found["killed"] is None else f"   (process {found['killed']} killed)"
    print(f"{name:22} wall {found['wall_s']:7.1f} s   CPU {found['cpu_s']:7.1f} s{killed}", flush=True)


def measure(data: Path, arguments: argparse.Namespace, share: float) -> dict[str, Any]:
    """Costs of all tasks, on a share of the training windows.

    Args:
        data: folder of tasks.
        arguments: of the command line.
        share: every so manieth frame of each recording, counted from its beginning.
    """
    workers = Timed()
    started = time.process_time()
    recordings = load([data])
    read = time.process_time() - started
    tested = [each for each in recordings if each.task == arguments.test]
    others = [each for each in recordings if each.task != arguments.test]
    options = WindowOptions(rate=RATE, stride=STRIDE)
    windows = training_windows(others, options, workers=workers)
    most = min(len(windows), arguments.windows)
    windows = windows.take(_leading(windows.recording, share * most / len(windows)))
    methods = train(arguments.methods.split(","), windows, workers=workers)
    scored = TestRecording.of(tested, options)
    evaluate(methods, scored, None, EvaluationOptions(arguments.samples, arguments.repeats), workers=workers)
    return {
        "training_windows": len(windows),
        "frames": int(sum(each.duration for each in others) * RATE),
        "scored_windows": sum(len(each.observations) for each in scored),
        "window_bytes": (windows.observed.nbytes + windows.future.nbytes) / len(windows),
        "fit_bytes": _fit_bytes(windows),
        "read_s_per_hour": read / sum(each.duration for each in recordings) * 3600,
        "costs": {name: vars(cost) for name, cost in workers.costs.items()},
    }


def _fit_bytes(windows: TrainingWindows) -> float:
    """Memory that the largest fit, a network's, holds for each window: its own and, in single precision, JAX's."""
    some = windows.take(np.arange(min(len(windows), 200)))
    views = arm_views(some.observed)
    features, target = FeatureScale.of(views).features(views), views.to_arms(some.future)
    return 1.5 * (features.nbytes + target.nbytes) / len(some)


def _leading(recording: np.ndarray, share: float) -> np.ndarray:
    """Rows of the first share of each recording's windows."""
    rows = [np.flatnonzero(recording == each) for each in np.unique(recording)]
    return np.concatenate([each[: max(int(np.ceil(share * len(each))), 1)] for each in rows])


def estimate(small: dict[str, Any], large: dict[str, Any]) -> dict[str, Any]:
    """45 hours on 64 workers, from the costs of two runs of different size.

    A task that sees all data costs a + b · windows, a line through both runs (b at least 0). A task of one recording
    costs what it does here for each window, and there are as many more of them as there are more windows.
    """
    frames = HOURS * 3600 * RATE
    training, scored = frames * (1 - TESTED), frames * TESTED / STRIDE
    n, m = small["training_windows"], large["training_windows"]
    reading = large["read_s_per_hour"] * HOURS
    stages = [{"stage": "read, in the command", "cpu_s": reading, "longest_task_s": reading, "wall_s": reading}]
    wall, cpu = reading, reading
    for title, kinds in STAGES:
        seconds, longest = 0.0, 0.0
        for kind in (kind for kind in kinds if kind in large["costs"]):
            cost, less = large["costs"][kind], small["costs"].get(kind, large["costs"][kind])
            if kind in SPREAD:
                per = large["frames"] if kind == "resampled_windows" else large["training_windows"]
                per = large["scored_windows"] if kind in ("score_recording", "broken_by_truth") else per
                many = scored if kind in ("score_recording", "broken_by_truth") else training
                seconds += cost["seconds"] / per * many
                longest = max(longest, cost["longest"])
            else:
                slope = max((cost["seconds"] - less["seconds"]) / (m - n), 0.0)
                seconds += cost["seconds"] + slope * (training - m)
                slope = max((cost["longest"] - less["longest"]) / (m - n), 0.0)
                longest = max(longest, cost["longest"] + slope * (training - m))
        here = max(seconds / WORKERS, longest)
        stages.append({"stage": title, "cpu_s": seconds, "longest_task_s": longest, "wall_s": here})
        wall, cpu = wall + here, cpu + seconds
    return {
        "hours": HOURS, "workers": WORKERS, "training_windows": training, "scored_windows": scored,
        "windows_gigabytes": training * large["window_bytes"] / 1e9,
        "fit_gigabytes": training * large["fit_bytes"] / 1e9, "stages": stages,
        "cpu_hours": cpu / 3600, "wall_hours": wall / 3600,
    }  # fmt: skip


def main() -> None:
    """Runs, prints, writes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--only", nargs="*", default=["speed", "kill", "estimate"])
    parser.add_argument("--test", default="PickPlaceCloseHuman")
    parser.add_argument("--methods", default=METHODS)
    parser.add_argument("--samples", type=int, default=1000)
    parser.add_argument("--repeats", type=int, default=25)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--windows", type=int, default=10**9)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    before, result = facts(), dict[str, Any]()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if {"speed", "kill"} & set(arguments.only):
            runs = speed(arguments.data, arguments, folder)
            walls = {name: float(np.median([each["wall_s"] for each in found])) for name, found in runs.items()}
            if "kill" in arguments.only:
                line = command(arguments.data, arguments, folder / "killed", RUNS["2 workers"])
                runs["2 workers, 1 killed"] = [run(line, folder / "killed", walls["2 workers"] / 2)]
                told("2 workers, 1 killed", runs["2 workers, 1 killed"][0])
            scores = {each.pop("scores") for found in runs.values() for each in found}
            ratio = walls["1 worker"] / walls["2 workers"]
            print(f"2 workers are {ratio:.2f} times as fast as 1; scores byte for byte equal: {len(scores) == 1}")
            result |= {"runs": runs, "ratio": ratio, "equal": len(scores) == 1}
        if "estimate" in arguments.only:
            small, large = (measure(arguments.data, arguments, share) for share in (0.25, 1.0))
            result["estimate"] = {"quarter": small, "whole": large, **estimate(small, large)}
            print(table(result["estimate"]))
    if arguments.out:
        save("cluster", result, arguments.out, before)
    print(f"load {before['load']:.1f} before, {facts()['load']:.1f} after, on {before['cores']} cores")


def table(found: dict[str, Any]) -> str:
    """The estimate as a table."""
    lines = [
        f"{found['hours']:g} h at {RATE:g} Hz: {found['training_windows']:.3g} windows trained on "
        f"({found['windows_gigabytes']:.1f} GB, {found['fit_gigabytes']:.1f} GB in the largest fit), "
        f"{found['scored_windows']:.3g} scored; {found['workers']} workers",
        f"{'stage':28} {'CPU h':>8} {'longest task s':>15} {'wall s':>8}",
    ]
    for each in found["stages"]:
        hours, longest, wall = each["cpu_s"] / 3600, each["longest_task_s"], each["wall_s"]
        lines.append(f"{each['stage']:28} {hours:8.2f} {longest:15.0f} {wall:8.0f}")
    lines.append(f"{'all':28} {found['cpu_hours']:8.2f} {'':15} {3600 * found['wall_hours']:8.0f}")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
