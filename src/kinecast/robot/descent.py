"""Compiled: CHOMP's covariant gradient descent over the waypoints of one arm among moving capsules."""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from numba import njit

from kinecast.robot.distances import columns, nearest_capsule, nearest_obstacle
from kinecast.robot.kinematics import joint_frames, site_position

__all__ = ["descend"]

SLOWEST = 5e-3
"""Least way [m] of a body point per waypoint in the cost, so that a point at rest inside an obstacle counts too."""

PROGRESS = 1e-3
"""Gain of the least distance that counts as progress [m]."""


@njit(cache=True)
@no_type_check
def _cost(distance: float, zone: float) -> tuple[float, float]:
    """CHOMP's obstacle cost and its slope: 0 beyond the zone, quadratic within, straight inside the obstacle."""
    if distance >= zone:
        return 0.0, 0.0
    if distance < 0.0:
        return 0.5 * zone - distance, -1.0
    return 0.5 * (distance - zone) ** 2 / zone, (distance - zone) / zone


@njit(cache=True)
@no_type_check
def _dilation(distance: float, slowing: tuple[float, float, float, float, float]) -> tuple[float, float]:
    """Time lost per metre at a distance from a person, where monitoring allows only v(d), and its slope.

    1/v(d) − 1/v₀ beyond the speed v₀ that the arm wants; straight on below a quarter of it. Scaled by the slope there.
    """
    constant, half, braking, top, weight = slowing
    least = 0.25 * top
    slope = braking / (least + half) / (least * least)
    nearest = constant + ((least + half) ** 2 - half * half) / (2.0 * braking)
    if distance <= nearest:
        return weight * ((1.0 / least - 1.0 / top) / slope + nearest - distance), -weight
    root = math.sqrt(half * half + 2.0 * braking * (distance - constant))
    speed = root - half
    if speed >= top:
        return 0.0, 0.0
    return weight * (1.0 / speed - 1.0 / top) / slope, -weight * braking / (root * speed * speed) / slope


@njit(cache=True)
@no_type_check
def _add_torque(
    frames: np.ndarray, joint: int, p: tuple[float, float, float], f: tuple[float, float, float], out: np.ndarray
) -> None:
    """Adds Jᵀ f of a point p fixed to a joint's link."""
    for j in range(joint + 1):
        rx, ry, rz = p[0] - frames[j, 0, 3], p[1] - frames[j, 1, 3], p[2] - frames[j, 2, 3]
        zx, zy, zz = frames[j, 0, 2], frames[j, 1, 2], frames[j, 2, 2]
        out[j] += f[0] * (zy * rz - zz * ry) + f[1] * (zz * rx - zx * rz) + f[2] * (zx * ry - zy * rx)


@njit(cache=True)
@no_type_check
def _push(
    places: np.ndarray, w: int, p: int, cost: float, gx: float, gy: float, gz: float
) -> tuple[float, float, float]:
    """The functional gradient of one body point: |x'| ((I − x̂' x̂'ᵀ) ∇c − c κ), x' by central differences."""
    ax, ay, az = places[w - 1, p, 0], places[w - 1, p, 1], places[w - 1, p, 2]
    bx, by, bz = places[w + 1, p, 0], places[w + 1, p, 1], places[w + 1, p, 2]
    vx, vy, vz = 0.5 * (bx - ax), 0.5 * (by - ay), 0.5 * (bz - az)
    speed = math.sqrt(vx * vx + vy * vy + vz * vz)
    if speed < SLOWEST:
        return SLOWEST * gx, SLOWEST * gy, SLOWEST * gz
    vx, vy, vz = vx / speed, vy / speed, vz / speed
    curve = cost / (speed * speed)
    gx -= curve * (bx - 2.0 * places[w, p, 0] + ax)
    gy -= curve * (by - 2.0 * places[w, p, 1] + ay)
    gz -= curve * (bz - 2.0 * places[w, p, 2] + az)
    along = gx * vx + gy * vy + gz * vz
    return speed * (gx - along * vx), speed * (gy - along * vy), speed * (gz - along * vz)


@njit(cache=True)
@no_type_check
def _repel(
    places: np.ndarray,
    frames: np.ndarray,
    joint: int,
    w: int,
    p: int,
    priced: tuple[float, float],
    direction: tuple[float, float, float],
    out: np.ndarray,
) -> None:
    """Adds what pushes one body point, by cost and slope, where its distance to an obstacle grows."""
    cost, slope = priced
    if slope != 0.0:
        gx, gy, gz = direction
        force = _push(places, w, p, cost, slope * gx, slope * gy, slope * gz)
        place = (places[w, p, 0], places[w, p, 1], places[w, p, 2])
        _add_torque(frames, joint, place, force, out)


@njit(cache=True)
@no_type_check
def _way(places: np.ndarray, looked: np.ndarray, w: int, p: int) -> float:
    """How far a body point is from where its distance was last measured [m]."""
    x, y, z = places[w, p, 0] - looked[w, p, 0], places[w, p, 1] - looked[w, p, 1], places[w, p, 2] - looked[w, p, 2]
    return math.sqrt(x * x + y * y + z * z)


