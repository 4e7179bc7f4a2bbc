"""Three cameras into one skeleton: error, hidden joints, crossings, lag and time, beside each camera and an average.

python -m benchmarks.fusion --data FOLDER [--takes N] [--seconds S] [--crossings N] [--seed N] [--tuning] [--out JSON]
    [--picture PNG]

Recorded Vicon motions are seen by rendered cameras (benchmarks/fusion_views.py). --tuning takes the recordings that the
constants of the fusion were chosen on; without it others are used, and other seeds.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import machine
from benchmarks.fusion_views import SLOW, Body, Faults, Image, disturbed, images, rig
from kinecast.cameras.fusion.fusion import Fusion
from kinecast.cameras.fusion.measurement import DEEP, skin_depths
from kinecast.cameras.rig import Rig
from kinecast.datasets.loading import load
from kinecast.types import SkeletonFrame

TUNED_ON = ("CollaborativeStacking", "CollaborativeLifting")
REPORTED_ON = ("CollaborativeHammering", "HumanRobotHandover", "PickPlaceCloseHuman", "TossTheCan")
RIGHT = 0.150
"""A joint that near is found [m]: the threshold of 3DPCK (Mehta et al. 2017, MPI-INF-3DHP)."""
SAME = 0.5
"""A skeleton further from everybody than this is of nobody [m]."""
PELVIS = 0.95
SETTLED = 0.5
ARMS = ("left_shoulder", "left_elbow", "left_wrist", "right_shoulder", "right_elbow", "right_wrist")
APART = 10
"""Images between two places that are compared for the lag."""
SHIFTS = np.arange(-0.060, 0.1201, 0.002)


@dataclass(frozen=True)
class Shown:
    """One skeleton that came out."""

    taken: float  # true time of the newest image in it [s]
    positions: np.ndarray  # (J, 3) in the order of the body's joints; NaN where not given
    variance: np.ndarray  # (J, 3, 3) what it says of its own error [m²]
    hidden: np.ndarray  # (J,) whether the panel hid the joint from the first camera in its newest image
    person: str


def main() -> None:
    """Runs, prints, writes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--takes", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=12.0)
    parser.add_argument("--crossings", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tuning", action="store_true")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--picture", type=Path)
    arguments = parser.parse_args()
    before = machine.facts()
    result = run(
        arguments.data, arguments.takes, arguments.seconds, arguments.crossings, arguments.seed, arguments.tuning
    )
    for name, each in result["one_person"].items():
        print(name)
        for method, figures in each.items():
            print(f"  {method:8}", "  ".join(f"{key} {value:.4g}" for key, value in figures.items()))
    print("crossings", result["crossings"])
    print("time", result["time"], result["processor_time"])
    if arguments.out:
        machine.save("fusion", result, arguments.out, before)
    if arguments.picture:
        draw(arguments.picture, arguments.data, arguments.seconds, arguments.seed)


def run(data: Path, takes: int, seconds: float, crossings: int, seed: int, tuning: bool) -> dict[str, Any]:
    """All scenarios; see the module."""
    tasks, seed = (TUNED_ON, seed + 1000) if tuning else (REPORTED_ON, seed)
    bodies = [body for task in tasks for body in _bodies(data / task, takes, seconds)]
    scenarios = {
        "as sourced": Faults(),
        "30 % of one view hidden": Faults(hidden=0.3),
        "30 % hidden, errors of pixels all new": Faults(hidden=0.3, slow=0.0),
        "30 % hidden, errors of pixels all standing": Faults(hidden=0.3, slow=1.0),
    }
    crossed, times, busy = cross(bodies, crossings, seed)
    return {
        "data": {"tasks": list(tasks), "takes": len(bodies), "seconds": seconds, "seed": seed},
        "one_person": {
            name: one_person(bodies, faults, seed, alone=faults.slow == SLOW) for name, faults in scenarios.items()
        },
        "crossings": crossed,
        "time": machine.milliseconds(times),
        "processor_time": machine.milliseconds(busy),
    }


def one_person(bodies: Sequence[Body], faults: Faults, seed: int, alone: bool = True) -> dict[str, dict[str, float]]:
    """Figures of the fusion, of an average, and perhaps of each camera alone, over all bodies."""
    return {name: figures(each) for name, each in shown_by_all(bodies, faults, seed, alone).items()}


