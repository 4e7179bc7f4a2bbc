"""One person's frames made into a window on the model's grid, whatever the camera does."""

from __future__ import annotations

import math

import numpy as np
import pytest

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.track import LONGEST_GAP, MOST_FRAMES, Track
from kinecast.types import SkeletonFrame, Status

DT = 1.0 / 30.0
REST = np.array([[0, 0.2, 1.4], [0, 0.25, 1.1], [0.2, 0.2, 1.0], [0, -0.2, 1.4], [0, -0.25, 1.1], [0.2, -0.2, 1.0]])
VELOCITY = np.array([0.3, -0.2, 0.1])


def place(stamp: float) -> np.ndarray:
    """(6, 3) where a person who glides along is."""
    return REST + VELOCITY * stamp


def frame(stamp: float, positions: np.ndarray | None = None, std: np.ndarray | None = None) -> SkeletonFrame:
    return SkeletonFrame(stamp, ARM_JOINTS, place(stamp) if positions is None else positions, std=std)


def track(frames: int = 6) -> Track:
    return Track(DT, frames, np.random.default_rng(0))


def fed(stamps: list[float] | np.ndarray) -> Track:
    followed = track()
    for stamp in stamps:
        followed.add(frame(float(stamp)))
    return followed


def test_a_window_is_full_after_as_many_frames_as_it_has() -> None:
    followed = track()
    for k in range(6):
        assert followed.observation(0.0) == (None, Status.WARMING_UP)
        assert followed.add(frame(k * DT)) is Status.OK
    seen, status = followed.observation(0.0)
    assert status is Status.OK
    assert seen is not None
    np.testing.assert_allclose(seen.positions, [place(k * DT) for k in range(6)], atol=1e-12)
    assert seen.stamp == pytest.approx(5 * DT)
    np.testing.assert_allclose(seen.up, [0.0, 0.0, 1.0], atol=1e-12)


def test_jittered_stamps_are_brought_to_the_grid() -> None:
    rng = np.random.default_rng(1)
    stamps = DT * (np.arange(12) + rng.uniform(-0.4, 0.4, 12))
    seen, status = fed(stamps).observation(0.0)
    assert status is Status.OK
    assert seen is not None
    grid = stamps[-1] - DT * np.arange(5, -1, -1)
    np.testing.assert_allclose(seen.positions, [place(t) for t in grid], atol=1e-12)


@pytest.mark.parametrize("rate", [15.0, 29.0, 31.0, 60.0, 240.0])
def test_cameras_of_other_rates_fill_the_window_too(rate: float) -> None:
    stamps = np.arange(0.0, 0.4, 1.0 / rate)
    seen, status = fed(stamps).observation(0.0)
    assert status is Status.OK
    assert seen is not None
    np.testing.assert_allclose(seen.positions, [place(stamps[-1] - DT * k) for k in range(5, -1, -1)], atol=1e-9)


def test_a_gap_is_bridged_and_said() -> None:
    seen, status = fed([0.0, DT, 2 * DT, 6 * DT, 7 * DT]).observation(0.0)
    assert status is Status.GAP
    assert seen is not None
    np.testing.assert_allclose(seen.positions, [place(k * DT) for k in range(2, 8)], atol=1e-9)


@pytest.mark.parametrize(("lost", "expected"), [((5,), Status.OK), ((4, 5), Status.GAP), ((7,), Status.OCCLUDED)])
def test_a_joint_that_one_frame_does_not_show_is_no_gap(lost: tuple[int, ...], expected: Status) -> None:
    track = Track(DT, 6, np.random.default_rng(0))
    for k in range(8):
        positions = place(k * DT)
        positions[2 if k in lost else []] = np.nan
        track.add(SkeletonFrame(k * DT, ARM_JOINTS, positions))
    seen, status = track.observation(0.0)
    assert status is expected
    assert seen is not None


def test_after_a_long_silence_history_starts_anew() -> None:
    followed = fed(np.arange(10) * DT)
    followed.add(frame(9 * DT + LONGEST_GAP + 0.01))
    assert len(followed.stamps) == 1
    assert followed.observation(0.0)[1] is Status.WARMING_UP


def test_late_frames_are_left_out_and_repeated_stamps_too() -> None:
    followed = fed(np.arange(10) * DT)
    before, _ = followed.observation(0.0)
    assert followed.add(frame(7.5 * DT, REST + 5.0)) is Status.LATE
    assert followed.add(frame(9 * DT, REST + 5.0)) is Status.REPEATED
    after, _ = followed.observation(0.0)
    assert before is not None
    assert after is not None
    np.testing.assert_array_equal(before.positions, after.positions)


def test_a_clock_that_jumps_back_starts_anew() -> None:
    followed = fed(1000.0 + np.arange(10) * DT)
    for k in range(6):
        assert followed.add(frame(k * DT)) is Status.OK
    seen, status = followed.observation(0.0)
    assert status is Status.OK
    assert seen is not None
    assert seen.stamp == pytest.approx(5 * DT)


def test_the_same_picture_under_a_new_stamp_is_repeated() -> None:
    followed = fed(np.arange(10) * DT)
    assert followed.add(frame(10 * DT, place(9 * DT))) is Status.REPEATED
    seen, status = followed.observation(0.0)
    assert status is Status.REPEATED
    assert seen is not None
    # The motion is carried on, not stopped.
    assert (seen.positions[-1] - place(9 * DT)) @ VELOCITY == pytest.approx(
        (place(10 * DT) - place(9 * DT)) @ VELOCITY, rel=0.4
    )


