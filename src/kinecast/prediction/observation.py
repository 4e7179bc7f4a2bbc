"""What a predictor sees: one window of arm positions, and the torso frame in which everything is predicted.

The torso frame of the last observed frame is the reference: origin midway between the shoulders, y from
right to left shoulder, z up the torso. A prediction made in it does not depend on where the person stands
or faces.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float

from kinecast.body.posture import postures_from_points
from kinecast.body.skeleton import ARM_JOINTS
from kinecast.geometry.regions import Regions
from kinecast.geometry.transforms import lengths

LEFT_SHOULDER, RIGHT_SHOULDER = ARM_JOINTS.index("left_shoulder"), ARM_JOINTS.index("right_shoulder")

STANDING = np.array([[0, 0.2, 1.4], [0, 0.25, 1.1], [0.2, 0.2, 1.0], [0, -0.2, 1.4], [0, -0.25, 1.1], [0.2, -0.2, 1.0]])
"""(6, 3) somebody who stands still [m]: what predictors are warmed up and methods tried with."""


def reference_frame(
    points: Float[np.ndarray, "*b 6 3"], up: Float[np.ndarray, "*b 3"]
) -> tuple[Float[np.ndarray, "*b 3 3"], Float[np.ndarray, "*b 3"]]:
    """Rotation R_world_torso (columns x, y, z) and origin [m] of the torso frame.

    Args:
        points: (…, 6, 3) arm joints [m].
        up: (…, 3) direction up the torso, of any length, not along the shoulder line.
    """
    left, right = points[..., LEFT_SHOULDER, :], points[..., RIGHT_SHOULDER, :]
    y = left - right
    y = y / lengths(y)[..., None]
    z = up - (up * y).sum(axis=-1, keepdims=True) * y
    z = z / lengths(z)[..., None]
    rotation = np.empty((*y.shape, 3))
    rotation[..., 1], rotation[..., 2] = y, z
    rotation[..., 0] = y[..., [1, 2, 0]] * z[..., [2, 0, 1]] - y[..., [2, 0, 1]] * z[..., [1, 2, 0]]
    return rotation, 0.5 * (left + right)


@dataclass(frozen=True)
class Observation:
    """One repaired window on a uniform grid, ending at the newest frame.

    Attributes:
        positions: (N, 6, 3) arm joints in the world [m], no NaN.
        up: (3,) direction up the torso at the last frame (kinecast.body.torso_frame).
        dt: time between frames [s].
        stamp: time of the last frame [s]; moving obstacles need it.
        noise: (6,) spread of each joint along each axis beyond that of the training data [m].
        goals: regions that hands may head for; None for none.
    """

    positions: Float[np.ndarray, "N 6 3"]
    up: Float[np.ndarray, "3"]
    dt: float
    stamp: float = 0.0
    noise: Float[np.ndarray, "6"] = field(default_factory=lambda: np.zeros(6))
    goals: Regions | None = None

    def times(self, steps: int) -> Float[np.ndarray, " T"]:
        """(T,) the predicted instants [s]."""
        return self.stamp + self.dt * np.arange(1, steps + 1)

    @cached_property
    def frame(self) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
        """Rotation R_world_torso and origin [m] of the last frame's torso."""
        return reference_frame(self.positions[-1], self.up)

    @cached_property
    def points(self) -> Float[np.ndarray, "N 6 3"]:
        """(N, 6, 3) the window in the torso frame [m]."""
        return self.to_torso(self.positions)

    @cached_property
    def posture(self) -> Float[np.ndarray, "18"]:
        """(18,) posture of the last frame, continuous through the window (kinecast.body.posture)."""
        return postures_from_points(self.points, continuous=True)[-1]

    def to_torso(self, positions: Float[np.ndarray, "*b 3"]) -> Float[np.ndarray, "*b 3"]:
        """World positions [m] in the torso frame."""
        rotation, origin = self.frame
        return (positions - origin) @ rotation

    def to_world(self, points: Float[np.ndarray, "*b 3"]) -> Float[np.ndarray, "*b 3"]:
        """Torso-frame points [m] in the world."""
        rotation, origin = self.frame
        return points @ rotation.T + origin