def shown_by_all(
    bodies: Sequence[Body], faults: Faults, seed: int, alone: bool = True
) -> dict[str, list[tuple[Body, list[Shown], int]]]:
    """Per method and body what it shows, and in how many rounds it could."""
    truth = rig()
    shown: dict[str, list[tuple[Body, list[Shown], int]]] = {}
    for k, body in enumerate(bodies):
        known, seen = disturbed(truth, faults, seed + k), images(truth, [body], faults, seed + k)
        for name in ("fused", *(truth.cameras if alone else ())):
            cameras = truth.cameras if name == "fused" else {name: truth.cameras[name]}
            mine = Rig({camera: known.cameras[camera] for camera in cameras})
            frames, rounds = _fuse(mine, [image for image in seen if image.camera in cameras], body)
            shown.setdefault(name, []).append((body, frames, rounds))
        shown.setdefault("average", []).append((body, *_average(known, seen, body)))
    return shown


def figures(runs: Sequence[tuple[Body, list[Shown], int]]) -> dict[str, float]:
    """Errors [mm], shares of joints, what the covariance promises, and lag [ms]."""
    errors, hidden, inside, given, expected = [], [], [], 0, 0
    for body, frames, rounds in runs:
        for shown in frames:
            real = body.at(shown.taken)
            off = shown.positions - real
            error = np.linalg.norm(off, axis=1)
            exists = np.isfinite(real).all(axis=1)
            errors.append(np.where(exists, error, np.nan))
            hidden.append(error[shown.hidden & exists])
            told = exists & np.isfinite(error)
            with np.errstate(invalid="ignore"):
                inside.append(_mahalanobis(off[told], shown.variance[told]) < 7.815)  # χ²₀.₉₅ of three
            given += int(np.isfinite(error[exists]).sum())
        expected += max(rounds, len(frames)) * len(body.joints)
    all_errors, behind = np.concatenate(errors), np.concatenate(hidden)
    found = all_errors[np.isfinite(all_errors)]
    result = {
        "mean_mm": 1e3 * float(found.mean()),
        "median_mm": 1e3 * float(np.median(found)),
        "p95_mm": 1e3 * float(np.percentile(found, 95)),
        "given": given / max(expected, 1),
        "within_150mm": float((all_errors < RIGHT).sum() / max(expected, 1)),
        "in_95_percent_region": float(np.mean(np.concatenate(inside) if any(map(len, inside)) else np.nan)),
        "lag_ms": 1e3 * lag([(body, frames) for body, frames, _ in runs]),
    }
    if len(behind):
        result |= {
            "hidden_joints": len(behind),
            "hidden_within_150mm": float((behind < RIGHT).mean()),
            "hidden_within_100mm": float((behind < 0.1).mean()),
            "hidden_within_50mm": float((behind < 0.05).mean()),
        }
    return result


def lag(runs: Sequence[tuple[Body, list[Shown]]]) -> float:
    """By how much what is shown moves later than the arms [s]: where a third of a second's moves fit best."""
    products, mine, theirs = (np.zeros(len(SHIFTS)) for _ in range(3))
    for body, frames in runs:
        columns = [body.joints.index(joint) for joint in ARMS]
        stamps, places = np.array([f.taken for f in frames]), np.array([f.positions[columns] for f in frames])
        before, after, moved = stamps[:-APART], stamps[APART:], places[APART:] - places[:-APART]
        for k, shift in enumerate(SHIFTS):
            real = (body.at(after - shift) - body.at(before - shift))[:, columns]
            both = np.isfinite(moved).all(axis=2) & np.isfinite(real).all(axis=2)
            products[k] += (moved[both] * real[both]).sum()
            mine[k] += (moved[both] ** 2).sum()
            theirs[k] += (real[both] ** 2).sum()
    correlation = products / np.sqrt(np.maximum(mine * theirs, 1e-12))
    k = int(np.clip(np.argmax(correlation), 1, len(SHIFTS) - 2))
    below, top, above = correlation[k - 1 : k + 2]
    bend = below - 2 * top + above
    return float(SHIFTS[k] + (SHIFTS[1] - SHIFTS[0]) * (0.5 * (below - above) / bend if bend else 0.0))


