"""A person as capsules around joints: arms, hands, trunk, head."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Int
from numba import njit

from kinecast.errors import OptionError

__all__ = ["PARTS", "TRUE_BODY", "BodyCapsules", "OccupancyOptions", "body_capsules"]

PARTS = (
    "left_upper_arm", "left_forearm", "left_hand", "right_upper_arm", "right_forearm", "right_hand",
    "shoulders", "trunk", "head",
)  # fmt: skip
"""The capsules of one person, in this order; persons follow one another."""
_NAMES = (
    "left_shoulder", "left_elbow", "left_wrist", "right_shoulder", "right_elbow", "right_wrist", "pelvis", "head",
)  # fmt: skip


@dataclass(frozen=True)
class OccupancyOptions:
    """How large a person is taken to be, and what of a prediction counts as space that may be filled.

    Attributes:
        level: probability that each capsule holds its limb, in (0, 1].
        upper_arm, forearm, hand: radii of the limbs [m]. Estimates: a large man's arms have radii of about 0.06 and
            0.05 m; the rest is clothing and the tracker's error, since a joint measured by a camera lies beside the
            bone's axis. The hand's radius holds a spread hand about its middle.
        hand_length: from the wrist to the middle of the fingers [m]: half of a hand of 0.20 m.
        shoulders, trunk, head: radii [m]: half the depth of a clothed chest, half its width, a head with hair.
        trunk_length, head_height: from mid-shoulders down to the hips and up to the middle of the head [m].
    """

    level: float = 0.95
    upper_arm: float = 0.10
    forearm: float = 0.07
    hand: float = 0.10
    hand_length: float = 0.10
    shoulders: float = 0.13
    trunk: float = 0.18
    head: float = 0.14
    trunk_length: float = 0.50
    head_height: float = 0.25

    def __post_init__(self) -> None:
        if not 0 < self.level <= 1:
            raise OptionError(f"level {self.level} is outside (0, 1]")
        for name, value in vars(self).items():
            if not 0 <= value < np.inf:
                raise OptionError(f"{name} {value} must be 0 or more")

    @property
    def radii(self) -> Float[np.ndarray, "9"]:
        """(9,) of the `PARTS` [m]."""
        arm = (self.upper_arm, self.forearm, self.hand)
        return np.array([*arm, *arm, self.shoulders, self.trunk, self.head])


TRUE_BODY = OccupancyOptions(
    upper_arm=0.06, forearm=0.05, hand=0.055, hand_length=0.10, shoulders=0.11, trunk=0.16, head=0.11
)
"""A large adult without clothes and without the tracker's error (estimates; see OccupancyOptions): what
touches this touches the person. The arm's side keeps away from more than that."""


@dataclass(frozen=True)
class BodyCapsules:
    """Capsules of one person; NaN where a joint is not known.

    Attributes:
        start, end: (…, K, 3) ends of the axes [m].
        radius: (K,) [m].
    """

    start: Float[np.ndarray, "*batch K 3"]
    end: Float[np.ndarray, "*batch K 3"]
    radius: Float[np.ndarray, " K"]


def body_capsules(
    joints: tuple[str, ...], positions: Float[np.ndarray, "*batch J 3"], options: OccupancyOptions | None = None
) -> BodyCapsules:
    """Both upper arms, forearms and hands, the shoulders, the trunk and the head.

    Args:
        joints: canonical names; both arms at least (kinecast.body.skeleton).
        positions: (…, J, 3) [m]; NaN where not known.
        options: radii and lengths that joints do not tell.

    Returns:
        K = 9 capsules, the `PARTS`; trunk and head follow from the shoulders where they are not tracked.
    """
    o = options or OccupancyOptions()
    batch, shape = positions.shape[:-2], positions.shape[-2:]
    poses = np.ascontiguousarray(positions, dtype=np.float64).reshape(-1, *shape)
    ends = _ends(poses, _rows(joints), o.hand_length, o.trunk_length, o.head_height).reshape(2, *batch, len(PARTS), 3)
    return BodyCapsules(ends[0], ends[1], o.radii)


@lru_cache(maxsize=64)
def _rows(joints: tuple[str, ...]) -> Int[np.ndarray, "8"]:
    """(8,) rows of shoulder, elbow and wrist, left and right, pelvis and head; -1 for one that is not tracked."""
    return np.array([joints.index(name) if name in joints else -1 for name in _NAMES])


@njit(cache=True)
@no_type_check
def _ends(poses: np.ndarray, rows: np.ndarray, palm: float, trunk: float, head: float) -> np.ndarray:
    """(2, N, 9, 3) starts and ends of the axes for joints (N, J, 3)."""
    ends = np.empty((2, len(poses), 9, 3))
    places = np.empty((8, 3))
    for m in range(len(poses)):
        start, end = ends[0, m], ends[1, m]
        for n in range(8):
            known = rows[n] >= 0
            for i in range(3):
                places[n, i] = poses[m, rows[n], i] if known else math.nan
            if not math.isfinite(places[n, 0] + places[n, 1] + places[n, 2]):
                places[n] = math.nan
        for i in range(3):
            start[7, i] = 0.5 * (places[0, i] + places[3, i])
        for n, above in ((6, -trunk), (7, head)):
            if math.isnan(places[n, 0]):
                places[n] = start[7]
                places[n, 2] += above
        for side in range(0, 6, 3):
            start[side : side + 3], end[side : side + 2] = places[side : side + 3], places[side + 1 : side + 3]
            squared = 0.0
            for i in range(3):
                squared += (places[side + 2, i] - places[side + 1, i]) ** 2
            share = palm / max(math.sqrt(squared), 1e-6)
            for i in range(3):
                end[side + 2, i] = places[side + 2, i] + share * (places[side + 2, i] - places[side + 1, i])
        start[6], end[6], end[7] = places[0], places[3], places[6]
        start[8], end[8] = places[7], places[7]
    return ends
