"""Arrays of a model file, checked."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from kinecast.errors import ModelError

__all__ = ["covariance_factor", "shaped"]


def shaped(arrays: Mapping[str, np.ndarray], name: str, *shape: int) -> np.ndarray:
    """An array of floats by its name.

    Raises:
        ModelError: missing, or of another shape.
    """
    if name not in arrays:
        raise ModelError(f"array {name} is missing; present are {sorted(arrays)}")
    array = np.ascontiguousarray(arrays[name], dtype=float)
    if array.shape != shape:
        raise ModelError(f"array {name} of shape {array.shape}; expected {shape}")
    return array


def covariance_factor(arrays: Mapping[str, np.ndarray], name: str, size: int) -> np.ndarray:
    """(K, K) lower factor of a covariance by its name.

    Raises:
        ModelError: missing, of another shape, or no such factor.
    """
    factor = shaped(arrays, name, size, size)
    if np.triu(factor, 1).any() or not (np.diag(factor) > 0).all():
        raise ModelError(f"array {name} is no lower triangle with a positive diagonal")
    return factor
