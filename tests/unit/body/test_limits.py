"""Limits: validation, Eq. 4's bounds, violations, and how real recordings lie within the ranges."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinecast.body.limits import AngleLimit, JointLimits, bounds, speeds_within_wrist_speed, violations
from kinecast.body.posture import LEFT_ARM, RIGHT_ARM, USUAL_RANGE, postures_from_points
from kinecast.body.skeleton import ARM_JOINTS
from kinecast.body.torso_frame import UpSource, torso_frame
from kinecast.errors import OptionError

DT = 1.0 / 30.0
ARM = {"flexion": 0, "abduction": 1, "axial rotation": 2, "elbow": 3}
UPPER_BODY = {
    "spine": 0, "neck": 2, "left_shoulder": 4, "left_elbow": 5, "left_wrist": 6,
    "right_shoulder": 11, "right_elbow": 12, "right_wrist": 13,
}  # fmt: skip


def person(theta: tuple[float, float, float, float] = (0.3, 0.2, -0.4, 1.0)) -> np.ndarray:
    """Posture with both arms at these angles."""
    posture = np.zeros(18)
    posture[[5, 10, 11, 16, 17]] = 0.4, 0.3, 0.25, 0.3, 0.25
    posture[LEFT_ARM] = posture[RIGHT_ARM] = theta
    return posture


def still(steps: int = 4) -> np.ndarray:
    return np.tile(person(), (steps, 1))


@pytest.fixture(scope="module")
def assembly(data_root: Path) -> np.ndarray:
    """(N, 18) postures of HA4M's two clips, each frame alone, each in its own torso frame."""
    postures = []
    for video in ("IDU001V001", "IDU001V002"):
        file = data_root / "ha4m_features_demo" / "UpSkel" / f"{video}.npy"
        camera = np.load(file, allow_pickle=False).reshape(3, 23, -1).transpose(2, 1, 0) / 1000.0
        world = np.stack([camera[..., 2], -camera[..., 0], -camera[..., 1]], axis=-1)
        joints = tuple(UPPER_BODY)
        positions = world[:, list(UPPER_BODY.values())]
        torso = torso_frame(joints, positions)
        assert torso.source is UpSource.SPINE
        T = torso.T_world_torso
        arms = positions[:, [joints.index(name) for name in ARM_JOINTS]] - T[:, None, :3, 3]
        postures.append(postures_from_points(np.einsum("nji,nkj->nki", T[:, :3, :3], arms), continuous=False))
    return np.concatenate(postures)


def test_real_work_lies_within_the_ranges(assembly: np.ndarray) -> None:
    lower, upper, _ = JointLimits().of_posture()
    for arm in (LEFT_ARM, RIGHT_ARM):
        angles = assembly[:, arm]
        inside = (angles >= lower[arm] - 1e-9) & (angles <= upper[arm] + 1e-9)
        bent = angles[:, 3] > math.radians(2.0)
        for name, i in ARM.items():
            share = inside[bent if i == 2 else slice(None), i].mean()
            assert share >= 0.999, f"{name}: {share:.4f} of the frames"


def test_axial_rotation_is_internal_at_a_table_and_so_negative(assembly: np.ndarray) -> None:
    """Hands meet in front of the body: the sign of axial rotation can be seen in any work at a table."""
    for arm in (LEFT_ARM, RIGHT_ARM):
        angles = assembly[:, arm]
        bent = angles[:, 3] > math.radians(30.0)
        assert np.quantile(angles[bent, 2], 0.95) < 0.0


def test_branches_are_judged_by_the_default_ranges() -> None:
    lower, upper, _ = JointLimits().of_posture()
    for arm in (LEFT_ARM, RIGHT_ARM):
        np.testing.assert_array_equal(np.stack([lower[arm], upper[arm]], axis=1), USUAL_RANGE)


def test_posture_limits_bind_the_arm_angles_alone() -> None:
    lower, upper, speed = JointLimits().of_posture()
    np.testing.assert_array_equal(speed[RIGHT_ARM], 12.0)
    others = [0, 1, 2, 3, 4, 5, 10, 11, 16, 17]
    assert np.isneginf(lower[others]).all()
    assert np.isposinf(upper[others]).all()
    assert np.isposinf(speed[others]).all()


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"elbow": AngleLimit(1.0, 1.0, 12.0)}, "elbow.*1.0"),
        ({"flexion": AngleLimit(-7.0, 1.0, 12.0)}, "flexion.*-7.0"),
        ({"flexion": AngleLimit(math.nan, 1.0, 12.0)}, "flexion.*nan"),
        ({"wrist_deviation": AngleLimit(-1.0, 1.0, 0.0)}, "wrist_deviation.*speed 0.0"),
        ({"pronation": AngleLimit(-1.0, 1.0, math.nan)}, "pronation.*nan"),
        ({"wrist_speed": -1.5}, "wrist_speed.*-1.5"),
    ],
)
def test_impossible_limits_are_refused_by_name_and_value(wrong: dict[str, object], named: str) -> None:
    with pytest.raises(OptionError, match=named):
        replace(JointLimits(), **wrong)  # type: ignore[arg-type]


