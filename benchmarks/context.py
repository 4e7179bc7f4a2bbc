"""What context is worth: goals in the scene.

python -m benchmarks.context [--data FOLDER] [--parts goals cost vicon] [--model FILE] [--samples N]

FOLDER (or the variable KINECAST_DATA) holds the recordings as docs/datasets.md names them. Parts, each added to the
JSON file as it ends:

goals: generated people (benchmarks.generated_people, seeds that nothing was fitted on) with the shipped model, which
    has seen no generated person. The scene's goals as they are, all of them moved by 15 cm, and people who reach
    elsewhere.
cost: what goals add to the processor time of a forecast of 1000 samples, on one core.
vicon: the recordings name no objects, so a goal is known without looking ahead only where people have been before:
    places where wrists rested in the training recordings of the same task. Held-out recordings, a model trained on the
    others.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numba
import numpy as np

from benchmarks.generalisation import VICON
from benchmarks.generated_people import SyntheticOptions, generate, generate_clean, table_scene
from benchmarks.machine import RESULTS, facts, save
from kinecast.datasets.loading import load
from kinecast.datasets.reaching import Fetch, fetching
from kinecast.datasets.recording import Recording
from kinecast.datasets.resampling import resample
from kinecast.datasets.windows import WindowOptions, all_windows
from kinecast.evaluation.scoring import EvaluationOptions, TestRecording, evaluate
from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Box, Sphere
from kinecast.pipeline import every_frame, followed, training_windows
from kinecast.prediction.goals import HANDS, WRISTS
from kinecast.prediction.kinecast.model import Kinecast
from kinecast.prediction.method import Method, forecast_in_scene, shortened
from kinecast.prediction.methods import card_of, read_method, save_method, shipped_methods, train

OPTIONS = WindowOptions()
PEOPLE, SEED, DURATION = 6, 300, 20.0
CUBES = ("red_cube", "green_cube", "blue_cube", "left_tray", "right_tray")
TASKS = ("pick_and_place", "reaching")
PARTS = ("goals", "cost", "vicon")
MOVED = 0.15
"""How far misplaced goals are from where they should be [m]."""
STILL, WAY, CLOSE = 0.08, 0.1, 0.04
"""A reach: consecutive frames in which a wrist is faster [m/s], at least so long [m]; it is for a goal if it ends this
near to it [m]."""
REST, APART, MOST = 0.06, 0.15, 4
"""A place: wrists slower than this [m/s] over a quarter of a second; nearer than this [m] are one; so many a task."""


def scores(
    methods: dict[str, Method[Any]], scene: Scene | None, tests: Sequence[TestRecording], samples: int
) -> dict[str, Any]:
    """Scores of methods in one scene: all windows, and those in which a wrist moves."""
    limits = next(method.limits for method in methods.values() if isinstance(method, Kinecast) and method.limits)
    found, _ = evaluate(methods, tests, scene, EvaluationOptions(samples=samples, repeats=0, limits=limits))
    return {name: brief(each) for name, each in found["methods"].items()}


def brief(each: dict[str, Any]) -> dict[str, Any]:
    """The figures that the table shows."""
    kept = ("mpjpe_mm", "mpjpe_mm_stderr", "wrist_final_mm", "crps_mm", "nll", "nll_stderr", "coverage", "latency_ms")
    return {name: each[name] for name in kept} | {"moving": each["moving"], "violations": each["violations"]}


def tests_of(recordings: Sequence[Recording], stride: int) -> list[TestRecording]:
    """Windows and the frames before them."""
    return TestRecording.of(recordings, replace(OPTIONS, stride=stride))


def reaches(path: np.ndarray, rate: float) -> list[tuple[int, int]]:
    """First and last frame of every reach of a wrist, (N, 3) true positions [m]."""
    fast = np.linalg.norm(np.gradient(path, axis=0), axis=1) * rate > STILL
    edges = np.flatnonzero(np.diff(np.concatenate([[False], fast, [False]]).astype(int)))
    pairs = [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return [(a, b) for a, b in pairs if b < len(path) - 2 and b - a >= 8 and np.linalg.norm(path[b] - path[a]) > WAY]


def accuracy(
    method: Kinecast, scene: Scene, measured: Sequence[Recording], clean: Sequence[Recording]
) -> dict[str, Any]:
    """How well goals are told during reaches, by the share of the reach gone, beside two baselines.

    A reach's goal is the one that the true wrist comes to rest in. The nearest goal (to the wrist now, and to where the
    forecast ends) is certain of itself and has no "none"; the uniform one holds all for equally likely.
    """
    names = [*scene.goals, "none"]
    truth = {recording.name: resample(recording, OPTIONS.rate) for recording in clean}
    rows: list[tuple[float, int, float, int, int, int]] = []
    for part in all_windows(measured, every_frame(OPTIONS)):
        at = {frame: k for k, frame in enumerate(part.frames.tolist())}
        goal_of: dict[tuple[int, int], tuple[float, int]] = {}
        for hand, side in enumerate(HANDS):
            path = truth[part.name].joint(f"{side}_wrist")
            for first, last in reaches(path, OPTIONS.rate):
                away = scene.regions.distance(path[last])
                goal = int(np.argmin(away)) if away.min() < CLOSE else len(names) - 1
                for frame in range(first, last + 1):
                    if frame in at:
                        goal_of[frame, hand] = ((frame - first) / (last - first), goal)
        state = method.init_state()
        for frame, observation, seen in followed(part):
            state = method.update(state, observation, seen)
            if not any((frame, hand) in goal_of for hand in (0, 1)):
                continue
            forecast = forecast_in_scene(method, state, observation, np.random.default_rng(0), 2, scene)
            assert state.output is not None
            for hand, side in enumerate(HANDS):
                if (frame, hand) in goal_of:
                    gone, goal = goal_of[frame, hand]
                    chances = np.array(list(forecast.goals[side].values()))
                    now, end = observation.positions[-1, WRISTS[hand]], state.output.mean[-1, WRISTS[hand]]
                    near = [int(np.argmin(np.linalg.norm(scene.regions.centers - p, axis=1))) for p in (now, end)]
                    rows.append((gone, goal, -np.log(chances[goal]), int(chances.argmax()), *near))
    table = np.array(rows)
    parts = {
        "all": (0.0, 1.01),
        "first third": (0.0, 1 / 3),
        "second third": (1 / 3, 2 / 3),
        "last third": (2 / 3, 1.01),
    }
    result: dict[str, Any] = {"uniform_log_loss": float(np.log(len(names)))}
    for label, (low, high) in parts.items():
        here = table[(table[:, 0] >= low) & (table[:, 0] < high)]
        to_goal = here[here[:, 1] < len(names) - 1]
        result[label] = {
            "frames": len(here),
            "to_goals": len(to_goal),
            "log_loss": float(here[:, 2].mean()) if len(here) else None,
            "accuracy": float((here[:, 3] == here[:, 1]).mean()) if len(here) else None,
            "log_loss_to_goals": float(to_goal[:, 2].mean()) if len(to_goal) else None,
            "accuracy_to_goals": float((to_goal[:, 3] == to_goal[:, 1]).mean()) if len(to_goal) else None,
            "nearest_to_wrist": float((to_goal[:, 4] == to_goal[:, 1]).mean()) if len(to_goal) else None,
            "nearest_to_forecast": float((to_goal[:, 5] == to_goal[:, 1]).mean()) if len(to_goal) else None,
        }
    return result


def moved(goals: dict[str, Sphere | Box], by: float, rng: np.random.Generator) -> dict[str, Sphere | Box]:
    """The goals, each moved level by a distance [m] in a random direction."""
    result: dict[str, Sphere | Box] = {}
    for name, shape in goals.items():
        angle = rng.uniform(0.0, 2 * np.pi)
        result[name] = replace(shape, center=shape.center + by * np.array([np.cos(angle), np.sin(angle), 0.0]))
    return result


def elsewhere(goals: dict[str, Sphere | Box], seed: int) -> Recording:
    """Somebody who reaches over the table, and never for a goal."""
    rng = np.random.default_rng([seed, 1])
    centers = np.array([shape.center for shape in goals.values()])
    fetches: list[Fetch] = []
    while len(fetches) < 10:
        place = np.array([rng.uniform(0.25, 0.55), rng.uniform(-0.45, 0.45), centers[0, 2] + rng.uniform(-0.02, 0.15)])
        if np.linalg.norm(centers - place, axis=1).min() > 0.15:
            fetches.append(Fetch(1.0 + 2.0 * len(fetches), place, hold=0.3))
    return fetching(fetches, 22.0, seed, OPTIONS.rate)


def on_goals(samples: int, stride: int, people: int = PEOPLE) -> dict[str, Any]:
    """The part `goals`."""
    method = shortened(shipped_methods()[1]["kinecast"], 0.5)
    assert isinstance(method, Kinecast)
    options = SyntheticOptions(subjects=people, recordings=3, duration=DURATION)
    scene = table_scene()
    goals = {name: scene.goals[name] for name in CUBES}
    measured = [each for each in generate(options, SEED) if each.task in TASKS]
    clean = [each for each in generate_clean(options, SEED) if each.task in TASKS]
    away = moved(goals, MOVED, np.random.default_rng(SEED))
    ignoring = [elsewhere(goals, SEED + k) for k in range(people)]
    known, table = Scene(scene.obstacles, goals), Scene(scene.obstacles)
    crowds = {
        "goals as they are": (measured, known),
        f"goals moved by {100 * MOVED:.0f} cm": (measured, Scene(scene.obstacles, away)),
        "people who reach elsewhere": (ignoring, known),
    }
    result: dict[str, Any] = {"goals": list(goals), "people": people, "seed": SEED}
    without: dict[int, dict[str, Any]] = {}
    for name, (recordings, with_goals) in crowds.items():
        tests = tests_of(recordings, stride)
        if id(recordings) not in without:
            without[id(recordings)] = scores({"kinecast": method}, table, tests, samples)["kinecast"]
        found = scores({"kinecast": method}, with_goals, tests, samples)["kinecast"]
        result[name] = {"without": without[id(recordings)], "with": found}
        print(line(name, result[name]), flush=True)
    result["told"] = accuracy(method, known, measured, clean)
    return result


def on_cost(samples: int) -> dict[str, Any]:
    """The part `cost`: processor time of one forecast on one core, medians over one person's frames taken in turns."""
    numba.set_num_threads(1)
    method = shortened(shipped_methods()[1]["kinecast"], 0.5)
    assert isinstance(method, Kinecast)
    options = SyntheticOptions(subjects=1, recordings=1, duration=8.0)
    scene, (person,) = table_scene(), generate(options, SEED)
    scenes = {count: Scene((), {name: scene.goals[name] for name in CUBES[:count]}) for count in (0, 1, 3, 5)}
    seconds: dict[int, list[float]] = {count: [] for count in scenes}
    (part,) = all_windows([person], every_frame(OPTIONS))
    state, rng = method.init_state(), np.random.default_rng(SEED)
    for _, observation, measured in followed(part):
        state = method.update(state, observation, measured)
        for count, each in scenes.items():
            started = time.process_time()
            forecast_in_scene(method, state, observation, rng, samples, each)
            seconds[count].append(time.process_time() - started)
    medians = {count: 1e3 * float(np.median(each[10:])) for count, each in seconds.items()}
    print("  ".join(f"{count} goals +{each - medians[0]:.2f} ms" for count, each in medians.items() if count))
    return {"frames": len(part), "forecast_ms_by_goals": {str(count): each for count, each in medians.items()}}


