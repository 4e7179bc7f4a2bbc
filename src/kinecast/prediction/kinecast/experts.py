"""The experts: trivial predictors, and small networks that give an arm's displacements in a basis of time.

A network sees a window freed of where the person stands, faces, and how fast they move. Each arm is described from its
own side, the right one mirrored, so that one model serves both and sees twice the data. The window's steps are divided
by their own amplitude: slow and fast motion then obey one law, and what comes out is multiplied by it again. Networks
are fitted for the mean distance, not its square: that is what is scored.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from kinecast.geometry.transforms import lengths
from kinecast.prediction.linear import damped, slope_weights
from kinecast.prediction.model_file import Arrays

MIRROR = np.array([1.0, -1.0, 1.0])
LEAST_STEP = 0.004
"""Added to the amplitude of a window [m per frame]: below it lies the sensor's noise."""
DAMPED = ((0, 1.0), (2, 16.0), (2, np.inf), (1, 4.0), (3, 12.0), (2, 6.0))
"""Trivial experts: degree of the polynomial whose slope is the velocity (0: none), and time constant [frames]."""
TRIVIAL = len(DAMPED)
NEWEST = 2 * 18 + 18 + 2
"""The last features of a view: its last two steps, pose and levels."""
OWN_SIDE = np.stack([np.ones((1, 3)), MIRROR[None]])
"""(2, 1, 3) what turns each arm's vectors to its own side: the right arm is mirrored."""


@cache
def time_basis(steps: int, functions: int) -> Float[np.ndarray, "T K"]:
    """(T, K) orthonormal polynomials of time that are zero now."""
    t = np.arange(1.0, steps + 1) / steps
    basis = np.linalg.qr(np.stack([t ** (k + 1) for k in range(functions)], axis=1))[0]
    return basis * np.sign(basis[-1])


def yaw_frame(pose: Float[np.ndarray, "*b 6 3"]) -> Float[np.ndarray, "*b 3 3"]:
    """Rotation with z up and y along the shoulder line's horizontal direction, from right to left (columns x, y, z)."""
    x, y = pose[..., 0, 0] - pose[..., 3, 0], pose[..., 0, 1] - pose[..., 3, 1]
    length = np.hypot(x, y)
    x, y = np.where(length > 1e-6, [x, y], [np.zeros_like(x), np.ones_like(y)])  # as if facing along x
    length = np.where(length > 1e-6, length, 1.0)
    frame = np.zeros((*length.shape, 3, 3))
    frame[..., 0, 0] = frame[..., 1, 1] = y / length
    frame[..., 0, 1], frame[..., 1, 0], frame[..., 2, 2] = x / length, -(x / length), 1.0
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

    def to_world(self, displacement: Float[np.ndarray, "E V T 3 3"]) -> Float[np.ndarray, "E W T 6 3"]:
        """Displacements of an arm's three joints [m], arm by arm, as positions of all six in the world."""
        left, right = displacement[:, : len(self.last)], displacement[:, len(self.last) :]
        both = np.concatenate([left, right * MIRROR], axis=3)
        return both @ self.rotation.transpose(0, 2, 1)[:, None] + self.last[:, None]

    def to_arms(self, positions: Float[np.ndarray, "W T 6 3"]) -> Float[np.ndarray, "V T 3 3"]:
        """World positions as displacements of each arm's joints from the last pose; the inverse of `to_world`."""
        local = (positions - self.last[:, None]) @ self.rotation[:, None].astype(positions.dtype)
        local[:, :, 3:] *= MIRROR.astype(positions.dtype)
        return np.concatenate([local[:, :, :3], local[:, :, 3:]])


