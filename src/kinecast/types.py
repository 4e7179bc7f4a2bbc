"""What goes through kinecast: a frame comes in, a prediction goes out, a robot decides. Read this file first."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float
from numba import njit

from kinecast.errors import OptionError

LIMBS = ((0, 1), (1, 2), (3, 4), (4, 5))
"""Limbs as (start, end) columns of the six arm joints: left upper arm, left forearm, right upper arm, right forearm."""
TAIL = 0.95
"""Tubes of a higher level are reckoned from the samples beyond it."""


class Status(Enum):
    """How far a prediction can be trusted. Anything but OK should make a robot slow down or stop."""

    OK = "The prediction is as good as the model's scores."
    WARMING_UP = "Fewer frames than one observation window so far: keep clear, wait for more."
    LATE = "The frame is older than the newest one or than the allowed delay: check clocks and load."
    REPEATED = "The camera sent the same frame again: the last motion is carried on."
    GAP = "Frames were missing inside the window: velocities are uncertain."
    OCCLUDED = "An arm joint is not seen: its last known place is carried on."
    JUMP = "A joint moved faster than a person can: the tracker has probably slipped."
    IMPLAUSIBLE = "The skeleton is not a person's (bone lengths): check units and tracking."
    BLOCKED = "No sample satisfies the scene: check the scene's frame and the person's calibration."
    UNFAMILIAR = "Nobody in training moved like this: a trivial predictor has done clearly better so far."
    FAULT = "The prediction failed: treat everything the person can reach as occupied."

    @property
    def advice(self) -> str:
        """What it means and what to do, in words."""
        return self.value


@dataclass(frozen=True)
class SkeletonFrame:
    """One person's joints at one instant, as a tracker gives them."""

    stamp: float  # time of acquisition [s], on the same clock for all frames
    joints: tuple[str, ...]  # canonical joint names (kinecast.body.skeleton)
    positions: Float[np.ndarray, "J 3"]  # [m] in a z-up world; NaN where not seen
    person: str = "0"  # the tracker's id of the person
    frame_id: str = "world"  # name of the coordinate frame the positions are in
    std: Float[np.ndarray, " J"] | None = None  # standard deviation of each [m], None where the tracker gives none
    covariance: Float[np.ndarray, "J 3 3"] | None = None  # of each [m²], None where nobody knows more than `std`

    @property
    def valid(self) -> Bool[np.ndarray, " J"]:
        """(J,) True where the joint is seen."""
        return np.isfinite(self.positions).all(axis=-1)


@runtime_checkable
class Density(Protocol):
    """A probability density over the pose of both arms at each predicted step."""

    def log_prob(self, positions: Float[np.ndarray, "T 6 3"]) -> Float[np.ndarray, " T"]:
        """(T,) log density [nats, per m^18] of the six arm joints at each step; NaN where a joint is NaN."""
        ...


@runtime_checkable
class Obstacle(Protocol):
    """Anything with a distance to a line segment (kinecast.geometry.shapes)."""

    def segment_distance(
        self, start: Float[np.ndarray, "*b 3"], end: Float[np.ndarray, "*b 3"]
    ) -> Float[np.ndarray, "*b"]:
        """Signed distance [m] from each segment to the obstacle, above 0 where free."""
        ...


@dataclass(frozen=True)
class Tubes:
    """Capsules, one per step and limb (order of `LIMBS`), each holding the limb with a stated probability."""

    times: Float[np.ndarray, " T"]  # [s]
    start: Float[np.ndarray, "T 4 3"]  # ends of the capsule's axis [m]
    end: Float[np.ndarray, "T 4 3"]
    radius: Float[np.ndarray, "T 4"]  # [m], of the limb's centre line: add the body's thickness
    level: float  # the probability each capsule holds


