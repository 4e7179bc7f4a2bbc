"""What happened while the arm worked: every control step, every decision, and a picture at every shot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from kinecast.types import Decision, RobotState

__all__ = ["Episode", "SceneSnapshot", "Tick"]


@dataclass(frozen=True)
class Tick:
    """One control step, with the truth that only the simulation knows.

    Attributes:
        stamp: [s].
        state: of the robot; speed: share of the planned one.
        distance: true least distance between the arm and a person [m]; inf without one.
        required: true S_p at the arm's and the person's true speeds, without errors of measurement [m].
        margin: true least d − S_p [m].
        arm_speed: of the arm's fastest point [m/s].
        measured: distance as the robot knew it [m].
        limit: S_p as the robot knew it [m].
    """

    stamp: float
    state: RobotState
    speed: float
    distance: float
    required: float
    margin: float
    arm_speed: float
    measured: float
    limit: float


@dataclass(frozen=True, eq=False)
class SceneSnapshot:
    """Everything there is to see at one instant.

    Attributes:
        stamp: [s].
        q: (6,) of the arm [rad].
        people: names of joints and where they truly are (J, 3) [m], of each.
        cubes: where they are [m].
        region: (S, T, 2, 3) predicted wrists [m]; empty where nothing is predicted.
        tube: (C, 7) start, end and radius of the occupied capsules half the horizon ahead [m].
        way: (W, 3) of the fingertips over what is planned [m]; empty without a plan.
        decision: in force.
    """

    stamp: float
    q: Float[np.ndarray, "6"]
    people: tuple[tuple[tuple[str, ...], Float[np.ndarray, "J 3"]], ...]
    cubes: Mapping[str, Float[np.ndarray, "3"]]
    region: Float[np.ndarray, "S T 2 3"]
    tube: Float[np.ndarray, "C 7"]
    way: Float[np.ndarray, "W 3"]
    decision: Decision


@dataclass
class Episode:
    """A run of the simulation.

    Attributes:
        ticks: every control step.
        decisions: every one that was new.
        scenes: one for each shot that arrived.
        latencies: frame in to decision out, planning beside it not counted [s].
        plannings: time each plan took [s].
        replans: reactions that changed cube or path.
        forecasts: of each way to the end of a grasp or a placing: how long it took, how long it was expected to take,
            and the 5 and 95 % quantiles of that [s].
        placed: when each cube stood in its place [s].
        given_up: cubes that could not be had.
        end: when it was over [s].
    """

    ticks: list[Tick] = field(default_factory=list)
    decisions: list[Decision] = field(default_factory=list)
    scenes: list[SceneSnapshot] = field(default_factory=list)
    latencies: list[float] = field(default_factory=list)
    plannings: list[float] = field(default_factory=list)
    replans: int = 0
    forecasts: list[tuple[float, float, float, float]] = field(default_factory=list)
    placed: dict[str, float] = field(default_factory=dict)
    given_up: tuple[str, ...] = ()
    end: float = 0.0
