"""What came of an episode, in figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from kinecast.datasets.summary import runs
from kinecast.robot.cell import Cell
from kinecast.robot.episode import Episode
from kinecast.robot.person import Person
from kinecast.types import Reaction, RobotState

__all__ = ["Outcome", "outcome_of"]

MOVES = 0.01
"""The arm moves while any point of it does, faster than this [m/s]."""
LONG_ENOUGH = 0.25
"""A standstill on the way is a stop from this duration on [s]."""
SOON, NEAR = 1.0, 0.27
"""A person did reach for a cube if a wrist came this near to it [m], hand and fingers included, within so long [s]."""
NEARLY = 0.2
"""Two steps of the roll-out (kinecast.robot.expected_time.STEP) [s]."""
ON_THE_WAY = {RobotState.WAITING, RobotState.STOPPED, RobotState.REPLANNING}


@dataclass(frozen=True)
class Outcome:
    """Figures of one episode.

    Attributes:
        result: `done`, or what is missing.
        contacts: how often the arm and a person (kinecast.robot.body.TRUE_BODY) touched.
        contacts_moving: of these, while the arm moved.
        least_distance: between them [m]; inf where nobody came.
        violation: time during which the arm moved and the true distance was less than the true S_p [s].
        time_to_done: until the last cube stood in its place, or the episode's end [s].
        stops: standstills on the way, a quarter of a second or longer.
        stopped: time spent in them [s].
        replans: changes of cube or path.
        false_replans: changes of cube where the person did not reach for the one left within a second.
        latency_p50, latency_p99: frame in to decision out, planning beside it not counted [ms].
        planning_p50, planning_p99: of a plan [ms].
        forecasts: how many times of ways were foretold and came out.
        forecast_error: median of their relative errors.
        forecast_held: share of them within the 90 % interval that was foretold, or 0.2 s of it: a control
            step of the roll-out on either side.
    """

    result: str
    contacts: int
    contacts_moving: int
    least_distance: float
    violation: float
    time_to_done: float
    stops: int
    stopped: float
    replans: int
    false_replans: int
    latency_p50: float
    latency_p99: float
    planning_p50: float
    planning_p99: float
    forecasts: int
    forecast_error: float
    forecast_held: float

    def plain(self) -> dict[str, Any]:
        """As `simulate` writes it to outcome.json; what is not finite becomes null."""
        pairs = {
            "latency_ms": (self.latency_p50, self.latency_p99),
            "planning_ms": (self.planning_p50, self.planning_p99),
        }
        return {
            "result": self.result,
            "time_to_done_s": _finite(self.time_to_done),
            "stops": self.stops,
            "stopped_s": _finite(self.stopped),
            "contacts": self.contacts,
            "contacts_moving": self.contacts_moving,
            "violation_s": _finite(self.violation),
            "least_distance_m": _finite(self.least_distance),
            "replans": self.replans,
            "false_replans": self.false_replans,
            **{name: {"p50": _finite(p50), "p99": _finite(p99)} for name, (p50, p99) in pairs.items()},
            "forecast": {
                "ways": self.forecasts,
                "median_relative_error": _finite(self.forecast_error),
                "within_90_percent": _finite(self.forecast_held),
            },
        }


def outcome_of(episode: Episode, people: Sequence[Person], cell: Cell) -> Outcome:
    """Figures of an episode with these people in this cell."""
    ticks = episode.ticks
    stamps = np.array([tick.stamp for tick in ticks])
    dt = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
    distance = np.array([tick.distance for tick in ticks])
    moving = np.array([tick.arm_speed > MOVES for tick in ticks])
    short = np.array([tick.margin < 0 for tick in ticks])
    waiting = np.array([tick.state in ON_THE_WAY and tick.arm_speed <= MOVES for tick in ticks])
    stops = [last - first for first, last in runs(waiting) if (last - first) * dt >= LONG_ENOUGH]
    missing = [name for name in cell.order if name not in episode.placed or name in episode.given_up]
    latency, planning = _percentiles(episode.latencies), _percentiles(episode.plannings)
    return Outcome(
        result=f"without {', '.join(missing)}" if missing else "done",
        contacts=len(runs(distance <= 0)),
        contacts_moving=len(runs((distance <= 0) & moving)),
        least_distance=float(distance.min(initial=np.inf)),
        violation=dt * int((short & moving).sum()),
        time_to_done=episode.end if missing else max(episode.placed.values()),
        stops=len(stops),
        stopped=dt * sum(stops),
        replans=episode.replans,
        false_replans=_false_replans(episode, people, cell),
        latency_p50=latency[0],
        latency_p99=latency[1],
        planning_p50=planning[0],
        planning_p99=planning[1],
        forecasts=len(episode.forecasts),
        forecast_error=float(np.median([abs(took / mean - 1.0) for took, mean, *_ in episode.forecasts] or [np.nan])),
        forecast_held=_held(episode.forecasts),
    )


def _held(forecasts: Sequence[tuple[float, float, float, float]]) -> float:
    """Share of times within their intervals; NaN of nothing."""
    within = [low - NEARLY <= took <= high + NEARLY for took, _, low, high in forecasts]
    return float(np.mean(within)) if within else float("nan")


def _finite(value: float) -> float | None:
    return round(value, 5) if np.isfinite(value) else None


def _percentiles(seconds: Sequence[float]) -> tuple[float, float]:
    """Median and 99th percentile in milliseconds; NaN of nothing."""
    if not seconds:
        return float("nan"), float("nan")
    p50, p99 = 1e3 * np.percentile(seconds, [50, 99])
    return float(p50), float(p99)


def _false_replans(episode: Episode, people: Sequence[Person], cell: Cell) -> int:
    """Changes of cube for nothing."""
    count = 0
    for decision in episode.decisions:
        if decision.reaction not in (Reaction.TAKE_ANOTHER, Reaction.CHANGE_CUBE):
            continue
        left = [name for name, chance in decision.taken.items() if chance >= 0.5 and name != decision.target]
        times = decision.stamp + np.linspace(-0.2, SOON, 13)
        reached = any(_nearest(person, cell, name, float(time)) < NEAR
                      for person in people for name in left for time in times)  # fmt: skip
        count += not reached
    return count


def _nearest(person: Person, cell: Cell, name: str, time: float) -> float:
    """From the nearer wrist to a cube [m]; inf while nobody is there."""
    pose = person.at(time)
    if pose is None:
        return np.inf
    wrists = pose[[joint.endswith("wrist") for joint in person.joints]]
    return float(np.linalg.norm(wrists - cell.cube(name).position, axis=1).min())
