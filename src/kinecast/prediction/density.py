"""The exact density over the pose of both arms at each predicted step (Eq. 6, 7), the same for every method.

A pose is read in three blocks: both shoulders, then the left arm (elbow, wrist) given the shoulders, then the
right arm given what came before. A method states the density f_bc of each block b in each component c of a mixture.
Each is mixed with a small broad part for tracker faults, so that one jump of a tracker costs a bounded price instead
of an infinite one:

    g(x) = Σ_c w_c Π_b [(1 − ε) f_bc(x) + ε h_b(x)]

Constraints bind the true pose, not the tracker's faults: they act on the part of g without any fault,
f = Π_b f_b, which becomes f(x) · P(allowed | x) / P(allowed) (Eq. 7, normalised).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from kinecast.body.limits import STRAIGHT, JointLimits
from kinecast.body.posture import (
    LEFT_ARM,
    RIGHT_ARM,
    TURN,
    block_log_det,
    coordinates_from_postures,
    postures_from_coordinates,
    postures_from_points,
)
from kinecast.geometry.scene import Scene
from kinecast.prediction.noise import angle_noise
from kinecast.prediction.observation import Observation

FAULT_PROBABILITY = 0.01
"""ε: share of blocks that are a tracker's fault."""
FAULT_SPREAD = 0.5
"""Spread of a faulty joint about its prediction [m], an arm's length."""

BLOCKS = ((0, 3), (1, 2), (4, 5))
"""Joints of each block: shoulders, left elbow and wrist, right elbow and wrist."""
JOINT_ORDER = [joint for block in BLOCKS for joint in block]
"""Permutation of the six joints into block order."""

TURNING = (3, 6, 7, 12, 13)
"""Posture coordinates that are angles: yaw, flexion and abduction of each arm."""
LEAST = 1e-12
"""Least probability of being allowed: keeps logarithms finite."""


Poses: TypeAlias = Float[np.ndarray, "T 6 3"]
Blocks: TypeAlias = tuple[Float[np.ndarray, " C"], Float[np.ndarray, "C T 3"]]


@runtime_checkable
class BlockDensity(Protocol):
    """The density of each block of a pose in each component of a mixture, before constraints and faults."""

    def log_blocks(self, poses: Poses) -> Blocks:
        """(C,) log weights of the components and (C, T, 3) log f_bc of torso-frame poses [nats]."""
        ...


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
            from scipy.special import log_ndtr  # here, since predicting does without and it is slow to import

            times = self.observation.times(poses.shape[-3])
            clearance = self.scene.clearance(self.observation.to_world(poses), times)
            edge = np.where(clearance >= 0, 0.0, -np.inf)
            log_p += log_ndtr(clearance / self.noise) if self.noise > 0 else edge
        if self.limits is not None:
            log_p += self._log_inside(poses, self.limits)
        return log_p

    def _log_inside(self, poses: Float[np.ndarray, "*b T 6 3"], limits: JointLimits) -> Float[np.ndarray, "*b T"]:
        from scipy.special import ndtr

        last = self.observation.posture
        postures = postures_from_points(poses, np.broadcast_to(last, (*poses.shape[:-3], 18)), continuous=False)
        lower, upper, speed = limits.of_posture()
        reach = speed * self.observation.dt * np.arange(1, poses.shape[-3] + 1)[:, None]
        lower = np.maximum(np.minimum(lower, last), last - reach)
        upper = np.minimum(np.maximum(upper, last), last + reach)
        log_p = np.zeros(poses.shape[:-2])
        for arm, bones in ((LEFT_ARM, slice(6, 12)), (RIGHT_ARM, slice(12, 18))):
            theta = postures[..., arm]
            spread = angle_noise(postures[..., bones], np.full(3, max(self.noise, 1e-9)))
            p = ndtr((upper[:, arm] - theta) / spread) - ndtr((lower[:, arm] - theta) / spread)
            p[..., 2] = np.where(theta[..., 3] < STRAIGHT, 1.0, p[..., 2])
            log_p += np.log(np.maximum(p, LEAST)).sum(axis=-1)
        return log_p


@dataclass(frozen=True)
class PoseDensity:
    """g(x) of the module's text, asked in the world; a rigid motion leaves a density's value as it is.

    Attributes:
        observation: places the torso frame.
        centre: (T, 6, 3) about which faults are spread, torso frame [m].
        blocks: the density without faults and constraints.
        constraint: what joint limits and scene leave of it; None where nothing binds.
    """

    observation: Observation
    centre: Poses
    blocks: BlockDensity
    constraint: ConstraintFactor | None = None

    def within(self, scene: Scene) -> PoseDensity:
        """The same, zero inside obstacles; as it is where nothing binds."""
        return self if self.constraint is None else replace(self, constraint=replace(self.constraint, scene=scene))

    def log_prob(self, positions: Poses) -> Float[np.ndarray, " T"]:
        """(T,) log density [nats per m^18]; NaN where a joint is NaN."""
        known = np.isfinite(positions).all(axis=(1, 2))
        poses = self.observation.to_torso(np.where(known[:, None, None], positions, self.observation.positions[-1]))
        log_weights, blocks = self.blocks.log_blocks(poses)
        allowed = 0.0 if self.constraint is None else self.constraint.log_factor(poses)
        log_g = log_weights[:, None] + with_faults(blocks, log_fault(poses, self.centre), allowed)
        return np.where(known, np.logaddexp.reduce(log_g, axis=0), np.nan)


