"""Capsules as triangles."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

__all__ = ["capsule_faces", "capsule_vertices", "facing"]

AROUND, UP = 24, 14
"""Corners around the axis; rings from one cap's pole to the other's, half of them on each cap."""


def _unit() -> tuple[Float[np.ndarray, "V 3"], Float[np.ndarray, " V"]]:
    """Directions (V, 3) from a capsule's ends along z, and which end (V,): 0 start, 1 end."""
    latitude = np.concatenate([np.linspace(-np.pi / 2, 0.0, UP // 2), np.linspace(0.0, np.pi / 2, UP // 2)])
    longitude = np.linspace(0.0, 2 * np.pi, AROUND, endpoint=False)
    up, around = np.meshgrid(latitude, longitude, indexing="ij")
    directions = np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], axis=-1)
    which = np.repeat(np.arange(UP) >= UP // 2, AROUND).astype(np.float64)
    return directions.reshape(-1, 3), which


DIRECTIONS, END = _unit()


def facing(direction: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "K 3 3"]:
    """(K, 3, 3) rotations that carry z to each direction; one without length stays z."""
    length = np.linalg.norm(direction, axis=-1, keepdims=True)
    z = np.where(length > 1e-9, direction / np.maximum(length, 1e-9), [0.0, 0.0, 1.0])
    aside = np.where(np.abs(z[:, :1]) < 0.8, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    y = np.cross(z, aside)
    y /= np.linalg.norm(y, axis=-1, keepdims=True)
    return np.stack([np.cross(y, z), y, z], axis=-1)


def capsule_vertices(
    start: Float[np.ndarray, "K 3"], end: Float[np.ndarray, "K 3"], radius: Float[np.ndarray, " K"]
) -> Float[np.ndarray, "W 3"]:
    """(K V, 3) corners of K capsules [m], in the order of `capsule_faces`.

    Args:
        start, end: (K, 3) ends of the axes [m]; a capsule that is not finite shrinks to a point at the origin.
        radius: (K,) [m].
    """
    known = np.isfinite(start).all(axis=1) & np.isfinite(end).all(axis=1) & np.isfinite(radius)
    start, end = np.where(known[:, None], start, 0.0), np.where(known[:, None], end, 0.0)
    round_ = np.einsum("kij,vj->kvi", facing(end - start), DIRECTIONS) * np.where(known, radius, 0.0)[:, None, None]
    axis = start[:, None] + END[None, :, None] * (end - start)[:, None]
    return (axis + round_).reshape(-1, 3)


def capsule_faces(count: int) -> Int[np.ndarray, "F 3"]:
    """(F, 3) corners of each triangle of so many capsules, counter-clockwise from outside."""
    ring, column = np.meshgrid(np.arange(UP - 1), np.arange(AROUND), indexing="ij")
    a, b = ring * AROUND + column, ring * AROUND + (column + 1) % AROUND
    c, d = a + AROUND, b + AROUND
    one = np.concatenate([np.stack([a, b, d], axis=-1), np.stack([a, d, c], axis=-1)]).reshape(-1, 3)
    return (one[None] + len(END) * np.arange(count)[:, None, None]).reshape(-1, 3)
