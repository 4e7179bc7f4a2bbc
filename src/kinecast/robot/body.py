"""A person as capsules around joints: arms, hands, trunk, head.

A capsule, everything within a radius of an axis, is a row of seven here and in all of kinecast.robot: start, end and
radius [m]; NaN where not known.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from kinecast.geometry.transforms import lengths

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
HAND_LENGTH = 0.10  # from the wrist to the middle of the fingers [m]: half of a hand of 0.20 m
HIPS_AND_HEAD = np.array([[0.0, 0.0, -0.50], [0.0, 0.0, 0.25]])
"""From mid-shoulders down to the hips and up to the middle of the head [m]."""
MEASURED_BODY = np.array([0.10, 0.07, 0.10, 0.10, 0.07, 0.10, 0.13, 0.18, 0.14])
"""Radii of the `PARTS` as a camera measures them [m]. Estimates: a large man's arms have radii of about 0.06 and
0.05 m; the rest is clothing and the tracker's error, since a joint measured by a camera lies beside the bone's axis.
The hand's holds a spread hand; then half the depth of a clothed chest, half its width, a head with hair."""
TRUE_BODY = np.array([0.06, 0.05, 0.055, 0.06, 0.05, 0.055, 0.11, 0.16, 0.11])
"""Of a large adult without clothes and without the tracker's error (estimates): what touches this touches the person.
The arm's side keeps away from more than that."""


def body_capsules(
    joints: tuple[str, ...],
    positions: Float[np.ndarray, "*batch J 3"],
    radii: Float[np.ndarray, "9"] = MEASURED_BODY,
    hand_length: float = HAND_LENGTH,
) -> Float[np.ndarray, "*batch 9 7"]:
    """Both upper arms, forearms and hands, the shoulders, the trunk and the head.

    Args:
        joints: canonical names; both arms at least (kinecast.body.skeleton).
        positions: (…, J, 3) [m]; NaN where not known.
        radii: (9,) of the `PARTS` [m].
        hand_length: [m].

    Returns:
        (…, 9, 7) the `PARTS`; trunk and head follow from the shoulders where they are not tracked.
    """
    unknown = np.full((*positions.shape[:-2], 1, 3), np.nan)
    places = np.concatenate([positions, unknown], axis=-2).take(_rows(joints), axis=-2)
    places[~np.isfinite(places.sum(axis=-1))] = np.nan
    wrists = places[..., 2:6:3, :]
    forearms = wrists - places[..., 1:5:3, :]
    hands = wrists + (hand_length / np.maximum(lengths(forearms), 1e-6))[..., None] * forearms
    middle = 0.5 * (places[..., :1, :] + places[..., 3:4, :])
    trunk_and_head = np.where(np.isnan(places[..., 6:, :]), middle + HIPS_AND_HEAD, places[..., 6:, :])
    points = np.concatenate([places[..., :6, :], hands, middle, trunk_and_head], axis=-2)
    thick = np.broadcast_to(radii[:, None], (*positions.shape[:-2], 9, 1))
    return np.concatenate([points.take(STARTS, axis=-2), points.take(ENDS, axis=-2), thick], axis=-1)


@lru_cache(maxsize=64)
def _rows(joints: tuple[str, ...]) -> Int[np.ndarray, "8"]:
    """(8,) rows of shoulder, elbow and wrist, left and right, pelvis and head; -1 for one that is not tracked."""
    return np.array([joints.index(name) if name in joints else -1 for name in _NAMES])


def held(capsules: Float[np.ndarray, "S *batch K 7"], level: float) -> Float[np.ndarray, "*batch K 7"]:
    """Capsules that each hold theirs in a share of the S samples.

    A capsule is convex: a limb lies inside as soon as both its ends lie within the radius of the axis's ends.
    """
    middle: Float[np.ndarray, "*batch K 7"] = capsules.mean(axis=0)
    away = capsules - middle
    far = np.sqrt(np.maximum((away[..., :3] ** 2).sum(axis=-1), (away[..., 3:6] ** 2).sum(axis=-1)))
    last = min(max(int(np.ceil(level * len(far) - 1e-9)), 1), len(far)) - 1
    middle[..., 6] += np.partition(far, last, axis=0)[last]
    return middle


def interpolated(
    at: Float[np.ndarray, " W"], times: Float[np.ndarray, " T"], values: Float[np.ndarray, "T *each"]
) -> Float[np.ndarray, "W *each"]:
    """Values at times in a row (T of 1 or more) [s], at others: straight between two, the ends' beyond them."""
    place = np.interp(at, times, np.arange(len(times)))
    before = place.astype(np.int64)
    share = (place - before).reshape(-1, *[1] * (values.ndim - 1))
    return values[before] + share * (values[np.minimum(before + 1, len(times) - 1)] - values[before])
