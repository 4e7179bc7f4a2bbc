"""A short simulation beside somebody who stands still."""

from __future__ import annotations

import numpy as np

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.robot.simulated_person import Camera, PlayedPerson
from kinecast.robot.simulation import Simulation

POSE = np.array(
    [[1.15, -0.2, 0.5], [1.1, -0.25, 0.2], [0.9, -0.2, 0.08], [1.15, 0.2, 0.5], [1.1, 0.25, 0.2], [0.9, 0.2, 0.08]]
)
LONG = 240.0
"""Of a wait for another thread, on however busy a machine [s]; it takes milliseconds, or a minute to compile."""


def simulation(limit: float = 0.4) -> Simulation:
    """Without a prediction: quick."""
    person = PlayedPerson("0", ARM_JOINTS, np.array([0.0]), POSE[None])
    return Simulation([person], lambda _frame, _now: None, Camera(lost=0.0, dropped=0.0), limit=limit, dt=0.02)
