"""Signed distances of the shapes at places where they are known, and what the shapes refuse."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from kinecast.errors import OptionError
from kinecast.geometry.shapes import Box, Capsule, HalfSpace, Shape, Sphere
from kinecast.geometry.transforms import rotation_z

O = np.zeros(3)  # noqa: E741
X, Y, Z = np.eye(3)


@pytest.mark.parametrize(
    ("shape", "point", "distance"),
    [
        (HalfSpace(Z, 5 * Z), 3 * Z + X, 2.0),
        (HalfSpace(Z, 5 * Z), -Z, -2.0),
        (Sphere(X, 0.5), 3 * X, 1.5),
        (Sphere(X, 0.5), X, -0.5),
        (Box(O, np.array([2.0, 4.0, 6.0])), O, -1.0),
        (Box(O, np.array([2.0, 4.0, 6.0])), np.array([4.0, 6.0, 3.0]), 5.0),
        (Box(O, np.array([2.0, 4.0, 6.0])), np.array([0.5, 1.9, 0.0]), -0.1),
        (Box(O, np.array([2.0, 2.0, 2.0]), rotation_z(np.pi / 4)), 2 * X, 2 - np.sqrt(2)),
        (Capsule(-X, X, 0.25), np.array([0.3, 1.0, 0.0]), 0.75),
        (Capsule(-X, X, 0.25), 3 * X, 1.75),
        (Capsule(-X, X, 0.25), 0.7 * X, -0.25),
        (Capsule(Y, Y, 0.25), O, 0.75),
    ],
)
def test_signed_distance(shape: Shape, point: np.ndarray, distance: float) -> None:
    assert shape.signed_distance(point) == pytest.approx(distance, abs=1e-14)
    assert shape.segment_distance(point, point) == pytest.approx(distance, abs=1e-14)


@pytest.mark.parametrize(
    ("shape", "start", "end", "distance"),
    [
        (HalfSpace(O, Z), X + Z, Y - 2 * Z, -2.0),
        (Sphere(O, 0.5), np.array([-3.0, 2.0, 0.0]), np.array([3.0, 2.0, 0.0]), 1.5),
        (Sphere(O, 0.5), -X, X, -0.5),
        (
            Box(O, np.ones(3)),
            np.array([-5.0, 0.0, 0.75]),
            np.array([5.0, 0.0, 0.75]),
            0.25,
        ),  # parallel to a face
        (Box(O, np.ones(3)), -5 * X, 5 * X, -0.5),  # through
        (Box(O, np.ones(3)), np.array([-2.0, 0.0, 0.4]), np.array([2.0, 0.0, 0.4]), -0.1),
        (
            Box(O, np.ones(3)),
            np.array([0.0, 1.5, 0.0]),
            np.array([1.5, 0.0, 0.0]),
            0.25 * np.sqrt(2),
        ),  # at an edge
        (Box(O, np.ones(3)), 0.1 * X, 0.2 * X, -0.4),  # wholly inside
        (Capsule(-X, X, 0.1), np.array([0.0, -1.0, 0.5]), np.array([0.0, 1.0, 0.5]), 0.4),  # crossing above
        (Capsule(-X, X, 0.1), -Y, Y, -0.1),  # axes meet
    ],
)
def test_segment_distance(shape: Shape, start: np.ndarray, end: np.ndarray, distance: float) -> None:
    assert shape.segment_distance(start, end) == pytest.approx(distance, abs=1e-12)
    assert shape.segment_distance(end, start) == pytest.approx(distance, abs=1e-12)


def test_batches_keep_their_axes_and_nan_stays_nan() -> None:
    box = Box(O, np.ones(3))
    points = np.zeros((2, 4, 3))
    points[1, 2, 0] = np.nan
    for distances in (box.signed_distance(points), box.segment_distance(points, points + X)):
        assert distances.shape == (2, 4)
        assert np.isnan(distances[1, 2])
        assert np.isfinite(distances).sum() == 7
    assert box.signed_distance(np.empty((0, 3))).shape == (0,)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: HalfSpace(O, O), "normal .* no direction"),
        (lambda: HalfSpace(np.array([np.nan, 0, 0]), Z), "half-space point .* three finite numbers"),
        (lambda: Sphere(O, 0.0), r"sphere radius 0.0 m must be above 0"),
        (lambda: Sphere(O, np.inf), r"sphere radius inf m"),
        (lambda: Capsule(O, X, -1.0), r"capsule radius -1.0 m must be above 0"),
        (lambda: Box(O, np.array([1.0, 0.0, 1.0])), r"box size \[1.0, 0.0, 1.0\] m"),
        (lambda: Box(O, np.ones(3), 1.01 * np.eye(3)), "not a rotation matrix"),
        (lambda: Box(O, np.ones(3), np.diag([1.0, 1.0, -1.0])), "reflection"),
    ],
)
def test_impossible_shapes_are_refused(build: Callable[[], Shape], message: str) -> None:
    with pytest.raises(OptionError, match=message):
        build()


def test_a_shape_cannot_be_changed_from_outside() -> None:
    center = np.zeros(3)
    sphere = Sphere(center, 1.0)
    center[0] = 5.0
    assert sphere.center[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        sphere.center[0] = 1.0
