"""Compiled forward kinematics of a chain of revolute joints: many configurations at once.

Each joint turns about its own z axis. `origins` (D, 3, 4) are the joints' frames in their parents', all as [R t]. A
`site` is a point fixed to the link that a joint moves.
"""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from numba import njit

__all__ = ["joint_frames", "site_positions"]


@njit(cache=True)
@no_type_check
def joint_frames(q: np.ndarray, origins: np.ndarray) -> np.ndarray:
    """(N, D, 3, 4) T_base_joint of configurations (N, D) [rad], each joint turned by its angle."""
    frames = np.empty((len(q), *origins.shape))
    for n in range(len(q)):
        parent = np.eye(4)[:3]
        for j in range(q.shape[1]):
            c, s = math.cos(q[n, j]), math.sin(q[n, j])
            for r in range(3):
                a, b, d = parent[r, 0], parent[r, 1], parent[r, 2]
                x = a * origins[j, 0, 0] + b * origins[j, 1, 0] + d * origins[j, 2, 0]
                y = a * origins[j, 0, 1] + b * origins[j, 1, 1] + d * origins[j, 2, 1]
                frames[n, j, r, 0] = c * x + s * y
                frames[n, j, r, 1] = c * y - s * x
                frames[n, j, r, 2] = a * origins[j, 0, 2] + b * origins[j, 1, 2] + d * origins[j, 2, 2]
                frames[n, j, r, 3] = a * origins[j, 0, 3] + b * origins[j, 1, 3] + d * origins[j, 2, 3] + parent[r, 3]
            parent = frames[n, j]
    return frames


@njit(cache=True)
@no_type_check
def site_positions(frames: np.ndarray, local: np.ndarray, joint: np.ndarray) -> np.ndarray:
    """(N, M, 3) places [m] of sites (M, 3), fixed to joints (M,), whose frames are (N, D, 3, 4)."""
    positions = np.empty((len(frames), len(local), 3))
    for n in range(len(frames)):
        for m in range(len(local)):
            x, y, z = local[m, 0], local[m, 1], local[m, 2]
            for i in range(3):
                row = frames[n, joint[m], i]
                positions[n, m, i] = row[0] * x + row[1] * y + row[2] * z + row[3]
    return positions
