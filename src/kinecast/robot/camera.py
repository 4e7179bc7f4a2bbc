"""What a depth camera and its tracker make of the people in the cell: noisy, late, with gaps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from kinecast.robot.simulated_person import Person
from kinecast.types import SkeletonFrame

__all__ = ["Camera", "CameraFrame"]

RATE = 30.0
"""Of shots [Hz]."""


@dataclass(frozen=True)
class CameraFrame:
    """Everybody seen at one instant. An empty one says that nobody is there; a silent camera says nothing."""

    stamp: float  # when it was taken [s]
    frames: tuple[SkeletonFrame, ...]  # one for each person


@dataclass
class Camera:
    """Takes a shot at every multiple of its period, with its faults, and hands it over when it is known."""

    delay: float = 0.04  # from taking to knowing [s]: exposure, pose estimation, network
    noise: float = 0.002  # standard deviation of each coordinate [m]; HA4M: 1.3 mm at the neck to 2.4 mm at a wrist
    lost: float = 0.01  # share of shots in which one arm is not seen
    dropped: float = 0.005  # share of shots that never arrive
    seed: int = 0  # of the noise
    _next: int = field(default=0, init=False)

    def shots(self, now: float, people: Sequence[Person]) -> list[CameraFrame]:
        """Shots that have become known by now and were not handed over before, oldest first."""
        due = []
        while (stamp := self._next / RATE) + self.delay <= now + 1e-9:
            rng = np.random.default_rng([self.seed, self._next])  # of this shot: what happens before changes nothing
            if rng.random() >= self.dropped:
                due.append(CameraFrame(stamp, tuple(self._frame(rng, stamp, person) for person in people)))
            self._next += 1
        return due

    def _frame(self, rng: np.random.Generator, stamp: float, person: Person) -> SkeletonFrame:
        pose = person.at(stamp)
        seen = pose + rng.normal(0.0, 1.0, pose.shape) * self.noise
        if rng.random() < self.lost:
            side = "left" if rng.random() < 0.5 else "right"
            parts = ("wrist",) if rng.random() < 0.5 else ("elbow", "wrist")
            seen[[name in {f"{side}_{part}" for part in parts} for name in person.joints]] = np.nan
        return SkeletonFrame(stamp, person.joints, seen, person.name, "cell")
