"""Angles from points: in closed form for an arm, by damped least squares for any other chain."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit

from kinecast.body.arm_angles import OUTSIDE_WEIGHT, arm_angles
from kinecast.errors import OptionError

__all__ = ["LeastSquaresOptions", "Solution", "closed_form", "damped_least_squares"]


@njit(cache=True)
@no_type_check
def _arm_series(elbow: np.ndarray, wrist: np.ndarray, side: float, previous: np.ndarray, out: np.ndarray) -> None:
    last = previous.copy()
    for step in range(len(elbow)):
        u = (elbow[step, 0], elbow[step, 1], elbow[step, 2])
        f = (wrist[step, 0] - u[0], wrist[step, 1] - u[1], wrist[step, 2] - u[2])
        theta = arm_angles(u, f, side, (last[0], last[1], last[2], last[3]), OUTSIDE_WEIGHT)
        for i in range(4):
            out[step, i] = theta[i]
            if not math.isnan(theta[i]):
                last[i] = theta[i]


def closed_form(
    elbow: Float[np.ndarray, "N 3"],
    wrist: Float[np.ndarray, "N 3"],
    side: float,
    previous: Float[np.ndarray, " 4"] | None = None,
) -> tuple[Float[np.ndarray, "N 4"], Float[np.ndarray, "N 2"]]:
    """The four angles of an arm over time, exactly: forward kinematics gives the points back.

    Args:
        elbow: (N, 3) elbow relative to the shoulder, in the torso frame [m].
        wrist: (N, 3) wrist relative to the shoulder, in the torso frame [m].
        side: +1 left, −1 right.
        previous: (4,) angles before the first frame [rad]; None for an arm at rest. Frames continue from one
            another, over NaN gaps too (kinecast.body.arm_angles).

    Returns:
        (N, 4) angles [rad] and (N, 2) lengths of upper arm and forearm [m]; NaN where points are.

    Raises:
        OptionError: another side.
    """
    if side not in (1.0, -1.0):
        raise OptionError(f"side {side} is neither +1 (left) nor -1 (right)")
    start = np.full(4, np.nan) if previous is None else np.asarray(previous, dtype=np.float64)
    theta = np.empty((len(elbow), 4))
    _arm_series(
        np.ascontiguousarray(elbow, dtype=np.float64),
        np.ascontiguousarray(wrist, dtype=np.float64),
        float(side),
        start,
        theta,
    )
    lengths = np.linalg.norm(np.stack([elbow, wrist - elbow], axis=1), axis=-1)
    return theta, lengths


@dataclass(frozen=True)
class LeastSquaresOptions:
    """When to stop.

    Attributes:
        tolerance: distance of all points together that counts as reached [m].
        iterations: greatest number of steps, all starts together.
        restarts: how often to start again where the solver is stuck (a straight elbow has no gradient to bend
            it): first near the best angles, then anywhere in the range.

    Raises:
        OptionError: a tolerance that is not positive, no iteration, or negative restarts.
    """

    tolerance: float = 1e-6
    iterations: int = 300
    restarts: int = 8

    def __post_init__(self) -> None:
        if not self.tolerance > 0.0:
            raise OptionError(f"tolerance {self.tolerance} m is outside (0, ∞)")
        if self.iterations < 1:
            raise OptionError(f"iterations {self.iterations} is below 1")
        if self.restarts < 0:
            raise OptionError(f"restarts {self.restarts} is below 0")


@dataclass(frozen=True)
class Solution:
    """What the solver found.

    Attributes:
        theta: (D,) the best angles met, within their range [rad].
        residual: distance of the points from the target, √Σ‖·‖² [m]; NaN for a target that is.
        converged: the residual is within the tolerance.
        iterations: steps taken.
    """

    theta: Float[np.ndarray, " D"]
    residual: float
    converged: bool
    iterations: int


def damped_least_squares(
    forward: Callable[[Float[np.ndarray, " D"]], Float[np.ndarray, "*points"]],
    jacobian: Callable[[Float[np.ndarray, " D"]], Float[np.ndarray, "*points D"]],
    target: Float[np.ndarray, "*points"],
    initial: Float[np.ndarray, " D"],
    lower: Float[np.ndarray, " D"],
    upper: Float[np.ndarray, " D"],
    options: LeastSquaresOptions | None = None,
) -> Solution:
    """Levenberg-Marquardt inside a box: δ = (JᵀJ + λI)⁻¹ Jᵀr, projected onto the range.

    An angle at an end of its range that the step pushes outward takes no part in it. A target out of reach
    gives the best angles met and `converged` False; nothing is raised for it.

    Args:
        forward: angles (D,) to points of any shape [m].
        jacobian: angles (D,) to the derivatives of those points, one axis more [m/rad].
        target: the points wanted [m].
        initial: (D,) angles to start from [rad]; projected onto the range.
        lower: (D,) least angles [rad].
        upper: (D,) greatest angles [rad].
        options: when to stop.

    Returns:
        The solution.

    Raises:
        OptionError: an empty range.
    """
    if not np.all(lower <= upper):
        raise OptionError(f"angle {int(np.argmin(lower <= upper))}: its range is empty")
    options = options or LeastSquaresOptions()
    goal = np.ravel(target)
    start = np.clip(initial, lower, upper)
    least, most = np.maximum(lower, start - np.pi), np.minimum(upper, start + np.pi)
    best = Solution(start, math.nan, False, 0)
    steps = 0
    for restart in range(options.restarts + 1):
        found, steps = _descend(forward, jacobian, goal, start, lower, upper, options, steps)
        if found.residual < best.residual or math.isnan(best.residual):
            best = found
        if best.converged or math.isnan(best.residual) or steps >= options.iterations:
            break
        anywhere = least + (most - least) * _scattered(restart + 1, len(start))
        start = 0.9 * best.theta + 0.1 * anywhere if restart == 0 else anywhere
    return Solution(best.theta, best.residual, best.converged, steps)


def _scattered(index: int, size: int) -> Float[np.ndarray, " D"]:
    """A point of a sequence that fills [0, 1)^D evenly: multiples of powers of a golden ratio."""
    ratio = 1.5
    for _ in range(30):
        ratio = (1.0 + ratio) ** (1.0 / (size + 1))
    scattered: Float[np.ndarray, " D"] = (index * ratio ** -np.arange(1.0, size + 1.0)) % 1.0
    return scattered


def _descend(
    forward: Callable[[Float[np.ndarray, " D"]], Float[np.ndarray, "*points"]],
    jacobian: Callable[[Float[np.ndarray, " D"]], Float[np.ndarray, "*points D"]],
    goal: Float[np.ndarray, " K"],
    theta: Float[np.ndarray, " D"],
    lower: Float[np.ndarray, " D"],
    upper: Float[np.ndarray, " D"],
    options: LeastSquaresOptions,
    steps: int,
) -> tuple[Solution, int]:
    """One descent, to the tolerance, a standstill or the last iteration; and the steps taken until then."""
    damping = 1e-3
    miss = goal - np.ravel(forward(theta))
    residual = float(np.linalg.norm(miss))
    while residual > options.tolerance and steps < options.iterations and damping < 1e9:
        steps += 1
        J = np.reshape(jacobian(theta), (len(goal), len(theta)))
        pull = J.T @ miss
        free = ~((theta <= lower) & (pull < 0.0)) & ~((theta >= upper) & (pull > 0.0))
        if np.linalg.norm(pull[free]) < 1e-12:
            break
        normal = J[:, free].T @ J[:, free]
        step = np.zeros_like(theta)
        step[free] = np.linalg.solve(normal + damping * np.eye(len(normal)), pull[free])
        trial = np.clip(theta + step, lower, upper)
        trial_miss = goal - np.ravel(forward(trial))
        trial_residual = float(np.linalg.norm(trial_miss))
        if trial_residual < residual:
            slow = residual - trial_residual < 1e-9 * residual
            theta, miss, residual = trial, trial_miss, trial_residual
            damping = max(0.2 * damping, 1e-12)
            if slow:
                break
        else:
            damping *= 10.0
    return Solution(theta, residual, residual <= options.tolerance, steps), steps
