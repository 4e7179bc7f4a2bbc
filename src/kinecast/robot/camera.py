"""What a depth camera and its tracker make of the people in the cell: noisy, late, with gaps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinecast.errors import OptionError
from kinecast.robot.person import Person
from kinecast.types import SkeletonFrame

__all__ = ["Camera", "CameraOptions", "Shot"]


@dataclass(frozen=True)
class Shot:
    """Everybody seen at one instant. An empty one says that nobody is there; a silent camera says nothing.

    Attributes:
        stamp: when it was taken [s].
        arrival: when it is known [s].
        frames: one for each person.
    """

    stamp: float
    arrival: float
    frames: tuple[SkeletonFrame, ...]


@dataclass(frozen=True)
class CameraOptions:
    """A camera and its faults.

    Attributes:
        rate: [Hz].
        delay: from taking to knowing [s]: exposure, pose estimation, network.
        noise: standard deviation of each coordinate [m]; HA4M: 1.3 mm at the neck to 2.4 mm at a wrist.
        lost: share of shots in which one arm is not seen.
        dropped: share of shots that never arrive.
        silent: when no shot is taken: pairs of from and until [s].
        blind: when every joint is NaN.
        seed: of the noise.
    """

    rate: float = 30.0
    delay: float = 0.04
    noise: float = 0.002
    lost: float = 0.01
    dropped: float = 0.005
    silent: tuple[tuple[float, float], ...] = ()
    blind: tuple[tuple[float, float], ...] = ()
    seed: int = 0

    def __post_init__(self) -> None:
        if not self.rate > 0:
            raise OptionError(f"rate {self.rate} Hz must be above 0")
        for name in ("delay", "noise"):
            if not 0 <= getattr(self, name) < math.inf:
                raise OptionError(f"{name} {getattr(self, name)} must be 0 or more")
        for name in ("lost", "dropped"):
            if not 0 <= getattr(self, name) <= 1:
                raise OptionError(f"{name} {getattr(self, name)} is outside 0..1")


class Camera:
    """Takes a shot at every multiple of its period and hands it over when it is known.

    Args:
        options: see CameraOptions.
    """

    def __init__(self, options: CameraOptions | None = None) -> None:
        self.options = options or CameraOptions()
        self._next = 0

    def shots(self, now: float, people: Sequence[Person]) -> list[Shot]:
        """Shots that have become known by now and were not handed over before, oldest first."""
        o = self.options
        due = []
        while (stamp := self._next / o.rate) + o.delay <= now + 1e-9:
            shot = self._take(self._next, stamp, people)
            if shot is not None:
                due.append(shot)
            self._next += 1
        return due

    def _take(self, index: int, stamp: float, people: Sequence[Person]) -> Shot | None:
        o = self.options
        rng = np.random.default_rng([o.seed, index])  # a shot of its own: what happens before changes nothing
        if rng.random() < o.dropped or _within(stamp, o.silent):
            return None
        frames = []
        for person in people:
            truth = person.at(stamp)
            if truth is None:
                continue
            seen = truth + rng.normal(0.0, 1.0, truth.shape) * o.noise
            if rng.random() < o.lost:
                side = "left" if rng.random() < 0.5 else "right"
                parts = ("wrist",) if rng.random() < 0.5 else ("elbow", "wrist")
                seen[[name in {f"{side}_{part}" for part in parts} for name in person.joints]] = np.nan
            if _within(stamp, o.blind):
                seen[:] = np.nan
            frames.append(SkeletonFrame(stamp, person.joints, seen, person.name, "cell"))
        return Shot(stamp, stamp + o.delay, tuple(frames))


def _within(time: float, intervals: Sequence[tuple[float, float]]) -> bool:
    return any(start <= time < end for start, end in intervals)
