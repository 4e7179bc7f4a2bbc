"""How long a path will take beside people: the arm rolled forward under speed and separation monitoring.

Against each of S possible motions of the people the path's clock runs at the rate that monitoring would allow at that
moment (kinecast.robot.separation), so that a path is judged by the time it will really need: where it will be slowed
and for how long, not by how far it keeps from anybody. After Pellegrinelli et al. and Flowers et al. (STAP, arXiv
2307.03909), with a distribution in place of a mean.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit

from kinecast.robot.capsules import Capsules
from kinecast.robot.motions import STEP
from kinecast.robot.separation import SeparationOptions, allowed_speed, closest_points
from kinecast.robot.ur5 import UR5

__all__ = ["RISE", "TravelTime", "travel_time"]

RISE = 3.0
"""How fast the clock may speed up again [1/s]."""
MEASURED = 0.1
"""What the noise of a camera adds to the speed at which monitoring takes people to come [m/s]."""
TAIL = 0.1
"""Share of the slowest motions that the price of risk looks at."""


@dataclass(frozen=True, eq=False)
class TravelTime:
    """When the arm will be at its path's end.

    Attributes:
        nominal: with nobody there [s].
        samples: (S,) beside each motion, rising [s].
    """

    nominal: float
    samples: Float[np.ndarray, " S"]

    @property
    def mean(self) -> float:
        """Expected [s]."""
        return float(self.samples.mean())

    def quantile(self, level: float) -> float:
        """Not exceeded with this probability [s]."""
        return float(np.quantile(self.samples, level))

    def with_errors(self, shares: Sequence[float]) -> TravelTime:
        """Each sample with each of the errors that such times had, equally likely shares of the nominal time."""
        samples = self.samples[:, None] + self.nominal * np.asarray(shares)
        return TravelTime(self.nominal, np.sort(np.maximum(samples, 0.0).ravel()))

    def priced(self, risk: float) -> float:
        """Expected time, plus `risk` times what the slowest tenth takes longer than that (CVaR) [s]."""
        slowest = self.samples[-max(1, math.ceil(TAIL * len(self.samples))) :]
        return self.mean + risk * (float(slowest.mean()) - self.mean)


def travel_time(
    arm: UR5,
    q: Float[np.ndarray, "W 6"],
    motions: Capsules | None,
    options: SeparationOptions,
    wait: float = 0.0,
    age: float = 0.1,
) -> TravelTime:
    """Rolls the arm forward beside every motion.

    Args:
        arm: its kinematics.
        q: (W, 6) configurations `STEP` apart at full speed [rad].
        motions: of the people from now on, (S, N, K, 3) `STEP` apart; None: nobody is there.
        options: of monitoring.
        wait: from now until the path is begun [s].
        age: of what monitoring will know of the people at each moment [s]: the camera's delay.

    Returns:
        Times from now to the last configuration. People whose motions end before are no longer there.
    """
    nominal = wait + STEP * (len(q) - 1)
    if motions is None or len(motions.radius) == 0:
        return TravelTime(nominal, np.array([nominal]))
    o = options
    monitored = (o.reaction, o.braking, o.least_speed, o.constant, o.across, age)
    return TravelTime(nominal, np.sort(_roll_out(*arm.capsules(q), *motions, wait, monitored)))


@njit(cache=True)
@no_type_check
def _roll_out(
    a0: np.ndarray,
    a1: np.ndarray,
    arm_radius: np.ndarray,
    b0: np.ndarray,
    b1: np.ndarray,
    body_radius: np.ndarray,
    wait: float,
    monitored: tuple[float, float, float, float, float, float],
) -> np.ndarray:
    """(S,) times [s] for links (W, L, 3) beside capsules (S, N, K, 3)."""
    end = len(a0) - 1.0
    out = np.empty(len(b0))
    links = np.empty((2, 2, a0.shape[1], 3))  # start and end, place and way in a step
    limbs = np.empty((2, 2, b0.shape[2], 3))
    for s in range(len(b0)):
        clock, rate, n = 0.0, 1.0, wait / STEP
        while clock < end and n < b0.shape[1] - 1:
            w, m = int(clock), int(n)
            _between(a0[w], a0[w + 1], clock - w, links[0])
            _between(a1[w], a1[w + 1], clock - w, links[1])
            _between(b0[s, m], b0[s, m + 1], n - m, limbs[0])
            _between(b1[s, m], b1[s, m + 1], n - m, limbs[1])
            rate = min(_rate(links, arm_radius, limbs, body_radius, monitored), rate + RISE * STEP)
            if clock + rate >= end:
                n += (end - clock) / rate
                clock = end
            else:
                clock += rate
                n += 1.0
        out[s] = STEP * (n + end - clock)
    return out


@njit(cache=True)
@no_type_check
def _between(first: np.ndarray, last: np.ndarray, share: float, out: np.ndarray) -> None:
    """Writes places (M, 3) so far from the first to the last, and the way from first to last."""
    for i in range(len(first)):
        for k in range(3):
            out[1, i, k] = last[i, k] - first[i, k]
            out[0, i, k] = first[i, k] + share * out[1, i, k]


@njit(cache=True)
@no_type_check
def _rate(
    links: np.ndarray,
    arm_radius: np.ndarray,
    limbs: np.ndarray,
    body_radius: np.ndarray,
    monitored: tuple[float, float, float, float, float, float],
) -> float:
    """Share of its full speed that every pair allows the arm; places and ways (2, 2, M, 3) of the capsules' ends."""
    reaction, braking, least, constant, across, age = monitored
    rate = 1.0
    fastest, half = _bounds(links)
    human_fastest, limb_half = _bounds(limbs)
    for i in range(len(arm_radius)):
        if fastest[i] < 1e-2:
            continue
        stopping = fastest[i] * (reaction + fastest[i] / (2.0 * braking)) + constant + arm_radius[i] + half[i]
        for j in range(len(body_radius)):
            apart = 0.0
            for k in range(3):
                apart += (links[0, 0, i, k] + links[1, 0, i, k] - limbs[0, 0, j, k] - limbs[1, 0, j, k]) ** 2
            approach = max(human_fastest[j], least) * (age + reaction + fastest[i] / braking)
            far = stopping + approach + body_radius[j] + limb_half[j]  # what is farther cannot slow it down
            if apart > 4.0 * far * far:
                continue
            s, t = closest_points(links[0, 0, i], links[1, 0, i], limbs[0, 0, j], limbs[1, 0, j])
            distance = robot = human = speed = 0.0
            for k in range(3):
                gap = limbs[0, 0, j, k] + t * (limbs[1, 0, j, k] - limbs[0, 0, j, k])
                gap -= links[0, 0, i, k] + s * (links[1, 0, i, k] - links[0, 0, i, k])
                velocity = ((1.0 - s) * links[0, 1, i, k] + s * links[1, 1, i, k]) / STEP
                distance += gap * gap
                speed += velocity * velocity
                robot += gap * velocity
                human -= gap * ((1.0 - t) * limbs[0, 1, j, k] + t * limbs[1, 1, j, k]) / STEP
            distance = max(math.sqrt(distance), 1e-9)
            robot /= distance
            robot += across * math.sqrt(max(speed - robot * robot, 0.0))
            if robot > 1e-6:
                human = max(human / distance + MEASURED, least)
                room = distance - arm_radius[i] - body_radius[j] - constant - human * (age + reaction)
                rate = min(rate, allowed_speed(room, human, reaction, braking) / robot)
    return rate


@njit(cache=True)
@no_type_check
def _bounds(capsules: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(M,) bounds of the speed of any point [m/s], and half of each length [m], of capsules (2, 2, M, 3)."""
    count = capsules.shape[2]
    speed, half = np.empty(count), np.empty(count)
    for i in range(count):
        first = second = length = 0.0
        for k in range(3):
            first += capsules[0, 1, i, k] ** 2
            second += capsules[1, 1, i, k] ** 2
            length += (capsules[1, 0, i, k] - capsules[0, 0, i, k]) ** 2
        speed[i] = math.sqrt(max(first, second)) / STEP
        half[i] = 0.5 * math.sqrt(length)
    return speed, half
