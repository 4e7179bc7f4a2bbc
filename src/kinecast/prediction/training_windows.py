"""What methods are trained on: windows of recordings and what followed them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from kinecast.body.limits import JointLimits
from kinecast.body.posture import postures_from_points
from kinecast.geometry.scene import Scene
from kinecast.prediction.observation import reference_frame

BLOCK = 10_000
"""Training windows that are looked at together."""


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

    @cached_property
    def noise(self) -> float:
        """Spread of a measured joint about the true one [m], from what changes too fast to be motion.

        The third difference of a smooth motion at 30 Hz is small; white noise of spread σ gives one of spread
        σ √20. The median over windows of a robust (median absolute deviation) spread is taken.
        """
        spreads = []
        for block in self.blocks():
            tracks = np.concatenate([block.observed, block.future], axis=1)
            spreads.append(np.median(np.abs(np.diff(tracks, n=3, axis=1)), axis=(1, 2, 3)))
        # 1.4826: from median absolute deviation to standard deviation of a normal.
        return float(max(1.4826 * np.median(np.concatenate(spreads)) / np.sqrt(20.0), 1e-4))

    @cached_property
    def limits(self) -> JointLimits:
        """Limits whose ranges are widened to hold the postures trained on: markers are not always at the joints."""
        last = [postures_from_points(block.points, continuous=True)[:, -1] for block in self.blocks()]
        return JointLimits().widened(np.concatenate(last))

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
