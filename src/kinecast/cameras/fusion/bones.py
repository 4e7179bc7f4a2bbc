"""How far joints of one person can be from one another: enough to tell a hand from the wall behind it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.sparse.csgraph import shortest_path

from kinecast.cameras.fusion.kalman import JointStates
from kinecast.cameras.fusion.measurement import FUSED_JOINTS

_BONES = {
    ("pelvis", "lumbar"): 0.15, ("lumbar", "spine"): 0.15, ("spine", "thorax"): 0.15, ("thorax", "chest"): 0.15,
    ("chest", "collar"): 0.15, ("collar", "neck"): 0.15, ("neck", "head"): 0.25, ("head", "nose"): 0.20,
    ("collar", "shoulder"): 0.40, ("shoulder", "elbow"): 0.42, ("elbow", "wrist"): 0.36, ("wrist", "hand"): 0.22,
    ("pelvis", "hip"): 0.35, ("hip", "knee"): 0.60, ("knee", "ankle"): 0.60,
}  # fmt: skip
"""Longest bones [m]: a tall man's (ANSUR II, 99th percentile) and a fifth more, since points are marker clusters and
estimates, no joint centres."""
FARTHEST = 1.0  # joints that can be farther apart [m] say little of one another
RECENT = 0.3  # a joint not seen for so long [s] says nothing of its neighbours


def _longest() -> Float[np.ndarray, "J J"]:
    """(J, J) longest distance of each two joints [m]: all bones between them in line."""
    bones = np.zeros((len(FUSED_JOINTS), len(FUSED_JOINTS)))
    for (a, b), far in _BONES.items():
        for side in ("left_", "right_"):
            i, j = (FUSED_JOINTS.index(each if each in FUSED_JOINTS else side + each) for each in (a, b))
            bones[i, j] = far
    return np.asarray(shortest_path(bones, directed=False))


_LONGEST = _longest()
_NEIGHBOURS = (_LONGEST > 0) & (_LONGEST < FARTHEST)


def share_too_far(states: JointStates, places: Float[np.ndarray, "*h J 3"]) -> Float[np.ndarray, "*h J"]:
    """(…, J) share of its neighbours that a joint at a place (…, J, 3) would be too far from; 0 without any."""
    told = _NEIGHBOURS & states.seen_within(RECENT)
    with np.errstate(invalid="ignore"):
        away = np.linalg.norm(places[..., :, None, :] - states.mean[:, 0], axis=-1)
        return ((away > _LONGEST) & told).sum(axis=-1) / np.maximum(told.sum(axis=-1), 1)
