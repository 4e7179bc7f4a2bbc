"""What joint limits and the scene leave of a density: P(allowed | measured pose) and P(allowed) at each step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import log_ndtr, ndtr

from kinecast.body.limits import JointLimits, bounds
from kinecast.body.posture import ANGLES, postures_from_points
from kinecast.geometry.scene import Scene
from kinecast.prediction.noise import angle_noise
from kinecast.prediction.observation import Observation

__all__ = ["Allowance"]

LEAST = 1e-12
"""Least probability of being allowed: keeps logarithms finite."""
STRAIGHT = np.radians(2.0)
"""θ4 below which axial rotation says nothing [rad]."""


@dataclass(frozen=True)
class Allowance:
    """Constraints on the pose at each step, for densities.

    A pose is allowed at step t where every arm angle lies within Eq. 4's bounds for a step of length t·dt from the
    last observed posture, and every joint and limb is free of obstacles (Eq. 7).

    Attributes:
        draws: gives (S, T, 6, 3) draws of the unconstrained density, torso frame [m]; called once, when needed.
        observation: the window; places the torso frame in the world.
        initial: (18,) last observed posture.
        limits: range and speed of the angles; None for none.
        scene: obstacles; None for none.
        noise: spread of a measured joint about the true one [m]; 0 makes every edge sharp.
    """

    draws: Callable[[], Float[np.ndarray, "S T 6 3"]]
    observation: Observation
    initial: Float[np.ndarray, "18"]
    limits: JointLimits | None
    scene: Scene | None
    noise: float

    @cached_property
    def log_total(self) -> Float[np.ndarray, " T"]:
        """(T,) log P(allowed): the share of draws allowed at each step."""
        points = self.draws()
        allowed = np.ones(points.shape[:2], dtype=bool)
        if self.scene is not None:
            times = self.observation.times(points.shape[1])
            allowed &= self.scene.free(self.observation.to_world(points), times)
        if self.limits is not None:
            allowed &= self._inside(points)
        return np.log(np.maximum(allowed.mean(axis=0), LEAST))

    def log_given(self, pose: Float[np.ndarray, "T 6 3"]) -> Float[np.ndarray, " T"]:
        """(T,) log P(the true pose is allowed | it was measured here); pose in the torso frame [m]."""
        log_p = np.zeros(len(pose))
        if self.scene is not None:
            clearance = self.scene.clearance(self.observation.to_world(pose), self.observation.times(len(pose)))
            if self.noise > 0:
                log_p += log_ndtr(clearance / self.noise)
            else:
                log_p += np.where(clearance >= 0, 0.0, -np.inf)
        if self.limits is not None:
            log_p += self._log_inside(pose)
        return log_p

    def _angles(self, points: Float[np.ndarray, "*b T 6 3"]) -> Float[np.ndarray, "*b T 18"]:
        """Postures nearest to the last observed one, each step for itself."""
        return postures_from_points(points, self.initial, continuous=False)

    @cached_property
    def _boxes(self) -> Callable[[int], tuple[Float[np.ndarray, "T 8"], Float[np.ndarray, "T 8"]]]:
        assert self.limits is not None
        lower, upper, speed = self.limits.of_posture()

        def boxes(steps: int) -> tuple[Float[np.ndarray, "T 8"], Float[np.ndarray, "T 8"]]:
            rows = [
                [bounds(lower[i], upper[i], speed[i], self.initial[i], t * self.observation.dt) for i in ANGLES]
                for t in range(1, steps + 1)
            ]
            table = np.array(rows)
            return table[..., 0], table[..., 1]

        return boxes

    def _inside(self, points: Float[np.ndarray, "S T 6 3"]) -> Bool[np.ndarray, "S T"]:
        postures = self._angles(points)
        lower, upper = self._boxes(points.shape[1])
        angles = postures[..., list(ANGLES)]
        inside = (angles >= lower) & (angles <= upper)
        for swing in (2, 6):
            inside[..., swing] |= angles[..., swing + 1] < STRAIGHT
        return np.asarray(inside.all(axis=-1))

    def _log_inside(self, pose: Float[np.ndarray, "T 6 3"]) -> Float[np.ndarray, " T"]:
        postures = self._angles(pose)
        lower, upper = self._boxes(len(pose))
        log_p = np.zeros(len(pose))
        for arm, start in enumerate((6, 12)):
            theta = postures[:, start : start + 4]
            spread = angle_noise(postures[:, start : start + 6], np.full(3, max(self.noise, 1e-9)))
            lb, ub = lower[:, 4 * arm : 4 * arm + 4], upper[:, 4 * arm : 4 * arm + 4]
            p = ndtr((ub - theta) / spread) - ndtr((lb - theta) / spread)
            p[:, 2] = np.where(theta[:, 3] < STRAIGHT, 1.0, p[:, 2])
            log_p += np.log(np.maximum(p, LEAST)).sum(axis=1)
        return log_p