def cross(bodies: Sequence[Body], count: int, seed: int) -> tuple[dict[str, float], list[float], list[float]]:
    """Two persons walk past one another, so many times: switches of identity, seconds and processor seconds a round."""
    truth, rng = rig(), np.random.default_rng([seed, 7])
    switches = ghosts = rounds = given = 0
    times: list[float] = []
    busy: list[float] = []
    errors: list[float] = []
    for k in range(count):
        one, two = rng.choice(len(bodies), 2, replace=False)
        pair = _walk(bodies[one], bodies[two], rng)
        known = disturbed(truth, Faults(), seed + 500 + k)
        fusion, taken = Fusion(known), {}
        names: list[str | None] = [None, None]
        for image in images(truth, pair, Faults(), seed + 500 + k):
            taken[image.stamp] = image.taken
            begun, idle = time.perf_counter(), time.thread_time()
            frames = fusion.add(image.camera, image.stamp, image.views)
            if not frames:
                continue
            times.append(time.perf_counter() - begun)
            busy.append(time.thread_time() - idle)
            if taken[frames[0].stamp] < pair[0].stamps[0] + SETTLED:
                continue
            rounds += 1
            real = [body.at(taken[frames[0].stamp]) for body in pair]
            for frame in frames:
                away = [_apart(frame, body, place) for body, place in zip(pair, real, strict=True)]
                who = int(np.argmin(away))
                if away[who] > SAME:
                    ghosts += 1
                    continue
                given += 1
                errors.append(away[who])
                switches += names[who] not in (None, frame.person)
                names[who] = frame.person
    summary = {
        "crossings": count,
        "identity_switches": switches,
        "skeletons_of_nobody": ghosts / max(given, 1),
        "persons_given": given / max(2 * rounds, 1),
        "mean_mm": 1e3 * float(np.mean(errors)),
    }
    return summary, times, busy


def draw(path: Path, data: Path, seconds: float, seed: int) -> None:
    """A picture of one take with a third of the left camera's view hidden: errors, and one coordinate of a wrist."""
    from matplotlib.figure import Figure

    body = _bodies(data / "TossTheCan", 1, seconds)[0]
    shown = shown_by_all([body], Faults(hidden=0.3), seed)
    colours = dict(zip(("fused", "left", "right", "back", "average"), ("C0", "C3", "C1", "C4", "0.5"), strict=True))
    figure = Figure(figsize=(10, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.6))
    for name, colour in colours.items():
        _, frames, _ = shown[name][0]
        errors = np.concatenate([1e3 * np.linalg.norm(f.positions - body.at(f.taken), axis=1) for f in frames])
        errors = np.sort(np.nan_to_num(errors, nan=np.inf))
        left.plot(errors, np.linspace(0, 1, len(errors)), color=colour, label=name, lw=2 if name == "fused" else 1)
    left.set(xlim=(0, 300), ylim=(0, 1), xlabel="error of a joint [mm]", ylabel="share of joints")
    left.legend(loc="lower right", frameon=False)
    wrist = body.joints.index("right_wrist")
    for name in ("left", "fused"):
        _, frames, _ = shown[name][0]
        places = np.array([f.positions[wrist, 1] for f in frames])
        right.plot([f.taken for f in frames], places, color=colours[name], lw=1, label=name)
    times = np.array([f.taken for f in shown["fused"][0][1]])
    right.plot(times, body.at(times)[:, wrist, 1], "k:", lw=1.5, label="truth")
    hidden = np.array([f.hidden[wrist] for f in shown["fused"][0][1]])
    right.fill_between(times, 0, 1, where=hidden, transform=right.get_xaxis_transform(), color="0.88", lw=0)
    right.set(xlabel="time [s]", ylabel="y of the right wrist [m]", title="grey: hidden from the left camera")
    low, high = np.nanpercentile(body.positions[:, wrist, 1], [0, 100])
    right.set_ylim(low - 0.25, high + 0.25)
    right.legend(loc="upper right", frameon=False, ncols=3)
    figure.savefig(path, dpi=110)


def _bodies(folder: Path, takes: int, seconds: float) -> list[Body]:
    """The first takes of a folder that have both arms, moved to the middle of the cameras."""
    found = []
    for path in sorted(folder.glob("*.csv.xz")):
        take = load(path)[0]
        if not {*ARMS, "collar", "pelvis"} <= set(take.joints) or len(found) >= takes:
            continue
        some = take.select(slice(0, int(seconds * take.rate)))
        middle = np.nanmean(some.joint("pelvis"), axis=0)
        found.append(Body(some.stamps - some.stamps[0], some.joints, some.positions - middle + (0, 0, PELVIS)))
    return found


