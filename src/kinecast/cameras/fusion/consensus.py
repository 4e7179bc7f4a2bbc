"""Which of several images, and the past, agree on where a joint is.

Every place that one image with depth, or two images, or the past alone would give is tried; what counts is how well all
others agree with it, each disagreement up to a limit (Torr and Zisserman 2000, MSAC, over all hypotheses in place of
random ones). A pixel and the depth read there are judged apart: behind a hand that is hidden by a box, the pixel may
be right and the depth is the box's.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float

from kinecast.cameras.fusion.bones import share_too_far
from kinecast.cameras.fusion.kalman import JointStates, Points
from kinecast.cameras.fusion.measurement import Measurement

Used = Bool[np.ndarray, "V J 2"]
Places = Float[np.ndarray, "*h J 3"]
LIMITS = np.array([16.0, 12.0])
"""Squared errors in standard deviations, of pixels and depths, beyond which something is simply wrong: 3 in 10 000
and 5 in 10 000 of good ones are."""
PAST_LIMIT = 30.0  # the same of the past: more than one image with depth, so that it takes two to overrule it
IMPOSSIBLE = 80.0  # what it costs to be too far from all neighbours: more than the past and an image together
MOST_PAIRED = 6  # images of which pairs are tried
WRONG_SHARE, WRONG_LEAST = 0.5, 3  # an image is wrong as a whole if that share, and so many joints, disagree
GUESS = 3.0  # distance of a joint of which nothing tells it [m], for the noise of its pixels
FLAT = 1e-3 * np.eye(3)  # keeps what a single pixel says solvable: 30 m [1/m²]


class Consensus:
    """What is left of V images of one person after the wrong was thrown out, at the instant of their states.

    `used` (V, J, 2) says whether the pixel, and the depth, of each image go in, `past` (J,) whether the past agrees.
    `positions` (J, 3) are where these images alone say that the joints are, NaN where they do not suffice, with a
    `covariance` (J, 3, 3) [m²]; `information` and `surprise` are what they say for `JointStates.correct`.
    """

    def __init__(self, images: Measurement, states: JointStates, standing: Float[np.ndarray, "J 3 3"]) -> None:
        self._images, self._known = images, states.known
        known = states.known[:, None]
        self._here = np.where(known, states.mean[:, 0], 0.0)
        moved = np.where(known, states.at(images.stamp) - states.mean[:, 0], 0.0)  # (V, J, 3) from now to each image
        self._values = images.values - np.einsum("vjrx,vjx->vjr", images.rows, moved)  # as if taken now
        self._prior = np.zeros_like(standing)
        self._prior[states.known] = np.linalg.inv((states.covariance[:, :3, :3] + standing)[states.known])
        places = self._hypotheses()
        best = np.argmin(self._cost(places) + IMPOSSIBLE * share_too_far(states, places), axis=0)
        place = places[best, np.arange(len(known))]
        off, past = self._errors(place)
        self.used, self.past = images.seen & (off < LIMITS), states.known & (past < PAST_LIMIT)
        N, n = (each.sum(axis=0) for each in self._normal(self.used, place))
        self.information, self.surprise = N, n - np.einsum("jxy,jy->jx", N, self._here)
        enough = (self.used.sum(axis=(0, 2)) >= 2)[:, None]
        self.covariance = np.linalg.inv(np.where(enough[..., None], N, np.eye(3)) + FLAT)
        self.positions = np.where(enough, np.einsum("jxy,jy->jx", self.covariance, n), np.nan)

    @property
    def wrong_images(self) -> Bool[np.ndarray, " V"]:
        """(V,) whether an image disagrees with the others, or with the past, in most of its joints."""
        seen = self._images.seen[..., 0]
        checked = seen & ((seen.sum(axis=0) > 1) | self.past)
        off = (checked & ~self.used[..., 0]).sum(axis=1)
        return (off >= WRONG_LEAST) & (off > WRONG_SHARE * checked.sum(axis=1))

    def _hypotheses(self) -> Float[np.ndarray, "H J 3"]:
        """Places to try: the past's, each image's by depth, each pair's by pixels, and all together's."""
        rows, seen, known = self._images.rows, self._images.seen, self._known[:, None]
        single = np.where(seen.all(axis=2, keepdims=True), _solve(rows, self._values), np.nan)
        axis, found = self._images.axis, np.isfinite(single).all(axis=-1, keepdims=True)
        ahead = ((GUESS - axis[:, 3:]) * axis[:, :3]).mean(axis=0)
        middle = np.where(found, single, 0.0).sum(axis=0) / np.maximum(found.sum(axis=0), 1)
        # somewhere near, to tell how far each camera is: the past, the middle of single images, or 3 m ahead
        guess = np.where(known, self._here, np.where(found.any(axis=0), middle, ahead))
        N, n = self._normal(seen, guess)
        past = np.einsum("jxy,jy->jx", self._prior, self._here)
        together = _solve(N.sum(axis=0) + self._prior + FLAT, n.sum(axis=0) + past)
        places = [np.where(known, self._here, np.nan)[None], single, together[None]]
        N, n = self._normal(seen & [True, False], guess)
        for a, b in combinations(range(min(len(rows), MOST_PAIRED)), 2):
            both = (seen[a] & seen[b])[:, :1]
            places.append(np.where(both, _solve(N[a] + N[b] + FLAT, n[a] + n[b]), np.nan)[None])
        return np.concatenate(places)

    def _depths(self, places: Places) -> Float[np.ndarray, "*h V J"]:
        axis = self._images.axis
        return np.einsum("vx,...jx->...vj", axis[:, :3], places) + axis[:, 3:]

    def _precision(self, places: Places) -> Float[np.ndarray, "*h V J 3"]:
        """(…, V, J, 3) 1/σ² of every row if the joints were at these places (…, J, 3)."""
        return 1 / (self._images.near**2 + (self._images.far * self._depths(places)[..., None]) ** 2)

    def _normal(self, used: Used, place: Points) -> tuple[Float[np.ndarray, "V J 3 3"], Float[np.ndarray, "V J 3"]]:
        """AᵀWA and AᵀWb of what is used of each image, a pixel's two rows and a depth's, weighted as at a place."""
        rows = self._images.rows
        weighted = (np.nan_to_num(self._precision(place)) * used[..., [0, 0, 1]])[..., None] * rows
        return np.einsum("vjrx,vjry->vjxy", rows, weighted), np.einsum("vjrx,vjr->vjx", weighted, self._values)

    def _cost(self, places: Places) -> Float[np.ndarray, "*h J"]:
        """(…, J) sum of squared errors, each up to its limit; inf where there is no place."""
        images, past = self._errors(places)
        cost = (np.minimum(images, LIMITS) * self._images.seen).sum(axis=(-3, -1))
        cost += np.minimum(past, PAST_LIMIT) * self._known
        return np.where(np.isfinite(places).all(axis=-1), cost, np.inf)

    def _errors(self, places: Places) -> tuple[Float[np.ndarray, "*h V J 2"], Float[np.ndarray, "*h J"]]:
        """Squared errors of pixels and depths, and of the past, in standard deviations; inf behind a camera."""
        off = np.einsum("vjrx,...jx->...vjr", self._images.rows, places) - self._values
        with np.errstate(invalid="ignore"):
            square = off * off * self._precision(places)
        square = np.where((self._depths(places) > 0)[..., None] & np.isfinite(square), square, np.inf)
        away = places - self._here
        past = np.einsum("...j,...j->...", away, np.einsum("jxy,...jy->...jx", self._prior, away))
        images = np.stack([square[..., 0] + square[..., 1], square[..., 2]], axis=-1)
        return images, np.where(np.isfinite(past), past, np.inf)


def _solve(A: Float[np.ndarray, "*b 3 3"], b: Float[np.ndarray, "*b 3"]) -> Float[np.ndarray, "*b 3"]:
    return np.linalg.solve(A, b[..., None])[..., 0]