def split(recordings: Sequence[Recording]) -> tuple[list[Recording], list[Recording]]:
    """Every second recording of each task, and the others."""
    train_on: list[Recording] = []
    test_on: list[Recording] = []
    for task in sorted({recording.task for recording in recordings}):
        own = [recording for recording in recordings if recording.task == task]
        train_on += own[::2]
        test_on += own[1::2]
    return train_on, test_on


def model_of(recordings: Sequence[Recording], path: Path) -> Kinecast:
    """A model trained on recordings, or read from a file."""
    if not path.exists():
        data = training_windows(recordings, OPTIONS)
        trained = train(["kinecast"], data)["kinecast"]
        save_method(path, card_of("kinecast", trained, data, "", [each.name for each in recordings]), trained)
    card, method = read_method(path)
    if set(card.trained_on) != {each.name for each in recordings}:
        raise SystemExit(f"{path}: trained on other recordings than this benchmark trains on")
    assert isinstance(method, Kinecast)
    return method


def places(recordings: Sequence[Recording]) -> dict[str, Sphere | Box]:
    """Where wrists rested longest in recordings: spheres, at most `MOST`."""
    rested = []
    for recording in recordings:
        sampled = resample(recording, OPTIONS.rate)
        for side in HANDS:
            path = sampled.joint(f"{side}_wrist")
            speed = np.linalg.norm(path[7:] - path[:-7], axis=1) * OPTIONS.rate / 7
            rested.append(path[3:-4][speed < REST])
    left = np.concatenate(rested)
    left = left[np.isfinite(left).all(axis=1)]
    found: dict[str, Sphere | Box] = {}
    while len(left) > 10 and len(found) < MOST:
        thin = left[:: max(len(left) // 500, 1)]
        near = (np.linalg.norm(left[:, None] - thin, axis=-1) < APART / 2).sum(axis=0)
        middle = left[np.linalg.norm(left - thin[near.argmax()], axis=1) < APART / 2].mean(axis=0)
        found[f"place {len(found) + 1}"] = Sphere(middle, 0.06)
        left = left[np.linalg.norm(left - middle, axis=1) > APART]
    return found


def on_vicon(data: Path, path: Path, samples: int, stride: int) -> dict[str, Any]:
    """The part `vicon`."""
    train_on, test_on = split(load([data / VICON]))
    method = model_of(train_on, path)
    result: dict[str, Any] = {}
    for task in sorted({recording.task for recording in test_on}):
        scene = Scene((), places([recording for recording in train_on if recording.task == task]))
        tests = tests_of([recording for recording in test_on if recording.task == task], stride)
        result[task] = {
            "places": len(scene.goals),
            "without": scores({"kinecast": method}, None, tests, samples)["kinecast"],
            "with": scores({"kinecast": method}, scene, tests, samples)["kinecast"],
        }
        print(line(task, result[task]), flush=True)
    return result


def line(name: str, each: dict[str, Any]) -> str:
    """One row of the table."""
    a, b = each["without"], each["with"]
    shown = [f"{key} {a[key]:.2f} -> {b[key]:.2f}" for key in ("mpjpe_mm", "wrist_final_mm", "crps_mm", "nll")]
    covered = f"coverage of 90 % {100 * a['coverage']['0.9']:.0f} -> {100 * b['coverage']['0.9']:.0f}"
    moving = f"moving {a['moving']['mpjpe_mm']:.1f} -> {b['moving']['mpjpe_mm']:.1f}"
    return f"{name:28} {'  '.join(shown)}  {moving}  {covered}"


def main() -> None:
    """Runs the parts asked for and writes each as it ends."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("KINECAST_DATA", "data")))
    parser.add_argument("--parts", nargs="*", choices=PARTS, default=PARTS)
    parser.add_argument("--model", type=Path, default=Path(tempfile.gettempdir()) / "kinecast-context.npz")
    parser.add_argument("--samples", type=int, default=200)
    parser.add_argument("--stride", type=int, default=5)
    parser.add_argument("--out", type=Path, default=RESULTS / "context.json")
    arguments = parser.parse_args()
    before = facts()
    for part in arguments.parts:
        if part == "goals":
            found = on_goals(arguments.samples, arguments.stride)
        elif part == "cost":
            found = on_cost(1000)
        else:
            found = on_vicon(arguments.data, arguments.model, arguments.samples, arguments.stride)
        known = json.loads(arguments.out.read_text()) if arguments.out.exists() else {}
        known.pop("machine", None)
        save(
            "context",
            {**known, part: {"samples": arguments.samples, "stride": arguments.stride, **found}},
            arguments.out,
            before,
        )


if __name__ == "__main__":
    main()
