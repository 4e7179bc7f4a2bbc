"""Cubes to be moved: their order, who takes them, and one cube's way to its place, step by step."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum

import numpy as np
from jaxtyping import Float

from kinecast.geometry.transforms import rotation_z
from kinecast.robot.cell import Cell
from kinecast.robot.trajectory import Trajectory, minimum_jerk
from kinecast.robot.ur5 import LINKS, UR5

VERTICAL = 0.5  # greatest speed of the straight ways down and up [m/s]
DWELL = 0.25  # time the gripper takes [s]
WAYPOINTS = 9
CONTINUOUS = 0.8
"""Between two waypoints of a straight line no angle changes by more than this, or the arm would flip over [rad]."""
ELBOW_ABOVE = 0.1  # the elbow stays this much higher than the tool [m]: over the table, not beside it
TAKEN = 0.5  # probability from which on a cube is the person's, at once
FREE, AFTER = 0.2, 0.5
"""Probability below which it may be the arm's again, once it has stayed below for so long [s]."""


class Step(Enum):
    """What is being done with the cube."""

    NONE = "nothing"
    REACH = "to the cube"
    DESCEND = "down to the cube"
    CLOSE = "closing the gripper"
    LIFT = "lifting the cube"
    CARRY = "to the cube's place"
    LOWER = "lowering the cube"
    OPEN = "opening the gripper"
    RISE = "up from the cube"
    REST = "to where it rests"


class TaskSequence:
    """The cubes still to be moved, in order.

    Args:
        order: names of the cubes.
    """

    def __init__(self, order: tuple[str, ...]) -> None:
        self.remaining = list(order)
        self.placed: dict[str, float] = {}
        self.given_up: list[str] = []
        self.probabilities = dict.fromkeys(order, 0.0)
        self._taken = dict.fromkeys(order, False)
        self._free_from = dict.fromkeys(order, np.inf)

    def update(self, now: float, probabilities: Mapping[str, float]) -> None:
        """Takes in, per cube, the probability that the person reaches for it.

        Args:
            now: [s].
            probabilities: of cubes by name; one that is not named keeps its own.
        """
        for name, probability in probabilities.items():
            self.probabilities[name] = probability
            if probability >= TAKEN or (self._taken[name] and probability > FREE):
                self._taken[name], self._free_from[name] = True, np.inf
            elif self._taken[name]:
                self._free_from[name] = min(self._free_from[name], now + AFTER)
                self._taken[name] = now < self._free_from[name]

    def is_taken(self, name: str) -> bool:
        """Whether the cube is the person's for now."""
        return self._taken[name]

    def finish(self, name: str, now: float) -> None:
        """The cube is in its place [s]."""
        self.remaining.remove(name)
        self.placed[name] = now

    def give_up(self) -> None:
        """What is left cannot be had."""
        self.given_up += self.remaining
        self.remaining.clear()


def postures(arm: UR5, T_world_tool: Float[np.ndarray, "4 4"], below: float = 0.0) -> Float[np.ndarray, "B 6"]:
    """Ways to hold the tool there, elbow up, its fingers turned by any quarter; angles in (−π, π].

    Args:
        arm: the arm.
        T_world_tool: where the tool is to be, pointing down.
        below: it must also get straight down by this [m].

    Returns:
        (B, 6) [rad]; none where the place is out of reach.
    """
    kept = [np.empty((0, 6))]
    for quarter in range(4):
        T = T_world_tool.copy()
        T[:3, :3] = rotation_z(quarter * np.pi / 2) @ T[:3, :3]
        rows = arm.inverse_kinematics(T)
        rows = rows[arm.capsules(rows)[:, LINKS.index("elbow"), 2] > T[2, 3] + ELBOW_ABOVE]
        if below:
            T[2, 3] -= below
            lower = arm.inverse_kinematics(T)
            rows = rows[[_change(lower, q).min(initial=np.inf) < CONTINUOUS for q in rows]]
        kept.append(rows)
    return np.concatenate(kept)


