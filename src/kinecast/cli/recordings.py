"""Recordings read for a command, and those it must not learn from."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

from kinecast.cli.formats import MORE_FORMATS
from kinecast.cli.progress import note, progress_bar
from kinecast.datasets.loading import load_all
from kinecast.datasets.recording import Recording
from kinecast.errors import OptionError


def read_recordings(paths: Sequence[Path], format: str | None, option: str = "") -> list[Recording]:
    """Every recording in files or folders, with a progress bar; `option` is what the paths were given with.

    Raises:
        OptionError: no paths.
        DatasetError: as `load_all`.
    """
    if not paths:
        raise OptionError(f"{option}: no recording given".removeprefix(": "))
    with progress_bar("reading") as progress:
        return load_all(paths, format, progress=progress, more=MORE_FORMATS)


def one_scene(recordings: Sequence[Recording], path: Path, command: str) -> Sequence[Recording]:
    """All recordings that a path holds; OptionError unless they may be of one scene, a person each."""
    if len({recording.person for recording in recordings}) < len(recordings):
        names = listed([recording.name for recording in recordings])
        raise OptionError(f"{path}: holds {len(recordings)} recordings ({names}); {command} takes one")
    return recordings


def unseen(train: Sequence[Recording], test: Sequence[Recording]) -> list[Recording]:
    """The training recordings that are not test recordings too, by content; OptionError if none is left."""
    tested = {_content(recording) for recording in test}
    kept = [recording for recording in train if _content(recording) not in tested]
    left_out = [recording.name for recording in train if _content(recording) in tested]
    if not kept:
        raise OptionError(
            f"every training recording is also a test recording ({listed(left_out)}); nothing is left to train on"
        )
    if left_out:
        note(f"not trained on, because they are test recordings: {listed(left_out)}")
    return kept


def listed(names: Sequence[str], most: int = 6) -> str:
    """Names with commas between them, the first few of many."""
    rest = len(names) - most
    return ", ".join(names[:most]) + (f" and {rest} more" if rest > 0 else "")


def _content(recording: Recording) -> tuple[tuple[int, ...], bytes]:
    """Equal for recordings of equal positions."""
    positions = recording.positions
    return positions.shape, hashlib.sha256(positions.tobytes()).digest()
