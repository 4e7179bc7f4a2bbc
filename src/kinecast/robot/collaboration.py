"""Episodes of the arm beside a person: who comes, what predicts them, and the simulation of both."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.ndimage import maximum_filter1d
from scipy.signal import butter, filtfilt

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.datasets.reaching import Fetch, fetching
from kinecast.datasets.recording import Recording
from kinecast.datasets.repair import repair
from kinecast.errors import OptionError
from kinecast.geometry.transforms import apply, inverse, rotation_z, transform
from kinecast.prediction.methods import SHIPPED, read_method, read_shipped
from kinecast.prediction.plugins import is_plugin
from kinecast.predictor import Predictor, PredictorOptions
from kinecast.robot.cell import Cell, Cube, standing_at
from kinecast.robot.simulated_person import Camera, Person, PlayedPerson, ReactivePerson
from kinecast.robot.simulation import Predict, Simulation
from kinecast.types import Prediction, SkeletonFrame, Status

PREDICTORS = ("kinecast", "gp_constrained", "damped_velocity", "zero_velocity", "reachable", "oracle", "none")
"""What can predict the person: shipped methods; all they can reach; the truth; nothing."""
SAMPLES = 200  # drawn per prediction
DT, STEPS = 1 / 30, 15  # of predictions that no method makes
HORIZON = DT * STEPS
"""Of shipped methods [s]: their whole second gains nothing here (docs/decisions/0029-one-second.md)."""
SMOOTH = 6.0
"""What limbs do lies below this frequency [Hz], above it is the tracker's noise (D. A. Winter, Biomechanics and Motor
Control of Human Movement, 2009, 3.4.4: cut-offs of 4 to 8 Hz)."""
HARDEST = 30.0
"""No joint of somebody at a table gains speed faster [m/s²]. Of wrists that markers tell, as smooth, 0.01 % of 38,000
frames do (human_robot_animations), of those that a camera tells 1 %: that is the tracker."""
BRIDGED, PASSES = 0.1, 10  # so long before and after it a joint is bridged [s], and so much longer each time again
PALM = 0.09  # a wrist is this far above a cube that its hand takes [m]


@dataclass(frozen=True)
class Scenario:
    """A scripted person."""

    about: str  # what it shows, in words
    fetches: tuple[tuple[str, float, float], ...]  # cube, start and hold [s] of each; without any they do as they would
    left: bool = False  # with which hand


SCENARIOS = {
    "avoid": Scenario(
        "The robot is to take red; the person reaches for blue, across its way: the same cube, around the person.",
        (("blue", 0.8, 1.5),),
        left=True,
    ),
    "reorder": Scenario(
        "Green is next, but the person is predicted to take it: blue first, green once it is free.",
        (("green", 7.5, 3.0),),
    ),
    "replan": Scenario(
        "The robot is on its way to green when the person reaches for it: blue instead, in mid-motion.",
        (("green", 9.7, 3.0),),
    ),
    "none": Scenario("A person who does what they would at a table.", ()),
}
"""The paper's three demonstrations, and a person without a script."""


def generated_person(seed: int, cell: Cell) -> PlayedPerson:
    """Somebody who reaches now for a cube, now for another place on the table, and rests between."""
    rng, duration = np.random.default_rng([seed, 1]), 125.0
    placement = standing_at(float(cell.person[0, 3] + rng.uniform(-0.05, 0.05)), float(rng.uniform(-0.12, 0.12)))
    now, reaches = float(rng.uniform(0.2, 2.0)), []
    while now < duration:
        if rng.random() < 0.75:
            place = cell.cube(str(rng.choice(cell.order))).position + rng.uniform(-0.02, 0.02, 3) * [1, 1, 0]
        else:
            place = np.array([rng.uniform(0.55, 0.75), rng.uniform(-0.4, 0.4), cell.cubes[0].position[2]])
        hold = float(rng.uniform(0.3, 1.8))
        reaches.append((now, place, hold))
        now += hold + float(rng.uniform(2.0, 5.0))
    return _reaching(reaches, placement, duration, seed)


def replayed_person(recording: Recording, cell: Cell) -> PlayedPerson:
    """A recorded person, so placed that they come as near as somebody who stands at the table, and look at the arm.

    Nine tenths of the time they are no nearer: who walks up to the table ends where others stand.

    Jumps of the tracking (kinecast.datasets.repair) are no motion, nor is what lies above `SMOOTH` or `HARDEST`: a hand
    that comes at 3 m/s from one frame to the next would be a person whom no arm can keep its distance from.

    Args:
        recording: of one person, z up [m].
        cell: where they are to stand.

    Raises:
        OptionError: the shoulders are never seen.
    """
    recording = repair(recording)
    left, right = recording.joint("left_shoulder"), recording.joint("right_shoulder")
    seen = np.isfinite(left + right).all(axis=1)
    if not seen.any():
        raise OptionError(f"{recording.name}: no frame shows both shoulders")
    left, right = left[seen], right[seen]
    across, middle = np.median(left - right, axis=0), np.median((left + right) / 2, axis=0)
    turn = rotation_z(math.atan2(-across[0], across[1]))  # left of the person is +y
    ahead = np.quantile(((left + right) / 2 - middle) @ turn[:, 0], 0.9)
    # Shoulders of a standing adult are 1.4 m above the floor; recordings do not say where theirs is.
    stand = transform(turn, middle + ahead * turn[:, 0] - [0.0, 0.0, 1.4])
    person = _placed(recording, cell.person @ inverse(stand), recording.person)
    rate = 1.0 / float(np.median(np.diff(person.stamps))) if len(person.stamps) > 1 else 0.0
    return person if rate < 3 * SMOOTH or len(person.stamps) < 20 else _as_people_move(person, rate)


