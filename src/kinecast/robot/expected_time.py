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

from kinecast.robot.motions import STEP
from kinecast.robot.separation import Moving, SeparationOptions, compare
from kinecast.robot.ur5 import UR5

RISE = 3.0  # how fast the clock may speed up again [1/s]
MEASURED = 0.1  # what the noise of a camera adds to the speed at which monitoring takes people to come [m/s]
AGE = 0.1  # of what monitoring will know of the people at each moment [s]: the camera's delay
RISK, TAIL = 0.2, 0.1
"""Price of what the slowest take longer than the mean [s/s], and the share of motions that counts as the slowest."""


@dataclass(frozen=True, eq=False)
class TravelTime:
    """When the arm will be at its path's end."""

    nominal: float  # with nobody there [s]
    samples: Float[np.ndarray, " S"]  # beside each motion, rising [s]

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

    @property
    def priced(self) -> float:
        """Expected time, plus `RISK` times what the slowest tenth takes longer than that (CVaR) [s]."""
        slowest = self.samples[-max(1, math.ceil(TAIL * len(self.samples))) :]
        return self.mean + RISK * (float(slowest.mean()) - self.mean)


def travel_time(
    arm: UR5,
    q: Float[np.ndarray, "W 6"],
    motions: Float[np.ndarray, "S N K 7"] | None,
    options: SeparationOptions,
    wait: float = 0.0,
) -> TravelTime:
    """Rolls the arm forward beside every motion.

    Args:
        arm: its kinematics.
        q: (W, 6) configurations `STEP` apart at full speed [rad].
        motions: (S, N, K, 7) capsules of the people from now on, `STEP` apart; None: nobody is there.
        options: of monitoring.
        wait: from now until the path is begun [s].

    Returns:
        Times from now to the last configuration. People whose motions end before are no longer there.
    """
    nominal = wait + STEP * (len(q) - 1)
    if motions is None:
        return TravelTime(nominal, np.array([nominal]))
    return TravelTime(nominal, np.sort(_roll_out(_moves(arm.capsules(q)), _moves(motions), wait, options)))


def _moves(capsules: Float[np.ndarray, "*S N K 7"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Capsules, their changes from step to step, and their velocities meanwhile."""
    changes = np.diff(capsules, axis=-3)
    return capsules, changes, changes[..., :6] / STEP


@njit(cache=True)
@no_type_check
def _roll_out(arm, people, wait, options):
    """(S,) times [s] of the moves of links (W, L, 7) beside those of people (S, N, K, 7)."""
    links, change, velocity = arm
    limbs, changes, velocities = people
    ages = np.full(links.shape[1], AGE), np.full(limbs.shape[2], AGE)
    end, count = len(links) - 1.0, limbs.shape[1]
    out = np.empty(len(limbs))
    for s in range(len(out)):
        clock, rate, n = 0.0, 1.0, wait / STEP
        while clock < end and n < count - 1:
            i, k = int(clock), int(n)
            link = Moving(links[i] + (clock - i) * change[i], velocity[i], ages[0])
            limb = Moving(limbs[s, k] + (n - k) * changes[s, k], velocities[s, k], ages[1])
            rate = min(compare(link, limb, options, MEASURED, True)[3], rate + RISE * STEP)
            if clock + rate >= end:
                n += (end - clock) / rate
                clock = end
            else:
                clock += rate
                n += 1.0
        out[s] = STEP * (n + end - clock)
    return out
