"""Who is who: the people of one image, and the persons that are known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment

from kinecast.cameras.fusion.consensus import DEPTH_LIMIT, PIXEL_LIMIT
from kinecast.cameras.fusion.motion import JointStates
from kinecast.cameras.fusion.sighting import Sighting

__all__ = ["LIMIT", "assign", "distance"]

LIMIT = 0.55
"""Mean share of the limits up to which a sighting may be of a person."""
LEAST_SHARED = 3
"""Joints that must be seen and known for a comparison."""


def distance(sighting: Sighting, states: JointStates) -> float:
    """How far a sighting is from a person, 0..1; see `_distance`."""
    return _distance(sighting, states, *states.at(sighting.stamp))


def _distance(
    sighting: Sighting, states: JointStates, places: Float[np.ndarray, "J 3"], spread: Float[np.ndarray, "J 3 3"]
) -> float:
    """Squared Mahalanobis distances of pixels and depths from where joints should be (J, 3), each up to its limit.

    Returns:
        Their mean share of the limit, over joints that are seen and known; inf where these are too few.
    """
    both = sighting.seen[:, 0] & states.known
    if both.sum() < LEAST_SHARED:
        return np.inf
    then, covariance = places[both], spread[both]
    rows, deep = sighting.rows[both], sighting.seen[both, 1]
    z = then @ sighting.axis[:3] + sighting.axis[3]
    off = np.einsum("jrx,jx->jr", rows, then) - sighting.values[both]
    noise = sighting.near[both] ** 2 + (sighting.far[both] * z[:, None]) ** 2
    square = off * off / (noise + np.einsum("jrx,jxy,jry->jr", rows, covariance, rows))
    square[(z <= 0)[:, None] | ~np.isfinite(square)] = np.inf
    pixel = np.minimum(square[:, 0] + square[:, 1], PIXEL_LIMIT).sum()
    depth = np.minimum(square[:, 2], DEPTH_LIMIT)[deep].sum()
    return float((pixel + depth) / (PIXEL_LIMIT * len(z) + DEPTH_LIMIT * deep.sum()))


def assign(sightings: Sequence[Sighting], persons: Sequence[JointStates]) -> list[int | None]:
    """For each sighting of one image the person it is of, or None: the assignment of least total distance."""
    found: list[int | None] = [None] * len(sightings)
    if not sightings or not persons:
        return found
    columns = []
    for person in persons:
        there = person.at(sightings[0].stamp)  # all are of one image
        columns.append([_distance(sighting, person, *there) for sighting in sightings])
    costs: Float[np.ndarray, "N M"] = np.array(columns).T
    for row, column in zip(*linear_sum_assignment(np.minimum(costs, 1.0)), strict=True):
        if costs[row, column] < LIMIT:
            found[row] = int(column)
    return found
