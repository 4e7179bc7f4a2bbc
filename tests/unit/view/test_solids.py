"""Capsules as triangles."""

from __future__ import annotations

import numpy as np

from kinecast.geometry.shapes import Capsule
from kinecast.view.solids import capsule_faces, capsule_vertices, facing


def test_corners_lie_on_the_capsules() -> None:
    rng = np.random.default_rng(0)
    start, end, radius = rng.normal(size=(5, 3)), rng.normal(size=(5, 3)), rng.uniform(0.05, 0.3, 5)
    end[4] = start[4]  # a ball
    corners = capsule_vertices(start, end, radius).reshape(5, -1, 3)
    for k in range(5):
        distance = Capsule(start[k], end[k], float(radius[k])).signed_distance(corners[k])
        np.testing.assert_allclose(distance, 0.0, atol=1e-9)


def test_triangles_face_outwards_and_hold_the_volume() -> None:
    start, end, radius = np.array([[0.1, 0.2, 0.3]]), np.array([[0.5, -0.1, 0.4]]), np.array([0.1])
    corners, faces = capsule_vertices(start, end, radius), capsule_faces(1)
    a, b, c = (corners[faces[:, k]] - start[0] for k in range(3))
    volume = np.einsum("fi,fi->f", a, np.cross(b, c)).sum() / 6  # of the signed tetrahedra
    length = float(np.linalg.norm(end - start))
    true = np.pi * 0.1**2 * length + 4 / 3 * np.pi * 0.1**3
    assert 0.95 * true < volume < true  # inscribed
    assert capsule_faces(3).max() == 3 * len(corners) - 1


def test_a_capsule_that_is_not_known_is_a_point() -> None:
    start = np.array([[np.nan, 0.0, 0.0], [0.0, 0.0, 0.0]])
    corners = capsule_vertices(start, np.tile([0.0, 0.0, 1.0], (2, 1)), np.full(2, 0.1)).reshape(2, -1, 3)
    assert np.isfinite(corners).all()
    assert not corners[0].any()


def test_rotations_carry_z_to_the_direction() -> None:
    direction = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -2.0], [3.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, -1.0, 0.2]])
    turns = facing(direction)
    np.testing.assert_allclose(np.einsum("kij,klj->kil", turns, turns), np.tile(np.eye(3), (5, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(turns), 1.0)
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    expected = np.where(length > 0, direction / np.maximum(length, 1e-9), [0.0, 0.0, 1.0])
    np.testing.assert_allclose(turns[:, :, 2], expected, atol=1e-12)
