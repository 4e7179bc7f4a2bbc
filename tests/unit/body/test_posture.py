"""Postures: anatomy, signs, continuity, singular arms, missing points, real frames."""

from __future__ import annotations

import lzma
from pathlib import Path

import numpy as np
import pytest

from kinecast.body.posture import (
    LEFT_ARM,
    RIGHT_ARM,
    block_log_det,
    coordinates_from_postures,
    other_branch,
    points_from_postures,
    postures_from_coordinates,
    postures_from_points,
)

HANGING = np.array([
    [0.0, 0.2, 0.0], [0.0, 0.2, -0.3], [0.0, 0.2, -0.55],
    [0.0, -0.2, 0.0], [0.0, -0.2, -0.3], [0.0, -0.2, -0.55],
])  # fmt: skip
"""Both arms hang straight down, shoulders 0.4 m apart at the origin."""


def arms(elbow: tuple[float, float, float], wrist: tuple[float, float, float]) -> np.ndarray:
    """Six points: a left arm with these steps from shoulder and elbow, the right arm its mirror image."""
    mirror = np.array([1.0, -1.0, 1.0])
    points = HANGING.copy()
    points[1] = points[0] + elbow
    points[2] = points[1] + wrist
    points[3:] = points[:3] * mirror
    return points


def angles(points: np.ndarray, previous: np.ndarray | None = None) -> np.ndarray:
    """Left arm's angles [degrees] of one frame, after a check that the mirrored right arm has the same."""
    posture = postures_from_points(points[None], previous)[0]
    np.testing.assert_allclose(posture[RIGHT_ARM], posture[LEFT_ARM], atol=1e-12)
    return np.degrees(posture[LEFT_ARM])


def ha4m_arms(file: Path) -> np.ndarray:
    """(N, 6, 3) arms [m] of an HA4M feature file, in the axes of the camera."""
    joints = np.load(file, allow_pickle=False).reshape(3, 23, -1).transpose(2, 1, 0)
    return joints[:, [4, 5, 6, 11, 12, 13]] / 1000.0


def vicon_arms(file: Path) -> np.ndarray:
    """(N, 6, 3) arms [m] of a Vicon Tracker file."""
    with lzma.open(file, "rt", encoding="utf-8-sig") as stream:
        lines = stream.read().splitlines()
    names = [cell.split(":")[-1].strip() for cell in lines[2].split(",") if cell.strip()]
    rows = [(line + 6 * len(names) * ",").split(",")[2 : 2 + 6 * len(names)] for line in lines[5:] if line]
    cells = np.array([[float(cell or "nan") for cell in row] for row in rows])
    positions = cells.reshape(len(rows), -1, 6)[..., 3:] / 1000.0
    wanted = [f"{side}_{joint}" for side in ("left", "right") for joint in ("shoulder", "elbow", "hand")]
    return positions[:, [names.index(name) for name in wanted]]


@pytest.mark.parametrize(
    ("elbow", "wrist", "expected"),
    [
        ((0.0, 0.0, -0.3), (0.25, 0.0, 0.0), (0, 0, 0, 90)),  # upper arm hangs, forearm points ahead
        ((0.3, 0.0, 0.0), (0.0, 0.0, 0.25), (90, 0, 0, 90)),  # arm ahead, forearm up
        ((0.0, 0.3, 0.0), (0.25, 0.0, 0.0), (0, 90, 0, 90)),  # arm sideways, forearm ahead
        ((0.0, 0.0, -0.3), (0.0, 0.25, 0.0), (0, 0, 90, 90)),  # forearm outward: external rotation
        ((0.0, 0.0, -0.3), (0.0, -0.25, 0.0), (0, 0, -90, 90)),  # forearm across the belly: internal rotation
        ((-0.15, 0.0, -0.15 * 3**0.5), (0.0, 0.0, -0.25), (-30, 0, 0, 30)),  # elbow drawn back
        ((0.0, -0.15, -0.15 * 3**0.5), (0.25, 0.0, 0.0), (0, -30, 0, 90)),  # elbow drawn across: adduction
        ((0.0, 0.15 * 3**0.5, 0.15), (0.25, 0.0, 0.0), (0, 120, 0, 90)),  # raised sideways above the shoulder
        ((0.15 * 3**0.5, 0.0, 0.15), (0.0, 0.0, 0.25), (120, 0, 0, 60)),  # raised ahead above the shoulder
    ],
)
def test_angles_are_anatomical_on_both_sides(
    elbow: tuple[float, float, float], wrist: tuple[float, float, float], expected: tuple[float, ...]
) -> None:
    np.testing.assert_allclose(angles(arms(elbow, wrist)), expected, atol=1e-9)


def test_layout_holds_position_yaw_roll_width_and_lengths() -> None:
    posture = postures_from_points(arms((0.0, 0.0, -0.3), (0.25, 0.0, 0.0))[None])[0]
    np.testing.assert_allclose(posture[:6], [0, 0, 0, 0, 0, 0.4], atol=1e-15)
    np.testing.assert_allclose(posture[[10, 11, 16, 17]], [0.3, 0.25, 0.3, 0.25], atol=1e-15)


