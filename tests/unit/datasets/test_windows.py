"""Windows: their frames, their gaps, what is left out, and the known figures on real recordings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.datasets.loading import load
from kinecast.datasets.recording import Recording
from kinecast.datasets.windows import WindowOptions, Windows, all_windows, windows
from kinecast.errors import DatasetError, OptionError

JOINTS = ("pelvis", "right_wrist", "right_elbow", "right_shoulder", "left_wrist", "left_elbow", "left_shoulder")
PLACES = np.array([
    [0, 0, 0.9], [0.4, -0.2, 1.1], [0.2, -0.2, 1.1], [0, -0.2, 1.4], [0.4, 0.2, 1.1], [0.2, 0.2, 1.1], [0, 0.2, 1.4],
])  # fmt: skip


def waving(frames: int = 60, rate: float = 30.0, labels: tuple[str, ...] | None = None) -> Recording:
    """A person whose hands wave, in an order of joints unlike the library's."""
    t = np.arange(frames) / rate
    positions = np.tile(PLACES, (frames, 1, 1))
    positions[:, [1, 4], 2] += 0.2 * np.sin(4 * t)[:, None]
    positions += 0.02 * t[:, None, None]
    return Recording("waving", JOINTS, t, positions, rate, labels=labels)


def test_windows_hold_the_frames_they_should() -> None:
    recording = waving()
    cut = windows(recording, WindowOptions())
    assert (cut.arms.shape, cut.future.shape) == ((8, 6, 6, 3), (8, 15, 6, 3))
    np.testing.assert_array_equal(cut.frames, np.arange(5, 45, 5))
    np.testing.assert_array_equal(cut.stamps, recording.stamps[cut.frames])
    arms = np.stack([recording.joint(name) for name in ARM_JOINTS], axis=1)
    for row, last in enumerate(cut.frames):
        np.testing.assert_array_equal(cut.arms[row], arms[last - 5 : last + 1])
        np.testing.assert_array_equal(cut.future[row], arms[last + 1 : last + 16])
    assert cut.left_out == 0


@pytest.mark.parametrize(("frames", "count"), [(20, 0), (21, 1), (25, 1), (26, 2)])
def test_the_last_window_ends_with_the_recording(frames: int, count: int) -> None:
    assert len(windows(waving(frames), WindowOptions())) == count


def test_seconds_become_steps_once() -> None:
    options = WindowOptions(rate=120.0, window=0.2, horizon=0.5)
    assert (options.observed_steps, options.predicted_steps) == (24, 60)
    assert (WindowOptions().observed_steps, WindowOptions().predicted_steps) == (6, 15)


def test_a_gap_makes_a_window_not_whole_unless_it_may() -> None:
    recording = waving()
    recording.positions[22, JOINTS.index("left_wrist")] = np.nan
    whole = windows(recording, WindowOptions())
    touching = np.array([last for last in range(5, 45, 5) if last - 5 <= 22 <= last + 15])
    np.testing.assert_array_equal(whole.frames, np.setdiff1d(np.arange(5, 45, 5), touching))
    assert whole.left_out == len(touching)

    every = windows(recording, WindowOptions(whole=False))
    assert len(every) == 8
    assert np.isfinite(every.arms).all()
    row = int(np.flatnonzero(every.frames == 25)[0])
    assert every.touched[row, 2, 2]  # left wrist, frame 22
    expected = waving().joint("left_wrist")[22]
    np.testing.assert_allclose(every.arms[row, 2, 2], expected, atol=0.01)
    before = int(np.flatnonzero(every.frames == 15)[0])
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(every.future[before]).any(axis=-1)), [6 * 6 + 2])


def test_windows_with_a_lost_arm_are_left_out_and_counted() -> None:
    recording = waving()
    recording.positions[19:21, JOINTS.index("right_elbow")] = np.nan
    cut = windows(recording, WindowOptions(whole=False))
    assert 20 not in cut.frames
    assert (len(cut), cut.left_out) == (7, 1)


def test_what_is_observed_is_repaired_and_the_truth_is_not() -> None:
    recording = waving()
    wrist = JOINTS.index("left_wrist")
    recording.positions[23, wrist] += [0.0, 0.0, 0.7]
    cut = windows(recording, WindowOptions())
    row = int(np.flatnonzero(cut.frames == 25)[0])
    np.testing.assert_allclose(cut.arms[row, 3, 2], waving().joint("left_wrist")[23], atol=0.01)
    before = int(np.flatnonzero(cut.frames == 20)[0])
    np.testing.assert_array_equal(cut.future[before, 2, 2], recording.positions[23, wrist])
    (mended,) = all_windows([recording], WindowOptions(mend_future=True))
    np.testing.assert_allclose(mended.future[before, 2, 2], waving().joint("left_wrist")[23], atol=0.01)
    np.testing.assert_array_equal(mended.arms, cut.arms)


def test_labels_choose_by_the_last_observed_frame() -> None:
    labels = ("reach",) * 20 + ("carry",) * 40
    cut = windows(waving(labels=labels), WindowOptions(label="carry"))
    np.testing.assert_array_equal(cut.frames, [20, 25, 30, 35, 40])


