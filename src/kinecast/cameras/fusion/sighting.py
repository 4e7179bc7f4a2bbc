"""One person in one image as rows of a linear least squares: what a pixel, a depth or a position says.

A pixel at direction (u, v) says x − u z = 0 and y − v z = 0 of the joint (x, y, z) in the camera's axes, a depth says
z = d: all linear in the joint's place in the world, with an error that grows with z for the first two (Hartley and
Sturm, Triangulation, 1997: iterative least squares).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from kinecast.body.skeleton import without_side
from kinecast.cameras.camera import PinholeCamera
from kinecast.live.detection import LEAST_CONFIDENCE, View
from kinecast.types import SkeletonFrame

__all__ = ["FLESH", "FUSED_JOINTS", "Sighter", "Sighting", "flesh_of"]

FLESH = {
    "shoulder": 0.050, "elbow": 0.035, "wrist": 0.025, "hip": 0.090, "knee": 0.050, "ankle": 0.040, "hand": 0.015,
    "pelvis": 0.110, "lumbar": 0.110, "spine": 0.110, "thorax": 0.110, "chest": 0.110, "collar": 0.050, "neck": 0.055,
    "head": 0.090, "nose": 0.0,
}  # fmt: skip
"""From skin to the joint's centre [m]: half of breadths and depths of body parts in ANSUR II (Gordon et al. 2014)."""
FLESH_STD = 0.015
"""By how much that varies with the person, clothes and the side it is seen from [m]."""

FUSED_JOINTS = tuple(
    f"{side}_{name}" if side else name
    for side, names in (
        ("left", ("shoulder", "elbow", "wrist", "hand", "hip", "knee", "ankle")),
        ("right", ("shoulder", "elbow", "wrist", "hand", "hip", "knee", "ankle")),
        ("", ("pelvis", "lumbar", "spine", "thorax", "chest", "collar", "neck", "head", "nose")),
    )
    for name in names
)
"""Joints that are fused; others of a view are left out."""

PLACE_STD = 0.005
ANGLE_STD = 1.7e-3
"""How well a camera's place [m] and direction [rad] are known: `kinecast calibrate` by hand, docs/decisions/0022."""
LEAST_PIXEL_STD = 0.5
NEAR, FAR = 0.1, 20.0
"""Depths that are believed [m]."""
DEEP = 0.9
"""No joint is so much nearer or farther than most of the person [m]: what is read there is something else."""
LEAST_STD = 0.002
"""Of a position that a tracker gives [m]."""
TRACKER_STD = 0.02
"""Of one whose tracker does not say: Azure Kinect's joints against Vicon, Tölgyessy et al. 2021, in still arms."""
STEREO_STD = 0.0024
"""Standard deviation of a depth, by its square [1/m]: 0.08 px / (674 px · 50 mm), a RealSense D435 at 1280 px."""


@dataclass(frozen=True, eq=False)
class Sighting:
    """One person in one image.

    Attributes:
        stamp: when the image was taken [s].
        camera: its name.
        rows: (J, 3, 3) what each joint's place in the world is multiplied with.
        values: (J, 3) what that should give.
        near, far: (J, 3) standard deviation of `values`: √(near² + (far z)²), z the depth.
        seen: (J, 2) whether there are the first two rows, whether there is the third.
        axis: (4,) z = axis[:3] · p + axis[3].
    """

    stamp: float
    camera: str
    rows: Float[np.ndarray, "J 3 3"]
    values: Float[np.ndarray, "J 3"]
    near: Float[np.ndarray, "J 3"]
    far: Float[np.ndarray, "J 3"]
    seen: Bool[np.ndarray, "J 2"]
    axis: Float[np.ndarray, " 4"]


def flesh_of(joints: Sequence[str]) -> Float[np.ndarray, " J"]:
    """(J,) from the skin to each joint's centre [m]."""
    return np.array([FLESH.get(without_side(joint), 0.0) for joint in joints])


