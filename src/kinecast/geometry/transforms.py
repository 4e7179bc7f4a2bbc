"""Rigid transforms, SE(3): 4 x 4 matrices, batched.

`T_world_torso` carries a point from the torso frame into the world: p_world = T_world_torso · p_torso, and
transforms compose by `@`: T_world_hand = T_world_torso @ T_torso_hand. Quaternions are w, x, y, z.
SciPy's rotations are imported when first used: they take a quarter of a second, and predicting needs none.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from kinecast.errors import OptionError


def transform(
    rotation: Float[np.ndarray, "*batch 3 3"], translation: Float[np.ndarray, "*batch 3"]
) -> Float[np.ndarray, "*batch 4 4"]:
    """T = [R t; 0 1] of (…, 3, 3) rotation matrices and (…, 3) translations [m]."""
    T = np.zeros((*translation.shape[:-1], 4, 4))
    T[..., :3, :3] = rotation
    T[..., :3, 3] = translation
    T[..., 3, 3] = 1.0
    return T


def inverse(T: Float[np.ndarray, "*batch 4 4"]) -> Float[np.ndarray, "*batch 4 4"]:
    """T⁻¹ = [Rᵀ −Rᵀt; 0 1]."""
    rotation = np.swapaxes(T[..., :3, :3], -1, -2)
    return transform(rotation, -np.einsum("...ij,...j->...i", rotation, T[..., :3, 3]))


def apply(T: Float[np.ndarray, "*#batch 4 4"], points: Float[np.ndarray, "*#batch 3"]) -> Float[np.ndarray, "... 3"]:
    """p' = R p + t for points (…, 3) [m].

    Leading axes broadcast: one transform per time step for (T, J, 3) points is `transforms[:, None]`.
    """
    return np.asarray(np.einsum("...ij,...j->...i", T[..., :3, :3], points) + T[..., :3, 3])


def transformed(
    points: Float[np.ndarray, "*batch 3"], rotation: Float[np.ndarray, "3 3"], shift: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "*batch 3"]:
    """p' = R p + s for points (…, 3) [m], all by the same rotation and shift."""
    return np.asarray(points @ rotation.T + shift)


def rotation_x(angle: Float[np.ndarray, "*batch"] | float) -> Float[np.ndarray, "*batch 3 3"]:
    """Rx(angle): about x, angle in rad; (…) → (…, 3, 3)."""
    return _about(angle, 0)


def rotation_y(angle: Float[np.ndarray, "*batch"] | float) -> Float[np.ndarray, "*batch 3 3"]:
    """Ry(angle): about y, angle in rad; (…) → (…, 3, 3)."""
    return _about(angle, 1)


def rotation_z(angle: Float[np.ndarray, "*batch"] | float) -> Float[np.ndarray, "*batch 3 3"]:
    """Rz(angle): about z, angle in rad; (…) → (…, 3, 3)."""
    return _about(angle, 2)


def _about(angle: Float[np.ndarray, "*batch"] | float, axis: int) -> Float[np.ndarray, "*batch 3 3"]:
    angle = np.asarray(angle, dtype=np.float64)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.zeros((*angle.shape, 3, 3))
    R[..., axis, axis] = 1.0
    R[..., i, i] = R[..., j, j] = np.cos(angle)
    R[..., j, i] = np.sin(angle)
    R[..., i, j] = -R[..., j, i]
    return R


def from_quaternion(wxyz: Float[np.ndarray, "*batch 4"]) -> Float[np.ndarray, "*batch 3 3"]:
    """(…, 3, 3) rotation matrices of (…, 4) quaternions w, x, y, z of any length but zero.

    Raises:
        OptionError: a quaternion of length zero or with a NaN.
    """
    from scipy.spatial.transform import Rotation

    if not np.all(np.linalg.norm(wxyz, axis=-1) > 0):
        raise OptionError("a quaternion of length zero or NaN is no rotation")
    flat = Rotation.from_quat(wxyz.reshape(-1, 4), scalar_first=True).as_matrix()
    return flat.reshape(*wxyz.shape[:-1], 3, 3)


def to_quaternion(rotation: Float[np.ndarray, "*batch 3 3"]) -> Float[np.ndarray, "*batch 4"]:
    """(…, 4) unit quaternions w, x, y, z with w ≥ 0 of (…, 3, 3) rotation matrices."""
    from scipy.spatial.transform import Rotation

    flat = Rotation.from_matrix(rotation.reshape(-1, 3, 3)).as_quat(canonical=True, scalar_first=True)
    return flat.reshape(*rotation.shape[:-2], 4)


def from_rotation_vector(vector: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3 3"]:
    """exp: (…, 3) rotation vectors (axis times angle) [rad] to (…, 3, 3) matrices."""
    from scipy.spatial.transform import Rotation

    flat = Rotation.from_rotvec(vector.reshape(-1, 3)).as_matrix()
    return flat.reshape(*vector.shape[:-1], 3, 3)


def rotation_vector(rotation: Float[np.ndarray, "*batch 3 3"]) -> Float[np.ndarray, "*batch 3"]:
    """log: (…, 3, 3) rotation matrices to (…, 3) rotation vectors [rad], no longer than π."""
    from scipy.spatial.transform import Rotation

    flat = Rotation.from_matrix(rotation.reshape(-1, 3, 3)).as_rotvec()
    return flat.reshape(*rotation.shape[:-2], 3)


def from_camera(points: Float[np.ndarray, "*shape 3"]) -> Float[np.ndarray, "*shape 3"]:
    """Camera axes (x right, y down, z forward) to the world's, z up: (x, y, z) → (x, z, −y)."""
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)


def from_y_up(points: Float[np.ndarray, "*shape 3"]) -> Float[np.ndarray, "*shape 3"]:
    """Axes with y up (x right, z towards the viewer) to the world's, z up: (x, y, z) → (x, −z, y)."""
    return np.stack([points[..., 0], -points[..., 2], points[..., 1]], axis=-1)


def lengths(vectors: Float[np.ndarray, "*b 3"]) -> Float[np.ndarray, "*b"]:
    """Euclidean norms; quicker than NumPy's own for arrays so small."""
    return np.asarray(np.sqrt(np.einsum("...d,...d->...", vectors, vectors)))
