"""The stack a reader of the paper would write: scikit-learn, SciPy and pyswarms, vectorised where that is easy."""

from __future__ import annotations

import numpy as np
from pyswarms.single import GlobalBestPSO
from scipy.stats import truncnorm
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, WhiteKernel

from kinecast.body.limits import JointLimits
from kinecast.prediction.observation import Observation, TrainingWindows

LIMITS = JointLimits()
LOWER, UPPER, SPEED = LIMITS.lower[:4], LIMITS.upper[:4], LIMITS.speed[:4]
PARTICLES, ITERATIONS = 20, 50


def arm(theta: np.ndarray, upper: float, fore: float, side: float) -> tuple[np.ndarray, np.ndarray]:
    """Elbow and wrist of (…, 4) angles, relative to the shoulder in the torso frame."""
    s1, c1, s2, c2 = np.sin(theta[..., 0]), np.cos(theta[..., 0]), np.sin(theta[..., 1]), np.cos(theta[..., 1])
    s3, c3, s4, c4 = np.sin(theta[..., 2]), np.cos(theta[..., 2]), np.sin(theta[..., 3]), np.cos(theta[..., 3])
    u = np.stack([c2 * s1, side * s2, -c2 * c1], axis=-1)
    e1 = np.stack([c1, np.zeros_like(c1), s1], axis=-1)
    e2 = np.stack([-s2 * s1, side * c2, s2 * c1], axis=-1)
    f = c4[..., None] * u + s4[..., None] * (c3[..., None] * e1 + s3[..., None] * e2)
    return upper * u, upper * u + fore * f


def swarm_angles(elbow: np.ndarray, wrist: np.ndarray, side: float) -> np.ndarray:
    """Inverse kinematics by particle swarm, as the paper has it."""
    upper, fore = np.linalg.norm(elbow), np.linalg.norm(wrist - elbow)

    def cost(particles: np.ndarray) -> np.ndarray:
        elbows, wrists = arm(particles, upper, fore, side)
        return np.linalg.norm(elbows - elbow, axis=1) + np.linalg.norm(wrists - wrist, axis=1)

    swarm = GlobalBestPSO(PARTICLES, 4, {"c1": 1.5, "c2": 1.5, "w": 0.7}, bounds=(LOWER, UPPER))
    return np.asarray(swarm.optimize(cost, ITERATIONS, verbose=False)[1])


class NaiveConstrained:
    """`gp_constrained` with off-the-shelf parts: a Gaussian process per angle and arm, truncated normals, swarm IK."""

    def __init__(self, windows: TrainingWindows, points: int = 300, seed: int = 0) -> None:
        rows = np.random.default_rng(seed).permutation(len(windows))[:points]
        both = np.concatenate([windows.points, windows.future_points[:, :1]], axis=1)[rows]
        # Training targets by closed form: only the online step is timed.
        from kinecast.body.posture import postures_from_points

        postures = postures_from_points(both)
        frames = windows.observed.shape[1]
        self.models = []
        for place in (6, 7, 8, 9, 12, 13, 14, 15):
            kernel = RBF(np.full(frames, 1.0)) + WhiteKernel(1e-3)
            model = GaussianProcessRegressor(kernel, normalize_y=True, n_restarts_optimizer=0)
            self.models.append(model.fit(postures[:, :frames, place], postures[:, frames, place]))

    def step(self, observation: Observation, steps: int, samples: int) -> np.ndarray:
        """(S, T, 4, 3) elbows and wrists of both arms from the window."""
        points = observation.points
        tracks = np.empty((2, len(points), 4))
        bones = np.empty((2, 2))
        for side, first in ((0, 0), (1, 3)):
            for n, pose in enumerate(points):
                elbow, wrist = pose[first + 1] - pose[first], pose[first + 2] - pose[first]
                tracks[side, n] = swarm_angles(elbow, wrist, 1.0 - 2.0 * side)
            bones[side] = np.linalg.norm(points[-1, first + 1] - points[-1, first]), np.linalg.norm(
                points[-1, first + 2] - points[-1, first + 1]
            )
        result = np.empty((samples, steps, 4, 3))
        past = np.repeat(tracks[None], samples, axis=0)
        for t in range(steps):
            now = np.empty((samples, 2, 4))
            for side in range(2):
                for i in range(4):
                    mean, spread = self.models[4 * side + i].predict(past[:, side, :, i], return_std=True)
                    before = past[:, side, -1, i]
                    lower = np.maximum(LOWER[i], before - SPEED[i] * observation.dt)
                    upper = np.maximum(np.minimum(UPPER[i], before + SPEED[i] * observation.dt), lower + 1e-6)
                    now[:, side, i] = truncnorm.rvs((lower - mean) / spread, (upper - mean) / spread, mean, spread)
                result[:, t, 2 * side], result[:, t, 2 * side + 1] = arm(now[:, side], *bones[side], 1.0 - 2.0 * side)
            past = np.concatenate([past[:, :, 1:], now[:, :, None]], axis=2)
        return result
