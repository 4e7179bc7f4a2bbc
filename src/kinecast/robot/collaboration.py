"""Episodes of the arm beside a person: who comes, what predicts them, and what came of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from kinecast.datasets.recording import Recording
from kinecast.datasets.repair import repair
from kinecast.datasets.synthetic import Fetch, fetching
from kinecast.errors import OptionError
from kinecast.geometry.transforms import inverse
from kinecast.prediction.method import Method
from kinecast.prediction.methods import read_method, shipped_methods
from kinecast.prediction.model_file import ModelCard
from kinecast.prediction.plugins import is_plugin
from kinecast.predictor import Predictor, PredictorOptions
from kinecast.robot.camera import Camera, CameraOptions
from kinecast.robot.cell import Cell, standing_at
from kinecast.robot.person import Person, PlayedPerson, ReactivePerson
from kinecast.robot.simulation import Predict, Simulation
from kinecast.robot.supervisor import SupervisorOptions
from kinecast.types import Prediction, SkeletonFrame, Status

__all__ = [
    "PREDICTORS",
    "SCENARIOS",
    "UNSCRIPTED",
    "Forecasters",
    "Scenario",
    "forth_and_back",
    "generated_person",
    "oracle",
    "replayed_person",
    "scripted_person",
    "simulate_scenario",
]

PREDICTORS = ("kinecast", "gp_constrained", "damped_velocity", "zero_velocity", "reachable", "oracle", "none")
"""What can predict the person: shipped methods; all they can reach; the truth; nothing."""

DT, STEPS = 1 / 30, 15
"""Of predictions that no method makes."""
PALM = 0.09
"""A wrist is this far above a cube that its hand takes [m]."""


@dataclass(frozen=True)
class Scenario:
    """A scripted person.

    Attributes:
        about: what it shows, in words.
        fetches: cube, start [s] and hold [s] of each reach.
        left: with which hand.
    """

    about: str
    fetches: tuple[tuple[str, float, float], ...]
    left: bool = False


SCENARIOS = {
    "avoid": Scenario(
        "The robot is to take red; the person reaches for blue, across its way: the same cube, around the person.",
        (("blue", 0.8, 1.5),),
        left=True,
    ),
    "reorder": Scenario(
        "Green is next, but the person is predicted to take it: blue first, green once it is free.",
        (("green", 6.3, 3.0),),
    ),
    "replan": Scenario(
        "The robot is on its way to green when the person reaches for it: blue instead, in mid-motion.",
        (("green", 9.7, 3.0),),
    ),
}
"""The paper's three demonstrations."""
UNSCRIPTED = "none"
"""An episode beside somebody who does what they would, and minds the arm."""


def scripted_person(scenario: Scenario, seed: int, cell: Cell, duration: float = 30.0) -> PlayedPerson:
    """Somebody who reaches for the scenario's cubes at its times."""
    fetches = [
        Fetch(start, _wrist_at(cell.cube(name).position, cell.person), hold, scenario.left)
        for name, start, hold in scenario.fetches
    ]
    return _played(fetching(fetches, duration, seed), cell.person)


def generated_person(seed: int, cell: Cell, duration: float = 125.0) -> PlayedPerson:
    """Somebody who reaches now for a cube, now for another place on the table, and rests between."""
    rng = np.random.default_rng([seed, 1])
    placement = standing_at(float(cell.person[0, 3] + rng.uniform(-0.05, 0.05)), float(rng.uniform(-0.12, 0.12)))
    now, fetches = float(rng.uniform(0.2, 2.0)), []
    while now < duration:
        if rng.random() < 0.75:
            place = cell.cube(str(rng.choice(cell.order))).position + rng.uniform(-0.02, 0.02, 3) * [1, 1, 0]
        else:
            place = np.array([rng.uniform(0.55, 0.75), rng.uniform(-0.4, 0.4), cell.cubes[0].position[2]])
        hold = float(rng.uniform(0.3, 1.8))
        fetches.append(Fetch(now, _wrist_at(place, placement), hold))
        now += hold + float(rng.uniform(2.0, 5.0))
    return _played(fetching(fetches, duration, seed), placement)


