"""How far a person's joints can be from one another: enough to tell a hand from the wall behind it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from kinecast.cameras.fusion.motion import JointStates

__all__ = ["ANCHOR_STD", "Reach"]

_ARMS = {
    ("shoulder", "elbow"): 0.42, ("elbow", "wrist"): 0.36, ("shoulder", "wrist"): 0.75, ("wrist", "hand"): 0.22,
    ("elbow", "hand"): 0.55, ("shoulder", "hip"): 0.75, ("hip", "knee"): 0.60, ("knee", "ankle"): 0.60,
    ("hip", "ankle"): 1.15,
}  # fmt: skip
"""Within one side of the body [m]: a tall man's (ANSUR II, 99th percentile) and a fifth more, since points are marker
clusters and estimates, no joint centres."""
_ACROSS = {"shoulder": 0.60, "hip": 0.50}
_TRUNK = ("pelvis", "lumbar", "spine", "thorax", "chest", "collar", "neck", "head", "nose")
_TO_TRUNK = {
    "pelvis": {"shoulder": 0.80, "hip": 0.35}, "lumbar": {"shoulder": 0.65, "hip": 0.40},
    "spine": {"shoulder": 0.60, "hip": 0.50}, "thorax": {"shoulder": 0.55, "hip": 0.55},
    "chest": {"shoulder": 0.45, "hip": 0.65}, "collar": {"shoulder": 0.40, "hip": 0.80},
    "neck": {"shoulder": 0.40, "hip": 0.85}, "head": {"shoulder": 0.55}, "nose": {"shoulder": 0.60},
}  # fmt: skip
_WITHIN_TRUNK = 1.0

RECENT = 0.3
"""A joint not seen for so long [s] says nothing of its neighbours."""
ANCHOR_STD = 0.25
"""How near a joint is to its neighbours [m]: about an upper arm's length."""


class Reach:
    """Longest distances of a set of joints.

    Args:
        joints: names.
    """

    def __init__(self, joints: Sequence[str]) -> None:
        places = {joint: column for column, joint in enumerate(joints)}
        self.longest = np.full((len(joints), len(joints)), np.inf)
        pairs = {(f"{side}_{a}", f"{side}_{b}"): far for (a, b), far in _ARMS.items() for side in ("left", "right")}
        pairs |= {(f"left_{joint}", f"right_{joint}"): far for joint, far in _ACROSS.items()}
        pairs |= {(a, b): _WITHIN_TRUNK for k, a in enumerate(_TRUNK) for b in _TRUNK[:k]}
        for joint, others in _TO_TRUNK.items():
            pairs |= {(joint, f"{side}_{b}"): far for b, far in others.items() for side in ("left", "right")}
        for (a, b), far in pairs.items():
            if a in places and b in places:
                self.longest[places[a], places[b]] = self.longest[places[b], places[a]] = far

    def beyond(self, places: Float[np.ndarray, "*h J 3"], states: JointStates) -> Float[np.ndarray, "*h J"]:
        """(…, J) share of its neighbours that a joint at a place (…, J, 3) would be too far from; 0 without any."""
        told = np.isfinite(self.longest) & self._recent(states)
        with np.errstate(invalid="ignore"):
            away = np.linalg.norm(places[..., :, None, :] - states.mean[:, 0], axis=-1)
            return ((away > self.longest) & told).sum(axis=-1) / np.maximum(told.sum(axis=-1), 1)

    def anchors(self, states: JointStates) -> tuple[Float[np.ndarray, "J 3"], Bool[np.ndarray, " J"]]:
        """(J, 3) the middle of each joint's neighbours, nearer ones first, and whether there is one."""
        weight = np.where(np.isfinite(self.longest) & self._recent(states), self.longest**-4.0, 0.0)
        there = np.where(states.known[:, None], states.mean[:, 0], 0.0)
        total = weight.sum(axis=1)
        return weight @ there / np.maximum(total, 1e-9)[:, None], total > 0

    def _recent(self, states: JointStates) -> Bool[np.ndarray, " J"]:
        return states.stamp - states.seen_at < RECENT
