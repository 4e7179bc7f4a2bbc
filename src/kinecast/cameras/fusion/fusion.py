"""Several cameras into one skeleton for each person.

Images are gathered into rounds: one of each camera that is alive. A round is of the instant of its newest image; the
others are moved there by each joint's motion. Then everything that is said of a joint, and what was known before, goes
into one weighted least squares.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from itertools import count

import numpy as np
from scipy.optimize import linear_sum_assignment

from kinecast.cameras.fusion.measurement import Measurement, of_detection, of_skeleton
from kinecast.cameras.fusion.person import Person
from kinecast.cameras.rig import Rig
from kinecast.live.detection import Detection
from kinecast.types import SkeletonFrame

ALIVE = 0.5  # a camera that was silent for so long [s] is not waited for
OLDEST = 0.15  # an image so much older than the newest round [s] is not used: its people have moved too far
ELSEWHERE = 20  # so many such images in a row, and time has been set back
FORGET, FORGET_DOUBTFUL = 1.0, 0.2  # who was not seen for so long [s] has left, who was not seen often sooner
ALONE, APART = 0.6, 0.25  # least distance from everybody at which one camera, or several together, see a new one [m]
DOUBLE = 0.12  # two persons nearer than this [m] are one
MOST_PEOPLE = 16  # in one image, and known at once
MOST_TRIALS = 12  # ways to put strangers together in one round
ASSIGNED = 0.55  # mean share of the limits up to which a measurement may be of a person; see `Person.distance`


class Fusion:
    """Takes images in the order they come and gives skeletons; never raises, whatever the images say."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.used = Counter[str]()  # measurements of each camera that went in
        self.thrown_out = Counter[str]()  # those that disagreed with most, or were of nobody
        self._names = count(1)
        self._late_in_a_row = 0
        self._start_anew()

    def _start_anew(self) -> None:
        """Forgets everything but the count of names."""
        self._round: dict[str, list[Measurement]] = {}
        self._heard: dict[str, float] = {}
        self._people: list[Person] = []
        self._stamp = -math.inf

    def add(self, camera: str, stamp: float, people: Sequence[Detection | SkeletonFrame]) -> list[SkeletonFrame]:
        """Takes one image; gives frames of everybody that a finished round, of an image of each camera, has seen.

        An unknown camera is passed over. The stamp is when it was taken [s], on one clock for all cameras; those of the
        people themselves do not matter. They are detections, or skeletons in the camera's own axes.
        """
        if camera not in self.rig.cameras or not math.isfinite(stamp):
            return []
        if stamp < self._stamp - OLDEST:
            self._late_in_a_row += 1
            if self._late_in_a_row < ELSEWHERE:
                return []
            self._start_anew()
        self._late_in_a_row = 0
        frames = self.finish() if camera in self._round and stamp != self._heard[camera] else []
        seen, pinhole = self._round.setdefault(camera, []), self.rig.cameras[camera]
        for each in people[:MOST_PEOPLE]:
            measure = of_detection if isinstance(each, Detection) else of_skeleton
            measurement = measure(pinhole, each, stamp)  # type: ignore[arg-type]
            if measurement.seen.any():
                seen.append(measurement)
        self._heard[camera] = stamp
        newest = max(self._heard.values())
        if all(name in self._round for name, last in self._heard.items() if newest - last < ALIVE):
            frames += self.finish()
        return frames

    def finish(self) -> list[SkeletonFrame]:
        """Ends a round before every camera is in it, for one that has waited long enough."""
        if not self._round:
            return []
        images, self._round = self._round, {}
        newest = max(self._heard[camera] for camera in images)
        last, self._stamp = self._stamp, max(newest, self._stamp)
        unseen = {person: self._stamp - person.seen_at for person in self._people}
        self._people = [each for each in unseen if unseen[each] < (FORGET if each.confirmed else FORGET_DOUBTFUL)]
        for person in self._people:
            person.states.advance(self._stamp)
        strangers = self._recognise([[m for m in seen if m.stamps[0] >= newest - OLDEST] for seen in images.values()])
        self._welcome(strangers)
        kept: list[Person] = []  # of two who stand in one another, who was seen in fewer rounds is nobody
        for person in sorted(self._people, key=lambda person: -person.rounds):
            if all(person.apart(other) > DOUBLE for other in kept):
                kept.append(person)
        self._people = kept
        if self._stamp <= last:
            return []
        shown = [person for person in self._people if person.confirmed and person.seen_at == self._stamp]
        for person in shown:
            person.name = person.name or str(next(self._names))
        return [person.frame(self.rig.frame_id) for person in shown]

    @property
    def waiting(self) -> bool:
        """Whether a round is open that some cameras are not in yet."""
        return bool(self._round)

    def _recognise(self, images: Sequence[list[Measurement]]) -> list[Measurement]:
        """Gives each person what was measured of them; what is of nobody known is returned."""
        strangers: list[Measurement] = []
        mine: dict[Person, list[Measurement]] = {person: [] for person in self._people}
        for seen in images:
            costs = np.array([[person.distance(each) for person in self._people] for each in seen])
            costs = costs.reshape(len(seen), len(self._people))
            pairs = zip(*linear_sum_assignment(np.minimum(costs, 1.0)), strict=True)
            of = {int(row): self._people[column] for row, column in pairs if costs[row, column] < ASSIGNED}
            for row, person in of.items():
                mine[person].append(seen[row])
            strangers += [each for row, each in enumerate(seen) if row not in of]
        for person, measurements in mine.items():
            if measurements:
                self._update(person, measurements)
        return strangers

    def _update(self, person: Person, measurements: list[Measurement]) -> None:
        left_out = Counter(each.camera for each in person.update(measurements))
        self.thrown_out += left_out
        self.used += Counter(each.camera for each in measurements) - left_out

    def _welcome(self, strangers: list[Measurement]) -> None:
        """Measurements of nobody known: people who came, if they are far enough from everybody."""
        nobodies = list(strangers)
        trials = MOST_TRIALS
        while strangers and trials > 0 and len(self._people) < MOST_PEOPLE:
            first, others = strangers[0], strangers[1:]
            partners = [None, *(other for other in others if other.camera != first.camera)][:trials]
            trials -= len(partners)
            best: Person | None = None
            fitting: list[Measurement] = []
            for partner in partners:
                trial = Person(self._stamp)
                trial.update([first] if partner is None else [first, partner])
                fits = _fitting(strangers, trial)
                if first in fits and len(fits) > len(fitting):
                    best, fitting = trial, fits
            strangers = others
            alive = sum(self._stamp - last < ALIVE for last in self._heard.values())
            room = APART if len(fitting) > 1 or alive < 2 else ALONE
            if best is not None and all(best.apart(other) > room for other in self._people):
                self._people.append(Person(self._stamp))
                self._update(self._people[-1], fitting)
                strangers = [each for each in strangers if each not in fitting]
                nobodies = [each for each in nobodies if each not in fitting]
        self.thrown_out.update(each.camera for each in nobodies)


def _fitting(measurements: list[Measurement], person: Person) -> list[Measurement]:
    """Of each camera the measurement that is nearest to a person, if it is near."""
    best: dict[str, tuple[float, Measurement]] = {}
    for each in measurements:
        away = person.distance(each)
        if away < min(ASSIGNED, best.get(each.camera, (np.inf,))[0]):
            best[each.camera] = away, each
    return [each for _, each in best.values()]