def test_an_unknown_label_lists_those_present() -> None:
    labels = ("reach",) * 20 + ("carry",) * 40
    with pytest.raises(OptionError, match=r"'juggle' does not occur; labels present: carry, reach"):
        all_windows([waving(labels=labels)], WindowOptions(label="juggle"))
    with pytest.raises(OptionError, match="no labels"):
        all_windows([waving()], WindowOptions(label="reach"))
    with pytest.raises(OptionError, match="carry, reach, stir"):
        list(all_windows([waving(labels=labels), waving(labels=("stir",) * 60)], WindowOptions(label="juggle")))


def test_many_recordings_are_resampled_and_counted() -> None:
    told: list[tuple[int, int]] = []
    many = (replace(waving(200, 100.0), name=name) for name in ("first", "second"))
    cuts = all_windows(many, WindowOptions(), lambda done, total: told.append((done, total)))
    assert [(cut.name, len(cut)) for cut in cuts] == [("first", 8), ("second", 8)]
    assert told == [(1, 2), (2, 2)]


def test_a_label_in_one_recording_is_enough() -> None:
    recordings = [waving(labels=("reach",) * 60), waving(labels=("carry",) * 60)]
    assert sum(len(cut) for cut in all_windows(recordings, WindowOptions(label="carry"))) == 8


def test_no_window_at_all_is_an_error() -> None:
    with pytest.raises(DatasetError, match=r"waving: no window of 0.7 s"):
        all_windows([waving(15)], WindowOptions())
    with pytest.raises(DatasetError, match=r"take\.csv\.gz: no window of 0.7 s"):
        all_windows([replace(waving(15), source=Path("take.csv.gz"))] * 2, WindowOptions())
    with pytest.raises(DatasetError, match="no window"):
        list(all_windows([], WindowOptions()))


def test_a_recording_without_arms_is_refused() -> None:
    armless = waving()
    armless = replace(armless, joints=JOINTS[:4], positions=armless.positions[:, :4])
    with pytest.raises(DatasetError, match="left_shoulder"):
        windows(armless, WindowOptions())


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("rate", 0.0), ("rate", np.nan), ("window", 0.0), ("window", 0.03), ("window", 1e9), ("horizon", -1.0),
        ("horizon", np.inf), ("stride", 0),
    ],
)  # fmt: skip
def test_options_out_of_range_are_refused(option: str, value: object) -> None:
    with pytest.raises(OptionError):
        WindowOptions(**{option: value})  # type: ignore[arg-type]


def test_up_is_the_torsos_and_square_to_the_shoulders() -> None:
    recording = waving()
    recording.positions[:, 0, 0] -= 0.3  # hips behind the shoulders: leaning forward
    cut = windows(recording, WindowOptions())
    np.testing.assert_allclose(np.linalg.norm(cut.up, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(cut.up, np.tile([[0.3, 0.0, 0.5]], (8, 1)) / np.hypot(0.3, 0.5), atol=1e-9)


def test_up_survives_an_occluded_shoulder() -> None:
    recording = waving()
    recording.positions[25, JOINTS.index("left_shoulder")] = np.nan
    cut = windows(recording, WindowOptions(whole=False))
    assert np.isfinite(cut.up).all()


def errors(cuts: list[Windows]) -> tuple[float, float]:
    """MPJPE [mm] of zero velocity and of constant velocity (slope of the last three frames)."""
    observed = np.concatenate([cut.arms for cut in cuts])
    future = np.concatenate([cut.future for cut in cuts])
    last = observed[:, -1:]
    step = (last - observed[:, -3:-2]) / 2
    k = np.arange(1, future.shape[1] + 1)[:, None, None]
    zero = np.linalg.norm(future - last, axis=-1)
    constant = np.linalg.norm(future - last - k * step, axis=-1)
    return 1e3 * float(np.nanmean(zero)), 1e3 * float(np.nanmean(constant))


@pytest.fixture(scope="module")
def pick_place(data_root: Path) -> list[Recording]:
    return load(data_root / "human_robot_animations" / "PickPlaceCloseHuman")


def test_the_known_figures_on_ha4m(data_root: Path) -> None:
    cuts = all_windows(load(data_root / "ha4m_features_demo" / "UpSkel" / "IDU001V002.npy"), WindowOptions())
    zero, constant = errors(cuts)
    assert zero == pytest.approx(48.2, abs=0.5)
    assert constant == pytest.approx(65.7, abs=2.0)


def test_the_known_figures_on_vicon(pick_place: list[Recording]) -> None:
    cuts = all_windows(pick_place, WindowOptions())
    zero, constant = errors(cuts)
    assert sum(len(cut) for cut in cuts) == 366
    assert zero == pytest.approx(102.5, abs=2.0)
    assert constant == pytest.approx(75.4, abs=3.0)


def test_gaps_and_jumps_of_real_recordings_are_survived(data_root: Path, pick_place: list[Recording]) -> None:
    for recording in [*pick_place[:2], *load(data_root / "human_assembly_data" / "Task2" / "Human2")]:
        every = windows(recording, WindowOptions(whole=False))
        assert np.isfinite(every.arms).all()
        assert np.isfinite(every.up).all()
        whole = windows(recording, WindowOptions())
        assert np.isfinite(whole.future).all()
        assert set(whole.frames) <= set(every.frames)
