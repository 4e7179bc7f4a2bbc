"""The true motion of somebody at a table who reaches for places: for simulated cells, and where the truth is needed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from kinecast.datasets.physique import JOINTS, Body, Trunk, joints
from kinecast.datasets.recording import Recording
from kinecast.errors import OptionError

LEFT, RIGHT = 0, 1
TABLE = 0.9
"""Height of the table's top [m]: lower than any elbow, and within the reach of all. People stand."""
WRIST_HEIGHT = TABLE + 0.08  # wrists stay above the table by the length of a bent hand [m]
SHORTEST = 0.4  # no movement takes less time [s]
PEAK = 1.875  # peak over mean speed of a minimum-jerk movement: s'(1/2) = 15/8

Point: TypeAlias = Float[np.ndarray, " D"]
Phase: TypeAlias = Float[np.ndarray, "*n"]


@dataclass(frozen=True, eq=False)
class Fetch:
    """One reach."""

    start: float  # when it begins [s]
    place: Float[np.ndarray, "3"]  # of the wrist, in the person's frame: on the floor, x forward, z up [m]
    hold: float = 1.0  # how long the hand stays there [s]
    left: bool | None = None  # with which hand; None for the one on the place's side


def fetching(fetches: Sequence[Fetch], duration: float, seed: int, rate: float = 100.0) -> Recording:
    """The true motion of somebody who reaches for places one after the other, for a duration [s] at a rate [Hz].

    Fetches are in order of their starts; one that begins before the last has ended waits for it. The seed is of the
    build, the tempo and the way they move. An OptionError for a duration or rate that is not above 0.
    """
    if not (duration > 0 and rate > 0):
        raise OptionError(f"duration {duration} s and rate {rate} Hz must be above 0")
    build, motion = np.random.SeedSequence(seed).spawn(2)
    actor = Actor(Body.sample(np.random.default_rng(build)), np.random.default_rng(motion))
    for fetch in fetches:
        left = fetch.place[1] > 0 if fetch.left is None else fetch.left
        hand = LEFT if left else RIGHT
        actor.now = max(actor.now, fetch.start)
        actor.now += actor.move({hand: fetch.place})
        actor.dwell(fetch.hold, fetch.hold)
        actor.now += actor.move({hand: actor.rest(hand)})
    stamps = np.arange(max(2, round(duration * rate))) / rate
    positions = actor.joints(stamps)
    return Recording(f"synthetic/fetching/{seed}", JOINTS, stamps, positions, rate, task="fetching")


class Actor:
    """One person in one recording, who remembers what every part of the body does when.

    Attributes:
        now: when the next movement begins [s].
    """

    def __init__(self, body: Body, rng: np.random.Generator) -> None:
        self.body, self.now = body, 0.0
        self._rng = rng
        rest = [self.rest(LEFT), self.rest(RIGHT)]
        self._hands = [Path(rest[LEFT]), Path(rest[RIGHT])]
        self._trunk = Path(self._posture(np.stack(rest), turn_to=0.0))
        self._swivel = Path(np.full(2, body.swivel))
        self._wander = Sway(rng, np.array([0.012, 0.012, 0.02, 0.03, 0.015]))  # pelvis x, y [m], angles [rad]
        self._tremble = [Sway(rng, np.full(3, 0.004)) for _ in (LEFT, RIGHT)]
        self._elbow_sway = Sway(rng, np.radians([4.0, 4.0]))

    def rest(self, hand: int) -> Point:
        """Somewhere above the near edge of the table [m]."""
        middle = np.array([0.22, 0.17 if hand == LEFT else -0.17, WRIST_HEIGHT])
        return middle + self._rng.uniform(-1.0, 1.0, 3) * [0.03, 0.03, 0.01]

    def dwell(self, low: float, high: float) -> None:
        """Stays for a random time [s]."""
        self.now += self._rng.uniform(low, high)

    def move(self, targets: Mapping[int, Point], lift: float | None = None, at_least: float = SHORTEST) -> float:
        """Moves one hand or both to places of the wrist [m] from now on, trunk and elbows with them; how long it takes.

        That is `at_least` [s] or more. `lift` is the height of the via-point [m]; a low natural arch if None.
        """
        rng = self._rng
        tempo = self.body.tempo * np.exp(np.clip(rng.normal(0.0, 0.12), -0.25, 0.25))
        vias: dict[int, Point] = {}
        duration = at_least
        for hand, target in targets.items():
            way = target - self._hands[hand].target
            length = float(np.linalg.norm(way))
            height = length * rng.uniform(0.05, 0.2) if lift is None else lift
            aside = length * rng.normal(0.0, 0.04)
            vias[hand] = np.array([-way[1], way[0], 0.0]) / max(length, 1e-9) * aside + [0.0, 0.0, height]
            duration = max(duration, PEAK * float(np.hypot(length, height)) / tempo)
        for hand, target in targets.items():
            self._hands[hand].move(self.now, duration, target, vias[hand])
        wrists = np.stack([path.target for path in self._hands])
        turn_to = float(np.mean([np.arctan2(target[1], target[0]) for target in targets.values()]))
        following = duration * rng.uniform(1.0, 1.2)  # the trunk arrives a little later
        self._trunk.move(self.now, following, self._posture(wrists, turn_to))
        self._swivel.move(self.now, duration, self.body.swivel + rng.uniform(-0.1, 0.15, 2))
        return duration

    def joints(self, times: Float[np.ndarray, " N"]) -> Float[np.ndarray, "N 10 3"]:
        """(N, 10, 3) true joint positions [m] at times [s], in the order of `physique.JOINTS`."""
        wander = self._wander.at(times)
        trunk = Trunk(self.body, wander[:, :2], *(self._trunk.at(times) + wander[:, 2:]).T)
        hands = [path.at(times) + sway.at(times) for path, sway in zip(self._hands, self._tremble, strict=True)]
        return joints(trunk, np.stack(hands, 1), self._swivel.at(times) + self._elbow_sway.at(times))

    def _posture(self, wrists: Float[np.ndarray, "2 3"], turn_to: float) -> Float[np.ndarray, " 3"]:
        """Lean, twist and tilt [rad]: the least lean that brings both wrists into comfortable reach."""
        lean = np.linspace(0.04, 0.9, 44)
        twist, tilt = 0.3 * turn_to, -0.06 * turn_to
        trunk = Trunk(self.body, np.zeros((44, 2)), lean, np.full(44, twist), np.full(44, tilt))
        ratios = [
            self.body.reach_ratio(trunk.shoulder(side), np.tile(wrist, (44, 1)))
            for side, wrist in zip((1.0, -1.0), wrists, strict=True)
        ]
        excess = np.maximum(np.max(ratios, axis=0), self.body.stretch)
        return np.array([lean[int(np.argmin(excess))], twist, tilt])


