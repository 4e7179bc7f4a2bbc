"""One online step, frame in to summary out, beside the naive stack; p50 and p99 in one run.

python -m benchmarks.online_step [--data RECORDING] [--frames N] [--naive-frames N] [--samples S] [--out JSON]

Both arms, 15 steps, 1000 samples: repair, torso frame, inverse kinematics, prediction, constraints, forward kinematics,
scene (a table and a box moving past), mean and covariance, all through `Predictor.observe`. Shipped models are taken
as they are; the others are trained on the recording itself, which is quick and changes nothing in the time of a step.
The naive stack (benchmarks/naive.py) does less: no repair, no torso, no scene, no summary. Then the shipped model with
one to four persons in view, 512 samples each; and, in processes of their own, how long a start takes and how much
memory is resident after a thousand frames. Without --data people are generated.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.generated_people import SyntheticOptions, generate
from benchmarks.machine import facts, milliseconds, save
from benchmarks.naive import NaiveConstrained
from kinecast import Predictor, PredictorOptions, Scene
from kinecast.datasets.loading import load
from kinecast.datasets.recording import Recording
from kinecast.datasets.windows import WindowOptions
from kinecast.geometry.shapes import Box, ConstantVelocity, MovingObstacle
from kinecast.pipeline import frames, training_windows
from kinecast.prediction.method import Method
from kinecast.prediction.methods import shipped_methods, train
from kinecast.prediction.paper import PostureSeries
from kinecast.prediction.training_windows import TrainingWindows
from kinecast.track import Track

TRAINED = ("constant_velocity", "kalman", "ridge", "kalman_constrained", "ridge_constrained")
PERSONS = (1, 2, 3, 4)
START = """
import time
begin = time.perf_counter()
from kinecast import Predictor
imported = time.perf_counter()
Predictor.shipped()
print(imported - begin, time.perf_counter() - imported)
"""
RESIDENT = """
import numpy as np
from kinecast import ARM_JOINTS, Box, Predictor, Scene, SkeletonFrame
predictor = Predictor.shipped(Scene((Box(np.array([0.5, 0.0, 0.7]), np.array([0.8, 1.6, 0.04])),)))
rest = np.array([[0, 0.2, 1.4], [0, 0.25, 1.1], [0.2, 0.2, 1.0], [0, -0.2, 1.4], [0, -0.25, 1.1], [0.2, -0.2, 1.0]])
for k in range(1000):
    predictor.observe(SkeletonFrame(k / 30, ARM_JOINTS, rest + 0.05 * np.sin(0.2 * k)))
with open("/proc/self/status") as status:
    print(next(line.split()[1] for line in status if line.startswith("VmHWM:")))
"""
"""Prints the most that was ever resident [KiB], as Linux knows it; getrusage counts the parent's memory too."""


