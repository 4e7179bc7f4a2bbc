"""Where a plain camera puts people: real motions, rendered as the network would give them, against where they were.

python -m benchmarks.webcam --data DATA [--takes N] [--video VIDEO] [--out JSON]

Landmarks are the joints of recordings (CMU, Berkeley MHAD) before a camera of 640 x 480 pixels and 65°, 1.4 m high,
5° down, with the published errors: in the image 8 % of the torso (σ at which 95.7 % are within 20 %, MediaPipe's
PCK@0.2), in the shape's depth 61 mm (97 mm in three dimensions, Kim et al. 2023), shapes 8 % too large or too small
for each take. Errors last 1 s (first-order), beside jitter that was measured on a video of a photograph: 1.5 % of the
torso in the image, 10 mm in depth. With --video, what a picture of it costs, step by step, one after the other.
"""

from __future__ import annotations

import argparse
import json
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from benchmarks.machine import facts, milliseconds, save
from kinecast.body.skeleton import ARM_JOINTS
from kinecast.cameras.landmarker import JOINTS, Landmarker, Landmarks
from kinecast.cameras.overlay import Picture, drawn
from kinecast.cameras.pinhole import Intrinsics, PinholeCamera, level_pose
from kinecast.cameras.single_view import BODY, ScaleOptions, SingleView, height_of, turn_towards
from kinecast.cameras.video import VideoStream
from kinecast.datasets.loading import load
from kinecast.datasets.remote_file import cached_model
from kinecast.geometry.transforms import apply
from kinecast.live.publication import Publication
from kinecast.predictor import Predictor

RATE, LONGEST = 30.0, 8.0  # pictures in a second; of a take [s]
PIXEL, DEPTH, SCALE = 0.08, 0.061, 0.08  # standard deviations: shares of the torso and of the size; [m]
PIXEL_JITTER, DEPTH_JITTER, LASTING = 0.015, 0.010, 1.0  # share of the torso; [m]; [s]
SETTLED = 1.0  # from here on it counts [s]
CONDITIONS = {
    "nothing known": ScaleOptions(focal_std=0.02),
    "body height stated": ScaleOptions(body=1.0, focal_std=0.02),
    "feet on the floor": ScaleOptions(feet_on_floor=True, focal_std=0.02),
}
DISTANCES, ANGLES = (1.5, 2.5, 4.0), (0.0, 25.0)  # [m], [deg] from the optical axis
_SEEN = tuple(joint for joint in BODY if joint != "nose")
_FOOT = ("heel", "foot")