def _walk(one: Body, two: Body, rng: np.random.Generator) -> list[Body]:
    """Both for as long as both last, on two lines 0.5 to 0.7 m apart, in opposite directions."""
    length = min(len(one.stamps), len(two.stamps), 600)
    turn, speed, gap = rng.uniform(0, 2 * np.pi), rng.uniform(0.5, 0.9), rng.uniform(0.5, 0.7)
    along, side = np.array([np.cos(turn), np.sin(turn), 0.0]), np.array([-np.sin(turn), np.cos(turn), 0.0])
    pair = []
    for body, sign in ((one, 1.0), (two, -1.0)):
        stamps = body.stamps[:length] - body.stamps[0]
        reach = speed * (stamps - stamps[-1] / 2)
        reach = np.clip(reach, -1.4, 1.4)
        place = sign * (reach[:, None] * along + gap / 2 * side)
        middle = np.nanmean(body.positions[:length, body.joints.index("pelvis")], axis=0) * (1, 1, 0)
        pair.append(Body(stamps, body.joints, body.positions[:length] - middle + place[:, None]))
    return pair


def _fuse(known: Rig, seen: Sequence[Image], body: Body) -> tuple[list[Shown], int]:
    """What the fusion gives for one person; and in how many rounds it could have."""
    fusion, shown, rounds = Fusion(known), [], 0
    taken: dict[float, float] = {}
    hidden = np.zeros(len(body.joints), bool)
    for image in seen:
        taken[image.stamp] = image.taken
        if image.camera == "left":
            hidden = image.hidden[0]
        frames = fusion.add(image.camera, image.stamp, image.views)
        settled = image.taken > body.stamps[0] + SETTLED
        rounds += settled and image.camera == seen[0].camera
        if frames and settled:
            frame = max(frames, key=lambda each: np.isfinite(each.positions).all(axis=1).sum())
            shown.append(_shown(frame, body, taken[frame.stamp], hidden))
    return shown, rounds


def _shown(frame: SkeletonFrame, body: Body, taken: float, hidden: np.ndarray) -> Shown:
    positions, variance = np.full((len(body.joints), 3), np.nan), np.full((len(body.joints), 3, 3), np.nan)
    for column, joint in enumerate(frame.joints):
        if joint in body.joints:
            positions[body.joints.index(joint)] = frame.positions[column]
            assert frame.covariance is not None
            variance[body.joints.index(joint)] = frame.covariance[column]
    return Shown(taken, positions, variance, hidden, frame.person)


def _average(known: Rig, seen: Sequence[Image], body: Body) -> tuple[list[Shown], int]:
    """The middle of what each camera's newest image says by pixels and depths, whenever the first camera's comes."""
    newest: dict[str, np.ndarray] = {}
    shown, rounds = [], 0
    hidden = np.zeros(len(body.joints), bool)
    skin = skin_depths(body.joints)
    for image in seen:
        if image.camera == "left":
            hidden = image.hidden[0]
        if image.views:
            view, camera = image.views[0], known.cameras[image.camera]
            near = np.abs(view.depth - np.nanmedian(view.depth)) < DEEP if np.isfinite(view.depth).any() else view.seen
            newest[image.camera] = camera.back_project(view.pixels, np.where(near, view.depth + skin, np.nan))
        if image.camera == seen[0].camera and image.taken > body.stamps[0] + SETTLED and newest:
            rounds += 1
            places = np.stack(list(newest.values()))
            count = np.isfinite(places).all(axis=-1).sum(axis=0)
            middle = np.nansum(places, axis=0) / np.where(count > 0, count, np.nan)[:, None]
            spread = np.full((len(body.joints), 3, 3), np.nan)
            shown.append(Shown(image.taken, middle, spread, hidden, "0"))
    return shown, rounds


def _mahalanobis(off: np.ndarray, variance: np.ndarray) -> np.ndarray:
    known = np.isfinite(variance).all(axis=(1, 2))
    off, variance = off[known], variance[known]
    return np.einsum("ji,ji->j", off, np.linalg.solve(variance, off[..., None])[..., 0])


def _apart(frame: SkeletonFrame, body: Body, place: np.ndarray) -> float:
    """Mean distance of a skeleton from a person [m]."""
    there = place[[body.joints.index(joint) for joint in frame.joints if joint in body.joints]]
    here = frame.positions[[joint in body.joints for joint in frame.joints]]
    away = np.linalg.norm(here - there, axis=1)
    return float(np.nanmean(away)) if np.isfinite(away).any() else np.inf


if __name__ == "__main__":
    main()
