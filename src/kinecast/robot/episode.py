"""What happened while the arm worked: every control step, every decision, and a picture at every shot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from kinecast.robot.expected_time import TravelTime
from kinecast.types import Decision, RobotState

__all__ = ["Episode", "SceneSnapshot", "Tick"]


@dataclass(frozen=True)
class Tick:
    """One control step, with the truth that only the simulation knows."""

    stamp: float  # [s]
    state: RobotState
    speed: float  # share of the planned one
    distance: float  # true least distance between the arm and a person [m]; inf without one
    required: float  # true S_p at the arm's and the person's true speeds, without errors of measurement [m]
    margin: float  # true least d − S_p [m]
    arm_speed: float  # of the arm's fastest point [m/s]
    measured: float  # distance as the robot knew it [m]
    limit: float  # S_p as the robot knew it [m]


@dataclass(frozen=True, eq=False)
class SceneSnapshot:
    """Everything there is to see at one instant."""

    stamp: float  # [s]
    q: Float[np.ndarray, "6"]  # of the arm [rad]
    people: tuple[tuple[tuple[str, ...], Float[np.ndarray, "J 3"]], ...]  # joints, and where they truly are [m]
    cubes: Mapping[str, Float[np.ndarray, "3"]]  # where they are [m]
    region: Float[np.ndarray, "S T 2 3"]  # predicted wrists [m]; empty where nothing is predicted
    tube: Float[np.ndarray, "C 7"]  # start, end and radius of the occupied capsules half the horizon ahead [m]
    way: Float[np.ndarray, "W 3"]  # of the fingertips over what is planned [m]
    decision: Decision  # in force


@dataclass
class Episode:
    """A run of the simulation."""

    ticks: list[Tick] = field(default_factory=list)  # every control step
    decisions: list[Decision] = field(default_factory=list)  # every one that was new
    scenes: list[SceneSnapshot] = field(default_factory=list)  # one for each shot that arrived
    latencies: list[float] = field(default_factory=list)  # frame in to decision out, less planning beside it [s]
    plannings: list[float] = field(default_factory=list)  # time each plan took [s]
    forecasts: list[tuple[float, TravelTime]] = field(default_factory=list)
    """How long each way to the end of a grasp or a placing took [s], and how long it was to take when begun."""
    placed: dict[str, float] = field(default_factory=dict)  # when each cube stood in its place [s]
    given_up: list[str] = field(default_factory=list)  # cubes that could not be had
    end: float = 0.0  # when it was over [s]
