"""What the learned experts see: a window, freed of where the person stands, faces, and how fast they move.

Each arm is described from its own side, the right one mirrored, so that one model serves both and sees twice the
data. The window's steps are divided by their own amplitude: slow and fast motion then obey one law, and what comes out
is multiplied by it again.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float

from kinecast.body.skeleton import ARM_JOINTS

__all__ = ["ArmViews", "FeatureScale", "arm_views", "time_basis", "yaw_frame"]

MIRROR = np.array([1.0, -1.0, 1.0])
SWAP = [ARM_JOINTS.index(name.replace("left", "right") if "left" in name else name.replace("right", "left"))
        for name in ARM_JOINTS]  # fmt: skip
"""The six joints with left and right exchanged."""
LEAST_STEP = 0.004
"""Added to the amplitude of a window [m per frame]: below it lies the sensor's noise."""
BASIS = 6
"""Functions of time that a displacement is made of."""


@cache
def time_basis(steps: int) -> Float[np.ndarray, "T K"]:
    """(T, K) orthonormal polynomials of time that are zero now."""
    t = np.arange(1.0, steps + 1) / steps
    basis = np.linalg.qr(np.stack([t ** (k + 1) for k in range(min(BASIS, steps))], axis=1))[0]
    return basis * np.sign(basis[-1])


def yaw_frame(pose: Float[np.ndarray, "*b 6 3"]) -> Float[np.ndarray, "*b 3 3"]:
    """Rotation with z up and y along the shoulder line's horizontal direction, from right to left (columns x, y, z)."""
    line = (pose[..., 0, :] - pose[..., 3, :]) * [1.0, 1.0, 0.0]
    length = np.linalg.norm(line, axis=-1, keepdims=True)
    y = np.where(length > 1e-6, line / np.maximum(length, 1e-6), [0.0, 1.0, 0.0])
    z = np.broadcast_to([0.0, 0.0, 1.0], y.shape)
    return np.stack([np.cross(y, z), y, z], axis=-1)


@dataclass(frozen=True)
class ArmViews:
    """W windows, each seen from the left arm (first half of the rows) and, mirrored, from the right (second half).

    Attributes:
        steps: (2 W, F) steps of all joints from frame to frame, over their amplitude.
        pose: (2 W, 18) last pose about the middle of the shoulders [m].
        level: (2 W, 2) log amplitude, and log of the jitter's share in it.
        amplitude: (2 W,) root mean square step of the window [m per frame].
        rotation: (W, 3, 3) yaw frame of the last pose.
        last: (W, 6, 3) last pose, world [m].
    """

    steps: Float[np.ndarray, "V F"]
    pose: Float[np.ndarray, "V 18"]
    level: Float[np.ndarray, "V 2"]
    amplitude: Float[np.ndarray, " V"]
    rotation: Float[np.ndarray, "W 3 3"]
    last: Float[np.ndarray, "W 6 3"]

    def to_world(self, displacement: Float[np.ndarray, "V T 3 3"]) -> Float[np.ndarray, "W T 6 3"]:
        """Displacements of an arm's three joints [m], arm by arm, as positions of all six in the world."""
        left, right = np.split(displacement, 2)
        both = np.concatenate([left, right * MIRROR], axis=2)
        return both @ self.rotation.transpose(0, 2, 1)[:, None] + self.last[:, None]

    def to_arms(self, positions: Float[np.ndarray, "W T 6 3"]) -> Float[np.ndarray, "V T 3 3"]:
        """World positions as displacements of each arm's joints from the last pose; the inverse of `to_world`."""
        local = (positions - self.last[:, None]) @ self.rotation[:, None]
        return np.concatenate([local[:, :, :3], local[:, :, 3:] * MIRROR])


def arm_views(windows: Float[np.ndarray, "W N 6 3"]) -> ArmViews:
    """Both arms' views of windows in the world [m], N ≥ 4."""
    count, frames = windows.shape[:2]
    last = windows[:, -1]
    rotation = yaw_frame(last)
    middle = 0.5 * (last[:, 0] + last[:, 3])
    pose = (last - middle[:, None]) @ rotation
    steps = np.diff(windows, axis=1) @ rotation[:, None]
    steps = np.concatenate([steps, steps[:, :, SWAP] * MIRROR]).reshape(2 * count, frames - 1, 18)
    pose = np.concatenate([pose, pose[:, SWAP] * MIRROR]).reshape(2 * count, 18)
    amplitude = np.sqrt((steps**2).sum(axis=(1, 2)) / (frames - 1) + LEAST_STEP**2)
    jerk = np.diff(steps, n=2, axis=1)
    jitter = np.sqrt((jerk**2).sum(axis=(1, 2)) / (frames - 3) + 1e-8)
    level = np.stack([np.log(amplitude), np.log(jitter / amplitude)], axis=1)
    flat = steps.reshape(2 * count, -1) / amplitude[:, None]
    return ArmViews(flat, pose, level, amplitude, rotation, last)


@dataclass(frozen=True)
class FeatureScale:
    """Standardisation of the features, fitted on training windows.

    Attributes:
        steps: one spread for all steps.
        pose_mean, pose_spread: (18,) of the last pose [m].
        level_mean, level_spread: (2,) of the levels.
    """

    steps: float
    pose_mean: Float[np.ndarray, "18"]
    pose_spread: Float[np.ndarray, "18"]
    level_mean: Float[np.ndarray, "2"]
    level_spread: Float[np.ndarray, "2"]

    @staticmethod
    def of(views: ArmViews) -> FeatureScale:
        """The scale of training windows."""
        return FeatureScale(
            float(views.steps.std(axis=0).mean()),
            views.pose.mean(axis=0),
            np.maximum(views.pose.std(axis=0), 0.02),
            views.level.mean(axis=0),
            views.level.std(axis=0) + 0.1,
        )

    def features(self, views: ArmViews) -> Float[np.ndarray, "V D"]:
        """(V, D) steps, then pose, then levels; poses and levels never seen in training are held at the edge."""
        pose = np.clip((views.pose - self.pose_mean) / self.pose_spread, -3.0, 3.0)
        level = np.clip((views.level - self.level_mean) / self.level_spread, -2.5, 2.5)
        return np.concatenate([views.steps / self.steps, pose, level], axis=1)

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Plain arrays for a checkpoint."""
        return {
            "steps": np.array(self.steps),
            "pose_mean": self.pose_mean,
            "pose_spread": self.pose_spread,
            "level_mean": self.level_mean,
            "level_spread": self.level_spread,
        }