@njit(cache=True)
@no_type_check
def descend(
    q: np.ndarray,
    arm: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    capsules: np.ndarray,
    obstacles: np.ndarray,
    first_link: np.ndarray,
    metric: np.ndarray,
    smoothest: np.ndarray,
    q_range: np.ndarray,
    margins: tuple[float, float, float, float],
    slowing: tuple[float, float, float, float, float],
    rates: tuple[float, float, float],
    least_iterations: int,
    most_iterations: int,
    patience: int,
) -> tuple[int, float]:
    """Moves the inner waypoints of q (W, 6) out of the obstacles, in place; both ends stay.

    Args:
        q: (W, 6) [rad].
        arm: base (3, 4), joint origins (6, 3, 4), sites (P, 3), their joints (P,), radii (P,), links (P,).
        capsules: (W, K, 7) of persons where they are at each waypoint's time.
        obstacles: (W, O, 17) of the scene, likewise.
        first_link: (O,) the first link each obstacle counts for.
        metric: (n, n) A⁻¹ of the inner waypoints, scaled to a greatest entry of 1.
        smoothest: (n, 6) inner waypoints of least smoothness cost.
        q_range: (6, 2) [rad].
        margins: of persons: least distance, zone beyond it in which the cost rises; of the scene: the same [m].
        slowing: by monitoring, beside persons: constant part of S_p [m], v_h + a T_r [m/s], a [m/s²], the speed that
            the arm wants [m/s], and the weight of the time lost, 0 to leave it out.
        rates: obstacle step, smoothness step, largest change of an angle in one iteration [rad].
        least_iterations, most_iterations: stops between the two as soon as every least distance is kept.
        patience: stops after so many iterations without progress.

    Returns:
        Iterations made, and the least distance beyond the least allowed [m], above 0 where all are
        kept, inf where nothing is near.
    """
    base, origins, sites, joint, radius, link = arm
    person_margin, person_zone, scene_margin, scene_zone = margins
    obstacle_step, smooth_step, largest = rates
    constant, half, braking, top, weight = slowing
    slowed = person_zone
    if weight > 0.0:
        slowed = max(person_zone, constant + ((top + half) ** 2 - half * half) / (2.0 * braking) - person_margin)
    waypoints, count = len(q), len(sites)
    inner = waypoints - 2
    frames = np.empty((waypoints, 6, 3, 4))
    places = np.empty((waypoints, count, 3))
    prepared = np.empty((waypoints, 8, capsules.shape[1]))
    scratch = np.empty(capsules.shape[1])
    for w in range(waypoints):
        columns(capsules[w], prepared[w])
    # A distance changes by no more than the point moves: far from everything, it need not be measured again.
    looked = np.zeros((2, waypoints, count, 3))
    spare = np.full((2, waypoints, count), -np.inf)
    torque = np.empty((inner, 6))
    best, least = q.copy(), -np.inf
    iteration, improved = 0, 0
    while True:
        for w in range(waypoints):
            joint_frames(q[w], base, origins, frames[w])
            for p in range(count):
                x, y, z = site_position(frames[w, joint[p]], sites[p])
                places[w, p, 0], places[w, p, 1], places[w, p, 2] = x, y, z
        torque[:] = 0.0
        worst = np.inf
        for w in range(1, waypoints - 1):
            for p in range(count):
                x, y, z = places[w, p, 0], places[w, p, 1], places[w, p, 2]
                moved = _way(places, looked[0], w, p)
                if moved >= spare[0, w, p]:
                    gap, gx, gy, gz = nearest_capsule(prepared[w], x, y, z, scratch)
                    gap -= radius[p] + person_margin
                    worst = min(worst, gap)
                    cost, slope = _cost(gap, person_zone)
                    if weight > 0.0:
                        lost, steeper = _dilation(gap + person_margin, slowing)
                        cost, slope = cost + lost, slope + steeper
                    _repel(places, frames[w], joint[p], w, p, (cost, slope), (gx, gy, gz), torque[w - 1])
                    spare[0, w, p], looked[0, w, p] = gap - slowed, places[w, p]
                moved = _way(places, looked[1], w, p)
                if moved >= spare[1, w, p]:
                    gap, gx, gy, gz = nearest_obstacle(obstacles[w], first_link, link[p], x, y, z, np.inf)
                    gap -= radius[p] + scene_margin
                    worst = min(worst, gap)
                    _repel(places, frames[w], joint[p], w, p, _cost(gap, scene_zone), (gx, gy, gz), torque[w - 1])
                    spare[1, w, p], looked[1, w, p] = gap - scene_zone, places[w, p]
        if worst > least:
            if worst > least + PROGRESS:
                improved = iteration
            least = worst
            best[:] = q
        if (
            iteration - improved > patience
            or iteration >= most_iterations
            or (iteration >= least_iterations and worst > 0.0)
        ):
            break
        change = np.dot(metric, torque)
        biggest = 0.0
        for w in range(inner):
            for j in range(6):
                change[w, j] = obstacle_step * change[w, j] + smooth_step * (q[w + 1, j] - smoothest[w, j])
                biggest = max(biggest, abs(change[w, j]))
        scale = min(1.0, largest / max(biggest, 1e-12))
        for w in range(inner):
            for j in range(6):
                q[w + 1, j] = min(max(q[w + 1, j] - scale * change[w, j], q_range[j, 0]), q_range[j, 1])
        iteration += 1
    if worst <= 0.0:
        q[:] = best
        return iteration, least
    return iteration, worst
