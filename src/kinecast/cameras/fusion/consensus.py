"""Which of several images, and the past, agree on where a joint is.

Every place that one image with depth, or two images, or the past alone would give is tried; what counts is how well all
others agree with it, each disagreement up to a limit (Torr and Zisserman 2000, MSAC, over all hypotheses in place of
random ones). A pixel and the depth read there are judged apart: behind a hand that is hidden by a box, the pixel may
be right and the depth is the box's.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse.csgraph import shortest_path

from kinecast.cameras.fusion.kalman import JointStates, Points
from kinecast.cameras.fusion.measurement import FUSED_JOINTS, Measurement, Places

LIMITS = np.array([16.0, 12.0])
"""Squared errors in standard deviations, of pixels and depths, beyond which something is simply wrong: 3 in 10 000
and 5 in 10 000 of good ones are."""
PAST_LIMIT = 30.0  # the same of the past: more than one image with depth, so that it takes two to overrule it
IMPOSSIBLE = 80.0  # what it costs to be too far from all neighbours: more than the past and an image together
MOST_PAIRED = 6  # images of which pairs are tried
WRONG_SHARE, WRONG_LEAST = 0.5, 3  # an image is wrong as a whole if that share, and so many joints, disagree
GUESS = 3.0  # distance of a joint of which nothing tells it [m], for the noise of its pixels
FLAT = 1e-3 * np.eye(3)  # keeps what a single pixel says solvable: 30 m [1/m²]
BONES = {
    ("pelvis", "lumbar"): 0.15, ("lumbar", "spine"): 0.15, ("spine", "thorax"): 0.15, ("thorax", "chest"): 0.15,
    ("chest", "collar"): 0.15, ("collar", "neck"): 0.15, ("neck", "head"): 0.25, ("head", "nose"): 0.20,
    ("collar", "shoulder"): 0.40, ("shoulder", "elbow"): 0.42, ("elbow", "wrist"): 0.36, ("wrist", "hand"): 0.22,
    ("pelvis", "hip"): 0.35, ("hip", "knee"): 0.60, ("knee", "ankle"): 0.60,
}  # fmt: skip
"""Longest bones [m]: a tall man's (ANSUR II, 99th percentile) and a fifth more, since points are marker clusters and
estimates, no joint centres."""
FARTHEST = 1.0  # joints that can be farther apart [m] say little of one another
RECENT = 0.3  # a joint not seen for so long [s] says nothing of its neighbours


class Consensus:
    """What is left of V images of one person after the wrong was thrown out, at the instant of their states.

    `used` (V, J, 2) says whether the pixel, and the depth, of each image go in, `past` (J,) whether the past agrees.
    `positions` (J, 3) are where these images alone say that the joints are, NaN where they do not suffice, with a
    `covariance` (J, 3, 3) [m²]; `information` and `surprise` are what they say for `JointStates.correct`.
    """

    def __init__(self, images: Measurement, states: JointStates, standing: Float[np.ndarray, "J 3 3"]) -> None:
        self._known, known = states.known, states.known[:, None]
        self._here = np.where(known, states.mean[:, 0], 0.0)
        moved = np.where(known, states.at(images.stamps) - states.mean[:, 0], 0.0)  # (V, J, 3) from now to each image
        values = images.values - np.einsum("vjrx,vjx->vjr", images.rows, moved)
        self._images = images = replace(images, values=values)  # as if taken now
        self._prior = np.zeros_like(standing)
        self._prior[states.known] = np.linalg.inv((states.covariance[:, :3, :3] + standing)[states.known])
        places = self._hypotheses()
        best = np.argmin(self._cost(places) + IMPOSSIBLE * _share_too_far(states, places), axis=0)
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
        single = np.where(seen.all(axis=2, keepdims=True), _solve(rows, self._images.values), np.nan)
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

    def _normal(
        self, used: Bool[np.ndarray, "V J 2"], place: Points
    ) -> tuple[Float[np.ndarray, "V J 3 3"], Float[np.ndarray, "V J 3"]]:
        """AᵀWA and AᵀWb of what is used of each image, a pixel's two rows and a depth's, weighted as at a place."""
        rows = self._images.rows
        weighted = (np.nan_to_num(1 / self._images.variance(place)) * used[..., [0, 0, 1]])[..., None] * rows
        return np.einsum("vjrx,vjry->vjxy", rows, weighted), np.einsum("vjrx,vjr->vjx", weighted, self._images.values)

    def _cost(self, places: Places) -> Float[np.ndarray, "*h J"]:
        """(…, J) sum of squared errors, each up to its limit; inf where there is no place."""
        images, past = self._errors(places)
        cost = (np.minimum(images, LIMITS) * self._images.seen).sum(axis=(-3, -1))
        cost += np.minimum(past, PAST_LIMIT) * self._known
        return np.where(np.isfinite(places).all(axis=-1), cost, np.inf)

    def _errors(self, places: Places) -> tuple[Float[np.ndarray, "*h V J 2"], Float[np.ndarray, "*h J"]]:
        """Squared errors of images, and of the past, in standard deviations."""
        away = places - self._here
        past = np.einsum("...j,...j->...", away, np.einsum("jxy,...jy->...jx", self._prior, away))
        return self._images.squared_errors(places), np.where(np.isfinite(past), past, np.inf)


def _solve(A: Float[np.ndarray, "*b 3 3"], b: Float[np.ndarray, "*b 3"]) -> Float[np.ndarray, "*b 3"]:
    return np.linalg.solve(A, b[..., None])[..., 0]


def _longest() -> Float[np.ndarray, "J J"]:
    """(J, J) longest distance of each two joints [m]: all bones between them in line."""
    bones = np.zeros((len(FUSED_JOINTS), len(FUSED_JOINTS)))
    for (a, b), far in BONES.items():
        for side in ("left_", "right_"):
            i, j = (FUSED_JOINTS.index(each if each in FUSED_JOINTS else side + each) for each in (a, b))
            bones[i, j] = far
    return np.asarray(shortest_path(bones, directed=False))


_LONGEST = _longest()
_NEIGHBOURS = (_LONGEST > 0) & (_LONGEST < FARTHEST)


def _share_too_far(states: JointStates, places: Float[np.ndarray, "*h J 3"]) -> Float[np.ndarray, "*h J"]:
    """(…, J) share of its neighbours that a joint at a place (…, J, 3) would be too far from; 0 without any."""
    told = _NEIGHBOURS & states.seen_within(RECENT)
    with np.errstate(invalid="ignore"):
        away = np.linalg.norm(places[..., :, None, :] - states.mean[:, 0], axis=-1)
        return ((away > _LONGEST) & told).sum(axis=-1) / np.maximum(told.sum(axis=-1), 1)
