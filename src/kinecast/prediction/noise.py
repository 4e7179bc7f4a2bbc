"""Measurement noise: how large it is in a recording, and what it does to posture coordinates."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from kinecast.prediction.observation import TrainingWindows

LEAST_SINE = 0.02
"""Near a degenerate pose an angle's noise stops growing here."""


def sensor_noise(windows: TrainingWindows) -> float:
    """Spread of a measured joint about the true one [m], from what changes too fast to be motion.

    The third difference of a smooth motion at 30 Hz is small; white noise of spread σ gives one of spread
    σ √20. The median over windows of a robust (median absolute deviation) spread is taken.
    """
    spreads = []
    for block in windows.blocks():
        tracks = np.concatenate([block.observed, block.future], axis=1)
        spreads.append(np.median(np.abs(np.diff(tracks, n=3, axis=1)), axis=(1, 2, 3)))
    # 1.4826: from median absolute deviation to standard deviation of a normal.
    return float(max(1.4826 * np.median(np.concatenate(spreads)) / np.sqrt(20.0), 1e-4))


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