class Sighter:
    """Makes sightings of one camera.

    Args:
        camera: the camera.
        joints: names of the joints, in the order of all arrays.
    """

    def __init__(self, camera: PinholeCamera, joints: Sequence[str] = FUSED_JOINTS) -> None:
        self.camera = camera
        self.joints = tuple(joints)
        self._columns = {joint: column for column, joint in enumerate(self.joints)}
        self._flesh = flesh_of(self.joints)
        self._known: dict[tuple[str, ...], tuple[Sequence[int], Sequence[int]]] = {}

    def of_view(self, view: View, stamp: float) -> Sighting:
        """From pixels and depths; whatever they are, nothing is raised."""
        i, T = self.camera.intrinsics, self.camera.T_camera_world
        source, target = self._map(view.joints)
        empty = np.full((len(self.joints), 2), np.nan)
        pixels, others = empty.copy(), np.full((4, len(self.joints)), np.nan)
        pixels[target] = view.pixels[source]
        others[:, target] = np.stack([view.pixel_std, view.depth, view.depth_std, view.confidence])[:, source]
        pixel_std, depth, depth_std, confidence = others
        with np.errstate(invalid="ignore", over="ignore"):
            pixels[~(np.abs(pixels) < 4 * max(i.width, i.height)).all(axis=1) | (confidence < LEAST_CONFIDENCE)] = (
                np.nan
            )
            depth = np.where((depth > NEAR) & (depth < FAR), depth, np.nan)
            depth[np.abs(depth - _median(depth)) > DEEP] = np.nan
            depth_std = np.where((depth_std > 0) & (depth_std < FAR), depth_std, STEREO_STD * depth**2)
            told = (pixel_std > 0) & (pixel_std < i.width)
            pixel_std = pixel_std if told.all() else np.where(told, pixel_std, _pixel_std(pixels))
            # A joint of confidence c is taken to be 1/c times as far off as its view says.
            pixel_std = np.maximum(pixel_std, LEAST_PIXEL_STD) / np.clip(confidence, LEAST_CONFIDENCE, 1)
        directions = i.directions(pixels)
        seen = np.isfinite(directions).all(axis=1)
        deep = seen & np.isfinite(depth)
        directions[~seen] = 0.0
        cosine = 1 / np.sqrt(1 + (directions**2).sum(axis=1))
        local = np.zeros((len(seen), 3, 4))
        local[:, 0], local[:, 1] = T[0] - directions[:, :1] * T[2], T[1] - directions[:, 1:] * T[2]
        local[:, 2] = T[2]
        values = -local[..., 3]
        values[:, 2] += np.where(deep, depth, 0.0) + self._flesh * cosine
        near = np.full((len(seen), 3), PLACE_STD)
        near[:, 2] = np.where(deep, np.sqrt(depth_std**2 + FLESH_STD**2 + PLACE_STD**2), 1.0)
        far = np.zeros((len(seen), 3))
        far[:, 0] = np.where(seen, np.hypot(pixel_std / i.fx, ANGLE_STD), 1.0)
        far[:, 1] = np.where(seen, np.hypot(pixel_std / i.fy, ANGLE_STD), 1.0)
        return Sighting(stamp, self.camera.name, local[..., :3], values, near, far, np.stack([seen, deep], 1), T[2])

    def of_positions(self, frame: SkeletonFrame, stamp: float) -> Sighting:
        """From a skeleton in the camera's own axes, as depth cameras with a tracker of their own give it."""
        T = self.camera.T_camera_world
        source, target = self._map(frame.joints)
        positions, std = np.full((len(self.joints), 3), np.nan), np.full(len(self.joints), np.nan)
        positions[target] = frame.positions[source]
        if frame.std is not None:
            std[target] = frame.std[source]
        with np.errstate(invalid="ignore"):
            seen = (np.abs(positions) < FAR).all(axis=1)
            std = np.where((std > 0) & (std < FAR), np.maximum(std, LEAST_STD), TRACKER_STD)
        rows = np.broadcast_to(T[:3, :3], (len(seen), 3, 3))
        values = np.where(seen[:, None], positions, 0.0) - T[:3, 3]
        near = np.hypot(std, PLACE_STD)[:, None] * np.ones(3)
        far = np.tile([ANGLE_STD, ANGLE_STD, 0.0], (len(seen), 1))
        return Sighting(stamp, self.camera.name, rows, values, near, far, np.stack([seen, seen], 1), T[2])

    def _map(self, joints: tuple[str, ...]) -> tuple[Sequence[int], Sequence[int]]:
        """Columns of a source and of the result, of the joints that both have."""
        if joints not in self._known:
            if len(self._known) >= 64:
                self._known.clear()
            shared = [(column, self._columns[joint]) for column, joint in enumerate(joints) if joint in self._columns]
            self._known[joints] = [source for source, _ in shared], [target for _, target in shared]
        return self._known[joints]


def _median(values: Float[np.ndarray, " J"]) -> float:
    known = np.sort(values[np.isfinite(values)])  # a tenth of the time of np.median
    return float((known[(len(known) - 1) // 2] + known[len(known) // 2]) / 2) if len(known) else np.nan


def _pixel_std(pixels: Float[np.ndarray, "J 2"]) -> float:
    """Where a source does not say: 2 % of the larger side of the box around the joints, at least 2 px."""
    shown = pixels[np.isfinite(pixels).all(axis=1)]
    return max(2.0, 0.02 * float(np.ptp(shown, axis=0).max())) if len(shown) else 2.0
