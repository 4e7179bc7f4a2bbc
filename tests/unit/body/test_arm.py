"""The arm as a chain: anatomy, Jacobian by finite differences, and the same as a Denavit-Hartenberg table."""

from __future__ import annotations

import numpy as np
import pytest

from kinecast.body.arm import forward_kinematics, jacobian
from kinecast.body.arm_angles import LEFT, RIGHT, arm_vectors
from kinecast.body.denavit_hartenberg import T_TORSO_BASE, Link, arm_links, link_frames
from kinecast.errors import OptionError

LENGTHS = {4: np.array([0.31, 0.26]), 7: np.array([0.31, 0.26, 0.18])}
SIDES = pytest.mark.parametrize("side", [LEFT, RIGHT])
CHAINS = pytest.mark.parametrize("angles", [4, 7])


def some_angles(angles: int, count: int = 50) -> np.ndarray:
    """Angles all over, with straight, folded and sideways arms among them."""
    theta = np.random.default_rng(angles).uniform(-3.0, 3.0, (count, angles))
    theta[0] = 0.0
    theta[1, 1] = np.pi / 2
    theta[2, 3] = np.pi
    theta[3, 3] = 0.0
    return theta


@SIDES
def test_hanging_arm_points_down_and_the_hand_goes_on(side: float) -> None:
    points = forward_kinematics(np.zeros(7), LENGTHS[7], side)
    np.testing.assert_allclose(points, [[0, 0, -0.31], [0, 0, -0.57], [0, 0, -0.75]], atol=1e-15)


@SIDES
@pytest.mark.parametrize(
    ("angle", "tip"),
    [
        (None, (0.44, 0.0, -0.31)),  # elbow bent: forearm and hand ahead, thumb up
        (5, (0.26, -0.18, -0.31)),  # wrist flexed: towards the palm, which faces inward
        (6, (0.26, 0.0, -0.49)),  # ulnar: away from the thumb, so down
    ],
)
def test_wrist_angles_are_anatomical(side: float, angle: int | None, tip: tuple[float, ...]) -> None:
    theta = np.zeros(7)
    theta[3] = np.pi / 2
    if angle is not None:
        theta[angle] = np.pi / 2
    hand = forward_kinematics(theta, LENGTHS[7], side)[2]
    np.testing.assert_allclose(hand * [1.0, side, 1.0], tip, atol=1e-15)


@SIDES
def test_pronation_turns_the_palm_down(side: float) -> None:
    theta = np.array([0.0, 0.0, 0.0, np.pi / 2, np.pi / 2, np.pi / 2, 0.0])
    hand = forward_kinematics(theta, LENGTHS[7], side)[2]
    np.testing.assert_allclose(hand, [0.26, 0.0, -0.49], atol=1e-15)


@CHAINS
def test_left_and_right_are_mirror_images(angles: int) -> None:
    theta = some_angles(angles)
    left, right = (forward_kinematics(theta, LENGTHS[angles], side) for side in (LEFT, RIGHT))
    np.testing.assert_allclose(left * [1.0, -1.0, 1.0], right, atol=1e-15)


@SIDES
def test_the_hand_does_not_move_the_arm_and_the_kernel_is_the_same_arm(side: float) -> None:
    theta = some_angles(7)
    points = forward_kinematics(theta, LENGTHS[7], side)
    np.testing.assert_array_equal(points[:, :2], forward_kinematics(theta[:, :4], LENGTHS[4], side))
    for angles, arm in zip(theta, points, strict=True):
        upper, fore = arm_vectors(tuple(angles[:4].tolist()), 0.31, 0.26, side)
        np.testing.assert_allclose(arm[0], upper, atol=1e-15)
        np.testing.assert_allclose(arm[1] - arm[0], fore, atol=1e-15)


@SIDES
@CHAINS
def test_jacobian_is_that_of_finite_differences(angles: int, side: float) -> None:
    theta, step = some_angles(angles), 1e-5
    numeric = np.stack(
        [
            forward_kinematics(theta + e, LENGTHS[angles], side) - forward_kinematics(theta - e, LENGTHS[angles], side)
            for e in step * np.eye(angles)
        ],
        axis=-1,
    ) / (2 * step)
    np.testing.assert_allclose(jacobian(theta, LENGTHS[angles], side), numeric, rtol=0, atol=1e-9)


@SIDES
@CHAINS
def test_denavit_hartenberg_table_is_the_same_chain(angles: int, side: float) -> None:
    theta = some_angles(angles)
    frames = T_TORSO_BASE @ link_frames(arm_links(LENGTHS[angles].tolist(), side), theta)
    rows = {4: [2, 3], 7: [2, 4, 6]}[angles]
    np.testing.assert_allclose(
        frames[:, rows][..., :3, 3], forward_kinematics(theta, LENGTHS[angles], side), rtol=0, atol=1e-12
    )
    rotations = frames[..., :3, :3]
    unit = np.broadcast_to(np.eye(3), rotations.shape)
    np.testing.assert_allclose(rotations @ np.swapaxes(rotations, -1, -2), unit, atol=1e-12)


@SIDES
def test_each_denavit_hartenberg_axis_is_the_one_its_angle_turns_about(side: float) -> None:
    """The tip's derivative is sign · z × lever for every row."""
    theta = some_angles(7)
    links = arm_links(LENGTHS[7].tolist(), side)
    frames = T_TORSO_BASE @ link_frames(links, theta)
    base = np.broadcast_to(T_TORSO_BASE, (len(theta), 1, 4, 4))
    before = np.concatenate([base, frames[:, :-1]], axis=1)
    signs = np.array([link.sign for link in links])
    levers = frames[:, -1:, :3, 3] - before[..., :3, 3]
    columns = np.cross(signs[:, None] * before[..., :3, 2], levers)
    J = jacobian(theta, LENGTHS[7], side)[:, 2]
    np.testing.assert_allclose(np.swapaxes(columns, -1, -2), J, atol=1e-12)


def test_batches_of_lengths_follow_their_angles() -> None:
    theta = some_angles(4, 6).reshape(2, 3, 4)
    lengths = np.random.default_rng(0).uniform(0.2, 0.4, (2, 3, 2))
    points = forward_kinematics(theta, lengths, LEFT)
    assert jacobian(theta, lengths, LEFT).shape == (2, 3, 2, 3, 4)
    np.testing.assert_array_equal(points[1, 2], forward_kinematics(theta[1, 2], lengths[1, 2], LEFT))


def test_other_chains_are_refused_with_what_was_found() -> None:
    with pytest.raises(OptionError, match="5 angles and 2 lengths"):
        forward_kinematics(np.zeros(5), LENGTHS[4], LEFT)
    with pytest.raises(OptionError, match=r"side 0\.0"):
        jacobian(np.zeros(4), LENGTHS[4], 0.0)
    with pytest.raises(OptionError, match="1 lengths"):
        arm_links([0.3], LEFT)
    with pytest.raises(OptionError, match="3 angles for a chain of 1 links"):
        link_frames([Link(0.0, 0.0)], np.zeros(3))