def test_turning_the_body_changes_yaw_alone() -> None:
    points = arms((0.2, 0.1, -0.2), (0.2, -0.1, 0.05))
    still = postures_from_points(points[None])[0]
    c, s = np.cos(0.7), np.sin(0.7)
    turned = points @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + np.array([1.0, 2.0, 3.0])
    posture = postures_from_points(turned[None])[0]
    np.testing.assert_allclose(posture[:4], [1.0, 2.0, 3.0, 0.7], atol=1e-14)
    np.testing.assert_allclose(posture[4:], still[4:], atol=1e-12)


def test_raising_the_left_shoulder_is_roll_and_carries_the_arms() -> None:
    points = arms((0.2, 0.1, -0.2), (0.2, -0.1, 0.05))
    still = postures_from_points(points[None])[0]
    c, s = np.cos(0.4), np.sin(0.4)
    rolled = postures_from_points((points @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]]).T)[None])[0]
    assert rolled[4] == pytest.approx(0.4, abs=1e-14)
    np.testing.assert_allclose(np.delete(rolled, 4), np.delete(still, 4), atol=1e-12)


def test_straight_elbow_keeps_the_previous_axial_rotation() -> None:
    previous = postures_from_points(arms((0.0, 0.0, -0.3), (0.1, -0.2, 0.0))[None])[0]
    posture = postures_from_points(HANGING[None], previous)[0]
    assert posture[8] == previous[8]
    assert posture[9] == 0.0
    assert postures_from_points(HANGING[None])[0, 8] == 0.0


def test_arm_along_the_abduction_pole_keeps_the_previous_flexion() -> None:
    sideways = arms((0.0, 0.3, 0.0), (0.0, 0.25, 0.0))
    previous = np.full(18, np.nan)
    previous[6:10] = previous[12:16] = [0.8, 1.4, -0.3, 0.5]
    np.testing.assert_allclose(angles(sideways, previous), np.degrees([0.8, np.pi / 2, -0.3, 0.0]), atol=1e-12)
    np.testing.assert_allclose(angles(sideways), [0, 90, 0, 0], atol=1e-12)


def test_raising_an_arm_sideways_past_the_pole_is_continuous() -> None:
    lift = np.radians(np.arange(10.0, 171.0, 2.0))
    frames = np.array([arms((0.0, 0.3 * np.sin(a), -0.3 * np.cos(a)), (0.25, 0.0, 0.0)) for a in lift])
    for continuous in (True, False):  # each frame alone finds the same, anatomical, branch
        postures = postures_from_points(frames, continuous=continuous)
        np.testing.assert_allclose(postures[:, 7], lift, atol=1e-12)
        np.testing.assert_allclose(postures[:, [6, 8]], 0.0, atol=1e-12)


def test_raising_an_arm_past_the_pole_at_a_few_degrees_ends_on_the_anatomical_branch() -> None:
    lift = np.radians(np.arange(10.0, 171.0, 2.0))
    ahead = 0.3 * np.sin(0.05)
    across = 0.3 * np.cos(0.05)
    frames = [arms((ahead, across * np.sin(a), -across * np.cos(a)), (0.25, 0.0, 0.0)) for a in lift]
    last = np.degrees(postures_from_points(np.array(frames))[-1, LEFT_ARM])
    np.testing.assert_allclose(last, [0.0, 170.0, 0.0, 90.0], atol=4.0)


def test_previous_posture_chooses_the_branch() -> None:
    """Flexion 100°, abduction 70° is also flexion −80°, abduction 110°, both about as anatomical."""
    one = np.zeros(18)
    one[[5, 10, 11, 16, 17]] = 0.3
    one[LEFT_ARM] = one[RIGHT_ARM] = [1.75, 1.2, -1.4, 1.2]
    other = one.copy()
    other[LEFT_ARM] = other[RIGHT_ARM] = other_branch(one[LEFT_ARM]) - np.array([2 * np.pi, 0, 0, 0])
    points = points_from_postures(one)
    np.testing.assert_allclose(points_from_postures(other), points, atol=1e-15)
    for previous in (one, other):
        found = postures_from_points(points[None], previous + 0.1)[0]
        np.testing.assert_allclose(found, previous, atol=1e-12)


def test_whole_turns_follow_the_previous_yaw() -> None:
    facing = np.linspace(0.0, 9.0, 60)
    c, s = np.cos(facing), np.sin(facing)
    turn = np.moveaxis(np.array([[c, -s, 0 * c], [s, c, 0 * c], [0 * c, 0 * c, 1 + 0 * c]]), -1, 0)
    postures = postures_from_points(np.einsum("nij,kj->nki", turn, HANGING))
    np.testing.assert_allclose(postures[:, 3], facing, atol=1e-12)


