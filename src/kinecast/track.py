"""One person's recent frames, as the camera gave them, and the repaired window they make on the model's grid."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from kinecast.body.skeleton import arms_of, of_arms
from kinecast.body.torso_frame import UpSource, torso_frame, up_source
from kinecast.body.tracking import Trouble, repair_window
from kinecast.prediction.observation import Observation
from kinecast.types import SkeletonFrame, Status

MOST_FRAMES = 512  # frames kept of one person: bounded memory whatever the camera's rate
LONGEST_GAP = 0.3  # after a longer silence [s] a person's history starts anew
LONG = 2.5  # a joint not seen for more of the grid's steps has a gap; one frame filled in costs 0.1 mm of 70 at most
BACKWARDS = 1.0  # a stamp older than the newest by more than this [s] is a new clock, not a late frame
BONES = (0.10, 0.60)
"""Lengths of upper arm, forearm and shoulder line that a person can have [m]; from infant to the tallest on record."""

BONE_ENDS = ((0, 1), (1, 2), (3, 4), (4, 5), (0, 3))


@dataclass
class Track:
    """One person's last frames."""

    dt: float  # time between frames of the model's grid [s]
    frames: int  # N, frames of the model's window
    rng: np.random.Generator  # of this person's predictions
    stamps: deque[float] = field(default_factory=lambda: deque(maxlen=MOST_FRAMES))  # [s]
    arms: deque[Float[np.ndarray, "6 3"]] = field(default_factory=lambda: deque(maxlen=MOST_FRAMES))  # [m]
    source: UpSource | None = None  # what tells the direction up the torso
    lean: float = 0.0
    up: Float[np.ndarray, "3"] = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    std: Float[np.ndarray, "6"] | None = None  # that the newest frame states [m]
    state: Any = None  # what the method remembers
    state_stamp: float = -np.inf  # of its newest frame [s]

    @property
    def span(self) -> float:
        """Length of the observation window [s]."""
        return self.dt * (self.frames - 1)

    def add(self, frame: SkeletonFrame) -> Status:
        """Takes in a frame: OK, LATE (older than the newest, not taken in) or REPEATED (the same as the newest).

        A ValueError for arrays whose shapes do not fit the joints' names.
        """
        joints, std = len(frame.joints), None if frame.std is None else frame.std.shape
        if frame.positions.shape != (joints, 3) or std not in (None, (joints,)):
            raise ValueError(f"positions {frame.positions.shape} and std {std} for {joints} joints")
        if self.stamps:
            age = self.stamps[-1] - frame.stamp
            if 0 <= age <= BACKWARDS:
                return Status.REPEATED if age == 0 else Status.LATE
            if age > BACKWARDS or -age > LONGEST_GAP:
                self.stamps.clear()
                self.arms.clear()
                self.state, self.state_stamp = None, -np.inf
        arms = arms_of(frame)
        repeated = bool(self.arms) and np.array_equal(self.arms[-1], arms)
        self.stamps.append(frame.stamp)
        self.arms.append(arms)
        self._follow_torso(frame)
        self.std = None
        if frame.std is not None:
            stated = of_arms(frame.joints, frame.std)
            self.std = np.where(np.isfinite(stated), stated.clip(0.0, 1.0), 0.0)  # what is not sensible says nothing
        return Status.REPEATED if repeated else Status.OK

    def _follow_torso(self, frame: SkeletonFrame) -> None:
        if not {"left_shoulder", "right_shoulder"} <= set(frame.joints):
            return
        if self.source is None or self.source is UpSource.WORLD:
            self.source = up_source(frame.joints, frame.positions[None])
        torso = torso_frame(frame.joints, frame.positions, self.source, self.lean)
        if np.isfinite(torso.lean):
            self.lean = float(torso.lean)
            self.up = torso.T_world_torso[:3, 2]

    def last_seen(self) -> tuple[Float[np.ndarray, "6 3"], Float[np.ndarray, "6"]]:
        """(6, 3) where each joint was last seen [m], NaN for never, and (6,) how long before the newest frame [s]."""
        stamps, arms = np.array(self.stamps), np.array(self.arms)
        seen = np.isfinite(arms).all(axis=-1)
        row = len(arms) - 1 - np.argmax(seen[::-1], axis=0)
        return arms[row, np.arange(6)], stamps[-1] - stamps[row]

    def observation(self, noise: float) -> tuple[Observation | None, Status]:
        """The window on the model's grid, ending at the newest frame, and what was wrong with it.

        Args:
            noise: spread of a measured joint in the training data [m]; only what a frame states beyond it counts.
        """
        stamps = np.array(self.stamps)
        # A camera a little faster than stated must not keep the window from ever being full.
        if len(stamps) < 2 or stamps[-1] - stamps[0] < self.span - 0.5 * self.dt:
            return None, Status.WARMING_UP
        first = max(int(np.searchsorted(stamps, stamps[-1] - self.span, side="right")) - 1, 0)
        window = np.array([self.arms[k] for k in range(first, len(stamps))])
        repair = repair_window(window, stamps[first:])
        trouble = Trouble(int(np.bitwise_or.reduce(repair.trouble)))
        if not np.isfinite(repair.positions).all():
            return None, Status.OCCLUDED
        grid = stamps[-1] - self.dt * np.arange(self.frames - 1, -1, -1)
        positions = _interpolate(repair.positions, stamps[first:], grid)
        excess = np.zeros(6) if self.std is None else np.sqrt(np.maximum(self.std**2 - noise**2, 0.0))
        observation = Observation(positions, self.up, self.dt, float(stamps[-1]), excess)
        return observation, self._status(positions[-1], trouble, self._longest_unseen(window, stamps[first:]))

    def _longest_unseen(self, window: Float[np.ndarray, "K 6 3"], stamps: Float[np.ndarray, " K"]) -> float:
        """From one frame that shows a joint to the next that does, at most [s]."""
        seen = np.isfinite(window[:, :, 0])
        if seen.all():
            return float(np.diff(stamps).max())
        before = stamps[0] - self.dt  # as if the frame before the window showed everything
        return max(float(np.diff(stamps[column], prepend=before).max()) for column in seen.T)

    def _status(self, last: Float[np.ndarray, "6 3"], trouble: Trouble, longest: float) -> Status:
        bones = np.array([np.linalg.norm(last[a] - last[b]) for a, b in BONE_ENDS])
        if not ((bones > BONES[0]) & (bones < BONES[1])).all():
            return Status.IMPLAUSIBLE
        if trouble & Trouble.JUMP:
            return Status.JUMP
        if trouble & (Trouble.OCCLUDED | Trouble.LOST):
            return Status.OCCLUDED
        if longest > LONG * self.dt:
            return Status.GAP
        return Status.REPEATED if trouble & Trouble.REPEATED else Status.OK


def _interpolate(
    positions: Float[np.ndarray, "K 6 3"], stamps: Float[np.ndarray, " K"], grid: Float[np.ndarray, " N"]
) -> Float[np.ndarray, "N 6 3"]:
    """Linear interpolation at the grid's instants; the first value is held before the first stamp."""
    right = np.clip(np.searchsorted(stamps, grid), 1, len(stamps) - 1)
    share = np.clip((grid - stamps[right - 1]) / (stamps[right] - stamps[right - 1]), 0.0, 1.0)[:, None, None]
    return (1 - share) * positions[right - 1] + share * positions[right]
