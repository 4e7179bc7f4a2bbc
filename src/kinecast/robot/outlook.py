"""What is known and predicted of the people in the cell, as the arm's foreman needs it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from kinecast.robot.body import OccupancyOptions
from kinecast.robot.camera import Shot
from kinecast.robot.cell import Cell
from kinecast.robot.motions import Motions, PoseHistory, motions_of
from kinecast.robot.occupancy import arms_of, is_trusted, occupied, reach_probabilities, standing
from kinecast.robot.ur5 import UR5
from kinecast.robot.watch import Watch, WatchOptions
from kinecast.types import Prediction

__all__ = ["Outlook", "Path"]

Path = Callable[[Float[np.ndarray, " N"]], Float[np.ndarray, "N 6"]]
"""Configurations [rad] so many seconds from now."""


class Outlook:
    """Keeps the newest measurement and prediction of every person.

    Args:
        arm: its kinematics.
        cell: with the cubes.
        options: how predictions become occupied space.
        touch: a limb that comes this near to a cube's middle may take it [m].
    """

    def __init__(self, arm: UR5, cell: Cell, options: OccupancyOptions, touch: float) -> None:
        self.arm, self.cell, self.options, self.touch = arm, cell, options, touch
        self.watch = Watch(WatchOptions(body=options))
        self.predictions: tuple[Prediction, ...] = ()
        self._histories: dict[str, PoseHistory] = {}

    @property
    def basis(self) -> float:
        """Stamp of the newest shot [s]."""
        return self.watch.newest

    def see(self, shot: Shot, predictions: Sequence[Prediction], now: float) -> None:
        """Takes in a shot, and what is predicted from it for each person; nothing where nobody predicts."""
        self.watch.add(shot)
        for frame in shot.frames:
            self._histories.setdefault(frame.person, PoseHistory()).add(frame.stamp, arms_of(frame))
        self._histories = {name: each for name, each in self._histories.items() if name in self.watch.persons}
        kept = {each.person: each for each in (*self.predictions, *predictions)}
        self.predictions = tuple(kept[name] for name in self.watch.persons if name in kept)

    def occupancy(self, now: float, at: float) -> Float[np.ndarray, "K 7"]:
        """Space that may be filled at a moment ahead, for pictures: start, end and radius of capsules [m]."""
        return occupied(self.predictions, now, at, self.options)

    def motions(self, now: float) -> Motions | None:
        """What everybody may do in the next seconds; None where nothing is predicted.

        Who is not to be trusted with a prediction stands where they were last seen, until they go on as before.
        """
        if not self.predictions:
            return None
        shown = [each if is_trusted(each, now) else standing(each) for each in self.predictions]
        histories = [self._histories.get(each.person, PoseHistory()) for each in shown]
        return motions_of(shown, histories, now, self.options, round(1e3 * now))

    def trusted(self, now: float) -> list[Prediction]:
        """Predictions that say more than what can be reached."""
        return [each for each in self.predictions if is_trusted(each, now)]

    def taken(self, names: Sequence[str], now: float) -> dict[str, float]:
        """Per cube, the probability that somebody reaches for it; 1 where a hand is there already."""
        if not names:
            return {}
        places = np.array([self.cell.cube(name).position for name in names])
        chance = np.zeros(len(names))
        for wrist in self.watch.wrists():
            near = np.linalg.norm(places - wrist, axis=1) <= self.options.hand + self.options.hand_length + self.touch
            chance = np.maximum(chance, near)
        for prediction in self.trusted(now):
            chance = np.maximum(chance, reach_probabilities(prediction, places, self.touch, self.options))
        return {name: float(p) for name, p in zip(names, chance, strict=True)}
