"""One person in one image as rows of a linear least squares: what a pixel, a depth or a position says.

A pixel at direction (u, v) says x − u z = 0 and y − v z = 0 of the joint (x, y, z) in the camera's axes, a depth says
z = d: all linear in the joint's place in the world, with an error that grows with z for the first two (Hartley and
Sturm, Triangulation, 1997: iterative least squares).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from kinecast.body.skeleton import without_side
from kinecast.cameras.pinhole import PinholeCamera
from kinecast.live.detection import LEAST_CONFIDENCE, Detection
from kinecast.types import SkeletonFrame

SKIN_DEPTH = {
    "shoulder": 0.050, "elbow": 0.035, "wrist": 0.025, "hip": 0.090, "knee": 0.050, "ankle": 0.040, "hand": 0.015,
    "pelvis": 0.110, "lumbar": 0.110, "spine": 0.110, "thorax": 0.110, "chest": 0.110, "collar": 0.050, "neck": 0.055,
    "head": 0.090, "nose": 0.0,
}  # fmt: skip
"""From skin to the joint's centre [m]: half of breadths and depths of body parts in ANSUR II (Gordon et al. 2014)."""
SKIN_STD = 0.015  # by how much that varies with the person, clothes and the side it is seen from [m]

TRUNK = ("pelvis", "lumbar", "spine", "thorax", "chest", "collar", "neck", "head", "nose")
_LIMBS = ("shoulder", "elbow", "wrist", "hand", "hip", "knee", "ankle")
FUSED_JOINTS = (*(f"{side}_{name}" for side in ("left", "right") for name in _LIMBS), *TRUNK)  # others are left out

PLACE_STD, ANGLE_STD = 0.005, 1.7e-3
"""How well a camera's place [m] and direction [rad] are known: `kinecast calibrate` by hand, docs/decisions/0022."""
LEAST_PIXEL_STD = 0.5
NEAR, FAR = 0.1, 20.0  # depths that are believed [m]
DEEP = 0.9  # no joint is so much nearer or farther than most of the person [m]: what is read there is something else
LEAST_STD = 0.002  # of a position that a tracker gives [m]
TRACKER_STD = 0.02  # of one whose tracker does not say: Azure Kinect's against Vicon, Tölgyessy et al. 2021, still arms
STEREO_STD = 0.0024
"""Standard deviation of a depth, by its square [1/m]: 0.08 px / (674 px · 50 mm), a RealSense D435 at 1280 px."""


@dataclass(frozen=True, eq=False)
class Measurement:
    """One person in one image; of several images, with an axis V before all others."""

    stamp: Any  # when the image was taken [s]; (V,) of several
    rows: Float[np.ndarray, "*v J 3 3"]  # what each joint's place in the world is multiplied with
    values: Float[np.ndarray, "*v J 3"]  # what that should give
    near: Float[np.ndarray, "*v J 3"]  # standard deviation of `values`: √(near² + (far z)²), z the depth
    far: Float[np.ndarray, "*v J 3"]
    seen: Bool[np.ndarray, "*v J 2"]  # whether there are the first two rows, whether there is the third
    axis: Float[np.ndarray, "*v 4"]  # z = axis[:3] · p + axis[3]
    camera: str = ""  # its name; empty of several


def stacked(measurements: Sequence[Measurement]) -> Measurement:
    """Several images of one person."""
    parts = ("stamp", "rows", "values", "near", "far", "seen", "axis")
    arrays: list[Any] = [np.stack([getattr(each, part) for each in measurements]) for part in parts]
    return Measurement(*arrays)


def skin_depths(joints: Sequence[str]) -> Float[np.ndarray, " J"]:
    """(J,) from the skin to each joint's centre [m]."""
    return np.array([SKIN_DEPTH.get(without_side(joint), 0.0) for joint in joints])


_COLUMNS = {joint: column for column, joint in enumerate(FUSED_JOINTS)}
_SKIN_DEPTHS = skin_depths(FUSED_JOINTS)