def arm_views(windows: Float[np.ndarray, "W N 6 3"]) -> ArmViews:
    """Both arms' views of windows in the world [m], N ≥ 4."""
    last = windows[:, -1]
    rotation, middle = yaw_frame(last), last[:, [0, 3]].mean(axis=1, keepdims=True)
    own = np.concatenate([np.diff(windows, axis=1), (last - middle)[:, None]], axis=1) @ rotation[:, None]
    own = np.concatenate([own, own[:, :, [3, 4, 5, 0, 1, 2]] * MIRROR])
    steps, pose = own[:, :-1].reshape(len(own), -1, 18), own[:, -1].reshape(len(own), 18)
    jerk = np.diff(steps, n=2, axis=1)
    amplitude = np.sqrt((steps**2).sum(axis=(1, 2)) / steps.shape[1] + LEAST_STEP**2)
    jitter = np.sqrt((jerk**2).sum(axis=(1, 2)) / jerk.shape[1] + 1e-8)
    level = np.log(np.stack([amplitude, jitter / amplitude], axis=1))
    return ArmViews((steps / amplitude[:, None, None]).reshape(len(own), -1), pose, level, amplitude, rotation, last)


class PersonView(NamedTuple):
    """What a regression on one person sees of a window, or of several.

    Attributes:
        features: (*K, 2, NEWEST + 1) the end of each arm's features, and 1.
        amplitude: (*K, 2) root mean square step of the window, as each arm has it [m per frame].
        rotation: (*K, 3, 3) yaw frame of the last pose.
    """

    features: Float[np.ndarray, "*K 2 F"]
    amplitude: Float[np.ndarray, "*K 2"]
    rotation: Float[np.ndarray, "*K 3 3"]

    def to_arms(self, errors: Float[np.ndarray, "K 6 3"]) -> Float[np.ndarray, "K 2 9"]:
        """Errors in the world [m] arm by arm, from its own side, over the amplitude."""
        own = (errors @ self.rotation).reshape(-1, 2, 3, 3) * OWN_SIDE
        return own.reshape(-1, 2, 9) / self.amplitude[..., None]

    def to_world(self, own: Float[np.ndarray, "K 2 9"]) -> Float[np.ndarray, "K 6 3"]:
        """The inverse of `to_arms`."""
        errors = (own * self.amplitude[..., None]).reshape(-1, 2, 3, 3) * OWN_SIDE
        return errors.reshape(-1, 6, 3) @ self.rotation.swapaxes(-1, -2)


@dataclass(frozen=True)
class WindowMotion:
    """How the joints moved in a window.

    Attributes:
        speed: (6,) mean length of a step [m per frame].
        own: (6,) root mean square step [m per frame].
        change: (6,) between the last step and the last but two [m per frame].
        shared: root mean square step of all joints [m per frame].
        jitter: root mean square third difference of all joints [m per frame].
    """

    speed: Float[np.ndarray, "6"]
    own: Float[np.ndarray, "6"]
    change: Float[np.ndarray, "6"]
    shared: float
    jitter: float

    @staticmethod
    def of(window: Float[np.ndarray, "N 6 3"]) -> WindowMotion:
        """The motion of one window [m], N ≥ 4."""
        steps = window[1:] - window[:-1]
        square = np.einsum("njd,njd->nj", steps, steps)
        mean = square.sum(axis=0) / len(steps)
        jerk = (steps[2:] - 2.0 * steps[1:-1] + steps[:-2]).ravel()
        return WindowMotion(
            np.sqrt(square).sum(axis=0) / len(steps),
            np.sqrt(mean + 1e-6),
            lengths(steps[-1] - steps[-3]),
            math.sqrt(mean.sum() / 6.0 + 1e-6),
            math.sqrt(3.0 * float(jerk @ jerk) / len(jerk) + 1e-8),
        )


@dataclass(frozen=True)
class FeatureScale(Arrays):
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
        pose = (views.pose - self.pose_mean) / self.pose_spread
        level = (views.level - self.level_mean) / self.level_spread
        held = [np.minimum(np.maximum(pose, -3.0), 3.0), np.minimum(np.maximum(level, -2.5), 2.5)]
        return np.concatenate([views.steps / self.steps, *held], axis=1)


