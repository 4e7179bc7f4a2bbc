"""What a predictor sees: one window of arm positions, and the torso frame in which everything is predicted.

The torso frame of the last observed frame is the reference: origin midway between the shoulders, y from
right to left shoulder, z up the torso. A prediction made in it does not depend on where the person stands
or faces.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from kinecast.body.posture import postures_from_points
from kinecast.body.skeleton import ARM_JOINTS
from kinecast.geometry.regions import Regions
from kinecast.geometry.scene import Scene
from kinecast.geometry.transforms import lengths

LEFT_SHOULDER, RIGHT_SHOULDER = ARM_JOINTS.index("left_shoulder"), ARM_JOINTS.index("right_shoulder")

STANDING = np.array([[0, 0.2, 1.4], [0, 0.25, 1.1], [0.2, 0.2, 1.0], [0, -0.2, 1.4], [0, -0.25, 1.1], [0.2, -0.2, 1.0]])
"""(6, 3) somebody who stands still [m]: what predictors are warmed up and methods tried with."""

BLOCK = 10_000
"""Training windows that are looked at together."""


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


@dataclass(frozen=True)
class TrainingWindows:
    """Windows and what followed them, from one or more recordings.

    Attributes:
        observed: (W, N, 6, 3) arm joints in the world [m], repaired, no NaN.
        future: (W, T, 6, 3) what was measured next [m], no NaN.
        up: (W, 3) direction up the torso at the last observed frame.
        recording: (W,) index of the recording each window comes from.
        dt: time between frames [s].
        frame: (W,) index in its recording of each window's last observed frame.
        group: (W,) what is left out together in folds: collections of the same people, a task, or a recording.
        collection: (W,) index of the sensor and place each window comes from.
        subject: (W,) index of the person.
    """

    observed: Float[np.ndarray, "W N 6 3"]
    future: Float[np.ndarray, "W T 6 3"]
    up: Float[np.ndarray, "W 3"]
    recording: Int[np.ndarray, " W"]
    dt: float
    frame: Int[np.ndarray, " W"]
    group: Int[np.ndarray, " W"]
    collection: Int[np.ndarray, " W"]
    subject: Int[np.ndarray, " W"]

    def __len__(self) -> int:
        return len(self.observed)

    @property
    def shape(self) -> tuple[int, int, float]:
        """N, T and the time between frames [s]."""
        return self.observed.shape[1], self.future.shape[1], self.dt

    @cached_property
    def points(self) -> Float[np.ndarray, "W N 6 3"]:
        """The observed windows, each in its own torso frame [m]."""
        return self._to_torso(self.observed)

    @cached_property
    def future_points(self) -> Float[np.ndarray, "W T 6 3"]:
        """The futures, each in its own window's torso frame [m]."""
        return self._to_torso(self.future)

    def shares(self, rows: Int[np.ndarray, " K"]) -> Float[np.ndarray, " K"]:
        """(K,) how often each of some windows is to be drawn: no collection and no person drowns the others.

        A collection counts by the root of its windows, and so does a person within it; they sum to one.
        """
        shares = np.zeros(len(rows))
        for collection in np.unique(self.collection[rows]):
            here = self.collection[rows] == collection
            _, person, windows = np.unique(self.subject[rows[here]], return_inverse=True, return_counts=True)
            root = windows[person] ** -0.5
            shares[here] = root / root.sum() * np.sqrt(here.sum())
        return shares / shares.sum()

    def take(self, rows: Int[np.ndarray, " K"]) -> TrainingWindows:
        """Some of the windows."""
        own = ("observed", "future", "up", "recording", "frame", "group", "collection", "subject")
        return replace(self, **{name: getattr(self, name)[rows] for name in own})

    def blocks(self) -> Iterator[TrainingWindows]:
        """All windows in their order, some at a time: what is derived from all at once takes as much room again."""
        for first in range(0, len(self), BLOCK):
            yield self.take(np.arange(first, min(first + BLOCK, len(self))))

    def outside(self, scene: Scene) -> TrainingWindows:
        """Only the windows that end with both arms free of obstacles."""
        free = scene.free(self.observed[:, -1:], np.zeros(1))[:, 0]
        return self.take(np.flatnonzero(free))

    def folds(self, count: int) -> Int[np.ndarray, " W"]:
        """(W,) fold of each window: whole groups where there are two or more, else blocks of time."""
        groups, sizes = np.unique(self.group, return_counts=True)
        if len(groups) < 2:
            return np.minimum(np.arange(len(self)) * count // max(len(self), 1), count - 1)
        fold_of, load = np.zeros(len(groups), dtype=int), np.zeros(min(count, len(groups)))
        for k in np.argsort(-sizes, kind="stable"):  # the largest first, each to the emptiest fold
            fold_of[k] = np.argmin(load)
            load[fold_of[k]] += sizes[k]
        return fold_of[np.searchsorted(groups, self.group)]

    def near(self, chosen: Bool[np.ndarray, " W"]) -> Bool[np.ndarray, " W"]:
        """(W,) windows that share a frame with a chosen one."""
        reach = self.observed.shape[1] + self.future.shape[1]
        near = np.zeros(len(self), dtype=bool)
        for recording in np.unique(self.recording[chosen]):
            here = self.recording == recording
            frames = np.sort(self.frame[here & chosen])
            after = np.searchsorted(frames, self.frame[here] - reach, side="right")
            before = np.searchsorted(frames, self.frame[here] + reach, side="left")
            near[here] = before > after
        return near

    def _to_torso(self, positions: Float[np.ndarray, "W K 6 3"]) -> Float[np.ndarray, "W K 6 3"]:
        rotation, origin = reference_frame(self.observed[:, -1], self.up)
        return np.einsum("wkjd,wde->wkje", positions - origin[:, None, None], rotation)
