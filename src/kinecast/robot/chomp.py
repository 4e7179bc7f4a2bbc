"""CHOMP: a smooth path pushed out of what is in the way, and out of where people would slow the arm down.

U[ξ] = ½ ‖K (ξ − ξ₀)‖² + Σ_points ∫ c(d(x, t)) |x'| dt, descended as ξ ← ξ − η A⁻¹ ∇U, K ξ its jerk, ξ₀ the straight
way: A = KᵀK. Both ends are fixed, the joint limits projected. N. Ratliff, M. Zucker, J. A. Bagnell and S. Srinivasa,
"CHOMP: Gradient Optimization Techniques for Efficient Motion Planning", ICRA 2009. The distance d to a person is that
of the moment at which the waypoint is passed.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit

from kinecast.geometry.distances import point_distance
from kinecast.geometry.shapes import Capsule
from kinecast.geometry.transforms import lengths
from kinecast.robot.collision import FIRST_LINK
from kinecast.robot.separation import SeparationOptions
from kinecast.robot.trajectory import minimum_jerk, rest_to_rest
from kinecast.robot.ur5 import LINKS, UR5, fixed_places

OBSTACLE_STEP, SMOOTH_STEP = 2.0, 0.03  # step sizes η of the two costs
LARGEST_CHANGE = 0.1  # of an angle in one iteration [rad]
SCENE_ZONE, PERSON_ZONE = 0.05, 0.10  # the cost rises so far beyond the margin of the scene and of a person [m]
WANTED = 1.0
"""Speed v₀ of a body point that the arm wants beside people [m/s]: about what it reaches on the way to a cube."""
TIME_WEIGHT = 0.3  # of the time lost beside people, next to what is in the way
ITERATIONS, ITERATIONS_BESIDE = (10, 100), (25, 40)
"""Least and most; it stops between the two once the margins are kept. The second are beside people."""
PATIENCE, PROGRESS = 20, 1e-3
"""It stops after so many iterations in which the least distance did not grow by so much [m]."""
SLOWEST = 5e-3
"""Least way [m] of a body point per waypoint in the cost, so that a point at rest inside an obstacle counts too."""
SPACING = 1.3
"""Largest distance of body points along a capsule's axis, in its radii: halfway between two points the capsule's
surface stands out from their balls by 0.24 radii, 0.014 m at most."""


class People(NamedTuple):
    """People beside a path, who cost time: monitoring allows v(d) = √(h² + 2 a (d − C)) − h, where h = v_h + a T_r."""

    capsules: Float[np.ndarray, "W K 7"]  # where they are when each waypoint is passed
    separation: SeparationOptions  # of monitoring

    def price(self, distance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Time lost per metre, 1/v(d) − 1/v₀, and its slope: straight on below v₀/4, and scaled by its slope there."""
        constant, a, least = self.separation.constant, self.separation.braking, 0.25 * WANTED
        h = self.separation.least_speed + a * self.separation.reaction
        steepest = a / (least + h) / least**2
        nearest = constant + ((least + h) ** 2 - h * h) / (2.0 * a)
        root = np.sqrt(h * h + 2.0 * a * (np.maximum(distance, nearest) - constant))
        speed = np.minimum(root - h, WANTED)
        slope = np.where(speed < WANTED, -a / (root * speed**2) / steepest, 0.0)
        lost = (1.0 / speed - 1.0 / WANTED) / steepest + np.maximum(nearest - distance, 0.0)
        return TIME_WEIGHT * lost, TIME_WEIGHT * slope


