"""Where a person is in an image, by whatever network: how far off joints' pixels are, and whose boxes overlap."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from kinecast.body.skeleton import without_side
from kinecast.live.detection import LEAST_CONFIDENCE, Detection

_SPREAD = {
    "nose": 0.026, "eye": 0.025, "ear": 0.035, "shoulder": 0.079, "elbow": 0.072, "wrist": 0.062, "hip": 0.107,
    "knee": 0.087, "ankle": 0.089, "neck": 0.079, "pelvis": 0.107,
}  # fmt: skip
_OTHERS = 0.079
"""By how much people differ who mark a keypoint, as a share of the root of the person's area: σ of COCO's keypoint
evaluation. It has none for neck, pelvis, hands and feet: they have the shoulders' and hips', and Halpe's for feet."""
AREA = 0.53  # of a person, as a share of their box: what mmpose takes where there is no mask


def detection(
    joints: tuple[str, ...],
    pixels: Float[np.ndarray, "J 2"],
    confidence: Float[np.ndarray, " J"],
    least_confidence: float = LEAST_CONFIDENCE,
) -> Detection:
    """One person in an image without depth: joints that the network is not sure of have no pixel."""
    seen = confidence >= least_confidence
    nothing = np.full(len(joints), np.nan)
    shown, std = np.where(seen[:, None], pixels, np.nan), keypoint_std(joints, pixels, seen)
    return Detection(0.0, "", joints, shown, std, nothing, nothing, confidence)


def keypoint_std(
    joints: Sequence[str], pixels: Float[np.ndarray, "J 2"], seen: Bool[np.ndarray, " J"]
) -> Float[np.ndarray, " J"]:
    """(J,) standard deviation of one coordinate of a person's keypoints [px]: COCO's σ times the root of their area.

    0 where none is seen.
    """
    spread = np.array([_SPREAD.get(without_side(joint), _OTHERS) for joint in joints])
    area = AREA * np.prod(np.ptp(pixels[seen], axis=0)) if seen.any() else 0.0
    return spread * np.sqrt(area / 2)  # d² is of two coordinates


def overlaps(box: Float[np.ndarray, " 4"], others: Float[np.ndarray, "N 4"]) -> Float[np.ndarray, " N"]:
    """(N,) intersection over union of a box with others."""
    sides = np.minimum(box[2:], others[:, 2:]) - np.maximum(box[:2], others[:, :2])
    common = np.maximum(sides, 0.0).prod(axis=1)
    union = (box[2:] - box[:2]).prod() + (others[:, 2:] - others[:, :2]).prod(axis=1) - common
    return common / np.maximum(union, 1e-9)
