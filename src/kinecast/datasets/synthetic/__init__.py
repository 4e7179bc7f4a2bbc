"""Generated people at a table: used where no recording can be shipped, and where the truth must be known.

Here: what can be chosen, the scene, and what a tracker makes of the people. physique: how a person is built and posed.
activity: what people do, when, and on which paths.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import cycle

import numpy as np
from jaxtyping import Float
from scipy.signal import lfilter

from kinecast.datasets.recording import Recording
from kinecast.datasets.synthetic.activity import LEFT, RIGHT, TABLE, TASKS, WRIST_HEIGHT, Actor
from kinecast.datasets.synthetic.physique import JOINTS, Body
from kinecast.errors import OptionError
from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Box, Sphere

HESITATION = 0.1  # share of reaches that set out for another goal first

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


@dataclass(frozen=True, eq=False)
class Fetch:
    """One reach."""

    start: float  # when it begins [s]
    place: Float[np.ndarray, "3"]  # of the wrist, in the person's frame: on the floor, x forward, z up [m]
    hold: float = 1.0  # how long the hand stays there [s]
    left: bool | None = None  # with which hand; None for the one on the place's side


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
            actor = Actor(body, scene, np.random.default_rng(motion), HESITATION)
            actor.perform(task, options.duration)
            performances.append((_recorded(actor, stamps, options.rate, f"{subject}-{take}", subject, task), sensor))
    return performances


def fetching(fetches: Sequence[Fetch], duration: float, seed: int, rate: float = 100.0) -> Recording:
    """The true motion of somebody at a table who reaches for places one after the other.

    Args:
        fetches: in order of their starts; one that begins before the last has ended waits for it.
        duration: [s].
        seed: of the build, the tempo and the way they move.
        rate: frames per second [Hz].

    Raises:
        OptionError: a duration or rate that is not above 0.
    """
    if not (duration > 0 and rate > 0):
        raise OptionError(f"duration {duration} s and rate {rate} Hz must be above 0")
    build, motion = np.random.SeedSequence(seed).spawn(2)
    actor = Actor(Body.sample(np.random.default_rng(build)), table_scene(), np.random.default_rng(motion))
    for fetch in fetches:
        left = fetch.place[1] > 0 if fetch.left is None else fetch.left
        actor.fetch(fetch.start, fetch.place, LEFT if left else RIGHT, fetch.hold)
    stamps = np.arange(max(2, round(duration * rate))) / rate
    return _recorded(actor, stamps, rate, str(seed), seed, "fetching")


def _recorded(
    actor: Actor, stamps: Float[np.ndarray, " N"], rate: float, name: str, subject: int, task: str
) -> Recording:
    return Recording(
        name=f"synthetic/{task}/{name}",
        joints=JOINTS,
        stamps=stamps,
        positions=actor.joints(stamps),
        rate=rate,
        subject=f"synthetic-{subject}",
        task=task,
        labels=actor.labels(stamps),
        notes=("generated",),
    )


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