def of_detection(camera: PinholeCamera, person: Detection, stamp: float) -> Measurement:
    """From pixels and depths; whatever they are, nothing is raised."""
    i, T = camera.intrinsics, camera.T_camera_world
    source, target = _shared(person.joints)
    pixels, others = np.full((len(_COLUMNS), 2), np.nan), np.full((4, len(_COLUMNS)), np.nan)
    pixels[target] = person.pixels[source]
    others[:, target] = np.stack([person.pixel_std, person.depth, person.depth_std, person.confidence])[:, source]
    pixel_std, depth, depth_std, confidence = others
    with np.errstate(invalid="ignore", over="ignore"):
        inside = (np.abs(pixels) < 4 * max(i.width, i.height)).all(axis=1)
        pixels[~inside | (confidence < LEAST_CONFIDENCE)] = np.nan
        depth = np.where((depth > NEAR) & (depth < FAR), depth, np.nan)
        if len(believed := depth[np.isfinite(depth)]):
            depth[np.abs(depth - np.median(believed)) > DEEP] = np.nan
        depth_std = np.where((depth_std > 0) & (depth_std < FAR), depth_std, STEREO_STD * depth**2)
        shown = pixels[np.isfinite(pixels).all(axis=1)]
        guess = max(2.0, 0.02 * np.ptp(shown, axis=0).max()) if len(shown) else 2.0  # 2 % of the larger side, and 2 px
        pixel_std = np.where((pixel_std > 0) & (pixel_std < i.width), pixel_std, guess)
        # a joint of confidence c is taken to be 1/c times as far off as its detection says
        pixel_std = np.maximum(pixel_std, LEAST_PIXEL_STD) / np.clip(confidence, LEAST_CONFIDENCE, 1)
    directions = i.directions(pixels)
    seen = np.isfinite(directions).all(axis=1)
    deep = seen & np.isfinite(depth)
    directions[~seen] = 0.0
    local = np.empty((len(seen), 3, 4))
    local[:, :2], local[:, 2] = T[:2] - directions[..., None] * T[2], T[2]
    values = -local[..., 3]
    values[:, 2] += np.where(deep, depth, 0.0) + _SKIN_DEPTHS / np.sqrt(1 + (directions**2).sum(axis=1))
    near, far = np.full((len(seen), 3), PLACE_STD), np.zeros((len(seen), 3))
    near[:, 2] = np.where(deep, np.sqrt(depth_std**2 + SKIN_STD**2 + PLACE_STD**2), 1.0)
    angle_std = np.hypot(pixel_std[:, None] / (i.fx, i.fy), ANGLE_STD)
    far[:, :2] = np.where(seen[:, None], angle_std, 1.0)
    return Measurement(stamp, local[..., :3], values, near, far, np.stack([seen, deep], 1), T[2], camera.name)


def of_skeleton(camera: PinholeCamera, person: SkeletonFrame, stamp: float) -> Measurement:
    """From a skeleton in the camera's own axes, as depth cameras with a tracker of their own give it."""
    T = camera.T_camera_world
    source, target = _shared(person.joints)
    positions, std = np.full((len(_COLUMNS), 3), np.nan), np.full(len(_COLUMNS), np.nan)
    positions[target] = person.positions[source]
    if person.std is not None:
        std[target] = person.std[source]
    with np.errstate(invalid="ignore"):
        seen = (np.abs(positions) < FAR).all(axis=1)
        std = np.where((std > 0) & (std < FAR), np.maximum(std, LEAST_STD), TRACKER_STD)
    rows = np.tile(T[:3, :3], (len(seen), 1, 1))
    values = np.where(seen[:, None], positions, 0.0) - T[:3, 3]
    near = np.tile(np.hypot(std, PLACE_STD)[:, None], 3)
    far = np.tile([ANGLE_STD, ANGLE_STD, 0.0], (len(seen), 1))
    return Measurement(stamp, rows, values, near, far, np.stack([seen, seen], 1), T[2], camera.name)


@lru_cache(maxsize=64)
def _shared(joints: tuple[str, ...]) -> tuple[list[int], list[int]]:
    """Columns of a source and of the result, of the joints that both have."""
    shared = [(column, _COLUMNS[joint]) for column, joint in enumerate(joints) if joint in _COLUMNS]
    return [source for source, _ in shared], [target for _, target in shared]
