"""Generated people who reach, pick, carry and place at a table, before a tracker: where the truth must be known.

Here: what can be chosen, the scene, what people do and when, and what a tracker makes of them. How they are built and
move is kinecast.datasets.reaching.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import cycle

import numpy as np
from jaxtyping import Float
from scipy.signal import lfilter

from kinecast.datasets.physique import JOINTS, Body
from kinecast.datasets.reaching import LEFT, RIGHT, TABLE, WRIST_HEIGHT, Actor, Point
from kinecast.datasets.recording import Recording
from kinecast.errors import OptionError
from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Box, Sphere

HESITATION = 0.1  # share of reaches that set out for another goal first
HANDLE = 0.13  # from the middle of the crate to each hand [m]

# The tracker, as two HA4M clips show one at 30 Hz
NOISE = 0.0015
"""Standard deviation of each coordinate of the trunk [m]; 1.5 times as much at elbows and wrists. HA4M: 1.3 mm at the
neck to 2.4 mm at a wrist, from third differences."""
BREATHING, BREATHING_TIME = 0.04, 0.83
"""Standard deviation of the one factor by which all bones grow and shrink together (HA4M: 0.043 and 0.039), and its
correlation time [s] (HA4M: 0.96, 0.67, 0.26 after 1, 10, 30 frames)."""
REPEATED = 0.025  # share of frames that repeat the one before; HA4M: 0.028 and 0.023
JUMPS = 0.15  # tracker jumps per second; HA4M: 20 in 80 s, 10 in 88 s
LARGEST_JUMP = 24.0  # fastest tracker jump [m/s], HA4M V001
SWAPPED = 0.3  # share of jumps that exchange left and right for a moment; HA4M V001 at 34.1 s
DROPOUTS = 0.01  # share of frames in which an arm is lost; Vicon: up to 5 %
LOST_FRAMES = 5.0  # mean length of a dropout, in frames

RANGES = {"subjects": (1, 10_000), "recordings": (1, 10_000), "duration": (0.1, 3600.0), "rate": (1.0, 1000.0)}


@dataclass(frozen=True)
class SyntheticOptions:
    """Options of `generate`; an OptionError outside `RANGES`."""

    subjects: int = 4  # how many people, each with an own build, tempo and handedness
    recordings: int = 3  # per person; the tasks pick_and_place, carrying, reaching take turns
    duration: float = 20.0  # of each recording [s]
    rate: float = 30.0  # frames per second [Hz]

    def __post_init__(self) -> None:
        for name, (low, high) in RANGES.items():
            if not low <= (value := getattr(self, name)) <= high:
                raise OptionError(f"{name} {value} is outside {low}..{high}")


def table_scene() -> Scene:
    """The table as a slab, and where a wrist is when its hand is at each cube, tray or side of the crate.

    People stand at the origin and look along x.
    """
    thickness = 0.04
    top = Box(np.array([0.55, 0.0, TABLE - thickness / 2]), np.array([0.76, 1.6, thickness]))
    goals: dict[str, Sphere | Box] = {
        name: Sphere(np.array([x, y, WRIST_HEIGHT + 0.01]), 0.05)
        for name, x, y in (("red_cube", 0.42, 0.24), ("green_cube", 0.45, 0.0), ("blue_cube", 0.42, -0.24))
    }
    for name, y in (("left_tray", 0.42), ("right_tray", -0.42)):
        goals[name] = Box(np.array([0.3, y, WRIST_HEIGHT + 0.02]), np.array([0.14, 0.2, 0.04]))
    for name, y in (("crate_left", 0.16), ("crate_right", -0.16)):
        goals[name] = Box(np.array([0.36, y, WRIST_HEIGHT + 0.03]), np.array([0.1, 0.36, 0.04]))
    return Scene((top,), goals)


def generate(options: SyntheticOptions, seed: int) -> list[Recording]:
    """People at a table as a tracker sees them: noise, jumps, dropouts, repeated frames, breathing bones.

    Returns:
        `options.subjects` × `options.recordings` recordings with labels, subject and task; frame by frame the
        motions of `generate_clean` with the same options and seed.
    """
    return [_sensed(truth, np.random.default_rng(sensor)) for truth, sensor in _performances(options, seed)]


def generate_clean(options: SyntheticOptions, seed: int) -> list[Recording]:
    """The true motions behind `generate`: constant bones, no noise, nothing missing.

    Arms keep clear of the table, of their joints' limits and of impossible speeds.
    """
    return [truth for truth, _ in _performances(options, seed)]


def _performances(options: SyntheticOptions, seed: int) -> list[tuple[Recording, np.random.SeedSequence]]:
    """Each true recording, and the seed of its sensor."""
    scene = table_scene()
    stamps = np.arange(max(1, round(options.duration * options.rate))) / options.rate
    performances = []
    for subject, person in enumerate(np.random.SeedSequence(seed).spawn(options.subjects)):
        build, *takes = person.spawn(1 + options.recordings)
        body = Body.sample(np.random.default_rng(build))
        for take, (task, source) in enumerate(zip(cycle(TASKS), takes, strict=False)):
            motion, sensor = source.spawn(2)
            worker = Worker(body, scene, np.random.default_rng(motion))
            worker.perform(task, options.duration)
            truth = Recording(
                name=f"synthetic/{task}/{subject}-{take}",
                joints=JOINTS,
                stamps=stamps,
                positions=worker.joints(stamps),
                rate=options.rate,
                subject=f"synthetic-{subject}",
                task=task,
                labels=worker.labels_at(stamps),
                notes=("generated",),
            )
            performances.append((truth, sensor))
    return performances


class Worker(Actor):
    """One person in one recording, who performs a task.

    Labels are those of the AnDy data: Re reaching (an empty hand moves), Pi picking, Ca carrying, Pl placing,
    Id idle. The last quarter of the movement to an object or to its place belongs to Pi or Pl.
    """

    def __init__(self, body: Body, scene: Scene, rng: np.random.Generator) -> None:
        super().__init__(body, rng)
        self._goals, self._labels = scene.goals, [(0.0, "Id")]

    def perform(self, task: str, duration: float) -> None:
        """Does one of `TASKS` over and over until the time [s] is up."""
        self._stay("Id", 0.2, 1.0)
        while self.now < duration:
            TASKS[task](self)

    def labels_at(self, times: Float[np.ndarray, " N"]) -> tuple[str, ...]:
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
        self._stay("Pi", 0.2, 0.5)
        self._reach({hand: self._within(place)}, ("Ca", "Pl"), lift=self._rng.uniform(0.05, 0.14))
        self._stay("Pl", 0.15, 0.4)
        if self._rng.random() < 0.5:
            self._back(hand)

    def _carry_crate(self) -> None:
        """The crate from one side to the other, with both hands."""
        sides = ["crate_left", "crate_right"]
        if self._rng.random() < 0.5:
            sides.reverse()
        self._reach(self._handles(sides[0]), ("Re", "Pi"))
        self._stay("Pi", 0.3, 0.7)
        self._reach(self._handles(sides[1]), ("Ca", "Pl"), lift=self._rng.uniform(0.06, 0.2))
        self._stay("Pl", 0.2, 0.5)
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
        self._stay("Id", 0.1, 0.4)
        if self._rng.random() < 0.6:
            self._back(*goals)

    def _stay(self, label: str, low: float, high: float) -> None:
        """Stays for a random time [s]."""
        self._labels.append((self.now, label))
        self.dwell(low, high)

    def _back(self, *hands: int) -> None:
        """Hands back to where they rest, and mostly a pause."""
        self._reach({hand: self.rest(hand) for hand in hands}, ("Re", "Re"))
        if self._rng.random() < 0.7:
            self._stay("Id", 0.2, 1.5)

    def _reach(
        self,
        targets: Mapping[int, Point],
        labels: tuple[str, str],
        lift: float | None = None,
        instead: Point | None = None,
    ) -> None:
        """Move one hand or both, trunk and elbows with them.

        `labels` are of the first three quarters, and of the last; `lift` is the height of the via-point [m], a low
        natural arch if None; now and then the hand sets out for `instead` first.
        """
        (first, goal), *_ = targets.items()
        self._labels.append((self.now, labels[0]))
        if instead is not None and self._rng.random() < HESITATION:
            start, wrong = self.now, self.move({first: instead}, lift)
            self.now += wrong * self._rng.uniform(0.35, 0.6)
            duration = self.move({first: goal}, 0.0, at_least=wrong - (self.now - start) + 0.25)
        else:
            duration = self.move(targets, lift)
        self._labels.append((self.now + 0.75 * duration, labels[1]))
        self.now += duration

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
        return RIGHT if self.body.right_handed else LEFT

    def _other_cube(self, goal: str, hand: int) -> Point:
        """Another cube the same hand could have been after."""
        near = "red_cube" if hand == LEFT else "blue_cube"
        return self._within("green_cube" if goal == near else near)


TASKS: Mapping[str, Callable[[Worker], None]] = {
    "pick_and_place": Worker._pick_and_place,
    "carrying": Worker._carry_crate,
    "reaching": Worker._touch,
}


def _sensed(truth: Recording, rng: np.random.Generator) -> Recording:
    """A recording as a depth camera and its skeleton tracker would have made it."""
    chest = truth.positions[:, JOINTS.index("chest"), None]
    factor = 1.0 + BREATHING * _breathing(rng, len(chest), truth.rate)
    positions = chest + factor[:, None, None] * (truth.positions - chest)
    spread = NOISE * np.array([1.5 if "elbow" in name or "wrist" in name else 1.0 for name in JOINTS])
    positions += rng.normal(0.0, 1.0, positions.shape) * spread[:, None]
    _jump(rng, positions, truth.rate)
    _lose(rng, positions)
    for frame in np.flatnonzero(rng.random(len(positions) - 1) < REPEATED) + 1:
        positions[frame] = positions[frame - 1]
    return replace(truth, positions=positions, notes=("generated, with a simulated tracker",))


def _breathing(rng: np.random.Generator, frames: int, rate: float) -> Float[np.ndarray, " N"]:
    """(N,) first-order autoregression of standard deviation 1, cut at 2.5."""
    rho = np.exp(-1.0 / (BREATHING_TIME * rate))
    innovations = rng.normal(0.0, np.sqrt(1.0 - rho**2), frames)
    innovations[0] = rng.normal()
    return np.asarray(np.clip(lfilter([1.0], [1.0, -rho], innovations), -2.5, 2.5))


def _jump(rng: np.random.Generator, positions: Float[np.ndarray, "N 10 3"], rate: float) -> None:
    """For one to three frames an arm is somewhere else, or left is right (in place)."""
    frames = len(positions)
    for _ in range(rng.poisson(JUMPS * frames / rate)):
        start = int(rng.integers(frames))
        slip = slice(start, start + int(rng.integers(1, 4)))
        if rng.random() < SWAPPED:
            positions[slip, :6] = positions[slip, [3, 4, 5, 0, 1, 2]]
            continue
        first = int(rng.choice([1, 2, 2, 4, 5, 5]))  # an elbow with its wrist, or a wrist alone
        direction = rng.normal(size=3)
        far = min(rng.exponential(0.2) + 0.08, 0.9 * LARGEST_JUMP / rate)
        positions[slip, first : 3 * (first // 3) + 3] += far * direction / np.linalg.norm(direction)


def _lose(rng: np.random.Generator, positions: Float[np.ndarray, "N 10 3"]) -> None:
    """Runs of frames without a wrist, or without wrist and elbow (in place)."""
    for end in (3, 6):
        starts = np.flatnonzero(rng.random(len(positions)) < DROPOUTS / LOST_FRAMES)
        for start, length in zip(starts, rng.geometric(1.0 / LOST_FRAMES, len(starts)), strict=True):
            positions[start : start + length, end - int(rng.integers(1, 3)) : end] = np.nan
