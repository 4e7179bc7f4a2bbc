"""Real motions as three depth cameras and their pose estimators would see them; nothing here is known to the fusion.

What the noise is made of:

- Pixels: an annotator's spread on COCO, σ_k times the root of the person's area in pixels (cocodataset.org, keypoints
  evaluation), with 0.53 of the box as the area, as mmpose takes it. That is of both coordinates together.
  Most of an estimator's error stays from image to image: HA4M's joints jitter by 1.3 to 2.4 mm (robot/camera.py),
  while trackers are centimetres off. So SLOW of the variance fades with FADE, the rest is new in each image.
- Depth: a RealSense D435's, 0.08 px / (f · 50 mm) of its square (Intel, Best known methods for tuning D400 depth
  cameras), read where the estimator believes the joint to be: on the body's surface, on who stands before it, or on
  the wall where it misses the limb.
- A body is capsules around the recorded points. A joint behind one, or behind another person, is guessed: three times
  as far off, with half the confidence.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from kinecast.body.skeleton import without_side
from kinecast.cameras.pinhole import Intrinsics, PinholeCamera
from kinecast.cameras.rig import Rig
from kinecast.geometry.transforms import from_rotation_vector, transform
from kinecast.live.clock import SourceClock
from kinecast.live.detection import Detection

COCO_SIGMA = {"shoulder": 0.079, "elbow": 0.072, "wrist": 0.062, "hip": 0.107}
OTHER_SIGMA = 0.079
"""Collar, head and pelvis are no COCO keypoints."""
BOX_SHARE = 0.53
SLOW, FADE = 0.8, 0.5
DEPTH_STD = 0.08 / (674 * 0.05)
WALL = 6.0
GUESS, GUESS_CONFIDENCE = 3.0, 0.5
LIMBS = (
    ("pelvis", "chest", 0.12), ("collar", "head", 0.06), ("head", "head", 0.10),
    ("collar", "left_shoulder", 0.06), ("collar", "right_shoulder", 0.06),
    ("left_shoulder", "left_elbow", 0.048), ("right_shoulder", "right_elbow", 0.048),
    ("left_elbow", "left_wrist", 0.035), ("right_elbow", "right_wrist", 0.035),
)  # fmt: skip
"""Capsules, and their radii [m]; where no chest was recorded it is CHEST of the way from pelvis to collar."""
CHEST = 0.75


@dataclass(frozen=True)
class Faults:
    """What is wrong with the cameras."""

    lost: float = 0.02  # share of joints that an estimator does not give
    dropped: float = 0.02  # share of images that never arrive
    hidden: float = 0.0  # share of the joints in the first camera's view that a panel hides
    drift: float = 50e-6  # clocks run so much apart, at most [s/s]
    place: float = 0.003  # standard deviation of the error in each camera's place [m]
    angle: float = 1e-3  # and in its direction [rad]
    slow: float = SLOW  # share of the variance of pixels that stays from image to image
    scale: float = 1.0  # of the error of pixels


@dataclass(frozen=True)
class Body:
    """One person: what is recorded, moved to where the cameras are."""

    stamps: Float[np.ndarray, " N"]  # [s]
    joints: tuple[str, ...]
    positions: Float[np.ndarray, "N J 3"]  # [m]

    def at(self, time: float | np.ndarray) -> Float[np.ndarray, "*t J 3"]:
        """(…, J, 3) at instants (…) [s], between the two recorded ones."""
        k = np.clip(np.searchsorted(self.stamps, time), 1, len(self.stamps) - 1)
        share = np.clip((time - self.stamps[k - 1]) / (self.stamps[k] - self.stamps[k - 1]), 0, 1)
        share = np.asarray(share)[..., None, None]
        return self.positions[k - 1] * (1 - share) + self.positions[k] * share


@dataclass(frozen=True)
class Image:
    """What one camera's estimator sends."""

    camera: str
    taken: float  # true time [s]
    stamp: float  # what the fusion's machine believes it to be [s]
    arrived: float  # when it got there [s]
    views: tuple[Detection, ...]  # everybody seen, from left to right, numbered so
    hidden: tuple[np.ndarray, ...]  # per body, (J,) whether the panel hid the joint


def rig() -> Rig:
    """Three D435s 3 m around the middle, 1.9 m up."""
    cameras = {}
    for name, azimuth in (("left", -60.0), ("right", 45.0), ("back", 170.0)):
        a = np.radians(azimuth)
        place = np.array([3.0 * np.cos(a), 3.0 * np.sin(a), 1.9])
        forward = np.array([0.0, 0.0, 1.1]) - place
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        R = np.stack([right, np.cross(forward, right), forward], axis=1)
        intrinsics = Intrinsics(1280, 720, 910.0, 910.0, 640.0, 360.0)
        cameras[name] = PinholeCamera(name, intrinsics, transform(R, place))
    return Rig(cameras)


