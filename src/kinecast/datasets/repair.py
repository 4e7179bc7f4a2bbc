"""Repair of a whole recording: repeated frames, gaps and jumps, and a report of what was touched.

With hindsight, so only for recordings; a window of an online predictor is repaired by
`kinecast.body.tracking.repair_window`, from nothing but itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Int8

from kinecast.body.tracking import fill, find_flaws
from kinecast.datasets.recording import Recording

MAX_GAP = 0.2
"""Flaws are interpolated up to this length [s]. Longer gaps and jumps become NaN, longer repeats stay as recorded."""


@dataclass(frozen=True)
class RepairReport:
    """What a repair found and what it did."""

    flaws: Int8[np.ndarray, "N J"]
    """The `kinecast.body.tracking.Flaw` of each value as recorded."""
    interpolated: Bool[np.ndarray, "N J"]
    """True where the value is not the recorded one but interpolated."""


def repair(recording: Recording) -> tuple[Recording, RepairReport]:
    """The recording with short flaws interpolated and jumps cut out, and what was touched.

    Values without a flaw keep every bit. Resample after the repair, not before, or jumps are smeared.
    """
    flaws = find_flaws(recording.positions, recording.stamps)
    filled, interpolated = fill(recording.positions, recording.stamps, flaws, MAX_GAP)
    return replace(recording, positions=filled), RepairReport(flaws, interpolated)
