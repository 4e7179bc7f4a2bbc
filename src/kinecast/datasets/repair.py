"""Repair of a whole recording: repeated frames, gaps and jumps, and a report of what was touched.

With hindsight, so only for recordings; a window of an online predictor is repaired by
`kinecast.body.tracking.repair_window`, from nothing but itself.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Int8

from kinecast.body.tracking import Flaw, TrackingLimits, fill, find_flaws
from kinecast.datasets.recording import Recording
from kinecast.errors import OptionError

__all__ = ["JointRepair", "RepairOptions", "RepairReport", "repair"]


@dataclass(frozen=True)
class RepairOptions:
    """What is repaired.

    Attributes:
        max_gap: flaws are interpolated up to this length [s], 0 for none. Longer gaps and jumps become NaN,
            longer repeats stay as recorded.
        limits: what counts as a jump.

    Raises:
        OptionError: max_gap negative or longer than 2 s.
    """

    max_gap: float = 0.2
    limits: TrackingLimits = field(default_factory=TrackingLimits)

    def __post_init__(self) -> None:
        if not 0 <= self.max_gap <= 2:
            raise OptionError(f"longest gap to interpolate is {self.max_gap} s, allowed is 0 to 2 s")


@dataclass(frozen=True)
class JointRepair:
    """What happened to one joint: frames per flaw, and how many of them were interpolated."""

    repeated: int
    missing: int
    jump: int
    interpolated: int
    left_missing: int


@dataclass(frozen=True)
class RepairReport:
    """What a repair found and what it did.

    Attributes:
        joints: J joint names.
        flaws: (N, J) the `Flaw` of each value as recorded.
        interpolated: (N, J) True where the value is not the recorded one but interpolated.
        removed: (N, J) True where a recorded value was cut out and is now NaN.
    """

    joints: tuple[str, ...]
    flaws: Int8[np.ndarray, "N J"]
    interpolated: Bool[np.ndarray, "N J"]
    removed: Bool[np.ndarray, "N J"]

    @property
    def touched(self) -> Bool[np.ndarray, "N J"]:
        """(N, J) True where the value differs from the recorded one."""
        touched: Bool[np.ndarray, "N J"] = np.logical_or(self.interpolated, self.removed)
        return touched

    def frames(self, flaw: Flaw, joint: str) -> list[int]:
        """Indices of the frames in which a joint has this flaw."""
        return [int(i) for i in np.flatnonzero(self.flaws[:, self.joints.index(joint)] == flaw)]

    def joint(self, name: str) -> JointRepair:
        """Counts for one joint."""
        column = self.joints.index(name)
        flaws, filled = self.flaws[:, column], self.interpolated[:, column]
        return JointRepair(
            repeated=int(np.count_nonzero(flaws == Flaw.REPEATED)),
            missing=int(np.count_nonzero(flaws == Flaw.MISSING)),
            jump=int(np.count_nonzero(flaws == Flaw.JUMP)),
            interpolated=int(np.count_nonzero(filled)),
            left_missing=int(np.count_nonzero((flaws >= Flaw.MISSING) & ~filled)),
        )

    @property
    def repeated_frames(self) -> int:
        """Frames that are copies of the one before them."""
        return int(np.count_nonzero((self.flaws == Flaw.REPEATED).any(axis=1)))

    def summary(self) -> dict[str, Any]:
        """Counts over the recording and per joint, and the frames of each kind, for JSON."""
        return {
            "frames": len(self.flaws),
            "repeated_frames": self.repeated_frames,
            "interpolated": int(np.count_nonzero(self.interpolated)),
            "removed": int(np.count_nonzero(self.removed)),
            "joints": {
                name: {
                    **vars(self.joint(name)),
                    "jump_frames": self.frames(Flaw.JUMP, name),
                    "missing_spans": spans(self.flaws[:, column] == Flaw.MISSING),
                }
                for column, name in enumerate(self.joints)
            },
        }


def repair(recording: Recording, options: RepairOptions | None = None) -> tuple[Recording, RepairReport]:
    """The recording with short flaws interpolated and jumps cut out, and what was touched.

    Values without a flaw keep every bit.

    Args:
        recording: as loaded; resample after the repair, not before, or jumps are smeared.
        options: see RepairOptions.
    """
    options = options or RepairOptions()
    flaws = find_flaws(recording.positions, recording.stamps, options.limits)
    filled, interpolated = fill(recording.positions, recording.stamps, flaws, options.max_gap)
    repaired = replace(recording, positions=filled)
    removed = np.logical_and(recording.valid, np.logical_not(repaired.valid))
    report = RepairReport(recording.joints, flaws, interpolated, removed)
    return repaired, report


def spans(marked: Bool[np.ndarray, " N"]) -> list[tuple[int, int]]:
    """Runs of True as (first index, length)."""
    edges = np.diff(np.concatenate([[0], marked.astype(np.int8), [0]]))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return [(int(a), int(b - a)) for a, b in zip(starts, ends, strict=True)]
