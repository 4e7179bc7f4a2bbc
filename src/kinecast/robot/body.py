"""A person as capsules around measured joints: arms, hands, trunk, head."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Int
from numba import njit

from kinecast.robot.occupancy import OccupancyOptions

__all__ = ["TRUE_BODY", "BodyCapsules", "body_capsules"]

TRUE_BODY = OccupancyOptions(
    upper_arm=0.06, forearm=0.05, hand=0.055, hand_length=0.10, shoulders=0.11, trunk=0.16, head=0.11
)
"""A large adult without clothes and without the tracker's error (estimates; see OccupancyOptions): what
touches this touches the person. The arm's side keeps away from more than that."""
_NAMES = (
    "left_shoulder", "left_elbow", "left_wrist", "right_shoulder", "right_elbow", "right_wrist", "pelvis", "head",
)  # fmt: skip


@dataclass(frozen=True)
class BodyCapsules:
    """Capsules of one person; NaN where a joint is not known.

    Attributes:
        start, end: (K, 3) ends of the axes [m].
        radius: (K,) [m].
    """

    start: Float[np.ndarray, "K 3"]
    end: Float[np.ndarray, "K 3"]
    radius: Float[np.ndarray, " K"]


def body_capsules(
    joints: tuple[str, ...], positions: Float[np.ndarray, "J 3"], options: OccupancyOptions | None = None
) -> BodyCapsules:
    """Both upper arms, forearms and hands, the shoulders, the trunk and the head.

    Args:
        joints: canonical names; both arms at least (kinecast.body.skeleton).
        positions: (J, 3) [m]; NaN where not known.
        options: radii and lengths that joints do not tell.

    Returns:
        K = 9 capsules; trunk and head follow from the shoulders where they are not tracked.
    """
    o = options or OccupancyOptions()
    ends = _ends(
        np.ascontiguousarray(positions, dtype=np.float64), _rows(joints), o.hand_length, o.trunk_length, o.head_height
    )
    return BodyCapsules(ends[0], ends[1], o.radii)


@lru_cache(maxsize=64)
def _rows(joints: tuple[str, ...]) -> Int[np.ndarray, "8"]:
    """(8,) rows of shoulder, elbow and wrist, left and right, pelvis and head; -1 for one that is not tracked."""
    return np.array([joints.index(name) if name in joints else -1 for name in _NAMES])


@njit(cache=True)
@no_type_check
def _ends(positions: np.ndarray, rows: np.ndarray, palm: float, trunk: float, head: float) -> np.ndarray:
    """(2, 9, 3) starts and ends of the axes for joints (J, 3)."""
    places = np.full((8, 3), np.nan)
    for n in range(8):
        if rows[n] >= 0 and np.isfinite(positions[rows[n]]).all():
            places[n] = positions[rows[n]]
    middle = (places[0] + places[3]) / 2
    for n, above in ((6, -trunk), (7, head)):
        if np.isnan(places[n, 0]):
            places[n] = middle
            places[n, 2] += above
    ends = np.empty((2, 9, 3))
    for side in range(0, 6, 3):
        line = places[side + 2] - places[side + 1]
        length = max(math.sqrt(line[0] * line[0] + line[1] * line[1] + line[2] * line[2]), 1e-6)
        ends[0, side : side + 3] = places[side : side + 3]
        ends[1, side : side + 2] = places[side + 1 : side + 3]
        ends[1, side + 2] = places[side + 2] + palm * line / length
    ends[0, 6], ends[1, 6] = places[0], places[3]
    ends[0, 7], ends[1, 7] = middle, places[6]
    ends[0, 8], ends[1, 8] = places[7], places[7]
    return ends
