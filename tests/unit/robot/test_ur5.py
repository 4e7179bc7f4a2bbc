"""The arm's kinematics against published figures, pinocchio and finite differences."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from kinecast.robot import ur5
from kinecast.robot.ur5 import LINKS, UR5

D = (0.089159, 0.0, 0.0, 0.10915, 0.09465, 0.0823)
A = (0.0, -0.425, -0.39225, 0.0, 0.0, 0.0)
ALPHA = (np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0)
TOOL = 0.15
"""From the flange to between the fingertips [m]."""


def table_pose(q: np.ndarray) -> np.ndarray:
    """T_base_flange straight from the manufacturer's Denavit-Hartenberg table."""
    T = np.eye(4)
    for theta, d, a, alpha in zip(q, D, A, ALPHA, strict=True):
        c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        T = T @ [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
    return T


def flange(arm: UR5, q: np.ndarray) -> np.ndarray:
    back = np.eye(4)
    back[2, 3] = -TOOL
    return arm.forward_kinematics(q) @ back


@pytest.mark.parametrize(
    ("q", "position"),
    [
        # Stretched along −x: a2 + a3, −(d4 + d6), d1 − d5.
        ([0, 0, 0, 0, 0, 0], [-0.81725, -0.19145, -0.005491]),
        # Upright: everything above the base; d1 − a2 − a3 + d5.
        ([0, -np.pi / 2, 0, -np.pi / 2, 0, 0], [0, -0.19145, 1.001059]),
    ],
)
def test_the_flange_is_where_the_published_figures_put_it(arm: UR5, q: list[float], position: list[float]) -> None:
    np.testing.assert_allclose(flange(arm, np.array(q, dtype=float))[:3, 3], position, atol=1e-9)


def test_forward_kinematics_is_that_of_the_published_table(arm: UR5) -> None:
    for q in np.random.default_rng(0).uniform(-6, 6, (20, 6)):
        np.testing.assert_allclose(flange(arm, q), table_pose(q), atol=1e-9)


def test_limits_are_those_of_the_data_sheet(arm: UR5) -> None:
    np.testing.assert_allclose(arm.q_range[[0, 1, 3, 4, 5]], [[-2 * np.pi, 2 * np.pi]] * 5)
    np.testing.assert_allclose(arm.q_range[2], [-np.pi, np.pi])
    np.testing.assert_allclose(arm.max_speed, np.deg2rad(180))
    assert (arm.max_acceleration > 0).all()
    assert (arm.max_jerk > 0).all()


def test_capsules_are_where_pinocchio_puts_them(arm: UR5) -> None:
    data = arm.model.createData()
    q = np.random.default_rng(1).uniform(-3, 3, (5, 6))
    capsules = arm.capsules(q)
    for n in range(len(q)):
        pin.forwardKinematics(arm.model, data, q[n])
        for k in range(len(LINKS)):
            placed = data.oMi[int(arm.link_joint[k]) + 1]
            np.testing.assert_allclose(capsules[n, k, :3], placed.act(arm.links[k, :3]), atol=1e-12)
            np.testing.assert_allclose(capsules[n, k, 3:6], placed.act(arm.links[k, 3:6]), atol=1e-12)


def test_the_tool_lies_between_the_fingertips(arm: UR5) -> None:
    q = np.array([[0.4, -1.1, 1.3, 1.4, 1.6, -1.1]])
    left, right = LINKS.index("left_finger"), LINKS.index("right_finger")
    ends = arm.capsules(q)[0, :, 3:6]
    np.testing.assert_allclose(arm.forward_kinematics(q[0])[:3, 3], 0.5 * (ends[left] + ends[right]), atol=1e-12)


def test_links_are_joined(arm: UR5) -> None:
    """From the shoulder to the palm each capsule touches the one before: nothing of the arm is left out."""
    links = arm.capsules(np.zeros(6))
    for k in range(LINKS.index("palm")):
        gaps = [
            np.linalg.norm(a - b)
            for a in np.linspace(links[k, :3], links[k, 3:6], 50)
            for b in np.linspace(links[k + 1, :3], links[k + 1, 3:6], 50)
        ]
        assert min(gaps) < links[k, 6] + links[k + 1, 6]


def test_every_branch_reaches_the_place_and_the_true_one_is_among_them(arm: UR5) -> None:
    for q in np.random.default_rng(4).uniform(-3.1, 3.1, (40, 6)):
        T = arm.forward_kinematics(q)
        found = arm.inverse_kinematics(T)
        assert np.abs(found - q).max(axis=1).min() < 1e-7
        assert ((found >= arm.q_range[:, 0]) & (found <= arm.q_range[:, 1])).all()
        for each in found:
            np.testing.assert_allclose(arm.forward_kinematics(each), T, atol=1e-9)


def test_an_ordinary_place_has_eight_branches_all_different(arm: UR5) -> None:
    T = arm.forward_kinematics(np.array([0.4, -1.1, 1.3, 1.4, 1.2, -1.1]))
    found = arm.inverse_kinematics(T)
    assert len(found) == 8
    apart = np.abs(found[:, None] - found).max(axis=-1) + 9.0 * np.eye(8)
    assert apart.min() > 1e-3


@pytest.mark.parametrize("q5", [0.0, np.pi, 1e-9])
def test_a_straight_wrist_is_solved_too(arm: UR5, q5: float) -> None:
    T = arm.forward_kinematics(np.array([0.4, -1.1, 1.3, 1.4, q5, 0.5]))
    found = arm.inverse_kinematics(T)
    assert len(found) > 0
    for each in found:
        np.testing.assert_allclose(arm.forward_kinematics(each), T, atol=1e-7)


def test_a_stretched_elbow_is_solved_too(arm: UR5) -> None:
    T = arm.forward_kinematics(np.array([0.4, -1.1, 0.0, 0.3, 1.2, 0.5]))
    assert min(np.abs(arm.forward_kinematics(q) - T).max() for q in arm.inverse_kinematics(T)) < 1e-6


@pytest.mark.parametrize("place", [[2.0, 0.0, 0.3], [0.0, 0.0, 0.3]])
def test_out_of_reach_there_is_no_branch(arm: UR5, place: list[float]) -> None:
    T = np.diag([1.0, -1.0, -1.0, 1.0])
    T[:3, 3] = place
    assert arm.inverse_kinematics(T).shape == (0, 6)


def test_the_closed_form_knows_the_same_arm(arm: UR5) -> None:
    assert (D[0], A[1], A[2]) == (ur5.D1, ur5.A2, ur5.A3)
    assert D[3:] == (ur5.D4, ur5.D5, ur5.D6)
    np.testing.assert_allclose(arm.joint_origins[1, :3, 3], [0, 0, D[0]])
    np.testing.assert_allclose(arm.joint_origins[[2, 3], 0, 3], [A[1], A[2]])