def test_widened_ranges_hold_nearly_all_postures_and_never_shrink() -> None:
    postures = np.tile(person(), (1001, 1))
    postures[:, 6] = np.linspace(-2.0, 0.0, 1001)  # the left arm reaches far behind
    postures[:, 14] = 3.0  # means nothing: the right elbow is straight
    postures[:, 15] = 0.01
    postures[500] = np.nan
    before = JointLimits()
    after = before.widened(postures)
    assert after.flexion.lower == pytest.approx(-1.998, abs=2e-4)
    assert (after.flexion.upper, after.flexion.speed) == (before.flexion.upper, before.flexion.speed)
    assert (after.abduction, after.axial_rotation, after.elbow) == (
        before.abduction, before.axial_rotation, before.elbow,
    )  # fmt: skip
    assert before.widened(postures[500:501]) == before
    assert before.widened(postures[:0]) == before


@pytest.mark.parametrize(
    ("previous", "expected"),
    [
        (0.5, (0.1, 0.9)),  # both ends by speed
        (0.1, (0.0, 0.5)),  # lower end by range
        (0.95, (0.55, 1.0)),  # upper end by range
        (1.2, (0.8, 1.0)),  # outside, but back within one step
        (2.0, (1.6, 1.6)),  # too far outside: nearest reachable value
        (-3.0, (-2.6, -2.6)),
        (math.nan, (0.0, 1.0)),
    ],
)
def test_bounds_are_eq_4_and_close_to_the_nearest_reachable_value(
    previous: float, expected: tuple[float, float]
) -> None:
    assert bounds(0.0, 1.0, 4.0, previous, 0.1) == pytest.approx(expected, abs=1e-15)


@given(st.floats(-10, 10), st.floats(0.001, 20.0), st.floats(1e-3, 1.0))
def test_bounds_are_never_empty_and_always_reachable(previous: float, speed: float, dt: float) -> None:
    lb, ub = bounds(-1.0, 2.0, speed, previous, dt)
    assert lb <= ub
    assert previous - speed * dt <= lb
    assert ub <= previous + speed * dt
    if -1.0 <= previous <= 2.0:
        assert -1.0 <= lb <= previous <= ub <= 2.0


def test_infinite_speed_leaves_the_range() -> None:
    assert bounds(-1.0, 2.0, math.inf, 0.3, 0.1) == (-1.0, 2.0)


def test_standing_still_violates_nothing() -> None:
    position, speed = violations(still(), person(), DT, JointLimits())
    assert position.shape == speed.shape == (4,)
    assert not position.any()
    assert not speed.any()


@pytest.mark.parametrize("arm", [6, 12])
@pytest.mark.parametrize("angle", [0, 1, 2, 3])
@pytest.mark.parametrize("end", ["lower", "upper"])
def test_an_angle_outside_its_range_is_found_at_its_step(arm: int, angle: int, end: str) -> None:
    limits = replace(
        JointLimits(),
        **{name: AngleLimit(-1.5, 1.5, 1e6) for name in ("flexion", "abduction", "axial_rotation")},
    )
    limit = limits.of_posture()[("lower", "upper").index(end)][arm + angle]
    outward = 1.0 if end == "upper" else -1.0
    path = still()
    path[2, arm + angle] = limit + outward * 1e-6
    position, _ = violations(path[None], person(), DT, limits)
    np.testing.assert_array_equal(position, [[False, False, True, False]])
    path[2, arm + angle] = limit + outward * 5e-10
    position, _ = violations(path[None], person(), DT, limits)
    assert not position.any()


@pytest.mark.parametrize("place", [6, 7, 8, 9, 12, 13, 14, 15])
def test_a_fast_step_is_found_there_and_at_the_first_step_from_the_initial_posture(place: int) -> None:
    path = still()
    path[2:, place] += 12.0 * DT + 1e-6
    _, speed = violations(path, person(), DT, JointLimits())
    np.testing.assert_array_equal(speed, [False, False, True, False])
    path[2:, place] -= 2e-6
    assert not violations(path, person(), DT, JointLimits())[1].any()
    initial = person()
    initial[place] -= 12.0 * DT + 1e-6
    np.testing.assert_array_equal(violations(still(), initial, DT, JointLimits())[1], [True, False, False, False])
    assert not violations(still(), np.full(18, np.nan), DT, JointLimits())[1].any()


