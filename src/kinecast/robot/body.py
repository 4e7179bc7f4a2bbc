"""A person as capsules around measured joints: arms, hands, trunk, head."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from kinecast.robot.occupancy import OccupancyOptions

__all__ = ["TRUE_BODY", "BodyCapsules", "body_capsules"]

TRUE_BODY = OccupancyOptions(
    upper_arm=0.06, forearm=0.05, hand=0.055, hand_length=0.10, shoulders=0.11, trunk=0.16, head=0.11
)
"""A large adult without clothes and without the tracker's error (estimates; see OccupancyOptions): what
touches this touches the person. The arm's side keeps away from more than that."""
DOWN = np.array([0.0, 0.0, -1.0])


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

    def joint(name: str, otherwise: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
        if name not in joints:
            return otherwise
        found: Float[np.ndarray, " 3"] = positions[joints.index(name)]
        return found if np.isfinite(found).all() else otherwise

    nowhere = np.full(3, np.nan)
    starts, ends, radii = [], [], []
    for side in ("left", "right"):
        shoulder, elbow, wrist = (joint(f"{side}_{part}", nowhere) for part in ("shoulder", "elbow", "wrist"))
        line = wrist - elbow
        palm = wrist + o.hand_length * line / max(float(np.linalg.norm(line)), 1e-6)
        starts += [shoulder, elbow, wrist]
        ends += [elbow, wrist, palm]
        radii += [o.upper_arm, o.forearm, o.hand]
    left, right = (joint(f"{side}_shoulder", nowhere) for side in ("left", "right"))
    middle = (left + right) / 2
    pelvis = joint("pelvis", middle + o.trunk_length * DOWN)
    head = joint("head", middle - o.head_height * DOWN)
    starts += [left, middle, head]
    ends += [right, pelvis, head]
    radii += [o.shoulders, o.trunk, o.head]
    return BodyCapsules(np.stack(starts), np.stack(ends), np.array(radii))