def test_a_wound_up_arm_is_let_go() -> None:
    """Ten circles of the whole arm about the sideways pole: no turn is left over when it hangs again."""
    around = np.linspace(0.0, 20.0 * np.pi, 400)
    frames = [arms((0.15 * np.sin(a), 0.26, -0.15 * np.cos(a)), (0.2, 0.0, 0.1)) for a in around]
    postures = postures_from_points(np.array([*frames, HANGING]))
    assert np.abs(postures[-1, 6:8]).max() < 1e-12


def test_nan_points_give_nan_only_where_needed_and_gaps_are_bridged() -> None:
    points = np.array([arms((0.2, 0.1, -0.2), (0.2, -0.1, 0.05))] * 3)
    points[1, 2] = np.nan
    postures = postures_from_points(points)
    assert np.isnan(postures[1, [8, 9, 11]]).all()
    assert np.isfinite(np.delete(postures[1], [8, 9, 11])).all()
    np.testing.assert_array_equal(postures[2], postures[0])
    points[1, 3] = np.nan  # a shoulder takes the torso with it, and so every angle
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(postures_from_points(points)[1])), [10, 17])
    np.testing.assert_array_equal(postures_from_points(points)[2], postures[0])


def test_a_gap_keeps_the_branch_of_the_frame_before_it() -> None:
    start = np.zeros(18)
    start[[5, 10, 11, 16, 17]] = 0.3
    start[LEFT_ARM] = start[RIGHT_ARM] = [-1.39, 1.94, 1.74, 1.2]
    points = np.array([points_from_postures(start)] * 3)
    points[1] = np.nan
    postures = postures_from_points(points, start)
    assert np.isnan(postures[1]).all()
    np.testing.assert_allclose(postures[2], start, atol=1e-12)


def test_one_series_equals_its_frames_one_after_another() -> None:
    rng = np.random.default_rng(5)
    points = HANGING + 0.2 * np.cumsum(rng.standard_normal((2, 3, 8, 6, 3)), axis=2)
    together = postures_from_points(points, np.full(18, np.nan))
    for a in range(2):
        for b in range(3):
            before = None
            for t in range(8):
                now = postures_from_points(points[a, b, t : t + 1], before)[0]
                np.testing.assert_array_equal(together[a, b, t], now)
                before = now
    alone = postures_from_points(points, continuous=False)
    np.testing.assert_array_equal(alone[1, 2, 5], postures_from_points(points[1, 2, 5:6])[0])


def test_no_frames_give_no_postures() -> None:
    assert postures_from_points(np.empty((0, 6, 3))).shape == (0, 18)
    assert points_from_postures(np.empty((4, 0, 18))).shape == (4, 0, 6, 3)


def test_shoulders_on_one_spot_or_one_above_the_other_are_finite_and_come_back() -> None:
    upright = HANGING.copy()
    upright[0], upright[3] = [0.0, 0.0, 0.4], [0.0, 0.0, 0.0]
    one_spot = HANGING.copy()
    one_spot[3] = one_spot[0]
    for points in (upright, one_spot, np.zeros((6, 3))):
        posture = postures_from_points(points[None])[0]
        assert np.isfinite(posture).all()
        np.testing.assert_allclose(points_from_postures(posture), points, atol=1e-15)


def test_the_determinant_stays_finite_where_the_map_folds() -> None:
    straight = postures_from_points(HANGING[None])[0]
    log_det = block_log_det(straight)
    assert np.isfinite(log_det).all()
    assert log_det[1] < -20.0
    assert block_log_det(np.zeros((0, 18))).shape == (0, 3)


def test_smooth_coordinates_hardly_move_while_axial_rotation_jumps() -> None:
    nearly = [arms((0.0, 0.0, -0.3), (x, 0.0, -0.25)) for x in (1e-4, -1e-4)]
    postures = postures_from_points(np.array(nearly))
    assert abs(postures[1, 8] - postures[0, 8]) > 3.0
    coordinates = coordinates_from_postures(postures)
    assert np.abs(np.diff(coordinates, axis=0)).max() < 1e-3
    np.testing.assert_allclose(
        points_from_postures(postures_from_coordinates(coordinates)),
        points_from_postures(postures),
        atol=1e-15,
    )


def test_real_frames_come_back(data_root: Path) -> None:
    for video in ("IDU001V001", "IDU001V002"):
        points = ha4m_arms(data_root / "ha4m_features_demo" / "UpSkel" / f"{video}.npy")
        postures = postures_from_points(points)
        np.testing.assert_allclose(points_from_postures(postures), points, rtol=0, atol=1e-12)
    points = vicon_arms(data_root / "human_robot_animations" / "TossTheCan" / "0.csv.xz")
    points = points[np.isfinite(points).all(axis=(1, 2))]
    assert len(points) > 1000
    back = points_from_postures(postures_from_points(points))
    np.testing.assert_allclose(back, points, rtol=0, atol=1e-12)
