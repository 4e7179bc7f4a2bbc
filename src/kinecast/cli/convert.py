"""`kinecast convert`: recordings in another format, and what is lost on the way."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from kinecast.cli.options import FormatName, Switch, check_file
from kinecast.cli.progress import progress_bar
from kinecast.cli.recordings import MORE_FORMATS, UNREAD, WRITERS, one_scene, read_recordings
from kinecast.datasets.loading import load
from kinecast.datasets.recording import differences
from kinecast.errors import OptionError
from kinecast.output import draft

NO_BVH = "BVH holds the rotations of a skeleton whose bones keep their length, which positions do not tell"


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