class Chomp:
    """The arm's body as balls strung along its links, among obstacles that stand still.

    Args:
        arm: the arm.
        obstacles: (O, 17) rows (kinecast.geometry.distances).
    """

    def __init__(self, arm: UR5, obstacles: Float[np.ndarray, "O 17"]) -> None:
        self.arm = arm
        # The arm's own pedestal is in the way too, from the elbow on.
        self._obstacles = np.concatenate(
            [obstacles, Capsule(arm.pedestal[:3], arm.pedestal[3:6], arm.pedestal[6]).row[None]]
        )
        start, end, radius = arm.links[:, :3], arm.links[:, 3:6], arm.links[:, 6]
        counts = np.ceil(lengths(end - start) / (SPACING * radius)).astype(int) + 1
        self._sites = np.concatenate([np.linspace(*each) for each in zip(start, end, counts, strict=True)])
        link = np.repeat(np.arange(len(LINKS)), counts)
        self._joint, self._radius = arm.link_joint[link], radius[link]
        self._meets = link >= np.array([*[FIRST_LINK] * len(obstacles), LINKS.index("elbow")])[:, None]

    def optimise(
        self,
        path: Float[np.ndarray, "W 6"],
        margin: float,
        people: People | None = None,
    ) -> tuple[Float[np.ndarray, "W 6"], float]:
        """Pushes a path out of what is in the way.

        Args:
            path: (W, 6) to begin with [rad]; its ends stay.
            margin: least distance to the obstacles [m].
            people: who cost time.

        Returns:
            The path (W, 6); and the least distance of a body point beyond its margin [m], above 0 where every margin is
            kept, inf where nothing is near.
        """
        q, metric = np.array(path, dtype=np.float64), _metric(len(path))
        straight = q[0] + minimum_jerk(len(q))[:, None] * (q[-1] - q[0])
        least, most = ITERATIONS if people is None else ITERATIONS_BESIDE
        best, highest, improved, iteration = q.copy(), -np.inf, 0, 0
        while True:
            gap, torque = self._forces(q, margin, people)
            if gap > highest:
                improved = iteration if gap > highest + PROGRESS else improved
                best, highest = q.copy(), gap
            change = OBSTACLE_STEP * metric @ torque + SMOOTH_STEP * (q - straight)[1:-1]
            done = gap > 0 and (iteration >= least or not change.any())
            if done or iteration >= most or iteration - improved > PATIENCE:
                return (q, gap) if gap > 0 else (best, highest)
            change *= min(1.0, LARGEST_CHANGE / max(np.abs(change).max(), 1e-12))
            q[1:-1] = np.clip(q[1:-1] - change, *self.arm.q_range.T)
            iteration += 1

    def _forces(
        self, q: Float[np.ndarray, "W 6"], margin: float, people: People | None
    ) -> tuple[float, Float[np.ndarray, "W-2 6"]]:
        """The least distance beyond its margin [m], and ∇U of the inner waypoints without the smoothness."""
        frames = self.arm.frames(q)
        places = fixed_places(frames, self._joint, self._sites)
        inner = places[1:-1]
        gap, pull = _nearest_obstacles(self._obstacles, self._meets, inner)
        gap -= self._radius + margin
        least, (cost, slope) = gap.min(), _cost(gap, SCENE_ZONE)
        pull *= slope[..., None]
        if people is not None:
            gap, away = _nearest_capsules(people.capsules[1:-1], inner)
            gap -= self._radius
            (near, steep), (lost, steeper) = _cost(gap, PERSON_ZONE), people.price(gap)
            least, cost = min(least, gap.min()), cost + near + lost
            pull += (steep + steeper)[..., None] * away
        if not pull.any():
            return float(least), np.zeros((len(q) - 2, 6))
        forces = _functional_gradient(places, cost, pull)
        # Jᵀ f: z · ((p − o) × f) of each joint and the points that it carries.
        carried = 1.0 * (self._joint >= np.arange(6)[:, None])
        force, moment = carried @ forces, carried @ np.cross(inner, forces)
        origin, axis = frames[1:-1, :, :3, 3], frames[1:-1, :, :3, 2]
        return float(least), ((moment - np.cross(origin, force)) * axis).sum(axis=-1)


