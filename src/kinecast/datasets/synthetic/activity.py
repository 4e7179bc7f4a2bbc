"""What people do at the table, and when: tasks made of reaches, picks, carries, places and pauses, on smooth paths."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from kinecast.datasets.synthetic.physique import Body, Trunk, joints
from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Box, Sphere

LEFT, RIGHT = 0, 1
TABLE = 0.9
"""Height of the table's top [m]: lower than any elbow, and within the reach of all. People stand."""
WRIST_HEIGHT = TABLE + 0.08  # wrists stay above the table by the length of a bent hand [m]
SHORTEST = 0.4  # no movement takes less time [s]
HANDLE = 0.13  # from the middle of the crate to each hand [m]
PEAK = 1.875  # peak over mean speed of a minimum-jerk movement: s'(1/2) = 15/8

Point: TypeAlias = Float[np.ndarray, " D"]
Phase: TypeAlias = Float[np.ndarray, "*n"]
Targets: TypeAlias = Mapping[int, Point]


class Actor:
    """One person in one recording: performs a task and remembers what every part of the body does when.

    Labels are those of the AnDy data: Re reaching (an empty hand moves), Pi picking, Ca carrying, Pl placing,
    Id idle. The last quarter of the movement to an object or to its place belongs to Pi or Pl.
    """

    def __init__(self, body: Body, scene: Scene, rng: np.random.Generator, hesitation: float = 0.0):
        self._body = body
        self._hesitation = hesitation
        self._goals = scene.goals
        self._rng = rng
        rest = [self._rest(LEFT), self._rest(RIGHT)]
        self._hands = [Path(rest[LEFT]), Path(rest[RIGHT])]
        self._trunk = Path(self._posture(np.stack(rest), turn_to=0.0))
        self._swivel = Path(np.full(2, body.swivel))
        self._now = 0.0
        self._labels = [(0.0, "Id")]
        self._wander = Sway(rng, np.array([0.012, 0.012, 0.02, 0.03, 0.015]))  # pelvis x, y [m], angles [rad]
        self._tremble = [Sway(rng, np.full(3, 0.004)) for _ in (LEFT, RIGHT)]
        self._elbow_sway = Sway(rng, np.radians([4.0, 4.0]))

    def perform(self, task: str, duration: float) -> None:
        """Do one of `TASKS` over and over until the time [s] is up."""
        self._dwell("Id", 0.2, 1.0)
        while self._now < duration:
            TASKS[task](self)

    def fetch(self, start: float, place: Point, hand: int, hold: float) -> None:
        """Reach for a place of the wrist [m] at a time [s], or when the last movement has ended; hold it, draw back."""
        self._now = max(self._now, start)
        self._reach({hand: place}, ("Re", "Pi"))
        self._dwell("Pi", hold, hold)
        self._reach({hand: self._rest(hand)}, ("Re", "Re"))

    def joints(self, times: Float[np.ndarray, " N"]) -> Float[np.ndarray, "N 10 3"]:
        """(N, 10, 3) true joint positions [m] at times [s], in the order of `physique.JOINTS`."""
        wander = self._wander.at(times)
        trunk = Trunk(self._body, wander[:, :2], *(self._trunk.at(times) + wander[:, 2:]).T)
        hands = [path.at(times) + sway.at(times) for path, sway in zip(self._hands, self._tremble, strict=True)]
        return joints(trunk, np.stack(hands, 1), self._swivel.at(times) + self._elbow_sway.at(times))

    def labels(self, times: Float[np.ndarray, " N"]) -> tuple[str, ...]:
        """The label of each time."""
        starts = np.array([start for start, _ in self._labels])
        return tuple(self._labels[i][1] for i in np.searchsorted(starts, times, side="right") - 1)

    def _pick_and_place(self) -> None:
        """A cube to the tray on its side, or to the middle."""
        cube = str(self._rng.choice(["red_cube", "green_cube", "blue_cube"]))
        hand = self._hand_for(cube)
        away = "left_tray" if hand == LEFT else "right_tray"
        place = str(self._rng.choice([away, away, "green_cube"])) if cube != "green_cube" else away
        self._reach({hand: self._within(cube)}, ("Re", "Pi"), instead=self._other_cube(cube, hand))
        self._dwell("Pi", 0.2, 0.5)
        self._reach({hand: self._within(place)}, ("Ca", "Pl"), lift=self._rng.uniform(0.05, 0.14))
        self._dwell("Pl", 0.15, 0.4)
        if self._rng.random() < 0.5:
            self._back(hand)

    def _carry_crate(self) -> None:
        """The crate from one side to the other, with both hands."""
        sides = ["crate_left", "crate_right"]
        if self._rng.random() < 0.5:
            sides.reverse()
        self._reach(self._handles(sides[0]), ("Re", "Pi"))
        self._dwell("Pi", 0.3, 0.7)
        self._reach(self._handles(sides[1]), ("Ca", "Pl"), lift=self._rng.uniform(0.06, 0.2))
        self._dwell("Pl", 0.2, 0.5)
        self._back(LEFT, RIGHT)

    def _touch(self) -> None:
        """One goal after the other, sometimes one with each hand."""
        left, right = ["red_cube", "left_tray"], ["blue_cube", "right_tray"]
        if self._rng.random() < 0.25:
            goals = {LEFT: str(self._rng.choice(left)), RIGHT: str(self._rng.choice(right))}
            self._reach({hand: self._within(goal) for hand, goal in goals.items()}, ("Re", "Re"))
        else:
            goal = str(self._rng.choice([*left, "green_cube", *right]))
            hand = self._hand_for(goal)
            self._reach({hand: self._within(goal)}, ("Re", "Re"), instead=self._other_cube(goal, hand))
            goals = {hand: goal}
        self._dwell("Id", 0.1, 0.4)
        if self._rng.random() < 0.6:
            self._back(*goals)

    def _dwell(self, label: str, low: float, high: float) -> None:
        """Stay for a random time [s]."""
        self._labels.append((self._now, label))
        self._now += self._rng.uniform(low, high)

    def _back(self, *hands: int) -> None:
        """Hands back to where they rest, and mostly a pause."""
        self._reach({hand: self._rest(hand) for hand in hands}, ("Re", "Re"))
        if self._rng.random() < 0.7:
            self._dwell("Id", 0.2, 1.5)

    def _reach(
        self, targets: Targets, labels: tuple[str, str], lift: float | None = None, instead: Point | None = None
    ) -> None:
        """Move one hand or both, trunk and elbows with them.

        `labels` are of the first three quarters, and of the last; `lift` is the height of the via-point [m], a low
        natural arch if None; now and then the hand sets out for `instead` first.
        """
        (first, goal), *_ = targets.items()
        self._labels.append((self._now, labels[0]))
        if instead is not None and self._rng.random() < self._hesitation:
            start, wrong = self._now, self._move({first: instead}, lift)
            self._now += wrong * self._rng.uniform(0.35, 0.6)
            duration = self._move({first: goal}, 0.0, at_least=wrong - (self._now - start) + 0.25)
        else:
            duration = self._move(targets, lift)
        self._labels.append((self._now + 0.75 * duration, labels[1]))
        self._now += duration

    def _move(self, targets: Targets, lift: float | None, at_least: float = SHORTEST) -> float:
        """Start a movement now; its duration [s]."""
        rng = self._rng
        tempo = self._body.tempo * np.exp(np.clip(rng.normal(0.0, 0.12), -0.25, 0.25))
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
            self._hands[hand].move(self._now, duration, target, vias[hand])
        wrists = np.stack([path.target for path in self._hands])
        turn_to = float(np.mean([np.arctan2(target[1], target[0]) for target in targets.values()]))
        following = duration * rng.uniform(1.0, 1.2)  # the trunk arrives a little later
        self._trunk.move(self._now, following, self._posture(wrists, turn_to))
        self._swivel.move(self._now, duration, self._body.swivel + rng.uniform(-0.1, 0.15, 2))
        return duration

    def _posture(self, wrists: Float[np.ndarray, "2 3"], turn_to: float) -> Float[np.ndarray, " 3"]:
        """Lean, twist and tilt [rad]: the least lean that brings both wrists into comfortable reach."""
        lean = np.linspace(0.04, 0.9, 44)
        twist, tilt = 0.3 * turn_to, -0.06 * turn_to
        trunk = Trunk(self._body, np.zeros((44, 2)), lean, np.full(44, twist), np.full(44, tilt))
        ratios = [
            self._body.reach_ratio(trunk.shoulder(side), np.tile(wrist, (44, 1)))
            for side, wrist in zip((1.0, -1.0), wrists, strict=True)
        ]
        excess = np.maximum(np.max(ratios, axis=0), self._body.stretch)
        return np.array([lean[int(np.argmin(excess))], twist, tilt])

    def _rest(self, hand: int) -> Point:
        """Somewhere above the near edge of the table."""
        middle = np.array([0.22, 0.17 if hand == LEFT else -0.17, WRIST_HEIGHT])
        return middle + self._rng.uniform(-1.0, 1.0, 3) * [0.03, 0.03, 0.01]

    def _within(self, goal: str) -> Point:
        """A random point of a goal's region."""
        region: Sphere | Box = self._goals[goal]
        half = np.full(3, region.radius / np.sqrt(3)) if isinstance(region, Sphere) else region.size / 2
        return region.center + self._rng.uniform(-0.9, 0.9, 3) * half

    def _handles(self, crate: str) -> dict[int, Point]:
        """Where both hands hold the crate."""
        middle = self._goals[crate].center + self._rng.uniform(-1.0, 1.0, 3) * [0.04, 0.03, 0.01]
        aside = np.array([0.0, HANDLE, 0.0])
        return {LEFT: middle + aside, RIGHT: middle - aside}

    def _hand_for(self, goal: str) -> int:
        """The hand on the goal's side; the better one in the middle."""
        y = self._goals[goal].center[1]
        if abs(y) > 0.1:
            return LEFT if y > 0 else RIGHT
        return RIGHT if self._body.right_handed else LEFT

    def _other_cube(self, goal: str, hand: int) -> Point:
        """Another cube the same hand could have been after."""
        near = "red_cube" if hand == LEFT else "blue_cube"
        return self._within("green_cube" if goal == near else near)


TASKS: Mapping[str, Callable[[Actor], None]] = {
    "pick_and_place": Actor._pick_and_place,
    "carrying": Actor._carry_crate,
    "reaching": Actor._touch,
}


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
