"""One arm in closed form against the same arm as a Denavit-Hartenberg table, and its inverse."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from kinecast.body.limits import JointLimits
from kinecast.body.posture import LEFT, LEFT_ARM, OUTSIDE_WEIGHT, RIGHT, arm_angles, arm_vectors

LENGTHS = np.array([0.31, 0.26])
LOWER, UPPER, _ = (limit[LEFT_ARM] for limit in JointLimits().of_posture())
SIDES = pytest.mark.parametrize("side", [LEFT, RIGHT])


def some_angles(count: int = 50) -> np.ndarray:
    """Angles all over, with straight, folded and sideways arms among them."""
    theta = np.random.default_rng(4).uniform(-3.0, 3.0, (count, 4))
    theta[0] = 0.0
    theta[1, 1] = np.pi / 2
    theta[2, 3] = np.pi
    theta[3, 3] = 0.0
    return theta


def elbows_and_wrists(theta: np.ndarray, side: float) -> np.ndarray:
    """(N, 2, 3) in closed form."""
    vectors = [arm_vectors(tuple(angles.tolist()), *LENGTHS, side) for angles in theta]
    return np.cumsum(vectors, axis=1)


@SIDES
def test_the_closed_form_is_the_denavit_hartenberg_chain(side: float, denavit_hartenberg: Callable) -> None:
    theta = some_angles()
    points, _ = denavit_hartenberg(theta, LENGTHS, side)
    np.testing.assert_allclose(elbows_and_wrists(theta, side), points, rtol=0, atol=1e-12)


@SIDES
def test_the_chains_jacobian_is_that_of_finite_differences(side: float, denavit_hartenberg: Callable) -> None:
    theta, step = some_angles(), 1e-5
    ahead, behind = (
        np.stack([elbows_and_wrists(theta + e, side)[:, 1] for e in sign * step * np.eye(4)], axis=-1)
        for sign in (1.0, -1.0)
    )
    _, jacobian = denavit_hartenberg(theta, LENGTHS, side)
    np.testing.assert_allclose(jacobian, (ahead - behind) / (2 * step), rtol=0, atol=1e-9)


def test_left_and_right_are_mirror_images() -> None:
    left, right = (elbows_and_wrists(some_angles(), side) for side in (LEFT, RIGHT))
    np.testing.assert_allclose(left * [1.0, -1.0, 1.0], right, atol=1e-15)


@SIDES
def test_angles_come_back_from_their_points(side: float) -> None:
    rng = np.random.default_rng(1)
    for theta in rng.uniform(LOWER + 0.2, UPPER - 0.2, (200, 4)):
        angles = tuple(theta.tolist())
        upper, fore = arm_vectors(angles, *LENGTHS, side)
        np.testing.assert_allclose(arm_angles(upper, fore, side, angles, OUTSIDE_WEIGHT), theta, atol=1e-10)


def test_angles_are_continuous_along_a_path() -> None:
    time = np.linspace(0.0, 2.0 * np.pi, 300)
    middle = np.array([0.6, 0.9, -0.3, 1.2])
    swing = np.array([0.7, 0.8, 0.6, 1.2])  # through a straight elbow, past shoulder height
    before = (np.nan,) * 4
    for theta in middle + swing * np.sin(time[:, None] + np.arange(4)):
        upper, fore = arm_vectors(tuple(theta.tolist()), *LENGTHS, LEFT)
        before = arm_angles(upper, fore, LEFT, before, OUTSIDE_WEIGHT)
        np.testing.assert_allclose(before, theta, atol=1e-9)
