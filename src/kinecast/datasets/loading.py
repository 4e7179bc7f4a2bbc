"""Recordings from any file or folder: the format is found by content, and what was loaded is checked."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from itertools import pairwise
from pathlib import Path

import numpy as np

from kinecast.body.skeleton import ARM_JOINTS, require_arms
from kinecast.datasets import andy, bvh, ha4m, kth_handover, lego, mvnx, table, vicon
from kinecast.datasets.recording import Recording
from kinecast.errors import DatasetError, OptionError

BONE_RANGE = (0.10, 0.60)
"""Shortest and longest believable median upper arm or forearm [m]. Adults' are 0.2 to 0.4 m; between marker
clusters, which sit beside the joints, 0.13 to 0.32 m are measured."""

FARTHEST = 10_000.0  # largest believable coordinate [m]; larger ones are damage
_BONES = (*pairwise(ARM_JOINTS[:3]), *pairwise(ARM_JOINTS[3:]))
_UNITS = ((1000.0, "millimetres"), (100.0, "centimetres"), (39.37, "inches"))


@dataclass(frozen=True)
class Format:
    """A format of recordings."""

    name: str  # on the command line
    matches: Callable[[Path], bool]  # whether a file or folder is of it, by its content, plain or compressed
    load: Callable[[Path], list[Recording]]
    """Every recording in it; DatasetError, with file and line, where anything is not as the format has it."""


_FORMATS = (
    Format("kth-handover", kth_handover.matches, kth_handover.load),
    Format("ha4m", ha4m.matches, ha4m.load),
    Format("ha4m-features", ha4m.matches_features, ha4m.load_features),
    Format("andy", andy.matches, andy.load),
    Format("mvnx", mvnx.matches, mvnx.load),
    Format("bvh", bvh.matches, bvh.load),
    Format("vicon", vicon.matches, vicon.load),
    Format("table", table.matches, table.load),
    Format("lego", lego.matches, lego.load),
)
"""In the order they are tried: folders, then andy before the mvnx it contains."""

FORMATS = tuple(sorted(each.name for each in _FORMATS))  # names of the formats, as `load` takes them


CLIPS = ("pick_and_place", "handover")
"""What each recording that comes with kinecast shows."""


def shipped_clips() -> list[Recording]:
    """The recordings that come with kinecast, in the order of `CLIPS`: each a real person at work with a robot.

    Cut from JakobThumm/human-robot-animations, MIT, © 2023 Jakob Thumm; the licence and how they were cut lie beside
    them, in the folder data/clips of the package.

    Returns:
        600 and 436 frames at 30 Hz of 9 joints, the arms' six, collar, head and pelvis: (N, 9, 3) positions [m], z up,
        origins of bodies worn at the joints; nothing repaired, NaN where one was not seen.
    """
    with resources.as_file(resources.files("kinecast") / "data" / "clips") as folder:
        return load([folder / f"{name}.csv.xz" for name in CLIPS])


def load(
    paths: str | Path | Sequence[str | Path],
    format: str | None = None,
    progress: Callable[[int, int], None] | None = None,
    more: Sequence[Format] = (),
) -> list[Recording]:
    """Every recording in files or folders and all folders in them; at least one, by path, of unique names, each once.

    Hidden files and those that match no format are passed over. What lies in one of the folders is one collection; of
    a file, what lies beside it.

    Args:
        paths: one file or folder, or several.
        format: one of `FORMATS`; None to find it by content.
        progress: called with (done, total) files.
        more: formats beside `FORMATS`.

    Raises:
        DatasetError: nothing is found, a file does not match its format, or a recording fails `check`.
        OptionError: the format is unknown.
    """
    known = (*_FORMATS, *more)
    formats = [each for each in known if format in (None, each.name)]
    if not formats:
        raise OptionError(f"format is {format!r}, expected one of {', '.join(sorted(each.name for each in known))}")
    sources: dict[Path, tuple[Path, Format, str]] = {}
    for path in map(Path, [paths] if isinstance(paths, str | Path) else paths):
        if not path.exists():
            raise DatasetError(path, "no such file or folder")
        try:
            found = list(_sources(path, formats))
        except OSError as error:
            raise DatasetError(path, f"cannot be searched: {error}") from error
        if not found and format is not None and path.is_file():
            found = [(path, formats[0])]  # its loader knows best what does not match
        if not found:
            raise DatasetError(path, f"no recording found; formats tried: {', '.join(each.name for each in formats)}")
        collection = (path.resolve() if path.is_dir() else path.resolve().parent).name
        sources |= {source.resolve(): (source, each, collection) for source, each in found}
    recordings = []
    for done, (source, each, collection) in enumerate(sources.values(), 1):
        for recording in each.load(source):
            check(recording, source)
            recordings.append(replace(recording, collection=collection))
        if progress:
            progress(done, len(sources))
    return _with_unique_names(recordings)


def check(recording: Recording, where: object) -> None:
    """Check that a recording is of a person's two arms, in metres; `where` (file or folder) is for the message.

    Raises:
        DatasetError: fewer than 2 frames, an arm joint that is not tracked or never seen, a position
            beyond `FARTHEST`, or a median arm bone outside `BONE_RANGE`.
    """
    place = where if recording.person == "0" else f"{where}, person {recording.person}"
    frames = len(recording.stamps)
    if frames < 2:
        raise DatasetError(place, f"{frames} frame; at least 2 are needed")
    require_arms(recording.joints, place)
    distances = np.abs(recording.positions).max(axis=(1, 2), initial=0.0, where=~np.isnan(recording.positions))
    if (distances > FARTHEST).any():
        frame = int(np.argmax(distances > FARTHEST))
        problem = f"a position is {distances[frame]:.3g} m away, expected at most {FARTHEST:g} m"
        raise DatasetError(f"{place}, frame {frame + 1}", problem)
    unseen = [joint for joint in ARM_JOINTS if np.isnan(recording.joint(joint)).any(axis=-1).all()]
    if unseen:
        raise DatasetError(place, f"{', '.join(unseen)} missing in every one of {frames} frames")
    shortest, longest = BONE_RANGE
    for upper, lower in _BONES:
        lengths = np.linalg.norm(recording.joint(upper) - recording.joint(lower), axis=-1)
        if not np.isfinite(lengths).any():
            raise DatasetError(place, f"{upper} to {lower} are never seen together")
        median = float(np.nanmedian(lengths))
        if not shortest <= median <= longest:
            unit = next((unit for scale, unit in _UNITS if shortest <= median / scale <= longest), None)
            allowed = f"an arm's bone is {shortest} to {longest} m"
            advice = f"; the file seems to be in {unit}" if unit else ""
            raise DatasetError(place, f"{upper} to {lower} is {median:.4g} m (median), but {allowed}{advice}")


def _sources(path: Path, formats: Sequence[Format]) -> Iterator[tuple[Path, Format]]:
    """Every file or folder at or below a path that one of the formats matches, in natural order."""
    matching = next((each for each in formats if each.matches(path)), None)
    if matching:
        yield path, matching
    elif path.is_dir():
        for child in sorted(path.iterdir(), key=_natural_order):
            if not child.name.startswith(".") and not (child.is_symlink() and child.is_dir()):
                yield from _sources(child, formats)


def _natural_order(path: Path) -> tuple[tuple[int, str], ...]:
    """A key that puts `take 2` before `take 10`."""
    return tuple((int(digits or 0), text) for digits, text in re.findall(r"(\d*)(\D*)", path.name))


def _with_unique_names(recordings: list[Recording]) -> list[Recording]:
    """Recordings of one name told apart by their folder, else by a number."""
    again = Counter(recording.name for recording in recordings)
    seen: Counter[str] = Counter()
    unique = []
    for recording in recordings:
        name = recording.name
        if recording.source and again[name] > 1:
            name = f"{recording.source.absolute().parent.name}/{name}"
        seen[name] += 1
        unique.append(replace(recording, name=name if seen[name] == 1 else f"{name}#{seen[name]}"))
    return unique
