"""Capsules as triangles, as the browser draws them."""

from __future__ import annotations

import numpy as np

from kinecast.geometry.shapes import Capsule
from kinecast.view.scene_nodes import capsule_faces, capsule_vertices


def test_corners_lie_on_the_capsules() -> None:
    rng = np.random.default_rng(0)
    rows = np.column_stack([rng.normal(size=(5, 6)), rng.uniform(0.05, 0.3, 5)])
    rows[3, 3:6] = rows[3, :3] - [0.0, 0.0, 2.0]  # upside down
    rows[4, 3:6] = rows[4, :3]  # a ball
    for row, corners in zip(rows, capsule_vertices(rows).reshape(5, -1, 3), strict=True):
        distance = Capsule(row[:3], row[3:6], float(row[6])).signed_distance(corners)
        np.testing.assert_allclose(distance, 0.0, atol=1e-9)


def test_triangles_face_outwards_and_hold_the_volume() -> None:
    start, end = np.array([0.1, 0.2, 0.3]), np.array([0.5, -0.1, 0.4])
    corners, faces = capsule_vertices(np.array([[*start, *end, 0.1]])), capsule_faces(1)
    a, b, c = (corners[faces[:, k]] - start for k in range(3))
    volume = np.einsum("fi,fi->f", a, np.cross(b, c)).sum() / 6  # of the signed tetrahedra
    length = float(np.linalg.norm(end - start))
    true = np.pi * 0.1**2 * length + 4 / 3 * np.pi * 0.1**3
    assert 0.95 * true < volume < true  # inscribed
    assert capsule_faces(3).max() == 3 * len(corners) - 1


def test_a_capsule_that_is_not_known_is_a_point() -> None:
    rows = np.array([[np.nan, 0.0, 0.0, 0.0, 0.0, 1.0, 0.1], [0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.1]])
    corners = capsule_vertices(rows).reshape(2, -1, 3)
    assert np.isfinite(corners).all()
    assert not corners[0].any()
