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

from kinecast.cameras.fusion.kalman import ANCHOR_STD, Flags, JointStates, Matrices, Points, back
from kinecast.cameras.fusion.measurement import Measurement

Used = Bool[np.ndarray, "V J 2"]
Places = Float[np.ndarray, "*h J 3"]
LIMITS = np.array([16.0, 12.0])
"""Squared errors in standard deviations, of pixels and depths, beyond which something is simply wrong: 3 in 10 000
and 5 in 10 000 of good ones are."""
PAST_LIMIT = 30.0  # the same of the past: more than one image with depth, so that it takes two to overrule it
IMPOSSIBLE = 80.0  # what it costs to be too far from all neighbours: more than the past and an image together
MOST_PAIRED = 6  # images of which pairs are tried
REFINEMENTS = 2
WRONG_SHARE, WRONG_LEAST = 0.5, 3  # an image is wrong as a whole if that share, and so many joints, disagree
GUESS = 3.0  # distance of a joint of which nothing tells it [m], for the noise of its pixels


class Consensus:
    """What is left of V images of one person after the wrong was thrown out, at the instant of their states.

    `used` (V, J, 2) says whether the pixel, and the depth, of each image go in, `past` (J,) whether the past agrees.
    `positions` (J, 3) are where these images alone say that the joints are, NaN where they do not suffice, with a
    `covariance` (J, 3, 3) [m²].
    """

    def __init__(self, images: Measurement, states: JointStates) -> None:
        self._images = images
        self._known = known = states.known
        self._here = np.where(known[:, None], states.mean[:, 0], 0.0)
        then = np.einsum("va,jax->vjx", back(states.stamp - images.stamp), states.mean)
        moved = np.where(known[:, None], then - states.mean[:, 0], 0.0)  # (V, J, 3) from now to each image
        self._values = images.values - np.einsum("vjrx,vjx->vjr", images.rows, moved)  # as if taken now
        speed = np.where(known, np.trace(states.covariance[:, 3:6, 3:6], axis1=1, axis2=2) / 3, 1.0)
        self._drift = speed * (states.stamp - images.stamp)[:, None] ** 2  # (V, J) variance of `moved`
        self._past_information = np.zeros((len(known), 3, 3))
        self._past_information[known] = np.linalg.inv((states.covariance[:, :3, :3] + states.standing)[known])
        self._anchors, self._anchored = states.anchors()
        places = self._hypotheses()
        best = np.argmin(self._cost(places) + IMPOSSIBLE * states.share_too_far(places), axis=0)
        place = places[best, np.arange(len(known))]
        self.used, self.past = self._inliers(place)
        for _ in range(REFINEMENTS):
            place, _ = self._solved(self.used, self.past, place)
            self.used, self.past = self._inliers(place)
        self.positions, self.covariance = self._solved(self.used, np.zeros_like(known), place)
        self._place = place

    @property
    def doubted(self) -> Flags:
        """(J,) whether something was thrown out, and what is left does not tell how far the joint is."""
        return (self._images.seen & ~self.used).any(axis=(0, 2)) & ~self.located

    @property
    def located(self) -> Flags:
        """(J,) whether images tell how far the joint is: by a depth, or by two pixels."""
        return self.used[..., 1].any(axis=0) | (self.used[..., 0].sum(axis=0) > 1)

    @property
    def wrong_images(self) -> Bool[np.ndarray, " V"]:
        """(V,) whether an image disagrees with the others, or with the past, in most of its joints."""
        seen = self._images.seen[..., 0]
        checked = seen & ((seen.sum(axis=0) > 1) | self.past)
        off = (checked & ~self.used[..., 0]).sum(axis=1)
        return (off >= WRONG_LEAST) & (off > WRONG_SHARE * checked.sum(axis=1))

    def evidence(self) -> tuple[Float[np.ndarray, "V J 3 3"], Float[np.ndarray, "V J 3"]]:
        """What is used, for `JointStates.correct`: AᵀWA and AᵀW(b − A p) of each image."""
        rows, weighted = self._images.rows, self._weighted(self.used, self._place)
        off = self._values - np.einsum("vjrx,jx->vjr", rows, self._here)
        return np.einsum("vjrx,vjry->vjxy", rows, weighted), np.einsum("vjrx,vjr->vjx", weighted, off)

    def _hypotheses(self) -> Float[np.ndarray, "H J 3"]:
        """Places to try: the past's, each image's by depth or near the body, each pair's, and all together's."""
        rows, seen = self._images.rows, self._images.seen
        single = np.where(seen.all(axis=2, keepdims=True), _solve(rows, self._values), np.nan)
        axis, found = self._images.axis, np.isfinite(single).all(axis=-1, keepdims=True)
        ahead = ((GUESS - axis[:, 3:]) * axis[:, :3]).mean(axis=0)
        middle = np.where(found, single, 0.0).sum(axis=0) / np.maximum(found.sum(axis=0), 1)
        # somewhere near, to tell how far each camera is: the past, the middle of single images, or 3 m ahead
        guess = np.where(self._known[:, None], self._here, np.where(found.any(axis=0), middle, ahead))
        weight = self._precision(guess)[:, :, :2]
        weighted = weight[..., None] * rows[:, :, :2]
        N = np.einsum("vjrx,vjry->vjxy", rows[:, :, :2], weighted) + 1e-3 * np.eye(3)
        n = np.einsum("vjrx,vjr->vjx", weighted, self._values[:, :, :2])
        places = [np.where(self._known[:, None], self._here, np.nan)[None], single]
        for a, b in combinations(range(min(len(rows), MOST_PAIRED)), 2):
            both = seen[a, :, 0] & seen[b, :, 0]
            places.append(np.where(both[:, None], _solve(N[a] + N[b], n[a] + n[b]), np.nan)[None])
        hold = self._anchored[:, None] * ANCHOR_STD**-2
        near = _solve(N + hold[..., None] * np.eye(3), n + hold * self._anchors)
        places.append(np.where(seen[:, :, :1] & self._anchored[:, None], near, np.nan))
        places.append(self._solved(seen, self._known, guess)[0][None])
        return np.concatenate(places)

    def _depths(self, places: Places) -> Float[np.ndarray, "*h V J"]:
        axis = self._images.axis
        return np.einsum("vx,...jx->...vj", axis[:, :3], places) + axis[:, 3:]

    def _precision(self, places: Places) -> Float[np.ndarray, "*h V J 3"]:
        """(…, V, J, 3) 1/σ² of every row if the joints were at these places (…, J, 3)."""
        far = self._images.far * self._depths(places)[..., None]
        return 1 / (self._images.near**2 + far**2 + self._drift[..., None])

    def _weighted(self, used: Used, place: Points) -> Float[np.ndarray, "V J 3 3"]:
        """(V, J, 3, 3) rows by their precision at a place; 0 where a pixel, two rows, or a depth, one, is not used."""
        precision = np.nan_to_num(self._precision(place)) * used[..., [0, 0, 1]]
        return precision[..., None] * self._images.rows

    def _cost(self, places: Places) -> Float[np.ndarray, "*h J"]:
        """(…, J) sum of squared errors, each up to its limit; inf where there is no place."""
        images, past = self._errors(places)
        cost = (np.minimum(images, LIMITS) * self._images.seen).sum(axis=(-3, -1))
        cost += np.minimum(past, PAST_LIMIT) * self._known
        return np.where(np.isfinite(places).all(axis=-1), cost, np.inf)

    def _inliers(self, place: Points) -> tuple[Used, Flags]:
        """What is within its limit of a place (J, 3)."""
        images, past = self._errors(place)
        return self._images.seen & (images < LIMITS), self._known & (past < PAST_LIMIT)

    def _errors(self, places: Places) -> tuple[Float[np.ndarray, "*h V J 2"], Float[np.ndarray, "*h J"]]:
        """Squared errors of pixels and depths, and of the past, in standard deviations; inf behind a camera."""
        off = np.einsum("vjrx,...jx->...vjr", self._images.rows, places) - self._values
        with np.errstate(invalid="ignore"):
            square = off * off * self._precision(places)
        square = np.where((self._depths(places) > 0)[..., None] & np.isfinite(square), square, np.inf)
        away = places - self._here
        past = np.einsum("...jx,jxy,...jy->...j", away, self._past_information, away)
        images = np.stack([square[..., 0] + square[..., 1], square[..., 2]], axis=-1)
        return images, np.where(np.isfinite(past), past, np.inf)

    def _solved(self, used: Used, past: Flags, place: Points) -> tuple[Points, Matrices]:
        """Weighted least squares over what is used: (J, 3) and its covariance; NaN where it does not suffice."""
        rows = self._images.rows
        weighted = self._weighted(used, place)
        N = np.einsum("vjrx,vjry->jxy", rows, weighted) + self._past_information * past[:, None, None]
        n = np.einsum("vjrx,vjr->jx", weighted, self._values)
        n += np.einsum("jxy,jy->jx", self._past_information, self._here) * past[:, None]
        loose = ~past & ~used[..., 1].any(axis=0) & (used[..., 0].sum(axis=0) == 1) & self._anchored
        hold = loose[:, None] * ANCHOR_STD**-2
        enough = past | loose | (used.sum(axis=(0, 2)) >= 2)
        N = np.where(enough[:, None, None], N + hold[..., None] * np.eye(3), np.eye(3)) + 1e-3 * np.eye(3)
        covariance = np.linalg.inv(N)
        solution = np.einsum("jxy,jy->jx", covariance, n + hold * self._anchors)
        return np.where(enough[:, None], solution, np.nan), covariance


def _solve(A: Float[np.ndarray, "*b 3 3"], b: Float[np.ndarray, "*b 3"]) -> Float[np.ndarray, "*b 3"]:
    return np.linalg.solve(A, b[..., None])[..., 0]
