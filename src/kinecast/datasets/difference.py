"""How recordings differ from what was read back of them: what a format could not hold."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kinecast.datasets.recording import Recording

__all__ = ["differences"]

WORDS = ("name", "format", "subject", "task", "labels")


def differences(before: Sequence[Recording], after: Sequence[Recording]) -> list[str]:
    """What is not the same, in words; nothing where recordings are equal to the last bit.

    Args:
        before: recordings of different persons.
        after: the same, read back.
    """
    found: dict[str, None] = {}
    back = {recording.person: recording for recording in after}
    for recording in before:
        if recording.person not in back:
            found[f"person {recording.person}"] = None
            continue
        for line in _between(recording, back.pop(recording.person)):
            found[f"{line} (person {recording.person})" if len(before) > 1 else line] = None
    found |= dict.fromkeys(f"nothing, but person {person} is new" for person in back)
    return list(found)


def _between(a: Recording, b: Recording) -> list[str]:
    lines = []
    for name in WORDS:
        one, other = getattr(a, name), getattr(b, name)
        if one != other:
            lines.append(f"{name}: {_short(one)} became {_short(other)}")
    if a.source is not None and a.source != b.source:
        lines.append(f"source: {_short(a.source)} became {_short(b.source)}")
    lines.extend(f"note: {note}" for note in a.notes if note not in b.notes)
    if a.rate != b.rate:
        lines.append(f"rate: {a.rate!r} Hz became {b.rate!r} Hz")
    missing = [joint for joint in a.joints if joint not in b.joints]
    if missing:
        lines.append(f"joints: {', '.join(missing)}")
    elif a.joints != b.joints:
        lines.append("order of the joints")
    if len(a.stamps) != len(b.stamps):
        return [*lines, f"frames: {len(a.stamps)} became {len(b.stamps)}"]
    if (a.stamps != b.stamps).any():
        lines.append(f"stamps: moved by up to {np.abs(a.stamps - b.stamps).max():.3g} s")
    for joint in (joint for joint in a.joints if joint in b.joints):
        one, other = a.joint(joint), b.joint(joint)
        if (np.isnan(one) != np.isnan(other)).any():
            lines.append(
                f"{joint}: seen in {np.isfinite(one).sum() // 3} frames became {np.isfinite(other).sum() // 3}"
            )
        away = np.nanmax(np.abs(one - other), initial=0.0)
        if away > 0:
            lines.append(f"{joint}: moved by up to {1e3 * away:.3g} mm")
    return lines


def _short(value: object) -> str:
    """A value in a line."""
    if isinstance(value, Path):
        value = value.name
    if value in (None, "", ()):
        return "nothing"
    if isinstance(value, tuple):
        return f"{len(value)} of them" if len(value) > 3 else ", ".join(map(str, value))
    return str(value)
