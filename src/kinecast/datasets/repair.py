"""Repair of a whole recording: repeated frames, gaps and jumps.

With hindsight, so only for recordings; a window of an online predictor is repaired by
`kinecast.body.tracking.repair_window`, from nothing but itself.
"""

from __future__ import annotations

from dataclasses import replace

from kinecast.body.tracking import fill, find_flaws
from kinecast.datasets.recording import Recording

MAX_GAP = 0.2
"""Flaws are interpolated up to this length [s]. Longer gaps and jumps become NaN, longer repeats stay as recorded."""


def repair(recording: Recording) -> Recording:
    """The recording with short flaws interpolated and jumps cut out; values without a flaw keep every bit.

    Resample after the repair, not before, or jumps are smeared.
    """
    flaws = find_flaws(recording.positions, recording.stamps)
    return replace(recording, positions=fill(recording.positions, recording.stamps, flaws, MAX_GAP)[0])
