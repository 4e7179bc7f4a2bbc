"""Compiled forward kinematics of a chain of revolute joints: many configurations at once.

Each joint turns about its own z axis. `base` (3, 4) is T_world_base and `origins` (D, 3, 4) are the joints' frames in
their parents', all as [R t]. A `site` is a point fixed to the link that a joint moves.
"""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from numba import njit

__all__ = ["joint_frames", "site_jacobians", "site_position", "site_positions"]


@njit(cache=True)
@no_type_check
def joint_frames(q: np.ndarray, base: np.ndarray, origins: np.ndarray, frames: np.ndarray) -> None:
    """Writes T_world_joint (D, 3, 4) of one configuration (D,), each joint turned by its angle."""
    parent = base
    for j in range(len(q)):
        c, s = math.cos(q[j]), math.sin(q[j])
        for r in range(3):
            a, b, d = parent[r, 0], parent[r, 1], parent[r, 2]
            x = a * origins[j, 0, 0] + b * origins[j, 1, 0] + d * origins[j, 2, 0]
            y = a * origins[j, 0, 1] + b * origins[j, 1, 1] + d * origins[j, 2, 1]
            frames[j, r, 0] = c * x + s * y
            frames[j, r, 1] = c * y - s * x
            frames[j, r, 2] = a * origins[j, 0, 2] + b * origins[j, 1, 2] + d * origins[j, 2, 2]
            frames[j, r, 3] = a * origins[j, 0, 3] + b * origins[j, 1, 3] + d * origins[j, 2, 3] + parent[r, 3]
        parent = frames[j]


@njit(cache=True)
@no_type_check
def site_position(frame: np.ndarray, local: np.ndarray) -> tuple[float, float, float]:
    """A site's place in the world [m]."""
    x, y, z = local[0], local[1], local[2]
    return (
        frame[0, 0] * x + frame[0, 1] * y + frame[0, 2] * z + frame[0, 3],
        frame[1, 0] * x + frame[1, 1] * y + frame[1, 2] * z + frame[1, 3],
        frame[2, 0] * x + frame[2, 1] * y + frame[2, 2] * z + frame[2, 3],
    )


@njit(cache=True)
@no_type_check
def site_positions(
    q: np.ndarray, base: np.ndarray, origins: np.ndarray, local: np.ndarray, joint: np.ndarray
) -> np.ndarray:
    """(N, M, 3) places [m] of the sites (M, 3), fixed to joints (M,), at configurations (N, D) [rad]."""
    positions = np.empty((len(q), len(local), 3))
    frames = np.empty((q.shape[1], 3, 4))
    for n in range(len(q)):
        joint_frames(q[n], base, origins, frames)
        for m in range(len(local)):
            x, y, z = site_position(frames[joint[m]], local[m])
            positions[n, m, 0], positions[n, m, 1], positions[n, m, 2] = x, y, z
    return positions


@njit(cache=True)
@no_type_check
def site_jacobians(
    q: np.ndarray, base: np.ndarray, origins: np.ndarray, local: np.ndarray, joint: np.ndarray
) -> np.ndarray:
    """(N, M, 3, D) derivative of each site by each angle [m/rad]: column j is z_j × (p − o_j)."""
    jacobians = np.zeros((len(q), len(local), 3, q.shape[1]))
    frames = np.empty((q.shape[1], 3, 4))
    for n in range(len(q)):
        joint_frames(q[n], base, origins, frames)
        for m in range(len(local)):
            x, y, z = site_position(frames[joint[m]], local[m])
            for j in range(joint[m] + 1):
                zx, zy, zz = frames[j, 0, 2], frames[j, 1, 2], frames[j, 2, 2]
                rx, ry, rz = x - frames[j, 0, 3], y - frames[j, 1, 3], z - frames[j, 2, 3]
                jacobians[n, m, 0, j] = zy * rz - zz * ry
                jacobians[n, m, 1, j] = zz * rx - zx * rz
                jacobians[n, m, 2, j] = zx * ry - zy * rx
    return jacobians
