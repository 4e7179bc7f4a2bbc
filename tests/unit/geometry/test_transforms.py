"""SE(3): composition, inverse and the conventions (wxyz, right-handed turns)."""

from __future__ import annotations

import numpy as np
import pytest

from kinecast.errors import OptionError
from kinecast.geometry import transforms as tf


def random_transforms(count: int) -> np.ndarray:
    rng = np.random.default_rng(7)
    return tf.transform(tf.from_rotation_vector(rng.normal(size=(count, 3))), rng.normal(size=(count, 3)))


def test_inverse_undoes_and_composition_applies_right_to_left() -> None:
    A, B = random_transforms(20), random_transforms(40)[20:]
    points = np.random.default_rng(1).normal(size=(20, 3))
    np.testing.assert_allclose(tf.inverse(A) @ A, np.broadcast_to(np.eye(4), A.shape), atol=1e-14)
    np.testing.assert_allclose(tf.apply(A @ B, points), tf.apply(A, tf.apply(B, points)), atol=1e-14)


def test_apply_broadcasts_one_transform_per_time_step() -> None:
    T = random_transforms(5)
    points = np.random.default_rng(2).normal(size=(5, 6, 3))
    moved = tf.apply(T[:, None], points)
    assert moved.shape == (5, 6, 3)
    np.testing.assert_allclose(moved[3, 4], tf.apply(T[3], points[3, 4]), atol=1e-15)


@pytest.mark.parametrize(
    ("turn", "before", "after"),
    [
        (tf.rotation_x, [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]),
        (tf.rotation_y, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]),
        (tf.rotation_z, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]),
    ],
)
def test_a_quarter_turn_follows_the_right_hand_rule(turn, before, after) -> None:  # type: ignore[no-untyped-def]
    np.testing.assert_allclose(turn(np.pi / 2) @ np.array(before), after, atol=1e-15)
    assert turn(np.zeros((2, 5))).shape == (2, 5, 3, 3)


def test_quaternions_are_wxyz() -> None:
    quarter_about_z = np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
    np.testing.assert_allclose(tf.from_quaternion(quarter_about_z), tf.rotation_z(np.pi / 2), atol=1e-15)
    np.testing.assert_allclose(tf.from_quaternion(-3.0 * quarter_about_z), tf.rotation_z(np.pi / 2), atol=1e-15)
    np.testing.assert_allclose(tf.to_quaternion(tf.rotation_z(np.pi / 2)), quarter_about_z, atol=1e-15)


def test_rotation_vector_and_quaternion_round_trips() -> None:
    vectors = np.random.default_rng(3).normal(size=(4, 5, 3))
    vectors *= np.linspace(1e-9, 3.1, 20).reshape(4, 5, 1) / np.linalg.norm(vectors, axis=-1, keepdims=True)
    R = tf.from_rotation_vector(vectors)
    np.testing.assert_allclose(tf.rotation_vector(R), vectors, atol=1e-12)
    np.testing.assert_allclose(tf.from_quaternion(tf.to_quaternion(R)), R, atol=1e-14)


@pytest.mark.parametrize("quaternion", [[0.0, 0.0, 0.0, 0.0], [np.nan, 0.0, 0.0, 1.0]])
def test_a_quaternion_without_length_is_refused(quaternion: list[float]) -> None:
    with pytest.raises(OptionError, match="length zero"):
        tf.from_quaternion(np.array([[1.0, 0.0, 0.0, 0.0], quaternion]))