def images(truth: Rig, bodies: Sequence[Body], faults: Faults, seed: int, rate: float = 30.0) -> list[Image]:
    """Every image of every camera while all bodies are recorded, in the order they arrive."""
    start, end = max(b.stamps[0] for b in bodies), min(b.stamps[-1] for b in bodies)
    streams = [
        _stream(camera, k, bodies, faults, np.random.default_rng([seed, k]), start, end, rate)
        for k, camera in enumerate(truth.cameras.values())
    ]
    return list(heapq.merge(*streams, key=lambda image: image.arrived))


def disturbed(truth: Rig, faults: Faults, seed: int) -> Rig:
    """The rig as a calibration finds it."""
    rng, cameras = np.random.default_rng([seed, 99]), {}
    for name, camera in truth.cameras.items():
        turn = from_rotation_vector(rng.normal(0, faults.angle, 3))
        T = camera.T_world_camera.copy()
        T[:3, :3] = T[:3, :3] @ turn
        T[:3, 3] += rng.normal(0, faults.place, 3)
        cameras[name] = replace(camera, T_world_camera=T)
    return Rig(cameras)


def _stream(
    camera: PinholeCamera,
    index: int,
    bodies: Sequence[Body],
    faults: Faults,
    rng: np.random.Generator,
    start: float,
    end: float,
    rate: float,
) -> Iterator[Image]:
    clock, offset = SourceClock(), rng.uniform(-1e6, 1e6)
    drift = rng.uniform(-faults.drift, faults.drift)
    least = 0.03 + 0.01 * index  # the three images go through one estimator, one after the other
    period, taken, arrived = 1 / rate, start + rng.uniform(0, 1 / rate), -np.inf
    slow = [rng.normal(size=(len(b.joints), 2)) for b in bodies]
    panel = _Panel(rng)
    while taken < end:
        fade = np.exp(-period / FADE)
        slow = [fade * s + np.sqrt(1 - fade**2) * rng.normal(size=s.shape) for s in slow]
        arrived = max(taken + least + rng.exponential(0.005), arrived)
        if rng.random() >= faults.dropped:
            stamp = clock.acquired(taken * (1 + drift) + offset, arrived)
            points = [b.at(taken) for b in bodies]
            share = faults.hidden if index == 0 else 0.0
            views, hidden = [], []
            for k, body in enumerate(bodies):
                view, behind = _look(camera, body.joints, k, points, bodies, slow[k], faults, share, panel, taken, rng)
                views.append(replace(view, stamp=stamp))
                hidden.append(behind)
            order = np.argsort([np.nanmean(v.pixels[:, 0]) if v.seen.any() else np.inf for v in views])
            named = tuple(replace(views[k], person=str(place)) for place, k in enumerate(order) if views[k].seen.any())
            yield Image(camera.name, float(taken), float(stamp), float(arrived), named, tuple(hidden))
        taken += period


