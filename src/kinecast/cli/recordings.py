"""Recordings as commands read and write them, in all formats; `kinecast info` and `kinecast convert`."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import Positional, arg

from kinecast.cli.options import Switch, What, check_file
from kinecast.cli.progress import note, progress_bar
from kinecast.datasets import table
from kinecast.datasets.files import head
from kinecast.datasets.loading import FORMATS, Format, load
from kinecast.datasets.recording import Recording, differences
from kinecast.datasets.summary import summarise
from kinecast.errors import OptionError
from kinecast.output import draft


def _is(format: str, path: Path) -> bool:
    """Whether a file or folder begins as one of this format."""
    if path.is_dir():
        about = path / "metadata.yaml"
        return format == "bag" and about.is_file() and head(about).startswith(b"rosbag2_bagfile_information")
    start = head(path) if path.is_file() else b""
    if start.startswith(b"\x89MCAP0\r\n"):
        return format == ("bag" if start[21:25] == b"ros2" else "mcap")  # the profile in its header
    if format == "bag":
        return start.startswith(b"#ROSBAG V2.0")
    return format == "jsonl" and start.lstrip().startswith(b"{")


def _lazily(module: str, function: str) -> Callable[..., Any]:
    """A function of a module that needs an extra, imported when it is called."""

    def call(*arguments: Any) -> Any:
        return getattr(importlib.import_module(f"kinecast.{module}"), function)(*arguments)

    return call


MORE_FORMATS = tuple(
    Format(name, partial(_is, name), _lazily(module, "load"))
    for name, module in (("bag", "ros.bags"), ("mcap", "live.mcap_file"), ("jsonl", "live.message_file"))
)
FORMAT_NAMES = tuple(sorted((*FORMATS, *(each.name for each in MORE_FORMATS))))
FormatName = Annotated[
    str | None,
    arg(
        metavar="NAME",
        help=f"format of the recordings: {', '.join(FORMAT_NAMES)}.",
        help_behavior_hint="(default: found by content)",
    ),
]
WRITERS: Mapping[str, Callable[[Path, Sequence[Recording]], None]] = {
    ".parquet": table.write,
    ".csv": table.write,
    ".mcap": _lazily("live.mcap_file", "write"),
    ".jsonl": _lazily("live.message_file", "write"),
    ".bag": _lazily("ros.bags", "write"),
    ".rosbag2": _lazily("ros.bags", "write"),
}
"""What writes a file of each ending, or with `.rosbag2` a folder; recordings are of different persons."""

UNREAD: Mapping[str, str] = {
    "bag": "orientations, coordinate frames and other topics",
    "vicon": "rotations of the rigid bodies",
    "bvh": "rotations and offsets of the joints",
    "mvnx": "orientations, velocities, sensors and joint angles",
    "andy": "orientations, velocities, sensors and joint angles; labels of single annotators and of other tracks",
    "ha4m": "orientations, confidences and image points",
    "kth-handover": "orientations",
}
"""What files of a format may hold that no recording does."""
NO_BVH = "BVH holds the rotations of a skeleton whose bones keep their length, which positions do not tell"


def read_recordings(paths: Sequence[Path], format: str | None, option: str = "") -> list[Recording]:
    """Every recording in files or folders, at least one; `option` is what the paths were given with, for an error."""
    if not paths:
        raise OptionError(f"{option}: no recording given".removeprefix(": "))
    with progress_bar("reading") as progress:
        return load(paths, format, progress=progress, more=MORE_FORMATS)


def one_scene(recordings: Sequence[Recording], path: Path, command: str) -> Sequence[Recording]:
    """All recordings that a path holds; OptionError unless they may be of one scene, a person each."""
    if len({recording.person for recording in recordings}) < len(recordings):
        names = listed([recording.name for recording in recordings])
        raise OptionError(f"{path}: holds {len(recordings)} recordings ({names}); {command} takes one")
    return recordings


def unseen(train: Sequence[Recording], test: Sequence[Recording]) -> list[Recording]:
    """The training recordings that are not test recordings too, by content; OptionError if none is left."""
    known = [any(np.array_equal(a.positions, b.positions, equal_nan=True) for b in test) for a in train]
    left_out = listed([recording.name for recording, out in zip(train, known, strict=True) if out])
    if all(known):
        raise OptionError(
            f"every training recording is also a test recording ({left_out}); nothing is left to train on"
        )
    if left_out:
        note(f"not trained on, because they are test recordings: {left_out}")
    return [recording for recording, out in zip(train, known, strict=True) if not out]


def listed(names: Sequence[str], most: int = 6) -> str:
    """Names with commas between them, the first few of many."""
    rest = len(names) - most
    return ", ".join(names[:most]) + (f" and {rest} more" if rest > 0 else "")


def info(
    paths: What,
    format: FormatName = None,
    as_json: Annotated[Switch, arg(name="json")] = False,
) -> None:
    """What recordings hold: format, joints, rate, length, gaps, jumps, bones, speeds, and what repair would do.

    Args:
        paths: recordings, or folders of them.
        as_json: print JSON instead of text.
    """
    recordings = read_recordings(paths, format)
    summaries = []
    with progress_bar("measuring") as progress:
        for recording in recordings:
            summaries.append(summarise(recording))
            progress(len(summaries), len(recordings))
    if as_json:
        print(json.dumps([summary.as_json() for summary in summaries], indent=1))
    else:
        print("\n\n".join("\n".join(summary.lines()) for summary in summaries))


def convert(
    source: Annotated[Positional[Path], arg(metavar="A")],
    target: Annotated[Positional[Path], arg(metavar="B")],
    force: Switch = False,
    format: FormatName = None,
) -> None:
    """Writes a recording in another format, reads it back, and says what is lost.

    Args:
        source: a recording, of one person or of several at the same time.
        target: the file to write, ending in .parquet, .csv, .mcap, .jsonl or .bag, or a folder ending in .rosbag2.
        force: replace a file that is there; never a folder.
    """
    if target.suffix == ".bvh":
        raise OptionError(f"{target}: cannot be written; {NO_BVH}")
    check_file(target, tuple(WRITERS), "B")
    if target.exists() and source.exists() and target.samefile(source):
        raise OptionError(f"{target}: is what is to be converted")
    if target.exists() and not force:
        raise OptionError(f"{target}: is there already; --force replaces it")
    here = source.resolve()
    recordings = one_scene(read_recordings((source,), format), source, "convert")
    with draft(target.absolute().parent, target.name) as folder:
        written = folder / target.name
        with progress_bar("writing"):
            WRITERS[target.suffix](written, recordings)
        lost = differences(recordings, load([written], more=MORE_FORMATS))
        if written.is_file():
            written.chmod(0o644)
        written.replace(target)
    frames, persons = sum(len(each.stamps) for each in recordings), len(recordings)
    print(f"{target}: {frames} frames of {persons} person{'s' * (persons != 1)}")
    of_file = {each.format for each in recordings if each.source and each.source.resolve().is_relative_to(here)}
    lost = [f"{UNREAD[name]}, which kinecast does not read" for name in of_file & set(UNREAD)] + lost
    print("\n".join(f"  lost: {each}" for each in lost) if lost else "  nothing is lost")