def _as_people_move(person: PlayedPerson, rate: float) -> PlayedPerson:
    """Smooth, and no joint beyond `HARDEST`: around such an instant it is bridged, more widely if that did not do."""
    low_pass, smooth = butter(2, SMOOTH, fs=rate), person
    for wide in range(1, 1 + PASSES):
        seen = np.isfinite(person.positions)  # a joint that is never seen is NaN throughout
        track = filtfilt(*low_pass, np.where(seen, person.positions, 0.0), axis=0)
        smooth = replace(person, positions=np.where(seen, track, np.nan))
        hard = np.linalg.norm(np.diff(track, n=2, axis=0), axis=2) * rate**2 > HARDEST
        if not hard.any():
            break
        torn = maximum_filter1d(np.pad(hard, ((1, 1), (0, 0))), 2 * round(wide * BRIDGED * rate) + 1, axis=0)
        person = replace(person, positions=np.where(torn[..., None], np.nan, person.positions))
    return smooth


def _reaching(
    reaches: Sequence[tuple[float, np.ndarray, float]],
    placement: Float[np.ndarray, "4 4"],
    duration: float,
    seed: int,
    left: bool = False,
) -> PlayedPerson:
    """Somebody whose hand is at places on the table: start [s], place (3,) [m] and hold [s] of each."""
    above, T_person_cell = np.array([0.0, 0.0, PALM - Cube.size / 2]), inverse(placement)
    fetches = [Fetch(start, apply(T_person_cell, place + above), hold, left) for start, place, hold in reaches]
    return _placed(fetching(fetches, duration, seed), placement)


def _placed(recording: Recording, placement: Float[np.ndarray, "4 4"], name: str = "0") -> PlayedPerson:
    """Who was recorded, so placed, from the beginning on."""
    stamps = recording.stamps - recording.stamps[0]
    return PlayedPerson(name, recording.joints, stamps, apply(placement, recording.positions))


def predictor_named(name: str, people: Sequence[Person], samples: int = SAMPLES) -> Predict:
    """A predictor that has seen nothing yet.

    Args:
        name: one of PREDICTORS, or MODULE:FUNCTION that gives a trained method.
        people: the truth, for the oracle.
        samples: drawn per prediction.

    Raises:
        OptionError: another name.
        ModelError: what the function gives is no method.
    """
    if name == "none":
        return lambda _frame, _now: None
    if name in ("reachable", "oracle"):
        known = {person.name: person for person in people} if name == "oracle" else {}
        return lambda frame, now: _one_motion(frame, now, known.get(frame.person))
    shipped = name in SHIPPED
    if not shipped and not is_plugin(name):
        raise OptionError(f"predictor {name!r} is none of {', '.join(PREDICTORS)}")
    card, method = read_shipped(name) if shipped else read_method(Path(name))
    return Predictor(method, card.noise, None, PredictorOptions(samples, horizon=HORIZON if shipped else None)).observe


def _one_motion(frame: SkeletonFrame, now: float, person: Person | None) -> Prediction:
    """A person's true motion; of nobody known, that they stand, not to be trusted: the arm minds all they can reach."""
    times = now + DT * np.arange(1, STEPS + 1)
    poses, status = [frame.positions] * STEPS, Status.WARMING_UP
    if person is not None:
        poses, status = [person.at(float(time)) for time in times], Status.OK
    arms = np.stack(poses)[:, [frame.joints.index(name) for name in ARM_JOINTS]]
    covariance = np.zeros((STEPS, 6, 3, 3))
    return Prediction(frame.stamp, times, arms[None], arms, covariance, ARM_JOINTS, frame.person, status)


def simulate_scenario(
    name: str,
    predictor: str,
    seed: int,
    samples: int = SAMPLES,
    person: PlayedPerson | None = None,
    level: float = 0.95,
    cell: Cell | None = None,
) -> Simulation:
    """One of SCENARIOS, ready to run.

    Args:
        name: of the scenario.
        predictor: one of PREDICTORS, or MODULE:FUNCTION that gives a trained method.
        seed: of the person and the camera.
        samples: drawn per prediction.
        person: instead of the scripted one.
        level: probability with which the space shown as occupied holds each limb.
        cell: where; the default one.

    Raises:
        OptionError: no such predictor.
    """
    scenario, cell = SCENARIOS[name], cell or Cell()
    if person is None and scenario.fetches:
        reaches = [(start, cell.cube(cube).position, hold) for cube, start, hold in scenario.fetches]
        person = _reaching(reaches, cell.person, 30.0, seed, scenario.left)
    person = person or generated_person(seed, cell)
    people: list[Person] = [person if scenario.fetches else ReactivePerson(person)]
    predict = predictor_named(predictor, people, samples)
    return Simulation(people, predict, Camera(delay=cell.delay, seed=seed), cell, level)
