"""What is known of people from their last measurements."""

from __future__ import annotations

import numpy as np
import pytest

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.robot.camera import Shot
from kinecast.robot.watch import HARDEST, Seen, Watch
from kinecast.types import SkeletonFrame

REST = np.array([[0, 0.2, 1.4], [0, 0.25, 1.1], [0.2, 0.2, 1.0], [0, -0.2, 1.4], [0, -0.25, 1.1], [0.2, -0.2, 1.0]])
LEFT_FOREARM = 1


def shown(acceleration: float, shots: int = 6, speed: float = 0.3) -> Watch:
    """Six arm joints that move along x, gaining speed, at 30 Hz up to now = 1 s; the speed is that of now."""
    watch = Watch()
    for stamp in 1.0 - np.arange(shots)[::-1] / 30:
        since = stamp - 1.0
        positions = REST + np.array([speed * since + acceleration * since**2 / 2, 0.0, 0.0])
        watch.add(Shot(stamp, stamp, (SkeletonFrame(float(stamp), ARM_JOINTS, positions),)))
    return watch


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