def main() -> None:
    """Runs, prints, writes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--takes", type=int, default=24)
    parser.add_argument("--video", type=Path)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    before = facts()
    result = run(arguments.data, arguments.takes)
    if arguments.video:
        result["cost"] = cost(arguments.video)
    save("webcam", result, arguments.out, before)
    print(json.dumps(result, indent=1))


def run(data: Path, takes: int) -> dict[str, Any]:
    """Errors for each distance, angle and what is known of sizes."""
    motions = list(_motions(data, takes))
    rows = [
        {"known": known, "distance_m": distance, "angle_deg": angle, **_scores(motions, options, distance, angle)}
        for known, options in CONDITIONS.items()
        for distance in DISTANCES
        for angle in ANGLES
    ]
    return {"takes": len(motions), "pictures": sum(map(len, motions)), "rows": rows}


def cost(video: Path) -> dict[str, Any]:
    """Milliseconds by the clock of each step of a picture: network, fit and filter, prediction, drawing."""
    stream, landmarker = VideoStream(str(video)), Landmarker(cached_model("pose-landmarker"))
    width, height = stream.size
    focal = width / 2 / np.tan(np.radians(65 / 2))
    lens = Intrinsics(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
    camera = PinholeCamera("c", lens, level_pose(1.4))
    view, predictor, rows = SingleView(camera, ScaleOptions(body=1.75)), Predictor.shipped(), []
    for stamp, image in stream.pictures(threading.Event()):
        times = [time.perf_counter()]
        people = landmarker.update(image, stamp)
        times.append(time.perf_counter())
        frame = view.update(stamp, next(iter(people.values()))) if people else None
        times.append(time.perf_counter())
        if frame is not None:
            prediction = predictor.observe(frame)
            times.append(time.perf_counter())
            published = Publication.of(len(rows) + 1, "c", frame, prediction, 0.95, 0.0)
            drawn(Picture("c", stamp, image, camera, stream.rate), [published])
            rows.append(np.diff([*times, time.perf_counter()]))
    landmarker.close()
    steps = np.array(rows[10:]).T
    names = ("network", "fit_and_filter", "prediction", "drawing")
    return {name: milliseconds(step) for name, step in zip(names, steps, strict=True)} | {"pixels": [width, height]}


def _motions(data: Path, takes: int) -> Iterator[Float[np.ndarray, "T 12 3"]]:
    """Takes at 30 Hz, feet on the floor, the middle of the hips at the origin on average."""
    files = sorted((data / "cmu").rglob("*.parquet")) + sorted((data / "mhad").rglob("a0[45]*e01.parquet"))
    chosen = [files[k] for k in np.linspace(0, len(files) - 1, min(takes, len(files))).astype(int)]
    for recording in load(chosen):
        columns = [recording.joints.index(joint) for joint in _SEEN]
        stamps = (
            np.arange(0.0, min(recording.stamps[-1] - recording.stamps[0], LONGEST), 1 / RATE) + recording.stamps[0]
        )
        flat = recording.positions[:, columns].reshape(len(recording.positions), -1)
        motion = np.stack([np.interp(stamps, recording.stamps, column) for column in flat.T], axis=1).reshape(-1, 12, 3)
        if np.isfinite(motion).all() and len(motion) > 2 * SETTLED * RATE:
            hips = motion[:, [_SEEN.index("left_hip"), _SEEN.index("right_hip")]].mean(axis=(0, 1))
            floor = motion[:, [_SEEN.index("left_ankle"), _SEEN.index("right_ankle")], 2].min() - 0.08
            yield motion - [hips[0], hips[1], floor]


def _scores(motions: list[np.ndarray], options: ScaleOptions, distance: float, angle: float) -> dict[str, float]:
    errors, lags, jitters = [], [], []
    for seed, motion in enumerate(motions):
        rng = np.random.default_rng(seed)
        off = distance * np.array([np.sin(np.radians(angle)), np.cos(np.radians(angle)), 0.0])
        truth, found, covariance, raw = _found(motion + off, options, rng)
        ray = off / np.linalg.norm(off)
        error = found - truth
        error = error[np.isfinite(error).all(axis=(1, 2))]
        middle = error[:, [0, 3]].mean(axis=1)
        along = np.abs(middle @ ray)
        across = np.linalg.norm(middle - (middle @ ray)[:, None] * ray, axis=1)
        arms = np.linalg.norm(error - middle[:, None], axis=2)[:, [1, 2, 4, 5]]
        square = np.einsum("tjx,tjxy,tjy->tj", found - truth, np.linalg.inv(covariance), found - truth)
        inside = np.nanmean(square <= 6.251)  # 90 % of χ² with three degrees of freedom
        errors.append([along.mean(), across.mean(), arms.mean(), np.linalg.norm(error, axis=2).mean(), inside])
        lags.append([_lag(truth[:, [2, 5]], raw[:, [2, 5]]), _lag(truth[:, [2, 5]], found[:, [2, 5]])])
        jitters.append([_jitter(raw[:, [2, 5]] - truth[:, [2, 5]]), _jitter((found - truth)[:, [2, 5]])])
    along, across, arms, joints, inside = np.mean(errors, axis=0)
    (lag_before, lag), (jitter_before, jitter) = np.median(lags, axis=0), np.mean(jitters, axis=0)
    return {
        "along_the_ray_mm": round(1e3 * along), "across_mm": round(1e3 * across),
        "arms_to_shoulders_mm": round(1e3 * arms), "joint_mm": round(1e3 * joints),
        "inside_90": round(float(inside), 3),
        "wrist_lag_ms": round(1e3 * lag, 1), "unfiltered_lag_ms": round(1e3 * lag_before, 1),
        "wrist_jitter_mm": round(1e3 * jitter, 1), "unfiltered_jitter_mm": round(1e3 * jitter_before, 1),
    }  # fmt: skip


def _found(motion: np.ndarray, options: ScaleOptions, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """True arms (T, 6, 3), those found, their covariance, and those of a filter that believes every picture."""
    focal = 320 / np.tan(np.radians(65 / 2))
    camera = PinholeCamera("c", Intrinsics(640, 480, focal, focal, 319.5, 239.5), level_pose(1.4, np.radians(5.0)))
    if options.body:
        options = ScaleOptions(body=_stature(motion) * (1 + 0.01 * rng.standard_normal()), focal_std=options.focal_std)
    view, unfiltered = SingleView(camera, options), Unfiltered(camera, options)
    arms = [BODY.index(joint) for joint in ARM_JOINTS]
    rows = []
    for k, person in enumerate(_landmarks(motion, camera, rng)):
        frame, plain = view.update(k / RATE, person), unfiltered.update(k / RATE, person)
        lost = np.full((6, 3), np.nan), np.full((6, 3, 3), np.nan), np.full((6, 3), np.nan)
        known = frame is not None and frame.covariance is not None and plain is not None
        rows.append((frame.positions[arms], frame.covariance[arms], plain.positions[arms]) if known else lost)
    start = round(SETTLED * RATE)
    found, covariance, raw = (np.array([row[k] for row in rows])[start:] for k in range(3))
    return motion[start:, [_SEEN.index(joint) for joint in ARM_JOINTS]], found, covariance, raw


class Unfiltered(SingleView):
    """Begins anew with every picture."""

    def update(self, stamp: float, person: Landmarks, name: str = "0") -> Any:
        self._states = None
        return super().update(stamp, person, name)


def _stature(motion: np.ndarray) -> float:
    """Height that bones of this length belong to [m]."""
    shape = np.full((len(JOINTS), 3), np.nan)
    shape[[JOINTS.index(joint) for joint in _SEEN]] = motion[0]
    return height_of(JOINTS, shape, np.isfinite(shape).all(axis=1))


def _landmarks(motion: np.ndarray, camera: PinholeCamera, rng: np.random.Generator) -> Iterator[Landmarks]:
    """What the network would give, picture by picture."""
    rows = [JOINTS.index(joint) for joint in _SEEN]
    feet = [JOINTS.index(f"{side}_{part}") for side in ("left", "right") for part in _FOOT]
    hips = [_SEEN.index("left_hip"), _SEEN.index("right_hip")]
    size = np.exp(SCALE * rng.standard_normal())
    stays = np.exp(-1 / (LASTING * RATE))
    slow = rng.standard_normal((16, 3))
    for points in motion:
        ankles = points[[_SEEN.index("left_ankle"), _SEEN.index("right_ankle")]]
        ground = np.repeat(ankles, 2, axis=0) * [1, 1, 0] + [0, 0, 0.03]
        everything = np.concatenate([points, ground])
        local = apply(camera.T_camera_world, everything)
        middle = local[hips].mean(axis=0)
        turned = (local - middle) @ turn_towards(middle[:2] / middle[2])
        pixels, _ = camera.project(everything)
        torso = np.linalg.norm(pixels[[0, 3]].mean(axis=0) - pixels[hips].mean(axis=0))
        slow = stays * slow + np.sqrt(1 - stays**2) * rng.standard_normal(slow.shape)
        fast = rng.standard_normal(slow.shape)
        pixels = pixels + torso * (PIXEL * slow + PIXEL_JITTER * fast)[:, :2]
        turned[:, 2] += DEPTH * slow[:, 2] + DEPTH_JITTER * fast[:, 2]
        turned -= turned[hips].mean(axis=0)
        shape, places, confidence = np.full((33, 3), np.nan), np.full((33, 2), np.nan), np.zeros(33)
        shape[rows + feet], places[rows + feet], confidence[rows + feet] = turned / size, pixels, 1.0
        yield Landmarks(places, shape, confidence)


def _lag(truth: np.ndarray, found: np.ndarray) -> float:
    """Delay at which what was found is most like the truth [s], by its velocity."""
    lags = np.arange(-3.0, 6.01, 0.1)
    k = np.arange(len(truth))
    flat, other = truth.reshape(len(truth), -1), found.reshape(len(found), -1)
    flat, other = flat - flat.mean(axis=0), other - np.nanmean(other, axis=0)
    apart = [
        np.nanmean((np.stack([np.interp(k - lag, k, column) for column in flat.T], axis=1) - other)[10:-10] ** 2)
        for lag in lags
    ]
    return float(lags[int(np.argmin(apart))]) / RATE


def _jitter(error: np.ndarray) -> float:
    """Standard deviation of what changes from picture to picture [m]: second difference over √6, three axes at once."""
    return float(np.sqrt((np.nanvar(np.diff(error, n=2, axis=0), axis=0) / 6).sum(axis=-1).mean()))


if __name__ == "__main__":
    main()