@cache
def trivial_experts(frames: int, steps: int) -> Float[np.ndarray, "E T N"]:
    """(E, T, N) weights over the window of each trivial expert's prediction."""
    velocities = [slope_weights(frames, degree) if degree else np.zeros(frames) for degree, _ in DAMPED]
    taus = [tau for _, tau in DAMPED]
    return np.stack([damped(v, tau, steps).weights for v, tau in zip(velocities, taus, strict=True)])


def forecasts(
    experts: Networks, windows: Float[np.ndarray, "W N 6 3"], steps: int
) -> tuple[Float[np.ndarray, "W E T 6 3"], list[PersonView]]:
    """What every expert forecasts, trivial ones first, world [m]; and what a regression on the person sees of each."""
    made = np.tensordot(trivial_experts(windows.shape[1], steps), windows, axes=(2, 1)).transpose(2, 0, 1, 3, 4)
    views = arm_views(windows)
    features = experts.scale.features(views)
    newest = np.concatenate([features[:, -NEWEST:], np.ones((len(features), 1))], axis=1)
    newest = newest.reshape(2, len(windows), -1).swapaxes(0, 1)
    seen = list(map(PersonView, newest, views.amplitude.reshape(2, -1).T, views.rotation))
    if not len(experts):
        return made, seen
    coefficients = experts.coefficients(features)
    coefficients = coefficients.reshape(*coefficients.shape[:2], -1, 9)
    displacement = time_basis(steps, coefficients.shape[2]) @ coefficients
    displacement *= views.amplitude[:, None, None]
    learned = views.to_world(displacement.reshape(*displacement.shape[:3], 3, 3))
    return np.concatenate([made, learned.transpose(1, 0, 2, 3, 4)], axis=1), seen


@dataclass(frozen=True)
class Networks(Arrays):
    """G small networks on the same features: h = silu(x W1 + b1); h += silu(h W2 + b2);
    coefficients = h W3 + b3 + x' A, x' without the levels.

    Each knows another world: all collections as they are, all with the faults of poor sensors, or one alone. Their
    weights take most of a model's room, and are kept in single precision, as they were trained.
    """

    PRECISION = np.float32
    scale: FeatureScale
    W1: Float[np.ndarray, "G D U"]
    b1: Float[np.ndarray, "G 1 U"]
    W2: Float[np.ndarray, "G U U"]
    b2: Float[np.ndarray, "G 1 U"]
    W3: Float[np.ndarray, "G U C"]
    b3: Float[np.ndarray, "G 1 C"]
    A: Float[np.ndarray, "G D2 C"]

    def __len__(self) -> int:
        return len(self.W1)

    def coefficients(self, features: Float[np.ndarray, "V D"]) -> Float[np.ndarray, "G V C"]:
        """(G, V, C) of the time basis, from the features of views."""
        features = features.astype(self.W1.dtype)
        hidden = _silu(features @ self.W1 + self.b1)
        hidden = hidden + _silu(hidden @ self.W2 + self.b2)
        return hidden @ self.W3 + self.b3 + features[:, : self.A.shape[1]] @ self.A

    def take(self, which: Sequence[int]) -> Networks:
        """Some of the networks."""
        return Networks(self.scale, *(weights[list(which)] for weights in self._weights()))

    @staticmethod
    def joined(parts: Sequence[Networks]) -> Networks:
        """The networks of several on one scale, in their order."""
        return Networks(parts[0].scale, *map(np.concatenate, zip(*(part._weights() for part in parts), strict=True)))

    def _weights(self) -> list[np.ndarray]:
        return [getattr(self, each.name) for each in fields(self) if each.name != "scale"]


def _silu(x: Float[np.ndarray, "G V U"]) -> Float[np.ndarray, "G V U"]:
    return x / (1.0 + np.exp(-np.clip(x, -60.0, 60.0)))
