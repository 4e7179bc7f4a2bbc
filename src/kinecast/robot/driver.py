"""What moves the simulated arm; kinecast.robot.ur_driver, which is called alike, moves a real one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from kinecast.errors import OptionError
from kinecast.robot.cell import Cell
from kinecast.robot.ur5 import UR5

__all__ = ["ArmState", "SimulatedDriver"]

HOLDS = 0.04
"""A cube is held when its centre is this near to where the fingers close [m]."""


@dataclass(frozen=True)
class ArmState:
    """What an arm says of itself.

    Attributes:
        q: (6,) [rad].
        closed: whether the gripper is.
    """

    q: Float[np.ndarray, "6"]
    closed: bool


class SimulatedDriver:
    """A kinematic arm with a gripper among cubes: goes where it is told, as fast as its joints can.

    Args:
        arm: its kinematics.
        cell: with the cubes.
        q: (6,) where it starts [rad].
        dt: time between two steps [s].
    """

    def __init__(self, arm: UR5, cell: Cell, q: Float[np.ndarray, "6"], dt: float = 0.008) -> None:
        if not dt > 0:
            raise OptionError(f"dt {dt} s must be above 0")
        self.arm = arm
        self.cubes = {cube.name: cube.position.copy() for cube in cell.cubes}
        self.held: str | None = None
        self.dt = dt
        self._q = np.array(q, dtype=np.float64)
        self._closed = False
        self._below = cell.cubes[0].size / 2 - cell.grip

    def state(self) -> ArmState:
        """Where the arm is; without noise."""
        return ArmState(self._q.copy(), self._closed)

    def move(self, q: Float[np.ndarray, "6"]) -> Float[np.ndarray, "6"]:
        """Goes there, or as far as the joints' speeds allow, and takes a cube that is held with it."""
        if not np.isfinite(q).all():
            return self._q.copy()
        furthest = self.arm.max_speed * self.dt
        self._q = self._q + np.clip(q - self._q, -furthest, furthest)
        if self.held is not None:
            self.cubes[self.held] = self._between_fingers()
        return self._q.copy()

    def grip(self, closed: bool) -> None:
        """Closing takes the cube between the fingers, if there is one; opening leaves it where it is."""
        self._closed = closed
        self.held = None
        if closed:
            here = self._between_fingers()
            nearest = min(self.cubes, key=lambda name: float(np.linalg.norm(self.cubes[name] - here)))
            if np.linalg.norm(self.cubes[nearest] - here) < HOLDS:
                self.held = nearest

    def _between_fingers(self) -> Float[np.ndarray, " 3"]:
        T = self.arm.forward_kinematics(self._q)
        place: Float[np.ndarray, " 3"] = T[:3, 3] + self._below * T[:3, 2]
        return place
