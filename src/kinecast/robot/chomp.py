"""CHOMP: a smooth path pushed out of where people will be, each waypoint at its own time.

U[ξ] = ½ ‖K ξ + e‖² + Σ_points ∫ c(d(x, t)) |x'| dt, descended as ξ ← ξ − η A⁻¹ ∇U, K ξ its jerk:
A = KᵀK. Both ends are fixed, the joint limits projected. N. Ratliff, M. Zucker, J. A. Bagnell
and S. Srinivasa, "CHOMP: Gradient Optimization Techniques for Efficient Motion Planning", ICRA 2009. Here the
distance d is that of the moment at which the waypoint is passed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.interpolate import make_interp_spline

from kinecast.errors import OptionError
from kinecast.robot.descent import descend
from kinecast.robot.ur5 import UR5

__all__ = ["ChompOptions", "Surroundings", "optimise", "smoothest"]


@dataclass(frozen=True)
class ChompOptions:
    """How the descent goes.

    Attributes:
        waypoints: W, both ends among them.
        person_margin: least distance kept from a person's region [m].
        person_zone: beyond it, in which the cost rises [m].
        scene_margin, scene_zone: the same for the scene [m].
        obstacle_step, smooth_step: step sizes η of the two costs.
        largest_change: of an angle in one iteration [rad].
        least_iterations, most_iterations: it stops between the two once the least distances are kept.
        patience: it also stops after so many iterations in which the least distance did not grow.
    """

    waypoints: int = 40
    person_margin: float = 0.02
    person_zone: float = 0.10
    scene_margin: float = 0.005
    scene_zone: float = 0.05
    obstacle_step: float = 2.0
    smooth_step: float = 0.03
    largest_change: float = 0.1
    least_iterations: int = 10
    most_iterations: int = 100
    patience: int = 20

    def __post_init__(self) -> None:
        if self.waypoints < 6:
            raise OptionError(f"waypoints {self.waypoints} must be at least 6")
        for name, value in vars(self).items():
            if not 0 <= value < np.inf:
                raise OptionError(f"{name} {value} must be 0 or more")


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What is in the way, where it is when each waypoint is passed.

    Attributes:
        capsules: (W, K, 7) start, end and radius of persons' capsules [m].
        obstacles: (W, O, 17) rows of the scene's obstacles (kinecast.geometry.distances).
        first_link: (O,) the first of `LINKS` that each obstacle counts for.
        slowing: what monitoring costs beside persons (kinecast.robot.descent.descend); nothing by default.
    """

    capsules: Float[np.ndarray, "W K 7"]
    obstacles: Float[np.ndarray, "W O 17"]
    first_link: Int[np.ndarray, " O"]
    slowing: tuple[float, float, float, float, float] = (0.0, 1.0, 1.0, 1.0, 0.0)


@lru_cache(maxsize=8)
def _metric(waypoints: int) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "n 6"]]:
    """A⁻¹ of the inner waypoints, scaled to a greatest entry of 1, and how the smoothest ones follow from the ends.

    The ends are the first and last waypoint, speed and acceleration at the first and at the last. K is the jerk of the
    spline through all of them (kinecast.robot.trajectory), at the nodes of a quadrature that is exact for its square.
    """
    given = np.eye(waypoints + 4)
    ends: Any = [[(1, given[-4]), (2, given[-3])], [(1, given[-2]), (2, given[-1])]]
    jerk = make_interp_spline(np.arange(waypoints), given[:-4], k=5, bc_type=tuple(ends)).derivative(3)
    nodes, weights = np.polynomial.legendre.leggauss(3)
    places = (np.arange(waypoints - 1)[:, None] + 0.5 * (1 + nodes)).ravel()
    K = jerk(places) * np.sqrt(np.tile(weights, waypoints - 1))[:, None]
    inner, outer = np.arange(1, waypoints - 1), np.r_[0, waypoints - 1 : waypoints + 4]
    inverse = np.linalg.inv(K[:, inner].T @ K[:, inner])
    return np.ascontiguousarray(inverse / inverse.max()), -inverse @ K[:, inner].T @ K[:, outer]


def smoothest(
    start: Float[np.ndarray, "6"],
    goal: Float[np.ndarray, "6"],
    waypoints: int,
    dt: float,
    velocity: Float[np.ndarray, "6"],
    acceleration: Float[np.ndarray, "6"],
) -> Float[np.ndarray, "W 6"]:
    """(W, 6) waypoints of least jerk from a moving start to rest at the goal [rad].

    Args:
        start, goal: (6,) [rad].
        waypoints: W.
        dt: time between waypoints [s].
        velocity: (6,) at the start [rad/s].
        acceleration: (6,) at the start [rad/s^2].
    """
    ends = np.stack([start, goal, dt * velocity, dt**2 * acceleration, np.zeros(6), np.zeros(6)])
    return np.concatenate([start[None], _metric(waypoints)[1] @ ends, goal[None]])


def optimise(
    arm: UR5,
    path: Float[np.ndarray, "W 6"],
    reference: Float[np.ndarray, "W 6"],
    surroundings: Surroundings,
    options: ChompOptions,
) -> tuple[Float[np.ndarray, "W 6"], float, int]:
    """Pushes a path out of what is in the way.

    Args:
        arm: whose body points are kept clear.
        path: (W, 6) to begin with [rad]; its ends stay.
        reference: (W, 6) the smoothest path between these ends (`smoothest`).
        surroundings: at each waypoint's time.
        options: see ChompOptions.

    Returns:
        The path (W, 6); the least distance of a body point beyond its margin [m], above 0 where every margin is kept;
        and the iterations made.
    """
    q = np.array(path, dtype=np.float64)
    metric, _ = _metric(len(q))
    body = (arm.base_rows, arm.joint_origins, arm.point_sites, arm.point_joint, arm.point_radius, arm.point_link)
    iterations, excess = descend(
        q,
        body,
        np.ascontiguousarray(surroundings.capsules),
        np.ascontiguousarray(surroundings.obstacles),
        surroundings.first_link,
        metric,
        np.ascontiguousarray(reference[1:-1]),
        np.ascontiguousarray(arm.q_range),
        (options.person_margin, options.person_zone, options.scene_margin, options.scene_zone),
        surroundings.slowing,
        (options.obstacle_step, options.smooth_step, options.largest_change),
        options.least_iterations,
        options.most_iterations,
        options.patience,
    )
    return q, float(excess), int(iterations)
