"""Rigid transforms, SE(3): 4 x 4 matrices, batched.

`T_world_torso` carries a point from the torso frame into the world: p_world = T_world_torso · p_torso, and
transforms compose by `@`: T_world_hand = T_world_torso @ T_torso_hand. Quaternions are w, x, y, z.
SciPy imports its rotations when they are first used: they take a quarter of a second, and predicting needs none.
"""

from __future__ import annotations

from functools import partial
from typing import TypeAlias

import numpy as np
import scipy
from jaxtyping import Float

from kinecast.errors import OptionError

Vectors: TypeAlias = Float[np.ndarray, "*batch 3"]
Quaternions: TypeAlias = Float[np.ndarray, "*batch 4"]
Rotations: TypeAlias = Float[np.ndarray, "*batch 3 3"]
Transforms: TypeAlias = Float[np.ndarray, "*batch 4 4"]
Angle: TypeAlias = Float[np.ndarray, "*batch"] | float


def transform(rotation: Rotations, translation: Vectors) -> Transforms:
    """T = [R t; 0 1] of (…, 3, 3) rotation matrices and (…, 3) translations [m]."""
    T = np.zeros((*translation.shape[:-1], 4, 4))
    T[..., :3, :3] = rotation
    T[..., :3, 3] = translation
    T[..., 3, 3] = 1.0
    return T


def inverse(T: Transforms) -> Transforms:
    """T⁻¹ = [Rᵀ −Rᵀt; 0 1]."""
    rotation = np.swapaxes(T[..., :3, :3], -1, -2)
    return transform(rotation, -np.einsum("...ij,...j->...i", rotation, T[..., :3, 3]))


def apply(T: Float[np.ndarray, "*#batch 4 4"], points: Float[np.ndarray, "*#batch 3"]) -> Float[np.ndarray, "... 3"]:
    """p' = R p + t for points (…, 3) [m]; axes broadcast: one T a time step for (T, J, 3) points is `T[:, None]`."""
    return np.asarray(np.einsum("...ij,...j->...i", T[..., :3, :3], points) + T[..., :3, 3])


def _about(axis: int, angle: Angle) -> Rotations:
    """(…) angles [rad] to (…, 3, 3)."""
    angle = np.asarray(angle, dtype=np.float64)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.zeros((*angle.shape, 3, 3))
    R[..., axis, axis] = 1.0
    R[..., i, i] = R[..., j, j] = np.cos(angle)
    R[..., j, i] = np.sin(angle)
    R[..., i, j] = -R[..., j, i]
    return R


rotation_x = partial(_about, 0)
rotation_y = partial(_about, 1)
rotation_z = partial(_about, 2)
"""Rz(angle): about z, angle (…) in rad to (…, 3, 3); the others about x and y."""


def from_quaternion(wxyz: Quaternions) -> Rotations:
    """(…, 3, 3) rotation matrices of (…, 4) quaternions w, x, y, z of any length but zero.

    Raises:
        OptionError: a quaternion of length zero or with a NaN.
    """
    if not np.all(np.linalg.norm(wxyz, axis=-1) > 0):
        raise OptionError("a quaternion of length zero or NaN is no rotation")
    flat = scipy.spatial.transform.Rotation.from_quat(wxyz.reshape(-1, 4), scalar_first=True).as_matrix()
    return flat.reshape(*wxyz.shape[:-1], 3, 3)


def to_quaternion(rotation: Rotations) -> Quaternions:
    """(…, 4) unit quaternions w, x, y, z with w ≥ 0 of (…, 3, 3) rotation matrices."""
    turns = scipy.spatial.transform.Rotation.from_matrix(rotation.reshape(-1, 3, 3))
    return turns.as_quat(canonical=True, scalar_first=True).reshape(*rotation.shape[:-2], 4)


def from_rotation_vector(vector: Vectors) -> Rotations:
    """exp: (…, 3) rotation vectors (axis times angle) [rad] to (…, 3, 3) matrices."""
    flat = scipy.spatial.transform.Rotation.from_rotvec(vector.reshape(-1, 3)).as_matrix()
    return flat.reshape(*vector.shape[:-1], 3, 3)


def rotation_vector(rotation: Rotations) -> Vectors:
    """log: (…, 3, 3) rotation matrices to (…, 3) rotation vectors [rad], no longer than π."""
    flat = scipy.spatial.transform.Rotation.from_matrix(rotation.reshape(-1, 3, 3)).as_rotvec()
    return flat.reshape(*rotation.shape[:-2], 3)


def from_camera(points: Vectors) -> Vectors:
    """Camera axes (x right, y down, z forward) to the world's, z up: (x, y, z) → (x, z, −y)."""
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)


def from_y_up(points: Vectors) -> Vectors:
    """Axes with y up (x right, z towards the viewer) to the world's, z up: (x, y, z) → (x, −z, y)."""
    return np.stack([points[..., 0], -points[..., 2], points[..., 1]], axis=-1)


def lengths(vectors: Float[np.ndarray, "*b 3"]) -> Float[np.ndarray, "*b"]:
    """Euclidean norms; quicker than NumPy's own for arrays so small."""
    return np.asarray(np.sqrt(np.einsum("...d,...d->...", vectors, vectors)))