def with_faults(
    inlier: Float[np.ndarray, "C T 3"], fault: Float[np.ndarray, "T 3"], allowed: Float[np.ndarray, " T"] | float = 0.0
) -> Float[np.ndarray, "C T"]:
    """(C, T) log g: every way in which blocks may be faulty, the faultless way weighted by what is allowed."""
    a, b, c = np.moveaxis(np.log1p(-FAULT_PROBABILITY) + inlier, -1, 0)
    u, v, w = np.moveaxis(np.log(FAULT_PROBABILITY) + fault, -1, 0)
    # Π(f + h), parted by where the first fault is: in no block, in the first, in the second, in the last.
    either = np.logaddexp(c, w)
    ways = [a + b + c + allowed, u + np.logaddexp(b, v) + either, a + v + either, a + b + w]
    return np.asarray(np.logaddexp.reduce(ways, axis=0))


def log_fault(poses: Poses, centre: Poses) -> Float[np.ndarray, "T 3"]:
    """(T, 3) log h_b: each block spread broadly about its prediction."""
    square = ((poses - centre) ** 2).sum(axis=-1) / FAULT_SPREAD**2
    joint = -0.5 * square - 1.5 * np.log(2 * np.pi * FAULT_SPREAD**2)
    return joint[:, JOINT_ORDER].reshape(-1, 3, 2).sum(axis=-1)


@dataclass(frozen=True)
class GaussianMixture:
    """Σ_c w_c Σ_k v_k N(mean_c, s_k² Σ_c) over 18 coordinates at each step, of positions or of the posture.

    Posture coordinates are carried to positions by Eq. 6: f(x) = f(coordinates) · |∂ coordinates / ∂ angles| /
    |det ∂ x / ∂ angles|; with bone lengths, shoulder width and torso pose as the paper's dummy variables the Jacobian
    is square and the result exact.

    Attributes:
        mean: (C, T, 18) positions in the order of `JOINT_ORDER` [m], or smooth posture coordinates.
        factor: (K, T, 18, R) of covariances = factor · factorᵀ, in the coordinates of the mean.
        weights: (C,) of the components.
        kind: (C,) which covariance each component has.
        scales, scale_weights: (F,) common factors of the spread, and how likely each is.
        posture: whether the coordinates are those of the posture.
        floor: (K, T, 18) spread of each coordinate for itself, in directions that a low-rank factor leaves out.
    """

    mean: Float[np.ndarray, "C T 18"]
    factor: Float[np.ndarray, "K T 18 R"]
    weights: Float[np.ndarray, " C"] = field(default_factory=lambda: np.ones(1))
    kind: Int[np.ndarray, " C"] = field(default_factory=lambda: np.zeros(1, dtype=int))
    scales: Float[np.ndarray, " F"] = field(default_factory=lambda: np.ones(1))
    scale_weights: Float[np.ndarray, " F"] = field(default_factory=lambda: np.ones(1))
    posture: bool = False
    floor: Float[np.ndarray, "K T 18"] | None = None

    @staticmethod
    def of_positions(
        mean: Float[np.ndarray, "C T 6 3"],
        factor: Float[np.ndarray, "K T 6 3 R"],
        floor: Float[np.ndarray, "K T 6 3"] | None = None,
        **more: Any,
    ) -> GaussianMixture:
        """The mixture over positions in the order of the skeleton; the rest as above."""
        mean, factor = mean[:, :, JOINT_ORDER], factor[:, :, JOINT_ORDER]
        own = None if floor is None else floor[:, :, JOINT_ORDER].reshape(*floor.shape[:2], 18)
        return GaussianMixture(
            mean.reshape(*mean.shape[:2], 18), factor.reshape(*factor.shape[:2], 18, -1), floor=own, **more
        )

    def log_blocks(self, poses: Poses) -> Blocks:
        """See BlockDensity; a component for each mean and scale."""
        if self.posture:
            error, log_volume = self._from_postures(poses)
        else:
            error, log_volume = poses[:, JOINT_ORDER].reshape(-1, 18) - self.mean, np.zeros((len(poses), 3))
        white = np.linalg.solve(self._cholesky[self.kind], error[..., None])[..., 0]
        square = (white**2).reshape(*white.shape[:2], 3, 6).sum(axis=-1)
        scales = self.scales[:, None, None, None]
        blocks = (
            -0.5 * square / scales**2 - 6 * np.log(scales) - (self._log_root_det[self.kind] + 3 * np.log(2 * np.pi))
        )
        weights = np.outer(self.scale_weights, self.weights)
        return np.log(np.maximum(weights, 1e-300)).ravel(), (blocks + log_volume).reshape(-1, *square.shape[1:])

    @cached_property
    def _cholesky(self) -> Float[np.ndarray, "K T 18 18"]:
        covariance = self.factor @ self.factor.swapaxes(2, 3)
        if self.floor is not None:
            covariance += self.floor[..., None] ** 2 * np.eye(18)
        return np.linalg.cholesky(covariance)

    @cached_property
    def _log_root_det(self) -> Float[np.ndarray, "K T 3"]:
        diagonal = np.log(np.diagonal(self._cholesky, axis1=2, axis2=3))
        return diagonal.reshape(*diagonal.shape[:2], 3, 6).sum(axis=-1)

    def _from_postures(self, poses: Poses) -> tuple[Float[np.ndarray, "C T 18"], Float[np.ndarray, "T 3"]]:
        # Only the way of writing the pose that is nearest to the mean counts: the others lie half a turn away.
        nearby = postures_from_coordinates(self.mean[0])
        postures = postures_from_points(poses[:, None], nearby, continuous=False)[:, 0]
        error = coordinates_from_postures(postures) - self.mean
        error[..., TURNING] -= TURN * np.round(error[..., TURNING] / TURN)
        log_volume = -block_log_det(postures)
        log_volume[:, 1:] += np.log(np.maximum(postures[:, [9, 15]], 1e-12))  # ∂(a, b)/∂(θ3, θ4) has determinant θ4
        return error, log_volume
