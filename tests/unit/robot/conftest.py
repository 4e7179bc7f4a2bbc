"""An arm on a table, and people beside it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import jaxtyping
import numpy as np
import pytest

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Box, Capsule
from kinecast.robot.collision import CollisionChecker
from kinecast.robot.people import CameraFrame
from kinecast.robot.planner import Planner
from kinecast.robot.simulated_person import Camera, Person, PlayedPerson
from kinecast.robot.ur5 import UR5
from kinecast.types import Prediction, Status

HOME = np.array([0.42, -1.08, 1.29, 1.36, 1.57, -1.15])
"""Above the table, the tool pointing down."""
AWAY = HOME + np.array([-1.5, 0, 0, 0, 0, 0])
TABLE = Box(np.array([0.0, 0.0, -0.06]), np.array([2.0, 2.0, 0.1]))
POST = [-0.45, 0.0, 0.0, -0.45, 0.0, 0.15, 0.06]
"""Between them, low enough to reach over."""
WALL = [[-0.9, 0.0, z, -0.3, 0.0, z, 0.06] for z in (0.1, 0.25, 0.4, 0.55, 0.7)]
FAR_AWAY = 50.0
SEALED = [[-1.2, 0.0, z, 1.2, 0.0, z, 0.15] for z in np.arange(0.0, 1.6, 0.2)]
"""No way leads past it."""


@pytest.fixture(scope="module")
def without_checks() -> Iterator[None]:
    """Thousands of steps are too many to check every shape in; one short episode does (test_simulation)."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.fixture(scope="session")
def arm() -> UR5:
    return UR5()


@pytest.fixture(scope="session")
def table() -> Scene:
    return Scene((TABLE,))


@pytest.fixture(scope="session")
def planner(arm: UR5, table: Scene) -> Planner:
    return Planner(arm, table)


@pytest.fixture(scope="session")
def checker(planner: Planner) -> CollisionChecker:
    return planner.checker


@dataclass(frozen=True, eq=False)
class Visitor(PlayedPerson):
    """Far away but from and until [s]."""

    present: tuple[float, float] = (-np.inf, np.inf)

    def at(self, time: float) -> np.ndarray:
        return super().at(time) + (0.0 if self.present[0] <= time < self.present[1] else 2 * FAR_AWAY)


@dataclass
class FaultyCamera(Camera):
    """Sees nobody who is far away; says nothing, or sees no joint, from and until [s]."""

    silent: tuple[tuple[float, float], ...] = ()
    blind: tuple[tuple[float, float], ...] = ()

    def shots(self, now: float, people: Sequence[Person]) -> list[CameraFrame]:
        found = []
        for shot in super().shots(now, people):
            nan = np.nan if any(start <= shot.stamp < end for start, end in self.blind) else 0.0
            if not any(start <= shot.stamp < end for start, end in self.silent):
                near = (frame for frame in shot.frames if np.nanmin(frame.positions) < FAR_AWAY)
                frames = (replace(frame, positions=frame.positions + nan) for frame in near)
                found.append(CameraFrame(shot.stamp, tuple(frames)))
        return found


def posts(*rows: list[float]) -> Scene:
    """Capsules (start, end, radius) above the table."""
    capsules = (Capsule(np.array(row[:3]), np.array(row[3:6]), row[6]) for row in rows)
    return Scene((TABLE, *capsules))


def down(x: float, y: float, z: float) -> np.ndarray:
    """T_world_tool of a tool that points down."""
    T = np.diag([1.0, -1.0, -1.0, 1.0])
    T[:3, 3] = x, y, z
    return T


def prediction(
    spread: float = 0.05, stamp: float = 0.0, status: Status = Status.OK, x: float = -1.2, samples: int = 400
) -> Prediction:
    """A person at rest across the table, whose joints spread evenly over half a second."""
    left = np.array([[x, 0.2, 0.5], [x + 0.08, 0.3, 0.25], [x + 0.3, 0.25, 0.15]])
    arms = np.concatenate([left, left * [1, -1, 1]])
    times = stamp + np.arange(1, 16) / 30
    share = (np.arange(1, 16) / 15)[:, None, None]
    rng = np.random.default_rng(0)
    drawn = arms + spread * share * rng.standard_normal((samples, 1, 6, 3))
    return Prediction(
        stamp, times, drawn, np.repeat(arms[None], 15, axis=0), np.zeros((15, 6, 3, 3)), ARM_JOINTS, status=status
    )