@dataclass(frozen=True)
class Prediction:
    """Where both arms of one person will be: a distribution over each of the next steps."""

    stamp: float  # acquisition time [s] of the newest frame it rests on
    times: Float[np.ndarray, " T"]  # the predicted instants [s], same clock
    samples: Float[np.ndarray, "S T 6 3"]  # equally likely motions [m]; joints in the order of `joints`
    mean: Float[np.ndarray, "T 6 3"]  # expected positions [m]
    covariance: Float[np.ndarray, "T 6 3 3"]  # of each joint [m²]
    joints: tuple[str, ...]  # names of the six joints
    person: str = "0"  # id of the person
    status: Status = Status.OK  # how far to trust it
    diagnostics: Mapping[str, float] = field(default_factory=dict)  # accepted fraction, effective sample size, …
    density: Density | None = None  # the exact density behind `log_prob`
    goals: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """For the "left" and the "right" hand, the probability that it heads for each goal of the scene, or for "none";
    empty without goals, and for methods that know none."""

    def without_samples(self) -> Prediction:
        """The same without samples and density, so that many can be kept."""
        return replace(self, samples=np.empty((0, *self.samples.shape[1:])), density=None)

    def log_prob(self, positions: Float[np.ndarray, "T 6 3"]) -> Float[np.ndarray, " T"]:
        """(T,) log density [nats] of a pose of the six joints at each step; -inf without a density.

        NaN where a joint of the pose is NaN.
        """
        if self.density is None:
            return np.full(len(self.times), -np.inf)
        return self.density.log_prob(positions)

    def probability_of_hitting(self, obstacle: Obstacle, radius: float = 0.0) -> Float[np.ndarray, " T"]:
        """(T,) probability that any limb touches the obstacle at each step; one that is NaN may be there, so it does.

        Args:
            obstacle: a shape of kinecast.geometry.shapes.
            radius: thickness of the limbs [m], added to their centre lines.
        """
        start, end = _limbs(self.samples)
        unknown = ~np.isfinite(start + end).all(axis=-1)
        return (unknown | (obstacle.segment_distance(start, end) <= radius)).any(axis=-1).mean(axis=0)

    def tubes(self, level: float = 0.95) -> Tubes:
        """Capsules per step and limb which each hold the limb with the given probability.

        A sample's limb lies inside as soon as both its ends lie within the radius of the mean limb's ends, since a
        capsule is convex; the radius is that distance's quantile. Beyond `TAIL` it goes on as an exponential
        distribution of the samples that lie there (peaks over a threshold; Pickands 1975): of some hundred samples none
        tells where one in a thousand is. Level 1 holds every sample.

        Raises:
            OptionError: level outside (0, 1].
        """
        if not 0 < level <= 1:
            raise OptionError(f"level {level} is outside (0, 1]")
        centre = self.samples.mean(axis=0)
        away = _squared_distances(self.samples, centre)
        start, end = np.array(LIMBS).T
        reach = np.maximum(away[:, start], away[:, end])
        held = level if level == 1 else min(level, TAIL)
        last = int(np.ceil(held * (len(self.samples) - 1)))
        farther = np.sqrt(np.partition(reach, last, axis=-1)[..., last:])  # of a NaN all are NaN, since the centre is
        radius = farther[..., 0]
        if held < level:
            radius = radius + (farther.mean(axis=-1) - radius) * np.log((1.0 - held) / (1.0 - level))
        return Tubes(self.times, *_limbs(centre), radius, level)


class RobotState(Enum):
    """What the robot is doing."""

    MOVING = "On its way at full speed."
    GRASPING = "Taking a cube."
    PLACING = "Putting a cube down."
    SLOWED = "On its way, slower than it could: a person is near or about to be."
    WAITING = "Standing until there is something it may do."
    REPLANNING = "Slowing down while another path is sought."
    STOPPED = "Held by the safety distance, or because nobody knows where the person is."
    DONE = "Every cube is in its place, or given up."


class Reaction(Enum):
    """What the robot changed because of a prediction."""

    GO_AROUND = "Same cube, another path, around where the person will be."
    TAKE_ANOTHER = "Another cube first: the person is about to take the next one."
    CHANGE_CUBE = "Another cube and another path in mid-motion: the person is about to take this one."


@dataclass(frozen=True)
class Decision:
    """What the robot does from this instant on, and why."""

    stamp: float  # when it was taken [s], on the clock of the frames
    state: RobotState  # what the robot does
    reason: str  # why, in words
    target: str | None = None  # the cube it is after
    reaction: Reaction | None = None  # what it changed; None where it goes on as before
    speed: float = 1.0  # share of the planned speed, 0..1
    distance: float = float("inf")  # measured from the arm to the nearest person [m]; inf without one
    separation: float = 0.0  # the distance that speed and separation monitoring asks for at this speed [m]
    taken: Mapping[str, float] = field(default_factory=dict)  # per cube, the probability that the person reaches for it
    basis: float = float("-inf")  # stamp of the newest frame it rests on [s]


@njit(cache=True, nogil=True)
@no_type_check
def _squared_distances(
    points: Float[np.ndarray, "S T J 3"], centre: Float[np.ndarray, "T J 3"]
) -> Float[np.ndarray, "T J S"]:
    """Of points from their centre [m²]; with NumPy it would take three times as long, to write all differences down."""
    count, steps, joints, _ = points.shape
    out = np.empty((steps, joints, count))
    for s in range(count):
        for t in range(steps):
            for j in range(joints):
                x = points[s, t, j, 0] - centre[t, j, 0]
                y = points[s, t, j, 1] - centre[t, j, 1]
                z = points[s, t, j, 2] - centre[t, j, 2]
                out[t, j, s] = (x * x + z * z) + y * y  # the order of np.einsum: the same to the last bit
    return out


def _limbs(
    points: Float[np.ndarray, "*b 6 3"],
) -> tuple[Float[np.ndarray, "*b 4 3"], Float[np.ndarray, "*b 4 3"]]:
    """Start and end points of the four limbs."""
    start, end = np.array(LIMBS).T
    return points[..., start, :], points[..., end, :]
