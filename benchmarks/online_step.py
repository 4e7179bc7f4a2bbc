"""One online step, frame in to summary out, beside the naive stack; p50 and p99 in one run.

python -m benchmarks.online_step [--data RECORDING] [--frames N] [--naive-frames N] [--out JSON]

Both arms, 15 steps, 1000 samples: repair, torso frame, inverse kinematics, prediction, constraints, forward kinematics,
scene (a table and a moving box), mean and covariance, through `Predictor.observe`. Models are the shipped ones. The naive
stack (benchmarks/naive.py) does less: no scene, no torso, no summary. Without --data people are generated.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from benchmarks.machine import milliseconds, save
from benchmarks.naive import NaiveConstrained
from kinecast import Predictor, PredictorOptions, Scene
from kinecast.datasets.loading import load
from kinecast.datasets.synthetic import SyntheticOptions, generate
from kinecast.datasets.windows import WindowOptions
from kinecast.pipeline import frames, training_windows
from kinecast.prediction.methods import shipped_methods

SCENE = """
table: {height: -2.0, center: [0.5, 0.0], extent: [2.0, 2.0]}
boxes: [{center: [5.0, 0.0, 1.0], size: [0.3, 0.3, 0.3], velocity: [0.1, 0.0, 0.0]}]
"""
"""A table and a moving box, out of the way of any recording: what is timed is the check, not its outcome."""


def main() -> None:
    """Times, prints, writes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--frames", type=int, default=500)
    parser.add_argument("--naive-frames", type=int, default=3)
    parser.add_argument("--samples", type=int, default=1000)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    run(arguments.data, arguments.frames, arguments.naive_frames, arguments.samples, arguments.out)


def run(data: Path | None, count: int, naive_count: int, samples: int, out: Path | None) -> dict[str, dict[str, float]]:
    """Every shipped method on every frame in turn, the naive stack on a few of them."""
    recordings = load(data) if data else generate(SyntheticOptions(subjects=1, recordings=3, duration=20.0), seed=0)
    recording = max(recordings, key=lambda each: len(each.stamps))
    scene = Scene.from_yaml(SCENE)
    card, methods = shipped_methods()
    started = time.perf_counter()
    predictors = {
        name: Predictor(method, card.noise, scene, PredictorOptions(samples=samples)) for name, method in methods.items()
    }
    start_up = time.perf_counter() - started
    windows = training_windows(recordings, WindowOptions(stride=5, whole=False))
    naive = NaiveConstrained(windows)
    seconds: dict[str, list[float]] = {name: [] for name in predictors}
    slow: list[float] = []
    for k, frame in enumerate(frames(recording)):
        if k >= count:
            break
        for name, predictor in predictors.items():
            begin = time.perf_counter()
            predictor.observe(frame)
            if k > predictor.method.frames:
                seconds[name].append(time.perf_counter() - begin)
        if len(slow) < naive_count and k % max(count // max(naive_count, 1), 1) == predictor.method.frames:
            track = predictor.track(frame.person)
            observation, _ = track.observation(card.noise)
            if observation is not None:
                begin = time.perf_counter()
                naive.step(observation, predictor.method.steps, samples)
                slow.append(time.perf_counter() - begin)
    table = {name: milliseconds(each) for name, each in seconds.items()} | {"naive stack": milliseconds(slow)}
    save("online_step", {"recording": recording.name, "samples": samples, "start_up_s": start_up, "steps": table}, out)
    print(f"{'method':20}{'p50 ms':>10}{'p99 ms':>10}{'frames':>8}")
    for name, row in table.items():
        print(f"{name:20}{row['p50_ms']:10.1f}{row['p99_ms']:10.1f}{row['count']:8.0f}")
    ratio = np.median(slow) / np.median(seconds["gp_constrained"])
    print(f"gp_constrained is {ratio:.0f} times as fast as the naive stack")
    return table


if __name__ == "__main__":
    main()
