"""What moves an arm: a real one (kinecast.robot.ur_driver), or a simulated one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from kinecast.errors import OptionError
from kinecast.robot.cell import Cell
from kinecast.robot.ur5 import UR5

__all__ = ["ArmState", "Driver", "SimulatedDriver"]

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


@runtime_checkable
class Driver(Protocol):
    """An arm with a gripper, told where to be at every step of its control."""

    @property
    def dt(self) -> float:
        """Time between two steps [s]."""
        ...

    def state(self) -> ArmState:
        """What the arm measures now."""
        ...

    def move(self, q: Float[np.ndarray, "6"]) -> Float[np.ndarray, "6"]:
        """Sends the configuration [rad] to be at in the next step; returns the one really sent."""
        ...

    def grip(self, closed: bool) -> None:
        """Closes or opens the gripper."""
        ...


class SimulatedDriver:
    """A kinematic arm among cubes: goes where it is told, as fast as its joints can.

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
        self._dt = dt
        self._q = np.array(q, dtype=np.float64)
        self._closed = False
        self._below = cell.cubes[0].size / 2 - cell.grip

    @property
    def dt(self) -> float:
        """Time between two steps [s]."""
        return self._dt

    def state(self) -> ArmState:
        """Where the arm is; without noise."""
        return ArmState(self._q.copy(), self._closed)

    def move(self, q: Float[np.ndarray, "6"]) -> Float[np.ndarray, "6"]:
        """Goes there, or as far as the joints' speeds allow, and takes a cube that is held with it."""
        if not np.isfinite(q).all():
            return self._q.copy()
        furthest = self.arm.max_speed * self._dt
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
