"""Which of several images, and the past, agree on where a joint is.

Every place that one image with depth, or two images, or the past alone would give is tried; what counts is how well all
others agree with it, each disagreement up to a limit (Torr and Zisserman 2000, MSAC, over all hypotheses in place of
random ones). A pixel and the depth read there are judged apart: behind a hand that is hidden by a box, the pixel may
be right and the depth is the box's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float

from kinecast.cameras.fusion.motion import JointStates
from kinecast.cameras.fusion.reach import ANCHOR_STD, Reach
from kinecast.cameras.fusion.sighting import Sighting

__all__ = ["Agreement", "Stack", "agree", "by_row", "stacked"]

PIXEL_LIMIT, DEPTH_LIMIT = 16.0, 12.0
"""Squared errors in standard deviations, of two and of one number, beyond which something is simply wrong: 3 in 10 000
and 5 in 10 000 of good ones are."""
PAST_LIMIT = 30.0
"""The same of the past. More than one image with depth together, so that it takes two images to overrule the past."""
IMPOSSIBLE = 80.0
"""What it costs to be too far from all neighbours: more than the past and an image together."""
MOST_PAIRED = 6
"""Images of which pairs are tried."""
ROUNDS = 2


@dataclass(frozen=True)
class Stack:
    """Several sightings of one person as arrays; V of them."""

    stamps: Float[np.ndarray, " V"]
    rows: Float[np.ndarray, "V J 3 3"]
    values: Float[np.ndarray, "V J 3"]
    near: Float[np.ndarray, "V J 3"]
    far: Float[np.ndarray, "V J 3"]
    seen: Bool[np.ndarray, "V J 2"]
    axis: Float[np.ndarray, "V 4"]


def stacked(sightings: Sequence[Sighting]) -> Stack:
    """Sightings as arrays."""
    parts = zip(*((s.rows, s.values, s.near, s.far, s.seen, s.axis) for s in sightings), strict=True)
    return Stack(np.array([s.stamp for s in sightings]), *map(np.stack, parts))


@dataclass(frozen=True)
class Agreement:
    """What is left after the wrong was thrown out.

    Attributes:
        used: (V, J, 2) whether the pixel, and the depth, of each image go in.
        precision: (V, J, 3) 1/σ² of each row; 0 where it does not go in.
        past: (J,) whether the past agrees.
        positions: (J, 3) where the joints are now, from these images alone; NaN where they do not suffice.
        covariance: (J, 3, 3) of that [m²].
        doubted: (J,) whether something was thrown out, and what is left does not tell how far the joint is.
    """

    used: Bool[np.ndarray, "V J 2"]
    precision: Float[np.ndarray, "V J 3"]
    past: Bool[np.ndarray, " J"]
    positions: Float[np.ndarray, "J 3"]
    covariance: Float[np.ndarray, "J 3 3"]
    doubted: Bool[np.ndarray, " J"]


def agree(stack: Stack, states: JointStates, reach: Reach) -> Agreement:
    """Which images agree with one another and with the past.

    Args:
        stack: one sighting for each camera.
        states: what is known of the joints, at the instant of interest.
        reach: how far they can be from one another.
    """
    V, J = stack.seen.shape[:2]
    known = states.known
    zero = np.zeros((J, 3))
    here = np.where(known[:, None], states.mean[:, 0], zero)
    moved = np.zeros((V, J, 3))  # from now to each image
    drift = np.zeros((V, J))  # variance of that
    for v, stamp in enumerate(stack.stamps):
        dt = states.stamp - stamp
        then, _ = states.at(stamp)
        moved[v, known] = (then - here)[known]
        speed = np.trace(states.covariance[:, 3:6, 3:6], axis1=1, axis2=2) / 3
        drift[v] = np.where(known, speed, 1.0) * dt * dt
    values = stack.values - np.einsum("vjrx,vjx->vjr", stack.rows, moved)  # as if taken now
    past_information = np.zeros((J, 3, 3))
    past_information[known] = np.linalg.inv((states.covariance[:, :3, :3] + states.standing)[known])
    anchors, anchored = reach.anchors(states)
    trial = _Trial(stack, values, drift, here, known, past_information, anchors, anchored)
    places = trial.hypotheses()
    best = np.argmin(trial.cost(places) + IMPOSSIBLE * reach.beyond(places, states), axis=0)
    place = places[best, np.arange(J)]
    used, past = trial.inliers(place)
    for _ in range(ROUNDS):
        place, _ = trial.solved(used, past, place)
        used, past = trial.inliers(place)
    positions, covariance = trial.solved(used, np.zeros(J, bool), place)
    told = used[..., 1].any(axis=0) | (used[..., 0].sum(axis=0) > 1)
    doubted = (stack.seen & ~used).any(axis=(0, 2)) & ~told
    return Agreement(used, trial.precision(place) * by_row(used), past, positions, covariance, doubted)


@dataclass(frozen=True)
class _Trial:
    stack: Stack
    values: Float[np.ndarray, "V J 3"]
    drift: Float[np.ndarray, "V J"]
    here: Float[np.ndarray, "J 3"]
    known: Bool[np.ndarray, " J"]
    past_information: Float[np.ndarray, "J 3 3"]
    anchors: Float[np.ndarray, "J 3"]
    anchored: Bool[np.ndarray, " J"]

    def precision(self, places: Float[np.ndarray, "*h J 3"]) -> Float[np.ndarray, "*h V J 3"]:
        """(…, V, J, 3) 1/σ² of every row if the joints were at these places (…, J, 3)."""
        s = self.stack
        z = np.einsum("vx,...jx->...vj", s.axis[:, :3], places) + s.axis[:, 3:]
        return 1 / (s.near**2 + (s.far * z[..., None]) ** 2 + self.drift[..., None])

    def hypotheses(self) -> Float[np.ndarray, "H J 3"]:
        """Places to try: the past's, each image's by depth or near the body, each pair's, and all together's."""
        s, V = self.stack, len(self.stack.stamps)
        whole = s.seen.all(axis=2, keepdims=True)
        single = np.where(whole, self._solve(s.rows, self.values), np.nan)
        guess = self._middle(single)
        weight = self.precision(guess)
        pixel = s.rows[:, :, :2] * np.sqrt(weight[:, :, :2, None])
        target = self.values[:, :, :2] * np.sqrt(weight[:, :, :2])
        N = np.einsum("vjrx,vjry->vjxy", pixel, pixel)
        n = np.einsum("vjrx,vjr->vjx", pixel, target)
        places = [np.where(self.known[:, None], self.here, np.nan)[None], single]
        for a, b in combinations(range(min(V, MOST_PAIRED)), 2):
            both = s.seen[a, :, 0] & s.seen[b, :, 0]
            pair = self._solve(N[a] + N[b] + 1e-3 * np.eye(3), n[a] + n[b])
            places.append(np.where(both[:, None], pair, np.nan)[None])
        hold = np.where(self.anchored, ANCHOR_STD**-2, 0.0)[:, None]
        near = self._solve(N + (hold[..., None] + 1e-3) * np.eye(3), n + hold * self.anchors)
        places.append(np.where(s.seen[:, :, :1] & self.anchored[:, None], near, np.nan))
        together, _ = self.solved(s.seen, self.known, guess)
        places.append(together[None])
        return np.concatenate(places)

    def cost(self, places: Float[np.ndarray, "H J 3"]) -> Float[np.ndarray, "H J"]:
        """(H, J) sum of squared errors, each up to its limit; inf where there is no place."""
        pixel, depth, past = self._errors(places)
        cost = (
            (np.minimum(pixel, PIXEL_LIMIT) * self.stack.seen[..., 0]).sum(axis=1)
            + (np.minimum(depth, DEPTH_LIMIT) * self.stack.seen[..., 1]).sum(axis=1)
            + np.minimum(past, PAST_LIMIT) * self.known
        )
        return np.where(np.isfinite(places).all(axis=-1), cost, np.inf)

    def inliers(self, place: Float[np.ndarray, "J 3"]) -> tuple[Bool[np.ndarray, "V J 2"], Bool[np.ndarray, " J"]]:
        """What is within its limit of a place (J, 3)."""
        pixel, depth, past = self._errors(place[None])
        used = self.stack.seen & np.stack([pixel[0] < PIXEL_LIMIT, depth[0] < DEPTH_LIMIT], axis=-1)
        return used, self.known & (past[0] < PAST_LIMIT)

    def solved(
        self, used: Bool[np.ndarray, "V J 2"], past: Bool[np.ndarray, " J"], place: Float[np.ndarray, "J 3"]
    ) -> tuple[Float[np.ndarray, "J 3"], Float[np.ndarray, "J 3 3"]]:
        """Weighted least squares over what is used: (J, 3) and its covariance; NaN where it does not suffice."""
        weight = self.precision(place) * by_row(used)
        weighted = np.where(np.isfinite(weight), weight, 0.0)[..., None] * self.stack.rows
        N = np.einsum("vjrx,vjry->jxy", self.stack.rows, weighted)
        n = np.einsum("vjrx,vjr->jx", weighted, self.values)
        N = N + self.past_information * past[:, None, None]
        n = n + np.einsum("jxy,jy->jx", self.past_information, self.here) * past[:, None]
        loose = ~past & ~used[..., 1].any(axis=0) & (used[..., 0].sum(axis=0) == 1) & self.anchored
        N = N + (loose * ANCHOR_STD**-2)[:, None, None] * np.eye(3)
        n = n + (loose * ANCHOR_STD**-2)[:, None] * self.anchors
        enough = past | loose | (used.sum(axis=(0, 2)) >= 2)
        N = np.where(enough[:, None, None], N, np.eye(3)) + 1e-3 * np.eye(3)
        covariance = np.linalg.inv(N)
        solution = np.where(enough[:, None], np.einsum("jxy,jy->jx", covariance, n), np.nan)
        return solution, covariance

    def _errors(
        self, places: Float[np.ndarray, "H J 3"]
    ) -> tuple[Float[np.ndarray, "H V J"], Float[np.ndarray, "H V J"], Float[np.ndarray, "H J"]]:
        """Squared errors of pixels, depths and past, in standard deviations; inf of what is behind a camera."""
        s = self.stack
        off = np.einsum("vjrx,hjx->hvjr", s.rows, places) - self.values
        with np.errstate(invalid="ignore"):
            square = off * off * self.precision(places)
        z = np.einsum("vx,hjx->hvj", s.axis[:, :3], places) + s.axis[:, 3:]
        square = np.where((z > 0)[..., None] & np.isfinite(square), square, np.inf)
        away = places - self.here
        past = np.einsum("hjx,jxy,hjy->hj", away, self.past_information, away)
        return square[..., 0] + square[..., 1], square[..., 2], np.where(np.isfinite(past), past, np.inf)

    def _middle(self, single: Float[np.ndarray, "V J 3"]) -> Float[np.ndarray, "J 3"]:
        """Somewhere near, to tell how far each camera is: the past, the middle of single images, or 3 m ahead."""
        s = self.stack
        ahead = np.stack([(3.0 - axis[3]) * axis[:3] for axis in s.axis]).mean(axis=0)
        found = np.where(np.isfinite(single).all(axis=-1, keepdims=True), single, 0.0)
        count = np.isfinite(single).all(axis=-1).sum(axis=0)[:, None]
        middle = np.where(count > 0, found.sum(axis=0) / np.maximum(count, 1), ahead)
        return np.where(self.known[:, None], self.here, middle)

    @staticmethod
    def _solve(A: Float[np.ndarray, "*b 3 3"], b: Float[np.ndarray, "*b 3"]) -> Float[np.ndarray, "*b 3"]:
        return np.linalg.solve(A, b[..., None])[..., 0]


def by_row(used: Bool[np.ndarray, "V J 2"]) -> Float[np.ndarray, "V J 3"]:
    """Two rows of a pixel, one of a depth, as 0 and 1."""
    return used[..., [0, 0, 1]].astype(np.float64)