def replayed_person(recording: Recording, cell: Cell, start: float = 0.0) -> PlayedPerson:
    """A recorded person, so placed that they come as near as somebody who stands at the table, and look at the arm.

    Nine tenths of the time they are no nearer: who walks up to the table ends where others stand.

    Jumps of the tracking (kinecast.datasets.repair) are no motion: a shoulder that is half a metre away for one frame
    would be a person whom no arm can keep its distance from.

    Args:
        recording: of one person, z up [m].
        cell: where they are to stand.
        start: of the part that is played, from the recording's beginning [s].

    Raises:
        OptionError: the shoulders are never seen.
    """
    recording, _ = repair(recording)
    left, right = recording.joint("left_shoulder"), recording.joint("right_shoulder")
    seen = np.isfinite(left + right).all(axis=1)
    if not seen.any():
        raise OptionError(f"{recording.name}: no frame shows both shoulders")
    across = np.median((left - right)[seen], axis=0)
    middle = np.median((left + right)[seen] / 2, axis=0)
    yaw = math.atan2(-across[0], across[1])  # left of the person is +y
    stand = np.eye(4)
    stand[:2, :2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
    # Shoulders of a standing adult are 1.4 m above the floor; recordings do not say where theirs is.
    ahead = ((left + right)[seen] / 2 - middle) @ stand[:3, 0]
    stand[:3, 3] = middle + np.quantile(ahead, 0.9) * stand[:3, 0] - [0.0, 0.0, 1.4]
    kept = recording.stamps - recording.stamps[0] >= start
    stamps = recording.stamps[kept] - recording.stamps[0] - start
    placement = cell.person @ inverse(stand)
    return PlayedPerson(recording.person, recording.joints, stamps, recording.positions[kept], placement)


def forth_and_back(person: PlayedPerson, duration: float = 60.0) -> PlayedPerson:
    """Somebody who, at the end of what was recorded, does it backwards, and so on for so long [s]."""
    since = person.stamps - person.stamps[0]
    if len(since) < 2:
        return person
    turns = math.ceil(duration / since[-1])
    parts, times = [person.positions[:1]], [since[:1]]
    for turn in range(turns):
        way = slice(1, None) if turn % 2 == 0 else slice(-2, None, -1)
        parts.append(person.positions[way])
        times.append(turn * since[-1] + (since[1:] if turn % 2 == 0 else since[-1] - since[-2::-1]))
    return PlayedPerson(
        person.name, person.joints, np.concatenate(times), np.concatenate(parts), person.placement, person.present
    )


def _wrist_at(place: Float[np.ndarray, "3"], placement: Float[np.ndarray, "4 4"]) -> np.ndarray:
    """Where a wrist is, in the person's frame, whose hand is at a place on the table."""
    there = np.append(place + np.array([0.0, 0.0, PALM - 0.025]), 1.0)
    wrist: np.ndarray = (inverse(placement) @ there)[:3]
    return wrist


def _played(recording: Recording, placement: Float[np.ndarray, "4 4"]) -> PlayedPerson:
    return PlayedPerson("0", recording.joints, recording.stamps, recording.positions, placement)


class Forecasters:
    """Makes predictors by name; the shipped models are read once.

    Args:
        samples: drawn per prediction.
    """

    def __init__(self, samples: int = 200) -> None:
        self._options = PredictorOptions(samples=samples)
        self._card, self._methods = shipped_methods()
        self._outside: dict[str, tuple[ModelCard, Method[Any]]] = {}

    def make(self, name: str, people: Sequence[Person]) -> Predict:
        """A predictor that has seen nothing yet.

        Args:
            name: one of PREDICTORS, or MODULE:FUNCTION that gives a trained method.
            people: the truth, for the oracle.

        Raises:
            OptionError: another name.
            ModelError: what the function gives is no method.
        """
        if is_plugin(name):
            if name not in self._outside:
                self._outside[name] = read_method(Path(name))
            card, method = self._outside[name]
            return Predictor(method, card.noise, None, self._options).observe
        if name in self._methods:
            return Predictor(self._methods[name], self._card.noise, None, self._options).observe
        if name == "reachable":
            return _reachable
        if name == "oracle":
            return oracle(people)
        if name == "none":
            return lambda _frame, _now: None
        raise OptionError(f"predictor {name!r} is none of {', '.join(PREDICTORS)}")


ARMS = ("left_shoulder", "left_elbow", "left_wrist", "right_shoulder", "right_elbow", "right_wrist")


def _arms(frame: SkeletonFrame) -> Float[np.ndarray, "6 3"]:
    places = dict(zip(frame.joints, frame.positions, strict=True))
    return np.stack([places[name] for name in ARMS])


def _stated(frame: SkeletonFrame, times: Float[np.ndarray, " T"], poses: np.ndarray, status: Status) -> Prediction:
    """A prediction of one motion."""
    covariance = np.zeros((len(times), 6, 3, 3))
    return Prediction(frame.stamp, times, poses[None], poses, covariance, ARMS, frame.person, status)


def _reachable(frame: SkeletonFrame, now: float) -> Prediction:
    """Nothing but where the person is: the arm's side takes all they can reach."""
    times = now + DT * np.arange(1, STEPS + 1)
    return _stated(frame, times, np.repeat(_arms(frame)[None], STEPS, axis=0), Status.WARMING_UP)


def oracle(people: Sequence[Person]) -> Predict:
    """Predicts what will truly happen."""
    by_name = {person.name: person for person in people}

    def predict(frame: SkeletonFrame, now: float) -> Prediction:
        person = by_name[frame.person]
        rows = [person.joints.index(name) for name in ARMS]
        times = now + DT * np.arange(1, STEPS + 1)
        poses = [person.at(float(time)) for time in times]
        last = person.at(frame.stamp)
        whole = np.stack([last if pose is None else pose for pose in poses])  # type: ignore[misc]
        return _stated(frame, times, whole[:, rows], Status.OK)

    return predict


def simulate_scenario(
    name: str,
    predictor: str,
    seed: int,
    forecasters: Forecasters,
    person: Person | None = None,
    options: SupervisorOptions | None = None,
    cell: Cell | None = None,
) -> Simulation:
    """One of SCENARIOS, or `none`, ready to run.

    Args:
        name: of the scenario; `none`: nobody has a script, a generated person does what people do at a table.
        predictor: one of PREDICTORS, or MODULE:FUNCTION that gives a trained method.
        seed: of the person and the camera.
        forecasters: makes the predictor.
        person: instead of the scripted one.
        options: how the foreman decides.
        cell: where; the default one.

    Raises:
        OptionError: no such scenario or predictor.
    """
    if name not in (*SCENARIOS, UNSCRIPTED):
        raise OptionError(f"scenario {name!r} is none of {', '.join(SCENARIOS)}, {UNSCRIPTED}")
    cell = cell or Cell()
    if person is None:
        generated = name == UNSCRIPTED
        person = generated_person(seed, cell) if generated else scripted_person(SCENARIOS[name], seed, cell)
    if name == UNSCRIPTED and isinstance(person, PlayedPerson):
        person = ReactivePerson(person)
    camera = Camera(CameraOptions(delay=cell.delay, seed=seed))
    return Simulation([person], forecasters.make(predictor, [person]), camera, cell, options)
