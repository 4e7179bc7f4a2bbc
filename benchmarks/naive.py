"""The stack a reader of the paper would write: scikit-learn, SciPy and pyswarms, vectorised over samples throughout.

Each angle's process predicts all samples in one call, and so does each truncated normal draw. The swarm solves the
newest frame only; the window's others are taken as solved when they were new.
"""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

os.environ.setdefault("LOG_CFG", str(Path(__file__).parent / "logging.yaml"))

import numpy as np
from scipy.stats import truncnorm

from kinecast.body.limits import JointLimits
from kinecast.body.posture import ANGLES, LEFT_ARM, postures_from_points
from kinecast.prediction.observation import Observation
from kinecast.prediction.training_windows import TrainingWindows

try:
    from pyswarms.single import GlobalBestPSO
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, WhiteKernel
except ImportError as error:
    raise SystemExit(f"this benchmark needs optional packages ({error}): pip install 'kinecast[bench]'") from None

LIMITS = JointLimits()
LOWER, UPPER, SPEED = (limit[LEFT_ARM] for limit in LIMITS.of_posture())
PARTICLES, ITERATIONS = 20, 50
"""Of the swarm in an online step: as few as come near at all."""
SIDES = (1.0, -1.0)


def arm(theta: np.ndarray, upper: float, fore: float, side: float) -> tuple[np.ndarray, np.ndarray]:
    """Elbow and wrist of (…, 4) angles, relative to the shoulder in the torso frame."""
    s1, c1, s2, c2 = np.sin(theta[..., 0]), np.cos(theta[..., 0]), np.sin(theta[..., 1]), np.cos(theta[..., 1])
    s3, c3, s4, c4 = np.sin(theta[..., 2]), np.cos(theta[..., 2]), np.sin(theta[..., 3]), np.cos(theta[..., 3])
    u = np.stack([c2 * s1, side * s2, -c2 * c1], axis=-1)
    e1 = np.stack([c1, np.zeros_like(c1), s1], axis=-1)
    e2 = np.stack([-s2 * s1, side * c2, s2 * c1], axis=-1)
    f = c4[..., None] * u + s4[..., None] * (c3[..., None] * e1 + s3[..., None] * e2)
    return upper * u, upper * u + fore * f


def swarm_angles(
    elbow: np.ndarray, wrist: np.ndarray, side: float, particles: int = PARTICLES, iterations: int = ITERATIONS
) -> np.ndarray:
    """Inverse kinematics by particle swarm, as the paper has it."""
    upper, fore = float(np.linalg.norm(elbow)), float(np.linalg.norm(wrist - elbow))

    def cost(theta: np.ndarray) -> np.ndarray:
        elbows, wrists = arm(theta, upper, fore, side)
        return np.linalg.norm(elbows - elbow, axis=1) + np.linalg.norm(wrists - wrist, axis=1)

    swarm = GlobalBestPSO(particles, 4, {"c1": 1.5, "c2": 1.5, "w": 0.7}, bounds=(LOWER, UPPER))
    return np.asarray(swarm.optimize(cost, iterations, verbose=False)[1])


class NaiveConstrained:
    """`gp_constrained` with off-the-shelf parts: a Gaussian process per angle and arm, truncated normals, swarm IK.

    Args:
        windows: to train on.
        points: of the windows each exact process keeps; the sparse ones are trained on 2000 and keep 32 of their own.
        seed: of their choice.

    Attributes:
        seconds: spent in each part, over all steps so far.
    """

    def __init__(self, windows: TrainingWindows, points: int = 500, seed: int = 0) -> None:
        rows = np.random.default_rng(seed).permutation(len(windows))[:points]
        both = np.concatenate([windows.points, windows.future_points[:, :1]], axis=1)[rows]
        postures = postures_from_points(both)
        frames = windows.observed.shape[1]
        self.models = []
        for place in ANGLES:
            model = GaussianProcessRegressor(RBF(np.full(frames, 1.0)) + WhiteKernel(1e-3), normalize_y=True)
            with warnings.catch_warnings():
                # A lag that says nothing sends its lengthscale to the end of its range.
                warnings.simplefilter("ignore", ConvergenceWarning)
                self.models.append(model.fit(postures[:, :frames, place], postures[:, frames, place]))
        self.seconds: dict[str, float] = {}

    @contextmanager
    def _timed(self, part: str) -> Iterator[None]:
        begin = time.perf_counter()
        yield
        self.seconds[part] = self.seconds.get(part, 0.0) + time.perf_counter() - begin

    def step(self, observation: Observation, steps: int, samples: int) -> np.ndarray:
        """(S, T, 4, 3) elbows and wrists of both arms, relative to their shoulders, from the window."""
        poses = observation.points
        solved = postures_from_points(poses)
        result = np.empty((samples, steps, 4, 3))
        for which, side in enumerate(SIDES):
            at = 3 * which
            elbow, wrist = poses[-1, at + 1] - poses[-1, at], poses[-1, at + 2] - poses[-1, at]
            track = solved[:, 6 + 6 * which : 10 + 6 * which].copy()
            with self._timed("particle swarm"):
                track[-1] = swarm_angles(elbow, wrist, side)
            bones = float(np.linalg.norm(elbow)), float(np.linalg.norm(wrist - elbow))
            past = np.repeat(track[None], samples, axis=0)
            for t in range(steps):
                now = np.empty((samples, 4))
                for i in range(4):
                    with self._timed("Gaussian processes"):
                        mean, spread = self.models[4 * which + i].predict(past[:, :, i], return_std=True)
                    before = past[:, -1, i]
                    lower = np.maximum(LOWER[i], before - SPEED[i] * observation.dt)
                    upper = np.maximum(np.minimum(UPPER[i], before + SPEED[i] * observation.dt), lower + 1e-6)
                    with self._timed("truncated normals"):
                        now[:, i] = truncnorm.rvs((lower - mean) / spread, (upper - mean) / spread, mean, spread)
                with self._timed("forward kinematics"):
                    result[:, t, 2 * which], result[:, t, 2 * which + 1] = arm(now, *bones, side)
                past = np.concatenate([past[:, 1:], now[:, None]], axis=1)
        return result
