"""How far a person's joints can be from one another: enough to tell a hand from the wall behind it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from kinecast.cameras.fusion.kalman import JointStates
from kinecast.cameras.fusion.measurement import FUSED_JOINTS, TRUNK

_ARMS = {
    ("shoulder", "elbow"): 0.42, ("elbow", "wrist"): 0.36, ("shoulder", "wrist"): 0.75, ("wrist", "hand"): 0.22,
    ("elbow", "hand"): 0.55, ("shoulder", "hip"): 0.75, ("hip", "knee"): 0.60, ("knee", "ankle"): 0.60,
    ("hip", "ankle"): 1.15,
}  # fmt: skip
"""Within one side of the body [m]: a tall man's (ANSUR II, 99th percentile) and a fifth more, since points are marker
clusters and estimates, no joint centres."""
_ACROSS = {"shoulder": 0.60, "hip": 0.50}
_TO_TRUNK = {
    "pelvis": {"shoulder": 0.80, "hip": 0.35}, "lumbar": {"shoulder": 0.65, "hip": 0.40},
    "spine": {"shoulder": 0.60, "hip": 0.50}, "thorax": {"shoulder": 0.55, "hip": 0.55},
    "chest": {"shoulder": 0.45, "hip": 0.65}, "collar": {"shoulder": 0.40, "hip": 0.80},
    "neck": {"shoulder": 0.40, "hip": 0.85}, "head": {"shoulder": 0.55}, "nose": {"shoulder": 0.60},
}  # fmt: skip
_WITHIN_TRUNK = 1.0

RECENT = 0.3  # a joint not seen for so long [s] says nothing of its neighbours
ANCHOR_STD = 0.25  # how near a joint is to its neighbours [m]: about an upper arm's length


def _longest() -> Float[np.ndarray, "J J"]:
    """(J, J) longest distance of each two joints [m]; inf where there is none."""
    sides = ("left", "right")
    pairs = {(f"{side}_{a}", f"{side}_{b}"): far for (a, b), far in _ARMS.items() for side in sides}
    pairs |= {(f"left_{joint}", f"right_{joint}"): far for joint, far in _ACROSS.items()}
    pairs |= {(a, b): _WITHIN_TRUNK for k, a in enumerate(TRUNK) for b in TRUNK[:k]}
    pairs |= {(a, f"{side}_{b}"): far for a, near in _TO_TRUNK.items() for b, far in near.items() for side in sides}
    longest = np.full((len(FUSED_JOINTS), len(FUSED_JOINTS)), np.inf)
    for (a, b), far in pairs.items():
        i, j = FUSED_JOINTS.index(a), FUSED_JOINTS.index(b)
        longest[i, j] = longest[j, i] = far
    return longest


LONGEST = _longest()


def share_too_far(places: Float[np.ndarray, "*h J 3"], states: JointStates) -> Float[np.ndarray, "*h J"]:
    """(…, J) share of its neighbours that a joint at a place (…, J, 3) would be too far from; 0 without any."""
    told = np.isfinite(LONGEST) & states.seen_within(RECENT)
    with np.errstate(invalid="ignore"):
        away = np.linalg.norm(places[..., :, None, :] - states.mean[:, 0], axis=-1)
        return ((away > LONGEST) & told).sum(axis=-1) / np.maximum(told.sum(axis=-1), 1)


def anchors(states: JointStates) -> tuple[Float[np.ndarray, "J 3"], Bool[np.ndarray, " J"]]:
    """(J, 3) the middle of each joint's neighbours, nearer ones first, and whether there is one."""
    weight = np.where(states.seen_within(RECENT), LONGEST**-4.0, 0.0)
    there = np.where(states.known[:, None], states.mean[:, 0], 0.0)
    total = weight.sum(axis=1)
    return weight @ there / np.maximum(total, 1e-9)[:, None], total > 0
