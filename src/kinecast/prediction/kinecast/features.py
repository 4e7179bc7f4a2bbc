"""What the learned experts see: a window, freed of where the person stands, faces, and how fast they move.

Each arm is described from its own side, the right one mirrored, so that one model serves both and sees twice the
data. The window's steps are divided by their own amplitude: slow and fast motion then obey one law, and what comes out
is multiplied by it again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit

__all__ = ["ArmViews", "FeatureScale", "arm_views", "time_basis", "yaw_frame"]

MIRROR = np.array([1.0, -1.0, 1.0])
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
    frame = np.zeros((*y.shape, 3))
    frame[..., 0, 0], frame[..., 1, 0] = y[..., 1], -y[..., 0]
    frame[..., 1] = y
    frame[..., 2, 2] = 1.0
    return frame


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
    last = np.ascontiguousarray(windows[:, -1])
    rotation = yaw_frame(last)
    steps, pose, level, amplitude = _views(windows, rotation)
    return ArmViews(steps, pose, level, amplitude, rotation, last)


@njit(cache=True)
@no_type_check
def _views(
    windows: Float[np.ndarray, "W N 6 3"], rotation: Float[np.ndarray, "W 3 3"]
) -> tuple[Float[np.ndarray, "V F"], Float[np.ndarray, "V 18"], Float[np.ndarray, "V 2"], Float[np.ndarray, " V"]]:
    """Steps, pose, level and amplitude of `ArmViews`."""
    count, frames = windows.shape[:2]
    steps = np.empty((2 * count, (frames - 1) * 18))
    pose, level, amplitude = np.empty((2 * count, 18)), np.empty((2 * count, 2)), np.empty(2 * count)
    for w in range(count):
        R, last = rotation[w], windows[w, frames - 1]
        for joint in range(6):
            other = 3 * (1 - joint // 3) + joint % 3
            for d in range(3):
                side = -1.0 if d == 1 else 1.0
                value = 0.0
                for axis in range(3):
                    value += (last[joint, axis] - 0.5 * (last[0, axis] + last[3, axis])) * R[axis, d]
                pose[w, 3 * joint + d] = value
                pose[count + w, 3 * other + d] = side * value
                for frame in range(frames - 1):
                    value = 0.0
                    for axis in range(3):
                        value += (windows[w, frame + 1, joint, axis] - windows[w, frame, joint, axis]) * R[axis, d]
                    steps[w, 18 * frame + 3 * joint + d] = value
                    steps[count + w, 18 * frame + 3 * other + d] = side * value
        for view in (w, count + w):
            own = steps[view]
            square = jerk = 0.0
            for k in range(len(own)):
                square += own[k] * own[k]
            for k in range(len(own) - 36):
                jerk += (own[k + 36] - 2.0 * own[k + 18] + own[k]) ** 2
            size = math.sqrt(square / (frames - 1) + LEAST_STEP**2)
            amplitude[view] = size
            level[view, 0] = math.log(size)
            level[view, 1] = math.log(math.sqrt(jerk / (frames - 3) + 1e-8) / size)
            own /= size
    return steps, pose, level, amplitude


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
