"""The arm as a Denavit-Hartenberg table (Eq. 1), to compare the closed form with."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

Chain = Callable[[np.ndarray, np.ndarray, float], tuple[np.ndarray, np.ndarray]]

HALF = 0.5 * np.pi
T_TORSO_BASE = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])
"""Base at the shoulder: x forward, y up, z to the right."""


def _link(theta: np.ndarray, offset: float, alpha: float, d: float, a: float) -> np.ndarray:
    """H = Rz(θ + offset) Tz(d) Tx(a) Rx(α), standard (distal) convention: (N,) angles to (N, 4, 4)."""
    s, c = np.sin(theta + offset), np.cos(theta + offset)
    sa, ca = np.sin(alpha), np.cos(alpha)
    zero, one = np.zeros_like(s), np.ones_like(s)
    rows = [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [zero, sa * one, ca * one, d * one]]
    return np.moveaxis(np.array([*rows, [zero, zero, zero, one]]), -1, 0)


def _chain(theta: np.ndarray, lengths: np.ndarray, side: float) -> tuple[np.ndarray, np.ndarray]:
    """(N, 4) angles to elbow and wrist (N, 2, 3) from the shoulder, and the wrist's Jacobian (N, 3, 4), Eq. 5.

    Flexion comes first: it turns about the line of the shoulders, abduction about an axis that flexion carries.
    """
    upper, fore = lengths
    table = [(1.0, -HALF, HALF, 0.0, 0.0), (-side, HALF, HALF, 0.0, 0.0),
             (-side, HALF, HALF, upper, 0.0), (1.0, HALF, 0.0, 0.0, fore)]  # fmt: skip
    frames = [np.broadcast_to(T_TORSO_BASE, (len(theta), 4, 4))]
    for i, (sign, *link) in enumerate(table):
        frames.append(frames[-1] @ _link(sign * theta[:, i], *link))
    wrist = frames[-1][:, :3, 3]
    columns = [
        np.cross(sign * frame[:, :3, 2], wrist - frame[:, :3, 3])
        for (sign, *_), frame in zip(table, frames[:-1], strict=True)
    ]
    return np.stack([frames[3][:, :3, 3], wrist], axis=1), np.stack(columns, axis=-1)


@pytest.fixture
def denavit_hartenberg() -> Chain:
    """Angles (N, 4), lengths (2,) and side to elbow and wrist (N, 2, 3) and the wrist's Jacobian (N, 3, 4)."""
    return _chain
