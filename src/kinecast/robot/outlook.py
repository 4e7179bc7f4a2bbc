"""What is known and predicted of the people in the cell, as the arm's foreman needs it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from kinecast.robot.camera import Shot
from kinecast.robot.cell import Cell
from kinecast.robot.occupancy import Occupancy, OccupancyOptions, occupied
from kinecast.robot.overlap import overlap_probability, reach_probabilities
from kinecast.robot.ur5 import UR5
from kinecast.robot.watch import Watch, WatchOptions
from kinecast.types import Prediction, Status

__all__ = ["Outlook", "Path"]

Path = Callable[[Float[np.ndarray, " N"]], Float[np.ndarray, "N 6"]]
"""Configurations [rad] so many seconds from now."""

REFRESH = 0.03
"""While the camera is silent, what may be occupied is found anew after so long [s]."""
PLAN_LEVEL = 0.5
"""Share of the predicted motions that a plan keeps clear of."""
LATER, LATER_MARGIN = 0.2, 0.08
"""So long after the horizon [s] a plan keeps clear of bodies alone, by this margin [m]."""


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
        self.occupancy = Occupancy.empty()
        self.predictions: tuple[Prediction, ...] = ()
        self._updated = -np.inf

    @property
    def basis(self) -> float:
        """Stamp of the newest shot [s]."""
        return self.watch.newest

    def see(self, shot: Shot, predictions: Sequence[Prediction], now: float) -> None:
        """Takes in a shot, and what is predicted from it for each person; nothing where nobody predicts."""
        self.watch.add(shot)
        kept = {each.person: each for each in (*self.predictions, *predictions)}
        self.predictions = tuple(kept[name] for name in self.watch.persons if name in kept)
        self._update(now)

    def refresh(self, now: float) -> None:
        """Occupied space grows old: makes it anew where that was too long ago."""
        if now - self._updated >= REFRESH + 1e-9:
            self._update(now)

    def _update(self, now: float) -> None:
        self._updated = now
        self.occupancy = occupied(self.predictions, now, self.options) if self.predictions else Occupancy.empty(now)

    def to_plan_around(self) -> Occupancy:
        """Occupied space for a plan: half the motions up to the horizon, then the bodies where they will be by then.

        All that a person may do, or reach a second from now, leaves no path at all. Plans keep clear of what is likely;
        that the arm is never where a person may be is ensured by its pace, at every instant.
        """
        if not self.predictions:
            return self.occupancy
        found = occupied(self.predictions, self._updated, replace(self.options, level=PLAN_LEVEL))
        bodies = np.tile(self.options.radii, found.radius.shape[1] // len(self.options.radii)) + LATER_MARGIN
        return replace(
            found,
            times=np.append(found.times, found.times[-1] + LATER),
            start=np.concatenate([found.start, found.start[-1:]]),
            end=np.concatenate([found.end, found.end[-1:]]),
            radius=np.concatenate([found.radius, bodies[None]]),
            growth_limit=0.0,
        )

    def within(self, q: Float[np.ndarray, "6"], people: Occupancy, time: float) -> bool:
        """Whether the arm at q [rad] is within what may be occupied at a time [s]."""
        body = self.arm.body_points(q[None])
        distance, _ = people.signed_distance(body.positions, np.array([time]))
        return bool((distance < body.radius).any())

    def trusted(self, now: float) -> list[Prediction]:
        """Predictions that say more than what can be reached."""
        oldest = self.options.stale_after + 1e-9
        return [each for each in self.predictions if each.status is Status.OK and now - each.stamp <= oldest]

    def overlap(self, path: Path, now: float) -> float:
        """Probability that somebody enters the path while the arm is there, by the predictions that can be trusted."""
        chance = 0.0
        for prediction in self.trusted(now):
            body = self.arm.body_points(path(prediction.times - now))
            chance = max(chance, overlap_probability(prediction, body.positions, body.radius, self.options))
        return chance

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