def test_an_occluded_wrist_is_carried_on_for_a_while() -> None:
    followed = fed(np.arange(10) * DT)
    hidden = place(10 * DT)
    hidden[2] = np.nan
    followed.add(frame(10 * DT, hidden))
    seen, status = followed.observation(0.0)
    assert status is Status.OCCLUDED
    assert seen is not None
    assert np.linalg.norm(seen.positions[-1, 2] - place(10 * DT)[2]) < 0.01
    for k in range(11, 20):
        hidden = place(k * DT)
        hidden[2] = np.nan
        followed.add(frame(k * DT, hidden))
    assert followed.observation(0.0) == (None, Status.OCCLUDED)
    where, age = followed.last_seen()
    np.testing.assert_allclose(where[2], place(9 * DT)[2])
    np.testing.assert_allclose(where[[0, 1, 3, 4, 5]], place(19 * DT)[[0, 1, 3, 4, 5]])
    np.testing.assert_allclose(age, [0, 0, 10 * DT, 0, 0, 0], atol=1e-9)


def test_what_was_never_seen_is_nowhere() -> None:
    followed = track()
    never = REST.copy()
    never[5] = np.nan
    followed.add(frame(0.0, never))
    where, age = followed.last_seen()
    assert np.isnan(where[5]).all()
    assert np.isfinite(where[:5]).all()
    np.testing.assert_array_equal(age, 0.0)


def test_a_jump_is_thrown_aside_and_said() -> None:
    followed = fed(np.arange(10) * DT)
    away = place(10 * DT)
    away[5] += 0.6
    followed.add(frame(10 * DT, away))
    seen, status = followed.observation(0.0)
    assert status is Status.JUMP
    assert seen is not None
    assert np.linalg.norm(seen.positions[-1, 5] - place(10 * DT)[5]) < 0.02


@pytest.mark.parametrize(
    "positions",
    [
        1000.0 * REST,
        0.01 * REST,
        np.where(np.arange(6)[:, None] == 3, REST[0], REST),
        np.where(np.arange(6)[:, None] == 3, [0.0, 0.2, 0.3], REST),
    ],
    ids=["millimetres", "tiny", "shoulders in one place", "shoulders far apart"],
)
def test_skeletons_that_are_no_persons_are_said_so(positions: np.ndarray) -> None:
    followed = track()
    for k in range(8):
        followed.add(frame(k * DT, positions + 1e-4 * k))
    assert followed.observation(0.0)[1] is Status.IMPLAUSIBLE


def test_stated_noise_counts_beyond_that_of_training() -> None:
    followed = fed(np.arange(6) * DT)
    std = np.array([0.0, 0.003, 0.005, np.nan, -1.0, 50.0])
    followed.add(frame(6 * DT, std=std))
    seen, _ = followed.observation(0.004)
    assert seen is not None
    expected = [0.0, 0.0, 0.003, 0.0, 0.0, math.sqrt(1.0 - 0.004**2)]
    np.testing.assert_allclose(seen.noise, expected, atol=1e-12)
    followed.add(frame(7 * DT))
    again, _ = followed.observation(0.004)
    assert again is not None
    np.testing.assert_array_equal(again.noise, 0.0)


def test_joints_in_any_order_and_strangers_among_them() -> None:
    names = ("nose", *reversed(ARM_JOINTS), "tail")
    followed = track()
    for k in range(6):
        positions = np.concatenate([[[9.0, 9.0, 9.0]], place(k * DT)[::-1], [[8.0, 8.0, 8.0]]])
        followed.add(SkeletonFrame(k * DT, names, positions))
    seen, status = followed.observation(0.0)
    assert status is Status.OK
    assert seen is not None
    np.testing.assert_allclose(seen.positions[-1], place(5 * DT), atol=1e-12)


def test_the_lean_of_the_torso_is_seen_and_kept() -> None:
    lean = 0.4
    names = (*ARM_JOINTS, "left_hip", "right_hip")
    followed = track()
    for k in range(12):
        middle = place(k * DT)[[0, 3]].mean(axis=0)
        hips = middle - 0.5 * np.array([math.sin(lean), 0.0, math.cos(lean)]) + [[0, 0.1, 0], [0, -0.1, 0]]
        if k > 8:
            hips[:] = np.nan
        followed.add(SkeletonFrame(k * DT, names, np.concatenate([place(k * DT), hips])))
    seen, _ = followed.observation(0.0)
    assert seen is not None
    np.testing.assert_allclose(seen.up, [math.sin(lean), 0.0, math.cos(lean)], atol=1e-6)


def test_memory_is_bounded() -> None:
    followed = fed(np.arange(MOST_FRAMES + 100) * 0.001)
    assert len(followed.stamps) == len(followed.arms) == MOST_FRAMES
    seen, status = followed.observation(0.0)
    assert status is Status.OK
    assert seen is not None


@pytest.mark.parametrize(
    ("positions", "std"), [(REST[:5], None), (REST[:, :2], None), (REST.ravel(), None), (REST, np.zeros(5))]
)
def test_arrays_of_the_wrong_shape_change_nothing(positions: np.ndarray, std: np.ndarray | None) -> None:
    followed = fed(np.arange(6) * DT)
    bad = frame(6 * DT)
    object.__setattr__(bad, "positions", positions)
    object.__setattr__(bad, "std", std)
    with pytest.raises(ValueError, match="for 6 joints"):
        followed.add(bad)
    assert len(followed.stamps) == 6
    assert followed.add(frame(6 * DT)) is Status.OK
