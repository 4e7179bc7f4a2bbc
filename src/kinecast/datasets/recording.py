"""A recording: one person's joints over time, in metres, seconds and a z-up right-handed world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.errors import DatasetError


@dataclass(frozen=True)
class Recording:
    """One person's skeleton over time, as loaded: nothing repaired, nothing dropped."""

    name: str  # short and unique, for tables, e.g. "PickPlaceCloseHuman/0"
    joints: tuple[str, ...]  # canonical names (kinecast.body.skeleton), one per column of `positions`
    stamps: Float[np.ndarray, " N"]  # acquisition times [s], strictly increasing
    positions: Float[np.ndarray, "N J 3"]  # [m], z up; NaN where missing
    rate: float  # nominal frames per second [Hz]
    source: Path | None = None  # file or folder it came from; None for generated ones
    format: str = "generated"  # name of the format it was read from, e.g. "vicon"
    person: str = "0"  # id of the person within the source
    subject: str = ""  # id of the person across sources, "" where unknown
    task: str = ""  # what is being done, "" where unknown
    labels: tuple[str, ...] | None = None  # one per frame
    collection: str = ""  # what it was loaded with: recordings of one sensor at one place; training weighs them
    notes: tuple[str, ...] = ()  # what a user must know, e.g. "rate not stated by the format; 30 Hz assumed"

    def __post_init__(self) -> None:
        where = self.source or self.name
        frames, joints = self.positions.shape[:2]
        if joints != len(self.joints):
            raise DatasetError(where, f"{joints} joint columns for {len(self.joints)} joint names")
        if len(set(self.joints)) != len(self.joints):
            raise DatasetError(where, f"joint names repeat: {', '.join(self.joints)}")
        if self.stamps.shape != (frames,):
            raise DatasetError(where, f"{len(self.stamps)} stamps for {frames} frames")
        later = np.diff(self.stamps) > 0
        if not later.all():
            row = int(np.argmin(later)) + 1
            raise DatasetError(where, f"frame {row}: stamps must increase, found {self.stamps[row]} s")
        if not (np.isfinite(self.rate) and 0 < self.rate <= 10_000):
            raise DatasetError(where, f"rate {self.rate} Hz is outside (0, 10000]")
        if self.labels is not None and len(self.labels) != frames:
            raise DatasetError(where, f"{len(self.labels)} labels for {frames} frames")

    @property
    def duration(self) -> float:
        """Time from first to last frame [s]."""
        return float(self.stamps[-1] - self.stamps[0]) if len(self.stamps) else 0.0

    def joint(self, name: str) -> Float[np.ndarray, "N 3"]:
        """(N, 3) positions [m] of one joint; all NaN where the recording does not track it."""
        if name not in self.joints:
            return np.full((len(self.stamps), 3), np.nan)
        return self.positions[:, self.joints.index(name)]

    @property
    def arms(self) -> Float[np.ndarray, "N 6 3"]:
        """(N, 6, 3) positions [m] of `ARM_JOINTS`."""
        return np.stack([self.joint(name) for name in ARM_JOINTS], axis=1)

    def select(self, frames: slice) -> Recording:
        """The same recording, a range of its frames."""
        labels = None if self.labels is None else self.labels[frames]
        return replace(self, stamps=self.stamps[frames], positions=self.positions[frames], labels=labels)


@dataclass(frozen=True)
class Description:
    """What a recording is beside its frames, as a file's metadata holds it.

    Raises:
        TypeError: an entry of another type.
    """

    name: str
    person: str
    joints: list[str]
    rate: float
    source: str | None
    format: str
    subject: str
    task: str
    notes: list[str]
    labelled: bool | None = None  # None where files do not say

    def __post_init__(self) -> None:
        words = [self.name, self.person, self.format, self.subject, self.task, *self.joints, *self.notes]
        if not all(isinstance(word, str) for word in words) or not isinstance(self.source, str | None):
            raise TypeError(f"a name in {self} is no text")
        if not isinstance(self.rate, float | int) or not isinstance(self.labelled, bool | None):
            raise TypeError(f"rate {self.rate!r} is no number, or labelled {self.labelled!r} not true or false")

    def recording(
        self, stamps: Float[np.ndarray, " N"], positions: Float[np.ndarray, "N J 3"], labels: tuple[str, ...] | None
    ) -> Recording:
        """The recording of these frames."""
        return Recording(
            self.name, tuple(self.joints), stamps, positions, self.rate,
            source=None if self.source is None else Path(self.source), format=self.format, person=self.person,
            subject=self.subject, task=self.task, labels=labels, notes=tuple(self.notes),
        )  # fmt: skip


def describe(recording: Recording) -> Description:
    """What a recording is beside its frames."""
    r = recording
    return Description(
        r.name, r.person, list(r.joints), r.rate, str(r.source) if r.source else None, r.format, r.subject,
        r.task, list(r.notes), labelled=r.labels is not None,
    )  # fmt: skip


def differences(before: Sequence[Recording], after: Sequence[Recording]) -> list[str]:
    """What is not the same in recordings of different persons and those read back, in words; none if every bit is."""
    back = {recording.person: recording for recording in after}
    found = [f"person {recording.person}" for recording in before if recording.person not in back]
    for recording in before:
        if other := back.pop(recording.person, None):
            where = f" (person {recording.person})" if len(before) > 1 else ""
            found += [f"{line}{where}" for line in _between(recording, other)]
    return list(dict.fromkeys([*found, *(f"nothing, but person {person} is new" for person in back)]))


def _between(a: Recording, b: Recording) -> list[str]:
    """What is not the same in two recordings of one person."""
    names = ["name", "format", "subject", "task", "labels", *(["source"] if a.source else [])]
    pairs = [(name, getattr(a, name), getattr(b, name)) for name in names]
    lines = [f"{name}: {_short(one)} became {_short(other)}" for name, one, other in pairs if one != other]
    lines += [f"note: {note}" for note in a.notes if note not in b.notes]
    if a.rate != b.rate:
        lines.append(f"rate: {a.rate!r} Hz became {b.rate!r} Hz")
    if missing := [joint for joint in a.joints if joint not in b.joints]:
        lines.append(f"joints: {', '.join(missing)}")
    elif a.joints != b.joints:
        lines.append("order of the joints")
    if len(a.stamps) != len(b.stamps):
        return [*lines, f"frames: {len(a.stamps)} became {len(b.stamps)}"]
    if (a.stamps != b.stamps).any():
        lines.append(f"stamps: moved by up to {np.abs(a.stamps - b.stamps).max():.3g} s")
    for joint in (joint for joint in a.joints if joint in b.joints):
        one, other = a.joint(joint), b.joint(joint)
        seen, still = np.isfinite(one), np.isfinite(other)
        if (seen != still).any():
            lines.append(f"{joint}: seen in {seen.sum() // 3} frames became {still.sum() // 3}")
        away = np.nanmax(np.abs(one - other), initial=0.0)
        if away > 0:
            lines.append(f"{joint}: moved by up to {1e3 * away:.3g} mm")
    return lines


def _short(value: object) -> str:
    """A value in a line."""
    if value in (None, "", ()):
        return "nothing"
    if isinstance(value, tuple):
        return f"{len(value)} of them" if len(value) > 3 else ", ".join(map(str, value))
    return value.name if isinstance(value, Path) else str(value)
