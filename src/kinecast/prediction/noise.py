"""What noise on the joints does to posture coordinates."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

LEAST_SINE = 0.02
"""Near a degenerate pose an angle's noise stops growing here."""


def angle_noise(arm: Float[np.ndarray, "*b 6"], noise: Float[np.ndarray, "*#b 3"]) -> Float[np.ndarray, "*b 4"]:
    """Spread of θ1..θ4 that independent noise of the joints brings, to first order [rad].

    Args:
        arm: (…, 6) angles and lengths of one arm (kinecast.body.posture).
        noise: (3,) or (…, 3) spread of shoulder, elbow and wrist along each axis [m].
    """
    upper = np.hypot(noise[..., 0], noise[..., 1]) / arm[..., 4]
    fore = np.hypot(noise[..., 1], noise[..., 2]) / arm[..., 5]
    return np.stack(
        [
            upper / np.maximum(np.abs(np.cos(arm[..., 1])), LEAST_SINE),
            upper,
            fore / np.maximum(np.abs(np.sin(arm[..., 3])), LEAST_SINE),
            np.hypot(upper, fore),
        ],
        axis=-1,
    )


def coordinate_noise(posture: Float[np.ndarray, "18"], noise: Float[np.ndarray, "6"]) -> Float[np.ndarray, "18"]:
    """(18,) spread of the smooth posture coordinates that noise on the joints [m] brings, to first order."""
    shoulders = np.hypot(noise[0], noise[3])
    spread = np.empty(18)
    spread[:3] = 0.5 * shoulders
    spread[3:5] = shoulders / posture[5]
    spread[5] = shoulders
    for joint, start in ((0, 6), (3, 12)):
        local = noise[joint : joint + 3]
        flexion, abduction, _, elbow = angle_noise(posture[start : start + 6], local)
        # The pair (θ4 cos θ3, θ4 sin θ3) is as uncertain as the elbow's angle, in every direction.
        bones = np.hypot(local[:2], local[1:])
        spread[start : start + 6] = flexion, abduction, elbow, elbow, *bones
    return spread
