"""A person as capsules around joints: arms, hands, trunk, head."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Float, Int

from kinecast.geometry.transforms import lengths
from kinecast.robot.capsules import Capsules

__all__ = ["MEASURED_BODY", "PARTS", "TRUE_BODY", "BodySize", "body_capsules"]

PARTS = (
    "left_upper_arm", "left_forearm", "left_hand", "right_upper_arm", "right_forearm", "right_hand",
    "shoulders", "trunk", "head",
)  # fmt: skip
"""The capsules of one person, in this order; persons follow one another."""
_NAMES = (
    "left_shoulder", "left_elbow", "left_wrist", "right_shoulder", "right_elbow", "right_wrist", "pelvis", "head",
)  # fmt: skip
STARTS, ENDS = [0, 1, 2, 3, 4, 5, 0, 8, 10], [1, 2, 6, 4, 5, 7, 3, 9, 10]
"""Of the `PARTS`: rows of both arms, fingers (6, 7), mid-shoulders, hips and head."""


@dataclass(frozen=True)
class BodySize:
    """How large a person is taken to be: by default as a camera measures them.

    Attributes:
        upper_arm, forearm, hand: radii of the limbs [m]. Estimates: a large man's arms have radii of about 0.06 and
            0.05 m; the rest is clothing and the tracker's error, since a joint measured by a camera lies beside the
            bone's axis. The hand's radius holds a spread hand about its middle.
        hand_length: from the wrist to the middle of the fingers [m]: half of a hand of 0.20 m.
        shoulders, trunk, head: radii [m]: half the depth of a clothed chest, half its width, a head with hair.
        trunk_length, head_height: from mid-shoulders down to the hips and up to the middle of the head [m].
    """

    upper_arm: float = 0.10
    forearm: float = 0.07
    hand: float = 0.10
    hand_length: float = 0.10
    shoulders: float = 0.13
    trunk: float = 0.18
    head: float = 0.14
    trunk_length: float = 0.50
    head_height: float = 0.25

    @cached_property
    def radii(self) -> Float[np.ndarray, "9"]:
        """(9,) of the `PARTS` [m]."""
        arm = (self.upper_arm, self.forearm, self.hand)
        return np.array([*arm, *arm, self.shoulders, self.trunk, self.head])


MEASURED_BODY = BodySize()
TRUE_BODY = BodySize(upper_arm=0.06, forearm=0.05, hand=0.055, shoulders=0.11, trunk=0.16, head=0.11)
"""A large adult without clothes and without the tracker's error (estimates; see BodySize): what touches this touches
the person. The arm's side keeps away from more than that."""


def body_capsules(
    joints: tuple[str, ...], positions: Float[np.ndarray, "*batch J 3"], size: BodySize = MEASURED_BODY
) -> Capsules:
    """Both upper arms, forearms and hands, the shoulders, the trunk and the head.

    Args:
        joints: canonical names; both arms at least (kinecast.body.skeleton).
        positions: (…, J, 3) [m]; NaN where not known.
        size: radii and lengths that joints do not tell.

    Returns:
        K = 9 capsules, the `PARTS`; trunk and head follow from the shoulders where they are not tracked.
    """
    unknown = np.full((*positions.shape[:-2], 1, 3), np.nan)
    places = np.concatenate([positions, unknown], axis=-2).take(_rows(joints), axis=-2)
    places[~np.isfinite(places.sum(axis=-1))] = np.nan
    wrists = places[..., 2:6:3, :]
    forearms = wrists - places[..., 1:5:3, :]
    hands = wrists + (size.hand_length / np.maximum(lengths(forearms), 1e-6))[..., None] * forearms
    middle = 0.5 * (places[..., :1, :] + places[..., 3:4, :])
    ends = middle + np.array([[0.0, 0.0, -size.trunk_length], [0.0, 0.0, size.head_height]])
    trunk_and_head = np.where(np.isnan(places[..., 6:, :]), ends, places[..., 6:, :])
    points = np.concatenate([places[..., :6, :], hands, middle, trunk_and_head], axis=-2)
    return Capsules(points.take(STARTS, axis=-2), points.take(ENDS, axis=-2), size.radii)


@lru_cache(maxsize=64)
def _rows(joints: tuple[str, ...]) -> Int[np.ndarray, "8"]:
    """(8,) rows of shoulder, elbow and wrist, left and right, pelvis and head; -1 for one that is not tracked."""
    return np.array([joints.index(name) if name in joints else -1 for name in _NAMES])