@njit(cache=True)
@no_type_check
def _nearest_obstacles(rows: np.ndarray, meets: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Signed distances (W, P) [m] of points to the nearest obstacle (O, 17) that they meet (O, P), and gradients."""
    distance, gradient = np.full(points.shape[:2], np.inf), np.zeros(points.shape)
    for w in range(points.shape[0]):
        for p in range(points.shape[1]):
            place = points[w, p, 0], points[w, p, 1], points[w, p, 2]
            for o in range(len(rows)):
                if meets[o, p]:
                    found, direction = point_distance(rows[o], place)
                    if found < distance[w, p]:
                        distance[w, p] = found
                        gradient[w, p, 0], gradient[w, p, 1], gradient[w, p, 2] = direction
    return distance, gradient


@njit(cache=True)
@no_type_check
def _nearest_capsules(capsules: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Signed distances (W, P) [m] of points to the nearest capsule (W, K, 7) of then, and gradients (W, P, 3)."""
    distance, gradient = np.full(points.shape[:2], np.inf), np.zeros(points.shape)
    for w in range(points.shape[0]):
        for k in range(capsules.shape[1]):
            c = capsules[w, k]
            lx, ly, lz = c[3] - c[0], c[4] - c[1], c[5] - c[2]
            squared = max(lx * lx + ly * ly + lz * lz, 1e-12)
            for p in range(points.shape[1]):
                x, y, z = points[w, p, 0] - c[0], points[w, p, 1] - c[1], points[w, p, 2] - c[2]
                share = min(max((x * lx + y * ly + z * lz) / squared, 0.0), 1.0)
                x, y, z = x - share * lx, y - share * ly, z - share * lz
                away = math.sqrt(x * x + y * y + z * z)
                if away - c[6] < distance[w, p]:
                    distance[w, p] = away - c[6]
                    away = max(away, 1e-12)
                    gradient[w, p, 0], gradient[w, p, 1], gradient[w, p, 2] = x / away, y / away, z / away
    return distance, gradient


def _cost(distance: np.ndarray, zone: float) -> tuple[np.ndarray, np.ndarray]:
    """CHOMP's obstacle cost and its slope: 0 beyond the zone, quadratic within, straight inside the obstacle."""
    within = np.minimum(np.maximum(distance, 0.0) - zone, 0.0)
    return 0.5 * within**2 / zone - np.minimum(distance, 0.0), within / zone


def _functional_gradient(
    places: Float[np.ndarray, "W P 3"], cost: Float[np.ndarray, "W-2 P"], pull: Float[np.ndarray, "W-2 P 3"]
) -> Float[np.ndarray, "W-2 P 3"]:
    """Of body points: |x'| ((I − x̂' x̂'ᵀ) ∇c − c κ), where ∇c is their pull; x' by central differences."""
    before, here, after = places[:-2], places[1:-1], places[2:]
    way = 0.5 * (after - before)
    speed = np.sqrt((way * way).sum(axis=-1, keepdims=True))
    moving = np.maximum(speed, SLOWEST)
    direction = way / moving
    curved = pull - cost[..., None] / moving**2 * (after - 2.0 * here + before)
    across = curved - (curved * direction).sum(axis=-1, keepdims=True) * direction
    return moving * np.where(speed < SLOWEST, pull, across)


@lru_cache(maxsize=8)
def _metric(waypoints: int) -> Float[np.ndarray, "n n"]:
    """A⁻¹ of the inner waypoints, scaled to a greatest entry of 1.

    K is the jerk of the spline through all of them (kinecast.robot.trajectory), at the nodes of a quadrature that is
    exact for its square.
    """
    jerk = rest_to_rest(np.arange(float(waypoints)), np.eye(waypoints)).derivative(3)
    nodes, weights = np.polynomial.legendre.leggauss(3)
    places = (np.arange(waypoints - 1)[:, None] + 0.5 * (1 + nodes)).ravel()
    K = (jerk(places) * np.sqrt(np.tile(weights, waypoints - 1))[:, None])[:, 1:-1]
    inverse: Float[np.ndarray, "n n"] = np.linalg.inv(K.T @ K)
    return inverse / inverse.max()