def test_axial_rotation_says_nothing_at_a_straight_elbow() -> None:
    path = still()
    path[:, 8] = [-0.4, 2.5, -3.0, -0.4]
    position, speed = violations(path, person(), DT, JointLimits())
    np.testing.assert_array_equal(position, [False, True, True, False])
    np.testing.assert_array_equal(speed, [False, True, True, True])
    path[1:3, 9] = math.radians(1.9)
    initial = path[1]  # elbows apart from it are still
    position, speed = violations(path[1:3], initial, DT, JointLimits())
    assert not position.any()
    assert not speed.any()


def test_a_start_outside_is_excused_only_on_the_way_back_at_full_speed() -> None:
    limits, step = JointLimits(), 12.0 * DT
    initial = person()
    initial[9] = limits.elbow.upper + 2.5 * step
    back = still(4)
    back[:, 9] = limits.elbow.upper + np.array([1.5 * step, 0.5 * step, 0.0, 0.0])
    position, speed = violations(back, initial, DT, limits)
    assert not position.any()
    assert not speed.any()
    lingering = back.copy()
    lingering[1, 9] += 0.1
    np.testing.assert_array_equal(violations(lingering, initial, DT, limits)[0], [False, True, False, False])
    again = back.copy()
    again[3, 9] += 0.2
    np.testing.assert_array_equal(violations(again, initial, DT, limits)[0], [False, False, False, True])
    # Nobody else is excused: a series that left the range by itself stays a violation all the way.
    position, _ = violations(back, person(), DT, limits)
    np.testing.assert_array_equal(position, [True, True, False, False])


def test_series_are_judged_one_by_one() -> None:
    paths = np.stack([still(), still(), still()])
    paths[1, 3, 6] = 4.0
    position, speed = violations(paths, person(), DT, JointLimits())
    np.testing.assert_array_equal(position, speed)
    np.testing.assert_array_equal(np.argwhere(position), [[1, 3]])
    assert violations(paths[:0], person(), DT, JointLimits())[0].shape == (0, 4)


def test_nan_violates_nothing() -> None:
    path = still()
    path[1] = np.nan
    position, speed = violations(path, person(), DT, JointLimits())
    assert not position.any()
    assert not speed.any()


@pytest.mark.parametrize(
    "theta", [(0.3, 0.2, -0.4, 1.0), (1.9, -0.5, 0.9, 2.2), (-0.6, 1.4, -1.5, 0.3), (0.1, 2.2, 0.5, 1.1)]
)
def test_wrist_speed_is_carried_through_the_jacobian(
    theta: tuple[float, float, float, float], denavit_hartenberg: Callable
) -> None:
    posture = person(theta)
    out = np.empty(18)
    speeds_within_wrist_speed(posture, np.full(18, 1e9), 1.5, out)
    for arm, side in ((LEFT_ARM, 1.0), (RIGHT_ARM, -1.0)):
        J = denavit_hartenberg(np.array([theta]), posture[10:12], side)[1][0]
        np.testing.assert_allclose(out[arm], 1.5 / np.linalg.norm(J, axis=0), rtol=1e-12)


def test_wrist_speed_only_lowers_speeds_and_is_off_by_default() -> None:
    _, _, speed = JointLimits().of_posture()
    out = np.empty(18)
    speeds_within_wrist_speed(person(), speed, math.inf, out)
    np.testing.assert_array_equal(out, speed)
    speeds_within_wrist_speed(person((0.0, 0.0, 0.0, 0.0)), speed, 1.5, out)
    np.testing.assert_allclose(out[LEFT_ARM], [1.5 / 0.55, 1.5 / 0.55, 12.0, 1.5 / 0.25])
    assert JointLimits().wrist_speed is None


def test_wrist_speed_counts_as_a_speed_violation() -> None:
    path = still(2)
    path[1, 9] += 0.25  # 7.5 rad/s of the elbow: 1.9 m/s at the wrist
    assert not violations(path, person(), DT, JointLimits())[1].any()
    limited = replace(JointLimits(), wrist_speed=1.5)
    np.testing.assert_array_equal(violations(path, person(), DT, limited)[1], [False, True])


def test_the_union_is_what_both_keep() -> None:
    one, other = (
        JointLimits(elbow=AngleLimit(0.1, 2.0, 5.0), wrist_speed=1.0),
        JointLimits(elbow=AngleLimit(0.2, 2.5, 4.0)),
    )
    assert one.union(other).elbow == AngleLimit(0.1, 2.5, 5.0)
    assert one.union(other).wrist_speed is None  # the other has none
    assert one.union(one) == one
