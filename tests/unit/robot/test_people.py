"""What is known of people from their last measurements, and the space that they may fill."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.geometry.shapes import Capsule
from kinecast.robot.body import HAND_LENGTH, MEASURED_BODY, PARTS, TRUE_BODY, body_capsules, interpolated
from kinecast.robot.motions import is_trusted
from kinecast.robot.people import FASTEST, HARDEST, TOUCH, CameraFrame, PeopleModel, occupied, reach_probabilities
from kinecast.robot.separation import Moving
from kinecast.types import Prediction, SkeletonFrame, Status

from .conftest import prediction

REST = np.array([[0, 0.2, 1.4], [0, 0.25, 1.1], [0.2, 0.2, 1.0], [0, -0.2, 1.4], [0, -0.25, 1.1], [0.2, -0.2, 1.0]])
FOREARM, HAND, HEAD = (PARTS.index(part) for part in ("left_forearm", "left_hand", "head"))
JOINTS = (*ARM_JOINTS, "head", "pelvis")
POSE = np.concatenate([REST, [[0.05, 0.0, 1.65], [0.0, 0.0, 0.9]]])


def shown(acceleration: float, shots: int = 6, speed: float = 0.3) -> PeopleModel:
    """Six arm joints that move along x, gaining speed, at 30 Hz up to now = 1 s; the speed is that of now."""
    people = PeopleModel()
    for stamp in 1.0 - np.arange(shots)[::-1] / 30:
        since = stamp - 1.0
        positions = REST + np.array([speed * since + acceleration * since**2 / 2, 0.0, 0.0])
        people.see(CameraFrame(stamp, (SkeletonFrame(float(stamp), ARM_JOINTS, positions),)))
    return people


def velocities(seen: Moving) -> np.ndarray:
    """(2, 3) or, where only that of the middle is known, (1, 3) of the wrist."""
    return seen.velocity[FOREARM :: len(PARTS), 3:]


@pytest.mark.parametrize("acceleration", [0.0, 3.0, -3.0])
def test_velocity_is_that_of_the_middle_and_that_of_now(acceleration: float) -> None:
    middle, now = velocities(shown(acceleration).seen(1.05))
    lag = 2 / 30  # five frames lie within 0.14 s
    np.testing.assert_allclose(middle, [0.3 - acceleration * lag, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(now, [0.3 + acceleration * 0.05, 0.0, 0.0], atol=1e-6)


def test_a_hand_that_gains_speed_as_no_hand_can_is_taken_for_one_that_can() -> None:
    middle, now = velocities(shown(100.0).seen(1.0))
    assert np.linalg.norm(now - middle) == pytest.approx(HARDEST * 2 / 30)


def test_with_few_measurements_nothing_is_known_of_velocity() -> None:
    [middle] = velocities(shown(3.0, shots=3).seen(1.0))
    assert np.isfinite(middle).all()
    assert np.isnan(velocities(shown(3.0, shots=2).seen(1.0))).all()


def test_the_model_knows_place_speed_and_age() -> None:
    people = PeopleModel()
    for stamp in np.arange(20) / 30:
        positions = POSE + np.array([0.5 * stamp, 0.0, 0.0])
        people.see(CameraFrame(stamp, (SkeletonFrame(float(stamp), JOINTS, positions, "a"),)))
    seen = people.seen(0.7)
    truth = body_capsules(JOINTS, positions)
    np.testing.assert_allclose(seen.capsules, np.tile(truth, (2, 1)), atol=1e-12)
    np.testing.assert_allclose(seen.velocity, np.tile([0.5, 0, 0], (18, 2)), atol=1e-6)
    np.testing.assert_allclose(seen.age, 0.7 - people.newest)


def test_a_lost_wrist_stays_where_it_was_grows_old_and_has_no_speed() -> None:
    people = PeopleModel()
    for k in range(10):
        positions = POSE.copy()
        if k >= 5:
            positions[2] = np.nan
        people.see(CameraFrame(k / 30, (SkeletonFrame(k / 30, JOINTS, positions, "a"),)))
    seen = people.seen(9 / 30)
    forearm, hand, trunk = 1, 2, 7
    np.testing.assert_allclose(seen.capsules[forearm, 3:6], POSE[2])
    assert seen.age[forearm] == seen.age[hand] == pytest.approx(5 / 30)
    assert seen.age[trunk] == pytest.approx(0.0)
    assert np.isnan(seen.velocity[hand]).all()
    assert np.isfinite(seen.velocity[trunk]).all()


def test_who_is_on_no_shot_for_a_while_has_left_but_a_silent_camera_says_nothing() -> None:
    people = PeopleModel()
    people.see(CameraFrame(0.0, (SkeletonFrame(0.0, JOINTS, POSE, "a"),)))
    assert people.seen(10.0).age.min() == pytest.approx(10.0)
    for k in range(1, 20):
        people.see(CameraFrame(k / 30, ()))
    assert len(people.seen(1.0).age) == 0


def test_a_person_never_seen_whole_is_named_and_old_shots_are_passed_over() -> None:
    people, nowhere = PeopleModel(), np.full_like(POSE, np.nan)
    people.see(CameraFrame(1.0, (SkeletonFrame(1.0, JOINTS, nowhere, "ghost"),)))
    assert people.unseen() == ["ghost"]
    people.see(CameraFrame(0.5, (SkeletonFrame(0.5, JOINTS, POSE, "late"),)))
    assert people.unseen() == ["ghost"]
    assert len(people.seen(1.0).age) == 9


@pytest.mark.parametrize("level", [0.5, 0.95, 1.0])
def test_each_capsule_holds_its_limb_with_the_stated_probability(level: float) -> None:
    ahead = prediction(spread=0.03)
    for t in (0, 7, 14):
        row = occupied([ahead], 0.03, float(ahead.times[t]), level)[FOREARM]
        capsule = Capsule(row[:3], row[3:6], float(row[6]))
        # The limb is a capsule of its own radius: its axis must lie that far inside.
        elbow, wrist = (capsule.signed_distance(ahead.samples[:, t, joint]) for joint in (1, 2))
        inside = np.maximum(elbow, wrist) <= 1e-9 - MEASURED_BODY[FOREARM]
        assert level <= inside.mean() <= min(level + 0.1, 1.0)


def test_the_region_is_never_larger_than_what_can_be_reached_and_the_whole_body_counts() -> None:
    at = 0.25
    wild, usual = (occupied([prediction(spread=spread)], 0.0, at) for spread in (3.0, 0.02))
    np.testing.assert_allclose(wild[:, 6], MEASURED_BODY + at * FASTEST)
    assert usual.shape == (len(PARTS), 7)
    assert (usual[:, 6] < wild[:, 6]).all()
    np.testing.assert_allclose(usual[HEAD, :3], [-1.2, 0.0, 0.75], atol=2e-2)


@pytest.mark.parametrize(
    "change", [{"status": status} for status in Status if status is not Status.OK] + [{"stamp": -0.2}], ids=str
)
def test_what_cannot_be_trusted_counts_as_the_reachable_set(change: dict[str, object]) -> None:
    doubtful = prediction(spread=0.01, **change)  # type: ignore[arg-type]
    assert not is_trusted(doubtful, 0.0)
    rows = occupied([doubtful], 0.0, 0.25)
    np.testing.assert_allclose(rows[:, 6], MEASURED_BODY + (0.25 - doubtful.stamp) * FASTEST)
    np.testing.assert_allclose(rows[FOREARM, :3], doubtful.mean[0, 1])


def test_what_is_not_finite_is_not_trusted_and_what_is_not_known_left_out() -> None:
    bad = prediction(spread=0.01)
    samples, mean = bad.samples.copy(), bad.mean.copy()
    samples[0, 0, 2], mean[:, 2] = np.nan, np.nan
    whole = occupied([replace(bad, samples=samples)], 0.0, 0.25)
    np.testing.assert_allclose(whole[:, 6], MEASURED_BODY + 0.25 * FASTEST)
    assert occupied([replace(bad, samples=samples, mean=mean)], 0.0, 0.25).shape == (len(PARTS) - 2, 7)
    assert occupied([], 0.0, 0.25).shape == (0, 7)
    assert occupied([bad, bad], 0.0, 0.25).shape == (2 * len(PARTS), 7)


def test_between_two_times_capsules_move_evenly_and_beyond_them_they_stay() -> None:
    rows = np.random.default_rng(2).normal(size=(4, 5, 7))
    found = interpolated(np.array([-5.0, 0.1, 0.15, 9.0]), np.arange(4) / 10, rows)
    np.testing.assert_allclose(found, [rows[0], rows[1], 0.5 * (rows[1] + rows[2]), rows[3]], atol=1e-12)


def test_bodies_are_the_same_one_by_one_and_all_at_once() -> None:
    samples = prediction().samples[:3]
    many = body_capsules(ARM_JOINTS, samples)
    for s, t in ((0, 0), (2, 14)):
        np.testing.assert_array_equal(many[s, t], body_capsules(ARM_JOINTS, samples[s, t]))


def two_ways(share: float, samples: int = 100) -> Prediction:
    """The left wrist goes to x = 0.5 with this probability, and stays at x = 1 otherwise."""
    arms = np.array([[1.2, -0.2, 0.5], [1.2, -0.25, 0.2], [1.0, -0.2, 0.1]])
    arms = np.concatenate([arms, arms + np.array([0.0, 2.0, 0.0])])
    drawn = np.repeat(np.repeat(arms[None, None], samples, axis=0), 15, axis=1)
    drawn[: round(share * samples), -1, 2, 0] = 0.5
    times = np.arange(1, 16) / 30
    return Prediction(0.0, times, drawn, drawn.mean(axis=0), np.zeros((15, 6, 3, 3)), ("",) * 6)


@pytest.mark.parametrize("share", [0.0, 0.2, 0.7, 1.0])
def test_probabilities_are_shares_of_samples(share: float) -> None:
    cubes = np.array([[0.45, -0.2, 0.05], [0.45, 0.6, 0.05]])
    np.testing.assert_allclose(reach_probabilities(two_ways(share), cubes), [share, 0.0])


def test_a_limb_that_is_not_known_may_be_anywhere() -> None:
    lost = two_ways(0.0)
    lost.samples[:10, 3, 2] = np.nan
    assert reach_probabilities(lost, np.array([[5.0, 5.0, 5.0]]))[0] == pytest.approx(0.1)


def test_a_hand_reaches_as_far_as_it_is_long_and_thick() -> None:
    sure = two_ways(1.0)
    hand = body_capsules(ARM_JOINTS, sure.samples[0, -1])[HAND]
    finger = hand[3:6] + (MEASURED_BODY[HAND] + TOUCH) * (hand[3:6] - hand[:3]) / HAND_LENGTH
    for beyond, reached in ((-0.01, 1.0), (0.01, 0.0)):
        assert reach_probabilities(sure, finger[None] - [[beyond, 0.0, 0.0]])[0] == reached
    assert (TRUE_BODY < MEASURED_BODY).all()
