"""Covariance functions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from kinecast.errors import OptionError

__all__ = ["RBF"]


@dataclass(frozen=True)
class RBF:
    """Squared exponential, one length per input: k(x, z) = σf² exp(−½ Σ_d (x_d − z_d)² / ℓ_d²).

    Attributes:
        lengthscales: (D,) ℓ > 0, in the units of the inputs.
        signal_variance: σf² > 0, in the squared units of the outputs.

    Raises:
        OptionError: if one of them is not positive and finite.
    """

    lengthscales: Float[np.ndarray, " D"]
    signal_variance: float

    def __post_init__(self) -> None:
        if not np.all((self.lengthscales > 0) & np.isfinite(self.lengthscales)):
            raise OptionError(f"lengthscales must be positive and finite, found {self.lengthscales}")
        if not (self.signal_variance > 0 and np.isfinite(self.signal_variance)):
            raise OptionError(f"signal variance must be positive and finite, found {self.signal_variance}")

    def __call__(self, x: Float[np.ndarray, "N D"], z: Float[np.ndarray, "M D"]) -> Float[np.ndarray, "N M"]:
        """(N, M) covariances of every x with every z."""
        from scipy.spatial.distance import cdist  # here, since only training needs it and it is slow to import

        squared = cdist(x / self.lengthscales, z / self.lengthscales, "sqeuclidean")
        return self.signal_variance * np.exp(-0.5 * squared)
