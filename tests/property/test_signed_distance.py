"""Signed distances against brute force: closest points found by a general optimiser or by dense sampling."""

from __future__ import annotations

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from kinecast.geometry.shapes import Box, Capsule, HalfSpace, Shape, Sphere
from kinecast.geometry.transforms import from_rotation_vector

coordinate = st.floats(-2.0, 2.0, allow_subnormal=False)
vectors = arrays(np.float64, 3, elements=coordinate)
lengths = st.floats(0.01, 2.0)
boxes = st.builds(
    lambda c, s, r: Box(c, s, from_rotation_vector(r)),
    vectors,
    arrays(np.float64, 3, elements=lengths),
    vectors,
)
spheres = st.builds(Sphere, vectors, lengths)
capsules = st.builds(Capsule, vectors, vectors, lengths)
half_spaces = st.builds(HalfSpace, vectors, vectors.filter(lambda n: np.linalg.norm(n) > 0.1))
shapes = st.one_of(boxes, spheres, capsules, half_spaces)


@given(shapes, vectors, vectors)
@settings(max_examples=150)
def test_the_segment_distance_is_the_least_over_its_points(shape: Shape, start: np.ndarray, end: np.ndarray) -> None:
    """A convex function along the segment: refine a grid around its best point until nothing is gained."""
    low, high = 0.0, 1.0
    for _ in range(8):
        t = np.linspace(low, high, 41)
        values = shape.signed_distance(start + t[:, None] * (end - start))
        best = int(np.argmin(values))
        low, high = t[max(best - 1, 0)], t[min(best + 1, 40)]
    assert abs(float(shape.segment_distance(start, end)) - values[best]) < 1e-9


@given(shapes, vectors)
@settings(max_examples=150)
def test_walking_the_distance_against_the_gradient_meets_the_surface(shape: Shape, point: np.ndarray) -> None:
    """The gradient has norm 1 wherever the nearest surface point is unique, on both sides of the surface."""
    h = 1e-6
    steps = np.concatenate([h * np.eye(3), -h * np.eye(3)])
    values = shape.signed_distance(point + steps)
    gradient = (values[:3] - values[3:]) / (2 * h)
    distance = float(shape.signed_distance(point))
    curvature = np.abs(values[:3] + values[3:] - 2 * distance).max() / h
    assume(curvature < 1e-4)  # away from edges of the distance field: axis of a capsule, diagonals of a box
    assert abs(np.linalg.norm(gradient) - 1.0) < 1e-4
    surface = point - distance * gradient
    assert abs(float(shape.signed_distance(surface))) < 1e-3


@given(shapes, vectors, vectors)
@settings(max_examples=100)
def test_no_distance_changes_faster_than_the_point_moves(shape: Shape, a: np.ndarray, b: np.ndarray) -> None:
    change = abs(float(shape.signed_distance(a)) - float(shape.signed_distance(b)))
    assert change <= np.linalg.norm(a - b) + 1e-12


@given(boxes, vectors)
@settings(max_examples=100)
def test_a_box_against_its_nearest_surface_point(box: Box, point: np.ndarray) -> None:
    """Clip onto each of the six faces in turn: the nearest of the six is the distance to the surface."""
    local, half = box.rotation.T @ (point - box.center), box.size / 2
    to_faces = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            on_face = np.clip(local, -half, half)
            on_face[axis] = side * half[axis]
            to_faces.append(np.linalg.norm(local - on_face))
    sign = -1.0 if np.all(np.abs(local) < half) else 1.0
    assert abs(float(box.signed_distance(point)) - sign * min(to_faces)) < 1e-12


@given(capsules, vectors, vectors)
@settings(max_examples=100)
def test_a_capsule_against_two_segments(capsule: Capsule, start: np.ndarray, end: np.ndarray) -> None:
    """The closest points of two segments, by clamped alternation from a grid of starts."""
    axis, limb = capsule.end - capsule.start, end - start
    t = np.linspace(0.0, 1.0, 21)
    for _ in range(60):
        p = start + t[:, None] * limb
        s = np.clip((p - capsule.start) @ axis / max(axis @ axis, 1e-300), 0, 1)
        q = capsule.start + s[:, None] * axis
        t = np.clip((q - start) @ limb / max(limb @ limb, 1e-300), 0, 1)
    nearest = np.linalg.norm(start + t[:, None] * limb - q, axis=-1).min() - capsule.radius
    found = float(capsule.segment_distance(start, end))
    assert found <= nearest + 1e-12
    assert nearest - found < 2e-2  # alternation creeps between almost parallel segments
