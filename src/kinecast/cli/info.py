"""`kinecast info`: what recordings hold."""

from __future__ import annotations

import json
from typing import Annotated

from tyro.conf import arg

from kinecast.cli.options import FormatName, Switch, What
from kinecast.cli.progress import progress_bar
from kinecast.cli.recordings import read_recordings
from kinecast.datasets.summary import summarise


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
