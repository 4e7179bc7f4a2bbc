"""`kinecast info`: what recordings hold."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import tyro

from kinecast.datasets.loading import load_all
from kinecast.datasets.summary import summarise

__all__ = ["info"]


def info(
    paths: Annotated[tuple[Path, ...], tyro.conf.Positional],
    format: str | None = None,
    as_json: bool = False,
) -> None:
    """What recordings hold: format, joints, rate, length, gaps, jumps, bones, speeds, and what repair would do.

    Args:
        paths: recordings, or folders of them.
        format: read them as this format instead of finding it by content.
        as_json: print JSON instead of text.
    """
    summaries = [summarise(recording) for recording in load_all(paths, format)]
    if as_json:
        print(json.dumps([summary.as_json() for summary in summaries], indent=1))
    else:
        print("\n\n".join("\n".join(summary.lines()) for summary in summaries))
