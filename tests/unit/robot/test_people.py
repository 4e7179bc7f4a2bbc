"""What is known of people from their last measurements."""

from __future__ import annotations

import numpy as np
import pytest

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.robot.body import body_capsules
from kinecast.robot.camera import CameraFrame
from kinecast.robot.people import HARDEST, PeopleModel, Seen
from kinecast.types import SkeletonFrame

REST = np.array([[0, 0.2, 1.4], [0, 0.25, 1.1], [0.2, 0.2, 1.0], [0, -0.2, 1.4], [0, -0.25, 1.1], [0.2, -0.2, 1.0]])
LEFT_FOREARM = 1
JOINTS = (*ARM_JOINTS, "head", "pelvis")
POSE = np.concatenate([REST, [[0.05, 0.0, 1.65], [0.0, 0.0, 0.9]]])


def shown(acceleration: float, shots: int = 6, speed: float = 0.3) -> PeopleModel:
    """Six arm joints that move along x, gaining speed, at 30 Hz up to now = 1 s; the speed is that of now."""
    people = PeopleModel()
    for stamp in 1.0 - np.arange(shots)[::-1] / 30:
        since = stamp - 1.0
        positions = REST + np.array([speed * since + acceleration * since**2 / 2, 0.0, 0.0])
        people.see(CameraFrame(stamp, stamp, (SkeletonFrame(float(stamp), ARM_JOINTS, positions),)))
    return people


def velocities(seen: Seen) -> tuple[np.ndarray, np.ndarray]:
    return seen.end_velocity[LEFT_FOREARM], seen.end_velocity_now[LEFT_FOREARM]


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
    middle, now = velocities(shown(3.0, shots=3).seen(1.0))
    assert np.isfinite(middle).all()
    assert np.isnan(now).all()
    assert np.isnan(velocities(shown(3.0, shots=2).seen(1.0))).all()


def test_the_model_knows_place_speed_and_age() -> None:
    people = PeopleModel()
    for stamp in np.arange(20) / 30:
        positions = POSE + np.array([0.5 * stamp, 0.0, 0.0])
        people.see(CameraFrame(stamp, stamp, (SkeletonFrame(float(stamp), JOINTS, positions, "a"),)))
    seen = people.seen(0.7)
    truth = body_capsules(JOINTS, positions)
    np.testing.assert_allclose(seen.start, truth.start, atol=1e-12)
    np.testing.assert_allclose(seen.start_velocity, np.tile([0.5, 0, 0], (9, 1)), atol=1e-6)
    np.testing.assert_allclose(seen.age, 0.7 - people.newest)


def test_a_lost_wrist_stays_where_it_was_grows_old_and_has_no_speed() -> None:
    people = PeopleModel()
    for k in range(10):
        positions = POSE.copy()
        if k >= 5:
            positions[2] = np.nan
        people.see(CameraFrame(k / 30, k / 30, (SkeletonFrame(k / 30, JOINTS, positions, "a"),)))
    seen = people.seen(9 / 30)
    forearm, hand, trunk = 1, 2, 7
    np.testing.assert_allclose(seen.end[forearm], POSE[2])
    assert seen.age[forearm] == seen.age[hand] == pytest.approx(5 / 30)
    assert seen.age[trunk] == pytest.approx(0.0)
    assert np.isnan(seen.start_velocity[hand]).all()
    assert np.isfinite(seen.start_velocity[trunk]).all()


def test_who_is_on_no_shot_for_a_while_has_left_but_a_silent_camera_says_nothing() -> None:
    people = PeopleModel()
    people.see(CameraFrame(0.0, 0.0, (SkeletonFrame(0.0, JOINTS, POSE, "a"),)))
    assert people.seen(10.0).age.min() == pytest.approx(10.0)
    for k in range(1, 20):
        people.see(CameraFrame(k / 30, k / 30, ()))
    assert len(people.seen(1.0).age) == 0


def test_a_person_never_seen_whole_is_named_and_old_shots_are_passed_over() -> None:
    people, nowhere = PeopleModel(), np.full_like(POSE, np.nan)
    people.see(CameraFrame(1.0, 1.0, (SkeletonFrame(1.0, JOINTS, nowhere, "ghost"),)))
    assert people.unseen() == ["ghost"]
    people.see(CameraFrame(0.5, 1.0, (SkeletonFrame(0.5, JOINTS, POSE, "late"),)))
    assert people.unseen() == ["ghost"]
    assert len(people.seen(1.0).age) == 9
