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
AGE = 0.1
"""Of what monitoring will know of the people at each moment [s]: the camera's delay."""
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
) -> TravelTime:
    """Rolls the arm forward beside every motion.

    Args:
        arm: its kinematics.
        q: (W, 6) configurations `STEP` apart at full speed [rad].
        motions: of the people from now on, (S, N, K, 3) `STEP` apart; None: nobody is there.
        options: of monitoring.
        wait: from now until the path is begun [s].

    Returns:
        Times from now to the last configuration. People whose motions end before are no longer there.
    """
    nominal = wait + STEP * (len(q) - 1)
    if motions is None or len(motions.radius) == 0:
        return TravelTime(nominal, np.array([nominal]))
    o = options
    monitored = (o.reaction, o.braking, o.least_speed, o.constant, o.across, AGE)
    return TravelTime(nominal, np.sort(_roll_out(arm.capsules(q), motions, wait, monitored)))


@njit(cache=True)
@no_type_check
def _roll_out(arm, people, wait, monitored):
    """(S,) times [s] of links (W, L, 3) beside capsules (S, N, K, 3)."""
    end, count = len(arm.start) - 1.0, people.start.shape[1]
    out = np.empty(len(people.start))
    links = np.empty((len(arm.radius), 2, 3)), np.empty((len(arm.radius), 2, 3)), np.empty((len(arm.radius), 3))
    limbs = (
        np.empty((len(people.radius), 2, 3)),
        np.empty((len(people.radius), 2, 3)),
        np.empty((len(people.radius), 3)),
    )
    for s in range(len(out)):
        clock, rate, n = 0.0, 1.0, wait / STEP
        while clock < end and n < count - 1:
            _at(arm.start, arm.end, arm.radius, clock, links)
            _at(people.start[s], people.end[s], people.radius, n, limbs)
            rate = min(_rate(links, limbs, monitored), rate + RISE * STEP)
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
def _at(start, end, radius, time, out):
    """Writes where capsules (N, M, 3) are after so many steps: their ends (M, 2, 3) and these ends' ways in a step.

    And (M, 3): their radii [m], and bounds of the speed of any point [m/s] and of its distance from the middle [m].
    """
    place, way, bounds = out
    n = int(time)
    for i in range(len(radius)):
        fastest = length = 0.0
        for side in range(2):
            axis = end if side else start
            squared = 0.0
            for k in range(3):
                way[i, side, k] = axis[n + 1, i, k] - axis[n, i, k]
                place[i, side, k] = axis[n, i, k] + (time - n) * way[i, side, k]
                squared += way[i, side, k] ** 2
            fastest = max(fastest, squared)
        for k in range(3):
            length += (place[i, 1, k] - place[i, 0, k]) ** 2
        bounds[i] = radius[i], math.sqrt(fastest) / STEP, radius[i] + 0.5 * math.sqrt(length)


@njit(cache=True)
@no_type_check
def _rate(links, limbs, monitored):
    """Share of its full speed that every pair allows the arm."""
    reaction, braking, least, constant, across, age = monitored
    arm, arm_way, arm_bounds = links
    body, body_way, body_bounds = limbs
    rate = 1.0
    for i in range(len(arm)):
        radius, fastest, reach = arm_bounds[i]
        if fastest < 1e-2:
            continue
        stopping = fastest * (reaction + fastest / (2.0 * braking)) + constant + reach
        for j in range(len(body)):
            apart = 0.0
            for k in range(3):
                apart += (arm[i, 0, k] + arm[i, 1, k] - body[j, 0, k] - body[j, 1, k]) ** 2
            approach = max(body_bounds[j, 1], least) * (age + reaction + fastest / braking)
            far = stopping + approach + body_bounds[j, 2]  # what is farther cannot slow it down
            if apart > 4.0 * far * far:
                continue
            s, t = closest_points(arm[i, 0], arm[i, 1], body[j, 0], body[j, 1])
            distance = robot = human = speed = 0.0
            for k in range(3):
                gap = body[j, 0, k] + t * (body[j, 1, k] - body[j, 0, k])
                gap -= arm[i, 0, k] + s * (arm[i, 1, k] - arm[i, 0, k])
                velocity = ((1.0 - s) * arm_way[i, 0, k] + s * arm_way[i, 1, k]) / STEP
                distance += gap * gap
                speed += velocity * velocity
                robot += gap * velocity
                human -= gap * ((1.0 - t) * body_way[j, 0, k] + t * body_way[j, 1, k]) / STEP
            distance = max(math.sqrt(distance), 1e-9)
            robot /= distance
            robot += across * math.sqrt(max(speed - robot * robot, 0.0))
            if robot > 1e-6:
                human = max(human / distance + MEASURED, least)
                room = distance - radius - body_bounds[j, 0] - constant - human * (age + reaction)
                rate = min(rate, allowed_speed(room, human, reaction, braking) / robot)
    return rate