def nearest(
    rows: Float[np.ndarray, "B 6"], q: Float[np.ndarray, "6"], q_range: Float[np.ndarray, "6 2"], most: int = 8
) -> Float[np.ndarray, "G 6"]:
    """The postures soonest reached from q [rad], with the full turns within range that bring each nearest."""
    turned = rows + np.round((q - rows) / (2 * np.pi)) * 2 * np.pi
    turned = np.where((turned < q_range[:, 0]) | (turned > q_range[:, 1]), rows, turned)
    way = np.abs(turned - q).max(axis=1, initial=0.0)  # the joint with the longest way says how long it takes
    return np.asarray(turned[np.argsort(way, kind="stable")[:most]])


def _change(rows: Float[np.ndarray, "B 6"], q: Float[np.ndarray, "6"]) -> Float[np.ndarray, " B"]:
    """Largest change of an angle from q to each row, full turns aside."""
    return np.asarray(np.abs((rows - q + np.pi) % (2 * np.pi) - np.pi).max(axis=1, initial=0.0))


def straight(arm: UR5, q: Float[np.ndarray, "6"], to: Float[np.ndarray, "3"], start_time: float) -> Trajectory | None:
    """The tool along a straight line, as it is turned, from rest to rest.

    Args:
        arm: the arm.
        q: (6,) where it starts [rad].
        to: (3,) where the tool ends [m].
        start_time: [s].

    Returns:
        The path; None where the arm cannot follow the line without turning over.
    """
    T = np.tile(arm.forward_kinematics(q), (WAYPOINTS, 1, 1))
    way = to - T[0, :3, 3]
    T[:, :3, 3] += minimum_jerk(WAYPOINTS)[:, None] * way  # its peak speed is 15/8 of its mean
    duration = max(1.875 * float(np.linalg.norm(way)) / VERTICAL, 0.1)
    rows = [np.asarray(q, dtype=np.float64)]
    for place in T[1:]:
        choices = arm.inverse_kinematics(place)
        change = _change(choices, rows[-1])
        if change.min(initial=np.inf) > CONTINUOUS:
            return None
        apart = choices[int(np.argmin(change))] - rows[-1]
        rows.append(rows[-1] + (apart + np.pi) % (2 * np.pi) - np.pi)
    return Trajectory(start_time + np.linspace(0.0, duration, WAYPOINTS), np.array(rows))


class GraspConfigurations:
    """Where the arm stands above each cube, above its place, and at rest: found once, as it takes a while.

    Args:
        arm: the arm.
        cell: with the cubes.
    """

    def __init__(self, arm: UR5, cell: Cell) -> None:
        self.cell, self._range = cell, arm.q_range
        self._resting = postures(arm, cell.grasp(cell.rest))
        self._above = {
            tuple(point): postures(arm, cell.grasp(point, cell.hover), cell.hover)
            for cube in cell.cubes for point in (cube.position, cube.place)
        }  # fmt: skip

    def usual(self, point: Float[np.ndarray, "3"], speed: float) -> float:
        """Time from rest to above a point, with nobody there, at a speed of the joints [rad/s]."""
        way = [self.above(point, rest)[:1] - rest for rest in self._resting[:1]]
        return 1.875 * float(np.abs(way).max(initial=0.0)) / speed

    def above(self, point: Float[np.ndarray, "3"], q: Float[np.ndarray, "6"]) -> Float[np.ndarray, "G 6"]:
        """Configurations above a cube or place from which the way down is straight, the nearest to q [rad] first."""
        return nearest(self._above[tuple(point)], q, self._range)

    def rest(self, q: Float[np.ndarray, "6"]) -> Float[np.ndarray, "G 6"]:
        """Configurations in which it rests, the nearest to q [rad] first."""
        return nearest(self._resting, q, self._range)
