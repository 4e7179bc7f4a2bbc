"""What happened while the arm worked, and what came of it: every control step and decision, figures, both as JSON."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from kinecast.datasets.summary import runs
from kinecast.output import write_atomically
from kinecast.robot.cell import Cell
from kinecast.robot.expected_time import TravelTime
from kinecast.robot.simulated_person import Person
from kinecast.types import Decision, Reaction, RobotState

MOVES = 0.01  # the arm moves while any point of it does, faster than this [m/s]
LONG_ENOUGH = 0.25  # a standstill on the way is a stop from this duration on [s]
SOON, NEAR = 1.0, 0.27
"""A person did reach for a cube if a wrist came this near to it [m], hand and fingers included, within so long [s]."""
ON_THE_WAY = {RobotState.WAITING, RobotState.STOPPED, RobotState.REPLANNING}
EVERY = 5  # control steps between two rows of the timeline in episode.json: 25 a second


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


@dataclass(frozen=True)
class Outcome:
    """Figures of one episode; NaN where there is nothing to count."""

    result: str  # `done`, or what is missing
    contacts: int  # how often the arm and a person (kinecast.robot.body.TRUE_BODY) touched
    contacts_moving: int  # of these, while the arm moved
    least_distance: float  # between them [m]; inf where nobody came
    violation: float  # time during which the arm moved and the true distance was less than the true S_p [s]
    time_to_done: float  # until the last cube stood in its place, or the episode's end [s]
    stops: int  # standstills on the way, a quarter of a second or longer
    stopped: float  # time spent in them [s]
    replans: int  # changes of cube or path
    false_replans: int  # changes of cube where the person did not reach for the one left within a second
    latency_p50: float  # frame in to decision out, planning beside it not counted [ms]
    latency_p99: float
    planning_p50: float  # of a plan [ms]
    planning_p99: float
    forecasts: int  # how many times of ways were foretold and came out
    forecast_error: float  # median of their relative errors
    forecast_held: float  # share of them within the 90 % interval that was foretold

    def plain(self) -> dict[str, Any]:
        """As `simulate` writes it to outcome.json."""
        simple = ("result", "time_to_done_s", "stops", "stopped_s", "contacts", "contacts_moving", "violation_s",
                  "least_distance_m", "replans", "false_replans")  # fmt: skip
        return {
            **{name: getattr(self, name.removesuffix("_s").removesuffix("_m")) for name in simple},
            "latency_ms": {"p50": self.latency_p50, "p99": self.latency_p99},
            "planning_ms": {"p50": self.planning_p50, "p99": self.planning_p99},
            "forecast": {
                "ways": self.forecasts,
                "median_relative_error": self.forecast_error,
                "within_90_percent": self.forecast_held,
            },
        }


def outcome_of(episode: Episode, people: Sequence[Person], cell: Cell) -> Outcome:
    """Figures of an episode with these people in this cell."""
    rows = [
        (each.stamp, each.distance, each.arm_speed, each.margin, each.state in ON_THE_WAY) for each in episode.ticks
    ]
    stamp, distance, speed, margin, on_the_way = np.array(rows).reshape(-1, 5).T
    dt = float(np.median(np.diff(stamp))) if len(stamp) > 1 else 0.0
    moving, short = speed > MOVES, margin < 0
    waiting = (on_the_way > 0) & ~moving
    stops = [last - first for first, last in runs(waiting) if (last - first) * dt >= LONG_ENOUGH]
    missing = [name for name in cell.order if name not in episode.placed]
    latency, planning = (
        1e3 * np.percentile(seconds or [np.nan], [50, 99]) for seconds in (episode.latencies, episode.plannings)
    )
    errors = [took / time.mean - 1.0 for took, time in episode.forecasts]
    held = [float(time.quantile(0.05) <= took <= time.quantile(0.95)) for took, time in episode.forecasts]
    return Outcome(
        result=f"without {', '.join(missing)}" if missing else "done",
        contacts=len(runs(distance <= 0)),
        contacts_moving=len(runs((distance <= 0) & moving)),
        least_distance=float(distance.min(initial=np.inf)),
        violation=dt * int((short & moving).sum()),
        time_to_done=episode.end if missing else max(episode.placed.values()),
        stops=len(stops),
        stopped=dt * sum(stops),
        replans=sum(each.reaction is not None for each in episode.decisions),
        false_replans=sum(_is_false(each, people, cell) for each in episode.decisions),
        latency_p50=float(latency[0]),
        latency_p99=float(latency[1]),
        planning_p50=float(planning[0]),
        planning_p99=float(planning[1]),
        forecasts=len(episode.forecasts),
        forecast_error=float(np.median(np.abs(errors or [np.nan]))),
        forecast_held=float(np.mean(held or [np.nan])),
    )


def _is_false(decision: Decision, people: Sequence[Person], cell: Cell) -> bool:
    """Whether it changes the cube for nothing."""
    if decision.reaction not in (Reaction.TAKE_ANOTHER, Reaction.CHANGE_CUBE):
        return False
    left = [name for name, chance in decision.taken.items() if chance >= 0.5 and name != decision.target]
    cubes = np.array([cell.cube(name).position for name in left]).reshape(-1, 1, 1, 3)
    for person in people:
        wrists = [joint.endswith("wrist") for joint in person.joints]
        poses = np.stack([person.at(float(time)) for time in decision.stamp + np.linspace(-0.2, SOON, 13)])
        if (np.linalg.norm(poses[:, wrists] - cubes, axis=-1) < NEAR).any():
            return False
    return True


def write_episodes(
    folder: Path, episodes: Mapping[str, tuple[Episode, Outcome]], settings: Mapping[str, object]
) -> None:
    """Writes episodes by name to episode.json, and figures to outcome.json: of several, each in a folder of its name.

    Args:
        folder: of the files.
        episodes: and their figures.
        settings: what was asked for.
    """
    content = {}
    for name, (episode, outcome) in episodes.items():
        content[name] = {
            "outcome": dataclasses.asdict(outcome),
            "placed": episode.placed,
            "given_up": episode.given_up,
            "decisions": [dataclasses.asdict(each) for each in episode.decisions],
            "timeline": [dataclasses.asdict(tick) for tick in episode.ticks[::EVERY]],
        }
        _write((folder if len(episodes) == 1 else folder / name) / "outcome.json", outcome.plain())
    _write(folder / "episode.json", {"settings": settings, "episodes": content})


def _write(path: Path, content: Mapping[str, Any]) -> None:
    write_atomically(path, (json.dumps(_plain(content), indent=1) + "\n").encode())


def _plain(value: Any) -> Any:
    """Names for states, numbers rounded to what they mean; what JSON cannot say (no distance, no time) as null."""
    if isinstance(value, RobotState | Reaction):
        return value.name.lower()
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, float):
        return round(value, 5) if math.isfinite(value) else None
    return value
