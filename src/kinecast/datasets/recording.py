"""A recording: one person's joints over time, in metres, seconds and a z-up right-handed world."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from kinecast.errors import DatasetError

__all__ = ["Recording"]


@dataclass(frozen=True)
class Recording:
    """One person's skeleton over time, as loaded: nothing repaired, nothing dropped.

    Attributes:
        name: short unique name for tables, e.g. `"PickPlaceCloseHuman/0"`.
        joints: canonical joint names (kinecast.body.skeleton), one per column of `positions`.
        stamps: (N,) acquisition times [s], strictly increasing.
        positions: (N, J, 3) joint positions [m], z up; NaN where missing.
        rate: nominal frames per second [Hz].
        source: file or folder it came from; None for generated ones.
        format: name of the format it was read from, e.g. `"vicon"`.
        person: id of the person within the source.
        subject: id of the person across sources ("" where unknown); splits by subject use it.
        task: what is being done ("" where unknown); splits by task use it.
        labels: one label per frame, or None.
        notes: what a user must know, e.g. `"rate not stated by the format; 30 Hz assumed"`.
    """

    name: str
    joints: tuple[str, ...]
    stamps: Float[np.ndarray, " N"]
    positions: Float[np.ndarray, "N J 3"]
    rate: float
    source: Path | None = None
    format: str = "generated"
    person: str = "0"
    subject: str = ""
    task: str = ""
    labels: tuple[str, ...] | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        where = self.source or self.name
        frames, joints = self.positions.shape[:2]
        if joints != len(self.joints):
            raise DatasetError(where, f"{joints} joint columns for {len(self.joints)} joint names")
        if len(set(self.joints)) != len(self.joints):
            raise DatasetError(where, f"joint names repeat: {', '.join(self.joints)}")
        if self.stamps.shape != (frames,):
            raise DatasetError(where, f"{len(self.stamps)} stamps for {frames} frames")
        if frames > 1 and not np.all(np.diff(self.stamps) > 0):
            row = int(np.argmin(np.diff(self.stamps) > 0)) + 1
            raise DatasetError(where, f"frame {row}: stamps must increase, found {self.stamps[row]} s")
        if not (np.isfinite(self.rate) and 0 < self.rate <= 10_000):
            raise DatasetError(where, f"rate {self.rate} Hz is outside (0, 10000]")
        if self.labels is not None and len(self.labels) != frames:
            raise DatasetError(where, f"{len(self.labels)} labels for {frames} frames")

    @property
    def valid(self) -> Bool[np.ndarray, "N J"]:
        """(N, J) True where a joint was tracked."""
        return np.isfinite(self.positions).all(axis=-1)

    @property
    def duration(self) -> float:
        """Time from first to last frame [s]."""
        return float(self.stamps[-1] - self.stamps[0]) if len(self.stamps) else 0.0

    def joint(self, name: str) -> Float[np.ndarray, "N 3"]:
        """(N, 3) positions [m] of one joint; all NaN where the recording does not track it."""
        if name not in self.joints:
            return np.full((len(self.stamps), 3), np.nan)
        return self.positions[:, self.joints.index(name)]

    def select(self, frames: slice) -> Recording:
        """The same recording, a range of its frames."""
        labels = None if self.labels is None else self.labels[frames]
        return replace(self, stamps=self.stamps[frames], positions=self.positions[frames], labels=labels)
