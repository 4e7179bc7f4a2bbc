"""What joint limits and the scene leave of a density: P(allowed | measured pose) and P(allowed) at each step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from kinecast.body.limits import JointLimits
from kinecast.body.posture import ANGLES, postures_from_points
from kinecast.geometry.scene import Scene
from kinecast.prediction.noise import angle_noise
from kinecast.prediction.observation import Observation

LEAST = 1e-12
"""Least probability of being allowed: keeps logarithms finite."""
STRAIGHT = np.radians(2.0)
"""θ4 below which axial rotation says nothing [rad]."""


@dataclass(frozen=True)
class ConstraintFactor:
    """Constraints on the pose at each step, for densities.

    A pose is allowed at step t where every arm angle lies in its range and can be reached from the last observed
    posture in t steps (Eq. 4), and every joint and limb is free of obstacles (Eq. 7). An angle last observed outside
    its range widens the range that far.

    Attributes:
        draws: gives (S, T, 6, 3) draws of the unconstrained density, torso frame [m]; called once, when needed.
        observation: the window; places the torso frame in the world.
        limits: range and speed of the angles; None for none.
        noise: spread of a measured joint about the true one [m]; 0 makes every edge sharp.
        scene: obstacles; None for none.
    """

    draws: Callable[[], Float[np.ndarray, "S T 6 3"]]
    observation: Observation
    limits: JointLimits | None
    noise: float
    scene: Scene | None = None

    @cached_property
    def log_total(self) -> Float[np.ndarray, " T"]:
        """(T,) log P(allowed) = log ∫ f(x) P(allowed | x) dx, the mean over draws; at least half a draw's share."""
        points = self.draws()
        share = np.logaddexp.reduce(self.log_given(points), axis=0) - np.log(len(points))
        return np.asarray(np.maximum(share, -np.log(2.0 * len(points))))

    def log_factor(self, poses: Float[np.ndarray, "T 6 3"]) -> Float[np.ndarray, " T"]:
        """(T,) log [P(allowed | x) / P(allowed)]."""
        if self.limits is None and self.scene is None:
            return np.zeros(len(poses))
        return self.log_given(poses) - self.log_total

    def log_given(self, poses: Float[np.ndarray, "*b T 6 3"]) -> Float[np.ndarray, "*b T"]:
        """(…, T) log P(the true pose is allowed | it was measured here); poses in the torso frame [m]."""
        log_p = np.zeros(poses.shape[:-2])
        if self.scene is not None:
            times = self.observation.times(poses.shape[-3])
            clearance = self.scene.clearance(self.observation.to_world(poses), times)
            if self.noise > 0:
                from scipy.special import log_ndtr  # here, since predicting does without and it is slow to import

                log_p += log_ndtr(clearance / self.noise)
            else:
                log_p += np.where(clearance >= 0, 0.0, -np.inf)
        if self.limits is not None:
            log_p += self._log_inside(poses, self.limits)
        return log_p

    def _log_inside(self, poses: Float[np.ndarray, "*b T 6 3"], limits: JointLimits) -> Float[np.ndarray, "*b T"]:
        from scipy.special import ndtr

        start = np.broadcast_to(self.observation.posture, (*poses.shape[:-3], 18))
        postures = postures_from_points(poses, start, continuous=False)
        lower, upper, speed, last = (x[list(ANGLES)] for x in (*limits.of_posture(), self.observation.posture))
        reach = speed * self.observation.dt * np.arange(1, poses.shape[-3] + 1)[:, None]
        lower, upper = (
            np.maximum(np.minimum(lower, last), last - reach),
            np.minimum(np.maximum(upper, last), last + reach),
        )
        log_p = np.zeros(poses.shape[:-2])
        for arm, at in enumerate((6, 12)):
            theta = postures[..., at : at + 4]
            spread = angle_noise(postures[..., at : at + 6], np.full(3, max(self.noise, 1e-9)))
            lb, ub = lower[:, 4 * arm : 4 * arm + 4], upper[:, 4 * arm : 4 * arm + 4]
            p = ndtr((ub - theta) / spread) - ndtr((lb - theta) / spread)
            p[..., 2] = np.where(theta[..., 3] < STRAIGHT, 1.0, p[..., 2])
            log_p += np.log(np.maximum(p, LEAST)).sum(axis=-1)
        return log_p