class _Panel:
    """Hides what lies beyond a line in the image that turns and moves with the person."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._angle, self._turn = rng.uniform(0, 2 * np.pi), rng.uniform(0.3, 0.8) * rng.choice([-1, 1])
        self._wave = rng.uniform(0, 2 * np.pi)

    def hides(self, pixels: Float[np.ndarray, "J 2"], time: float, share: float) -> np.ndarray:
        """(J,) whether a joint is behind it, of so many on the average."""
        if not share:
            return np.zeros(len(pixels), bool)
        angle = self._angle + self._turn * time
        along = pixels @ (np.cos(angle), np.sin(angle))
        now = np.clip(share * (1 + 0.8 * np.sin(time + self._wave)), 0, 1)
        known = np.isfinite(along)
        return known & (along > np.quantile(along[known], 1 - now)) if known.any() else known


def _look(
    camera: PinholeCamera,
    joints: tuple[str, ...],
    own: int,
    points: Sequence[Float[np.ndarray, "J 3"]],
    bodies: Sequence[Body],
    slow: Float[np.ndarray, "J 2"],
    faults: Faults,
    share: float,
    panel: _Panel,
    taken: float,
    rng: np.random.Generator,
) -> tuple[Detection, np.ndarray]:
    eye = camera.T_world_camera[:3, 3]
    exact, _ = camera.project(points[own])
    i = camera.intrinsics
    inside = (exact > 0).all(axis=1) & (exact < (i.width, i.height)).all(axis=1)
    side = np.ptp(exact[np.isfinite(exact).all(axis=1)], axis=0) if np.isfinite(exact).any() else np.zeros(2)
    sigma = np.array([COCO_SIGMA.get(without_side(joint), OTHER_SIGMA) for joint in joints])
    # The points end at the hip: a standing person's box is twice as high.
    std = faults.scale * sigma * np.sqrt(BOX_SHARE * max(side[0], 0.25 * side[1]) * 2 * side[1]) / np.sqrt(2)
    reach = _first_hit(eye, points[own] - eye, points, bodies, skip=(own, joints))
    occluded = reach < 1.0
    behind = panel.hides(exact, taken, share) & inside
    guess = np.where(occluded | behind, GUESS, 1.0)[:, None]
    error = np.sqrt(faults.slow) * slow + np.sqrt(1 - faults.slow) * rng.normal(size=slow.shape)
    pixels = exact + error * std[:, None] * guess
    rays = camera.rays(pixels)
    along = rays @ camera.T_world_camera[:3, 2]
    hit = _first_hit(eye, np.nan_to_num(rays), points, bodies)  # unit vectors: the distance
    surface = np.where(behind, 1.2, np.where(np.isfinite(hit), hit, WALL)) * along
    surface = surface + rng.normal(size=len(joints)) * DEPTH_STD * surface**2
    confidence = np.where(occluded | behind, GUESS_CONFIDENCE, 0.9) + rng.normal(0, 0.15, len(joints))
    confidence = np.clip(confidence, 0, 1)
    lost = (rng.random(len(joints)) < faults.lost) | ~inside | (behind & (rng.random(len(joints)) < 0.5))
    pixels[lost] = np.nan
    surface[lost] = np.nan
    view = Detection(taken, camera.name, joints, pixels, std, surface, DEPTH_STD * surface**2, confidence)
    return view, behind


def _first_hit(
    eye: Float[np.ndarray, " 3"],
    rays: Float[np.ndarray, "J 3"],
    points: Sequence[Float[np.ndarray, "K 3"]],
    bodies: Sequence[Body],
    skip: tuple[int, tuple[str, ...]] | None = None,
) -> Float[np.ndarray, " J"]:
    """(J,) share of each ray at which it meets a body; inf where it meets none.

    With `skip`, rays lead to the joints of one body, and limbs that end there, or hold the joint, are passed over.
    """
    starts, ends, radii, touching = [], [], [], []
    for k, (body, place) in enumerate(zip(bodies, points, strict=True)):
        at = dict(zip(body.joints, place, strict=True))
        if "pelvis" in at and "collar" in at:
            at.setdefault("chest", at["pelvis"] + CHEST * (at["collar"] - at["pelvis"]))
        for a, b, radius in LIMBS:
            if a in at and b in at:
                starts.append(at[a])
                ends.append(at[b])
                radii.append(radius)
                touching.append(
                    [skip is not None and skip[0] == k and joint in (a, b) for joint in (skip or (0, ()))[1]]
                )
    hits = _meets(eye, rays, np.array(starts), np.array(ends), np.array(radii))
    if skip is not None:
        hits[np.array(touching).T | _inside(eye + rays, np.array(starts), np.array(ends), np.array(radii))] = np.inf
    return hits.min(axis=1)


def _inside(points: np.ndarray, starts: np.ndarray, ends: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """(J, C) whether a point is in a capsule, or within 3 cm of it: recorded points are markers on the skin."""
    axis, to = ends - starts, points[:, None] - starts
    along = np.clip((to * axis).sum(-1) / np.maximum((axis**2).sum(-1), 1e-9), 0, 1)
    return np.linalg.norm(to - along[..., None] * axis, axis=-1) < radii + 0.03


def _meets(
    eye: np.ndarray, rays: np.ndarray, starts: np.ndarray, ends: np.ndarray, radii: np.ndarray
) -> Float[np.ndarray, "J C"]:
    """(J, C) share of each ray at which it enters each capsule; inf where it does not, as with one that is NaN."""
    with np.errstate(invalid="ignore", divide="ignore"):
        axis = ends - starts
        to = eye - starts  # (C, 3)
        aa, ad, dd = (axis**2).sum(-1), rays @ axis.T, (rays**2).sum(-1)[:, None]
        at, dt, tt = (axis * to).sum(-1), rays @ to.T, (to**2).sum(-1)
        a, b, c = aa * dd - ad**2, aa * dt - at * ad, aa * tt - at**2 - radii**2 * aa
        side = (-b - np.sqrt(b * b - a * c)) / a
        height = at + side * ad
        best = np.where((height > 0) & (height < aa) & (side > 0), side, np.inf)
        for place in (starts, ends):
            off = eye - place
            b, c = rays @ off.T, (off**2).sum(-1) - radii**2
            ball = (-b - np.sqrt(b * b - dd * c)) / dd
            best = np.fmin(best, np.where(ball > 0, ball, np.inf))
    return np.where(np.isnan(best), np.inf, best)
