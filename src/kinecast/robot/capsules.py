"""Arms, people and the space they may fill as capsules: everything within a radius of an axis."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

__all__ = ["Capsules", "interpolated"]


class Capsules(NamedTuple):
    """K capsules at many configurations, instants or samples.

    Attributes:
        start, end: (…, K, 3) ends of the axes [m]; NaN where not known.
        radius: (K,) [m].
    """

    start: Float[np.ndarray, "*batch K 3"]
    end: Float[np.ndarray, "*batch K 3"]
    radius: Float[np.ndarray, " K"]

    def regions(self, level: float) -> Float[np.ndarray, "*batch K 7"]:
        """(…, K, 7) start, end and radius [m] of capsules that each hold theirs in a share of the samples (first axis).

        A capsule is convex: a limb lies inside as soon as both its ends lie within the radius of the axis's ends.
        """
        middle = np.concatenate([self.start.mean(axis=0), self.end.mean(axis=0)], axis=-1)
        away = np.concatenate([self.start, self.end], axis=-1) - middle
        far = np.sqrt(np.maximum((away[..., :3] ** 2).sum(axis=-1), (away[..., 3:] ** 2).sum(axis=-1)))
        held = min(max(int(np.ceil(level * len(far) - 1e-9)), 1), len(far)) - 1
        radius = self.radius + np.partition(far, held, axis=0)[held]
        return np.concatenate([middle, radius[..., None]], axis=-1)


def interpolated(
    at: Float[np.ndarray, " W"], times: Float[np.ndarray, " T"], values: Float[np.ndarray, "T *each"]
) -> Float[np.ndarray, "W *each"]:
    """Values at times in a row (T of 1 or more) [s], at others: straight between two, the ends' beyond them."""
    place = np.interp(at, times, np.arange(len(times)))
    before = place.astype(np.int64)
    share = (place - before).reshape(-1, *[1] * (values.ndim - 1))
    return values[before] + share * (values[np.minimum(before + 1, len(times) - 1)] - values[before])
