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


Places = Float[np.ndarray, "*h J 3"]


@dataclass(frozen=True, eq=False)
class Measurement:
    """One person in V images: each joint's place in the world p [m], of which `rows` p = `values` is said."""

    stamps: Float[np.ndarray, " V"]  # when they were taken [s]
    rows: Float[np.ndarray, "V J 3 3"]
    values: Float[np.ndarray, "V J 3"]
    near: Float[np.ndarray, "V J 3"]  # standard deviation of `values`: √(near² + (far z)²), z the depth
    far: Float[np.ndarray, "V J 3"]
    seen: Bool[np.ndarray, "V J 2"]  # whether there are the first two rows, whether there is the third
    axis: Float[np.ndarray, "V 4"]  # z = axis[:3] · p + axis[3]
    camera: str = ""  # its name; empty of several

    @classmethod
    def stacked(cls, images: Sequence[Measurement]) -> Measurement:
        """Several images of one person as one measurement."""
        parts = ("stamps", "rows", "values", "near", "far", "seen", "axis")
        arrays: list[Any] = [np.concatenate([getattr(each, part) for each in images]) for part in parts]
        return cls(*arrays)

    def variance(self, places: Places) -> Float[np.ndarray, "*h V J 3"]:
        """(…, V, J, 3) σ² of every row if the joints were at these places (…, J, 3)."""
        return self.near**2 + (self.far * self._depths(places)[..., None]) ** 2

    def squared_errors(
        self, places: Places, covariance: Float[np.ndarray, "J 3 3"] | None = None
    ) -> Float[np.ndarray, "*h V J 2"]:
        """(…, V, J, 2) squared errors of pixels and of depths, in standard deviations; inf behind a camera.

        Places are (…, J, 3), certain or with a covariance (J, 3, 3) [m²].
        """
        variance = self.variance(places)
        if covariance is not None:
            variance = variance + np.einsum("vjrx,jxy,vjry->vjr", self.rows, covariance, self.rows)
        with np.errstate(invalid="ignore"):
            square = (np.einsum("vjrx,...jx->...vjr", self.rows, places) - self.values) ** 2 / variance
        square = np.where((self._depths(places) > 0)[..., None] & np.isfinite(square), square, np.inf)
        return np.stack([square[..., 0] + square[..., 1], square[..., 2]], axis=-1)

    def _depths(self, places: Places) -> Float[np.ndarray, "*h V J"]:
        return np.einsum("vx,...jx->...vj", self.axis[:, :3], places) + self.axis[:, 3:]


def skin_depths(joints: Sequence[str]) -> Float[np.ndarray, " J"]:
    """(J,) from the skin to each joint's centre [m]."""
    return np.array([SKIN_DEPTH.get(without_side(joint), 0.0) for joint in joints])


_SKIN_DEPTHS = skin_depths(FUSED_JOINTS)


def of_detection(camera: PinholeCamera, person: Detection, stamp: float) -> Measurement:
    """From pixels and depths; whatever they are, nothing is raised."""
    i, T = camera.intrinsics, camera.T_camera_world
    pixels, pixel_std, depth, depth_std, confidence = _in_order(
        person.joints, person.pixels, person.pixel_std, person.depth, person.depth_std, person.confidence
    )
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
    return _of_one(camera, stamp, local[..., :3], values, near, far, np.stack([seen, deep], 1))


def of_skeleton(camera: PinholeCamera, person: SkeletonFrame, stamp: float) -> Measurement:
    """From a skeleton in the camera's own axes, as depth cameras with a tracker of their own give it."""
    T = camera.T_camera_world
    unknown = np.full(len(person.joints), np.nan)
    positions, std = _in_order(person.joints, person.positions, unknown if person.std is None else person.std)
    with np.errstate(invalid="ignore"):
        seen = (np.abs(positions) < FAR).all(axis=1)
        std = np.where((std > 0) & (std < FAR), np.maximum(std, LEAST_STD), TRACKER_STD)
    rows = np.tile(T[:3, :3], (len(seen), 1, 1))
    values = np.where(seen[:, None], positions, 0.0) - T[:3, 3]
    near = np.tile(np.hypot(std, PLACE_STD)[:, None], 3)
    far = np.tile([ANGLE_STD, ANGLE_STD, 0.0], (len(seen), 1))
    return _of_one(camera, stamp, rows, values, near, far, np.stack([seen, seen], 1))


def _of_one(camera: PinholeCamera, stamp: float, *parts: np.ndarray) -> Measurement:
    rows, values, near, far, seen = (part[None] for part in parts)
    axis = camera.T_camera_world[None, 2]
    return Measurement(np.array([stamp]), rows, values, near, far, seen, axis, camera.name)


def _in_order(joints: tuple[str, ...], *values: Float[np.ndarray, "J ..."]) -> list[np.ndarray]:
    """Values of joints in the order of `FUSED_JOINTS`, NaN of those that are not among them."""
    rows = _rows(joints)
    return [np.concatenate([each, np.full((1, *each.shape[1:]), np.nan)])[rows] for each in values]


@lru_cache(maxsize=64)
def _rows(joints: tuple[str, ...]) -> list[int]:
    return [joints.index(joint) if joint in joints else -1 for joint in FUSED_JOINTS]