def minimum_jerk(phase: Phase) -> Phase:
    """s(τ) = 10 τ³ − 15 τ⁴ + 6 τ⁵, from 0 to 1, at rest outside (Flash & Hogan 1985)."""
    tau = np.clip(phase, 0.0, 1.0)
    return np.multiply(tau**3, 10.0 + tau * (-15.0 + 6.0 * tau))


def arch(phase: Phase) -> Phase:
    """b(τ) = (20 u³ − 25 u⁴ + 8 u⁵) / 3 with u = 1 − |2τ − 1|: from 0 over 1 half-way to 0.

    d·s(τ) + v·b(τ) is the minimum-jerk movement by d through a via-point v off the middle of the straight
    line: the quintic spline that is at rest at both ends and smooth to the fourth derivative between.
    """
    u = 1.0 - np.abs(2.0 * np.clip(phase, 0.0, 1.0) - 1.0)
    return np.divide(u**3 * (20.0 + u * (-25.0 + 8.0 * u)), 3.0)


class Path:
    """A point that starts at rest and is moved again and again.

    A movement that begins before the last one has ended is added to it, as people do who change their mind
    in mid-reach (Flash & Henis 1991).
    """

    def __init__(self, start: Point) -> None:
        self.target = self._start = start
        self._movements: list[tuple[float, float, Point, Point | float]] = []

    def move(self, start: float, duration: float, target: Point, via: Point | float = 0.0) -> None:
        """Move on to a target from a time [s] on; `via` is how far the via-point is off the middle of the way."""
        self._movements.append((start, duration, target - self.target, via))
        self.target = target

    def at(self, times: Float[np.ndarray, " N"]) -> Float[np.ndarray, "N D"]:
        """(N, D) where it is at times [s]."""
        position = np.tile(self._start, (len(times), 1))
        for start, duration, displacement, via in self._movements:
            phase = ((times - start) / duration)[:, None]
            position += minimum_jerk(phase) * displacement
            position += arch(phase) * via
        return position


class Sway:
    """Slow wandering that nobody intends: three sines per coordinate, between 0.1 and 0.5 Hz."""

    def __init__(self, rng: np.random.Generator, amplitude: Point) -> None:
        self._frequency = rng.uniform(0.1, 0.5, (3, len(amplitude)))
        self._phase = rng.uniform(0.0, 2 * np.pi, (3, len(amplitude)))
        self._amplitude = amplitude / 3

    def at(self, times: Float[np.ndarray, " N"]) -> Float[np.ndarray, "N D"]:
        """(N, D) offset at times [s], within ± the amplitude."""
        angle = 2 * np.pi * self._frequency * times[:, None, None] + self._phase
        return np.multiply(self._amplitude, np.sin(angle).sum(axis=1))