def main() -> None:
    """Times, prints, writes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--frames", type=int, default=520)
    parser.add_argument("--naive-frames", type=int, default=3)
    parser.add_argument("--samples", type=int, default=1000)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    recordings = (
        load(arguments.data) if arguments.data else generate(SyntheticOptions(subjects=1, recordings=1), seed=0)
    )
    recording = max(recordings, key=lambda each: len(each.stamps))
    before = facts()
    result = run(recording, arguments.frames, arguments.naive_frames, arguments.samples)
    result |= {"persons": crowd(recording, arguments.frames), "start_up_s": start_up(), "resident_mib": resident()}
    save("online_step", result, arguments.out, before)
    report(result)


def run(
    recording: Recording,
    count: int,
    naive_count: int,
    samples: int,
    naive_points: int = 500,
    trained: Sequence[str] = TRAINED,
) -> dict[str, Any]:
    """Every method on all frames, one method after another; the naive stack on a few of the frames.

    Args:
        recording: whose frames are observed.
        count: of frames, more than one window.
        naive_count: frames on which the naive stack is timed too: it takes seconds for each.
        samples: drawn by each.
        naive_points: windows the naive stack is trained on.
        trained: methods to train, beside the shipped ones.

    Returns:
        What is written: milliseconds by method, and how much longer the naive stack takes.
    """
    windows = training_windows([recording], WindowOptions())
    noise, methods = method_set(windows, trained)
    scene, options = surroundings(recording), PredictorOptions(samples=samples)
    predictors = {name: Predictor(method, noise, scene, options) for name, method in methods.items()}
    reference = methods["gp_constrained"]
    naive = NaiveConstrained(windows, naive_points)
    track = Track(reference.dt, reference.frames, np.random.default_rng(0))
    wall: dict[str, list[float]] = {name: [] for name in predictors}
    busy: dict[str, list[float]] = {name: [] for name in predictors}
    slow: list[float] = []
    seen = list(frames(recording))[:count]
    also_naive = set(np.linspace(reference.frames + 1, len(seen) - 1, naive_count, dtype=int))
    for name, predictor in predictors.items():
        for k, frame in enumerate(seen):
            begin, worked = time.perf_counter(), time.process_time()
            predictor.observe(frame)
            if k > reference.frames:
                wall[name].append(time.perf_counter() - begin)
                busy[name].append(time.process_time() - worked)
    for k, frame in enumerate(seen):
        track.add(frame)
        observation, _ = track.observation(noise)
        if k in also_naive and observation is not None:
            begin = time.perf_counter()
            naive.step(observation, reference.steps, samples)
            slow.append(time.perf_counter() - begin)
    return {
        "recording": recording.name,
        "samples": samples,
        "steps": {
            name: {**milliseconds(wall[name]), "cpu_p50_ms": 1e3 * float(np.median(busy[name]))} for name in predictors
        },
        "naive": {**milliseconds(slow), "share": {part: s / sum(slow) for part, s in naive.seconds.items()}},
        "naive_over_gp_constrained": float(np.median(slow) / np.median(wall["gp_constrained"])),
    }


def method_set(windows: TrainingWindows, trained: Sequence[str]) -> tuple[float, dict[str, Method[Any]]]:
    """The noise the shipped models were trained with, and all methods: shipped, freed of limits, and trained here."""
    card, shipped = shipped_methods()
    methods = dict(shipped)
    constrained = shipped["gp_constrained"]
    if isinstance(constrained, PostureSeries):
        methods["gp_angles"] = replace(constrained, limits=None)
    return card.noise, {**methods, **train(trained, windows)}


def surroundings(recording: Recording) -> Scene:
    """A table just below the hands, and a box that moves past them at arm's length."""
    wrists = np.concatenate([recording.joint("left_wrist"), recording.joint("right_wrist")])
    x, y, z = np.nanmean(wrists, axis=0)
    top = float(np.nanmin(wrists[:, 2])) - 0.03
    table = Box(np.array([x, y, top - 0.02]), np.array([1.6, 1.6, 0.04]))
    box = Box(np.array([x - 1.0, y + 0.7, z]), np.array([0.2, 0.2, 0.2]))
    speed = 2.0 / max(recording.duration, 1.0)
    motion = ConstantVelocity(np.array([speed, 0.0, 0.0]), since=float(recording.stamps[0]))
    return Scene((table, MovingObstacle(box, motion)))


def crowd(recording: Recording, count: int, persons: Sequence[int] = PERSONS, samples: int = 512) -> dict[str, Any]:
    """Milliseconds that one camera frame takes with several persons in view, the shipped model, by their number."""
    seen = list(frames(recording))[:count]
    result = {}
    for number in persons:
        predictor = Predictor.shipped(surroundings(recording), PredictorOptions(samples=samples))
        wall = []
        for frame in seen:
            begin = time.perf_counter()
            for person in range(number):
                predictor.observe(replace(frame, person=str(person)))
            wall.append(time.perf_counter() - begin)
        result[str(number)] = milliseconds(wall[predictor.method.frames :])
    return result


def resident() -> float:
    """MiB resident at most over a thousand frames, in a fresh process."""
    done = subprocess.run([sys.executable, "-c", RESIDENT], capture_output=True, text=True, check=True)
    return float(done.stdout) / 1024


def start_up(starts: int = 3) -> dict[str, float]:
    """Seconds to import, and to load the shipped model and make its first predictions; medians of fresh processes."""
    told = [
        subprocess.run([sys.executable, "-c", START], capture_output=True, text=True, check=True).stdout.split()
        for _ in range(starts)
    ]
    imported, ready = np.median(np.array(told, dtype=float), axis=0)
    return {"import": float(imported), "first_prediction": float(ready)}


def report(result: Mapping[str, Any]) -> None:
    """Prints the table."""
    print(f"{'method':20}{'least ms':>10}{'p50 ms':>10}{'p99 ms':>10}{'CPU p50':>10}{'frames':>8}")
    for name, row in {**result["steps"], "naive stack": {"cpu_p50_ms": np.nan, **result["naive"]}}.items():
        figures = "".join(f"{row[key]:10.1f}" for key in ("least_ms", "p50_ms", "p99_ms", "cpu_p50_ms"))
        print(f"{name:20}{figures}{row['count']:8.0f}")
    print(f"gp_constrained is {result['naive_over_gp_constrained']:.0f} times as fast as the naive stack")
    for number, row in result.get("persons", {}).items():
        print(f"{number} persons, 512 samples: p50 {row['p50_ms']:.1f} ms, p99 {row['p99_ms']:.1f} ms a camera frame")
    if "start_up_s" in result:
        seconds = result["start_up_s"]
        print(f"start: import {seconds['import']:.2f} s, first prediction {seconds['first_prediction']:.2f} s more")
        print(f"resident: {result['resident_mib']:.0f} MiB")


if __name__ == "__main__":
    main()
