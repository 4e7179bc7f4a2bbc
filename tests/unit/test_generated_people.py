"""Generated people: bodies that hold together, motions people make, flaws in measured amounts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from benchmarks import generated_people
from benchmarks.generated_people import SyntheticOptions, generate, generate_clean, table_scene
from scipy.interpolate import make_interp_spline

from kinecast.body.limits import JointLimits, violations
from kinecast.body.posture import postures_from_points
from kinecast.body.skeleton import ARM_JOINTS, JOINTS
from kinecast.body.torso_frame import torso_frame
from kinecast.datasets.reaching import TABLE, Path, arch, minimum_jerk
from kinecast.datasets.recording import Recording
from kinecast.errors import OptionError
from kinecast.geometry.transforms import apply, inverse

OPTIONS = SyntheticOptions(subjects=4, recordings=3, duration=20.0)
Tracked = Callable[..., list[Recording]]
FLAWS = ("NOISE", "BREATHING", "REPEATED", "JUMPS", "DROPOUTS")
LIMBS = ((0, 1), (1, 2), (3, 4), (4, 5))
WRISTS = [2, 5]


@pytest.fixture(scope="module")
def performances() -> list[tuple[Recording, np.random.SeedSequence]]:
    return generated_people._performances(OPTIONS, seed=5)


@pytest.fixture(scope="module")
def clean(performances: list[tuple[Recording, np.random.SeedSequence]]) -> list[Recording]:
    return [truth for truth, _ in performances]


@pytest.fixture
def tracked(
    performances: list[tuple[Recording, np.random.SeedSequence]], monkeypatch: pytest.MonkeyPatch
) -> Callable[..., list[Recording]]:
    """tracked(NOISE=0.004) → the people of `clean` seen by a tracker with no flaw but those."""

    def make(**flaws: float) -> list[Recording]:
        for name in FLAWS:
            monkeypatch.setattr(generated_people, name, flaws.get(name, 0.0))
        monkeypatch.setattr(generated_people, "_performances", lambda *_: performances)
        return generate(OPTIONS, seed=5)

    return make


def limb_lengths(recording: Recording) -> np.ndarray:
    start, end = np.array(LIMBS).T
    return np.linalg.norm(recording.positions[:, end] - recording.positions[:, start], axis=-1)


def wrist_speeds(recording: Recording) -> np.ndarray:
    return np.linalg.norm(np.diff(recording.positions[:, WRISTS], axis=0), axis=-1) * recording.rate


def test_who_and_what(clean: list[Recording]) -> None:
    assert len(clean) == 12
    assert len({r.name for r in clean}) == 12
    assert len({r.subject for r in clean}) == 4
    assert [r.task for r in clean[:3]] == ["pick_and_place", "carrying", "reaching"]
    for recording in clean:
        assert recording.joints[:6] == ARM_JOINTS
        assert set(recording.joints) <= set(JOINTS)
        assert recording.positions.shape == (600, 10, 3)
        assert np.isfinite(recording.positions).all()
        assert recording.labels is not None


def test_the_same_seed_gives_the_same_people_and_another_seed_others() -> None:
    short = replace(OPTIONS, subjects=2, recordings=2, duration=3.0)
    first, again, other = generate(short, 1), generate(short, 1), generate(short, 2)
    for a, b, c in zip(first, again, other, strict=True):
        np.testing.assert_array_equal(a.positions, b.positions)
        assert a.labels == b.labels
        assert not np.array_equal(a.positions, c.positions, equal_nan=True)
    longer = generate_clean(replace(short, duration=6.0), 1)
    for truth, more in zip(generate_clean(short, 1), longer, strict=True):
        np.testing.assert_allclose(truth.positions, more.positions[:90], atol=1e-12)


def test_bones_are_rigid_and_bodies_differ(clean: list[Recording]) -> None:
    lengths = np.array([limb_lengths(recording) for recording in clean])
    assert np.ptp(lengths, axis=1).max() < 1e-12
    by_subject = lengths[:, 0].reshape(4, 3, 4)
    assert np.ptp(by_subject, axis=1).max() < 1e-12, "one person keeps the same arms"
    assert by_subject[:, 0, 0].std() > 0.005
    assert 0.25 < lengths[..., 0].min() < lengths[..., 0].max() < 0.38
    np.testing.assert_allclose(lengths[..., :2], lengths[..., 2:], atol=1e-12)


def test_arms_keep_clear_of_the_table_and_within_joint_limits_and_speeds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(generated_people, "HESITATION", 0.5)
    scene = table_scene()
    for recording in generate_clean(replace(OPTIONS, subjects=5), seed=11):
        arms = np.ascontiguousarray(recording.positions[:, :6])
        assert arms[:, [1, 2, 4, 5], 2].min() > TABLE + 0.01
        assert scene.free(arms[None], recording.stamps, limb_radius=0.01).all()
        torso = torso_frame(recording.joints, recording.positions).T_world_torso
        postures = postures_from_points(apply(inverse(torso)[:, None], arms))
        position, fast = violations(postures[1:], postures[0], 1 / recording.rate, JointLimits())
        assert not position.any()
        assert not fast.any()


def test_hands_peak_at_the_speeds_of_real_reaching(clean: list[Recording]) -> None:
    peaks = np.array([wrist_speeds(recording).max() for recording in clean])
    assert peaks.min() > 0.5
    assert peaks.max() < 1.5
    elbows = np.concatenate([np.linalg.norm(np.diff(r.positions[:, [1, 4]], axis=0), axis=-1) * r.rate for r in clean])
    assert elbows.max() < 1.5


def test_labels_say_what_the_hands_do(clean: list[Recording]) -> None:
    seen = {task: {label for r in clean if r.task == task for label in r.labels or ()} for task in
            ("pick_and_place", "carrying", "reaching")}  # fmt: skip
    assert seen == {
        "pick_and_place": {"Re", "Pi", "Ca", "Pl", "Id"},
        "carrying": {"Re", "Pi", "Ca", "Pl", "Id"},
        "reaching": {"Re", "Id"},
    }
    fastest = np.concatenate([wrist_speeds(r).max(axis=1) for r in clean])
    labels = np.concatenate([np.array(r.labels)[:-1] for r in clean])
    assert np.median(fastest[labels == "Re"]) > 0.3
    assert np.median(fastest[labels == "Ca"]) > 0.3
    assert np.quantile(fastest[labels == "Id"], 0.9) < 0.1


def test_a_pick_ends_at_a_goal(clean: list[Recording]) -> None:
    goals = table_scene().goals.values()
    picks = 0
    for recording in clean:
        labels = np.array(recording.labels)
        if recording.task != "pick_and_place":
            continue
        for frame in np.flatnonzero((labels[:-1] == "Pi") & (labels[1:] == "Ca")):
            wrists = recording.positions[frame, WRISTS]
            assert min(goal.signed_distance(wrists).min() for goal in goals) < 0.01
            picks += 1
    assert picks > 8


def test_a_crate_keeps_both_hands_apart_while_it_is_carried(clean: list[Recording]) -> None:
    apart = [
        np.linalg.norm(r.positions[:, 2] - r.positions[:, 5], axis=-1)[np.array(r.labels) == "Ca"]
        for r in clean
        if r.task == "carrying"
    ]
    carried = np.concatenate(apart)
    assert len(carried) > 200
    assert 0.23 < carried.min() < carried.max() < 0.29  # 26 cm, give or take the tremor of two hands


def test_hesitation_changes_some_reaches(monkeypatch: pytest.MonkeyPatch) -> None:
    people = []
    for share in (0.0, 1.0):
        monkeypatch.setattr(generated_people, "HESITATION", share)
        people.append(generate_clean(replace(OPTIONS, subjects=3, recordings=1), 3))
    for a, b in zip(*people, strict=True):
        assert np.abs(a.positions - b.positions).max() > 0.1


def test_without_flaws_the_measured_motion_is_the_true_one(clean: list[Recording], tracked: Tracked) -> None:
    for measured, truth in zip(tracked(), clean, strict=True):
        np.testing.assert_allclose(measured.positions, truth.positions, atol=1e-12)
        assert measured.labels == truth.labels
        np.testing.assert_array_equal(measured.stamps, truth.stamps)


def test_noise_has_the_stated_spread(clean: list[Recording], tracked: Tracked) -> None:
    noisy = tracked(NOISE=0.004)
    error = np.concatenate([m.positions - t.positions for m, t in zip(noisy, clean, strict=True)])
    chest, wrist = error[:, noisy[0].joints.index("chest")], error[:, 2]
    tolerance = 5 * 0.004 / np.sqrt(2 * chest.size)  # five standard errors of a standard deviation
    assert chest.std() == pytest.approx(0.004, abs=tolerance)
    assert wrist.std() == pytest.approx(0.006, abs=1.5 * tolerance)


def test_all_bones_breathe_together(clean: list[Recording], tracked: Tracked) -> None:
    breathing = tracked(BREATHING=0.04)
    scale = np.stack([limb_lengths(m) / limb_lengths(t) for m, t in zip(breathing, clean, strict=True)])
    assert np.ptp(scale, axis=2).max() < 1e-12, "one factor for all bones"
    factor = scale[..., 0] - 1.0
    assert np.abs(factor).max() <= 0.1 + 1e-12
    # 12 recordings of 20 s at a correlation time of 0.83 s: about 12 * 20 / 1.66 = 145 independent values
    assert factor.std() == pytest.approx(0.04, abs=4 * 0.04 / np.sqrt(2 * 145))
    lag = 10
    correlation = np.mean(factor[:, lag:] * factor[:, :-lag]) / np.mean(factor**2)
    assert correlation == pytest.approx(np.exp(-lag / 30 / 0.83), abs=0.1)


def test_repeated_frames_come_at_the_stated_rate(tracked: Tracked) -> None:
    measured = tracked(NOISE=0.001, REPEATED=0.1)
    repeated = np.concatenate([np.all(np.diff(r.positions, axis=0) == 0, axis=(1, 2)) for r in measured])
    assert repeated.mean() == pytest.approx(0.1, abs=4 * np.sqrt(0.1 * 0.9 / repeated.size))


def test_dropouts_lose_a_wrist_or_a_forearm_and_never_the_trunk(tracked: Tracked) -> None:
    measured = tracked(DROPOUTS=0.05)
    lost = np.concatenate([np.isnan(r.positions).any(axis=-1) for r in measured])
    assert not lost[:, [0, 3, 6, 7, 8, 9]].any()
    assert not (lost[:, 1] & ~lost[:, 2]).any(), "an elbow is lost with its wrist"
    assert lost[:, [1, 4]].any()
    frames = lost[:, WRISTS].mean()
    runs = 0.05 * lost.shape[0] * 2 / 5.0
    assert frames == pytest.approx(0.05, abs=4 * 0.05 * np.sqrt(2 / runs))  # geometric runs


def test_jumps_are_rare_short_and_bounded(clean: list[Recording], tracked: Tracked) -> None:
    measured = tracked(JUMPS=0.5)
    jumped = 0
    for bad, truth in zip(measured, clean, strict=True):
        off = np.linalg.norm(bad.positions - truth.positions, axis=-1)
        assert off[:, 6:].max() < 1e-12
        swapped = np.any(off[:, [0, 3]] > 1e-6, axis=1)
        assert off[~swapped][:, WRISTS].max() <= 3 * 24.0 / 30  # even if jumps meet
        jumped += int((off.max(axis=1) > 1e-6).sum())
    frames = 12 * 600
    expected = 0.5 * 12 * 20 * 2  # two frames each on average, a few of them shared or cut
    assert 0.6 * expected < jumped < 1.2 * expected
    assert jumped < 0.05 * frames


def test_the_arch_is_the_quintic_spline_through_the_via_point() -> None:
    """The minimum-jerk interpolant: the quintic spline at rest at both ends, its fourth derivative smooth."""
    rest = [(1, 0.0), (2, 0.0)]
    tau = np.linspace(0, 1, 201)
    spline = make_interp_spline([0.0, 0.5, 1.0], [0.0, 1.0, 0.0], k=5, bc_type=(rest, rest))
    np.testing.assert_allclose(arch(tau), spline(tau), atol=1e-12)
    straight = make_interp_spline([0.0, 0.5, 1.0], [0.0, 0.5, 1.0], k=5, bc_type=(rest, rest))
    np.testing.assert_allclose(minimum_jerk(tau), straight(tau), atol=1e-12)


def test_movements_add_up_and_stay_between_their_targets() -> None:
    path = Path(np.array([0.0, 0.0]))
    path.move(1.0, 1.0, np.array([1.0, 0.0]))
    path.move(1.4, 1.0, np.array([0.0, 1.0]))  # another goal in mid-reach
    times = np.linspace(0.0, 4.0, 401)
    position = path.at(times)
    np.testing.assert_array_equal(position[times <= 1.0], 0.0)
    np.testing.assert_allclose(position[times >= 2.4], [[0.0, 1.0]] * int((times >= 2.4).sum()), atol=1e-12)
    assert position.min() >= -1e-12
    assert position.sum(axis=1).max() <= 1 + 1e-12  # inside the triangle of start and both goals
    assert position[:, 0].max() < 0.8, "the first goal is given up"


@pytest.mark.parametrize(("name", "value"), [("subjects", 0), ("duration", 0.0), ("rate", np.nan)])
def test_impossible_options_are_refused(name: str, value: float) -> None:
    with pytest.raises(OptionError, match=rf"{name} .* is outside"):
        replace(OPTIONS, **{name: value})


def test_a_recording_may_be_a_single_frame() -> None:
    (recording,) = generate(replace(OPTIONS, subjects=1, recordings=1, duration=0.1, rate=1.0), 0)
    assert recording.positions.shape == (1, 10, 3)
