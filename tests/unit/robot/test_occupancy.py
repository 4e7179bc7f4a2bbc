"""Space that people may fill: what it holds, how it grows, how far away it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.errors import OptionError
from kinecast.geometry.shapes import Capsule
from kinecast.robot.occupancy import PARTS, Occupancy, OccupancyOptions, measured, occupied, reachable, seen
from kinecast.types import SkeletonFrame, Status

from .conftest import prediction

FOREARM, HAND, HEAD = PARTS.index("left_forearm"), PARTS.index("left_hand"), PARTS.index("head")


def random_occupancy(rng: np.random.Generator, times: int = 4, count: int = 7) -> Occupancy:
    start = rng.normal(0, 0.5, (times, count, 3))
    return Occupancy(
        0.0,
        np.arange(times) / 10,
        start,
        start + rng.normal(0, 0.2, start.shape),
        rng.uniform(0.05, 0.2, (times, count)),
    )


@pytest.mark.parametrize("level", [0.5, 0.95, 1.0])
def test_each_capsule_holds_its_limb_with_the_stated_probability(level: float) -> None:
    seen_ahead = prediction(spread=0.03)
    options = OccupancyOptions(level=level)
    region = occupied([seen_ahead], 0.03, options)
    for t in range(15):
        capsule = Capsule(region.start[t, FOREARM], region.end[t, FOREARM], region.radius[t, FOREARM])
        elbow, wrist = seen_ahead.samples[:, t, 1], seen_ahead.samples[:, t, 2]
        # The limb is a capsule of its own radius: its axis must lie that far inside.
        inside = (capsule.signed_distance(elbow) <= 1e-9 - options.forearm) & (
            capsule.signed_distance(wrist) <= 1e-9 - options.forearm
        )
        assert level <= inside.mean() <= min(level + 0.1, 1.0)


def test_the_region_is_never_larger_than_what_can_be_reached() -> None:
    wild = prediction(spread=3.0)
    region, reach = occupied([wild], 0.0), reachable([wild], 0.0)
    for t, time in enumerate(region.times):
        assert (region.radius[t] <= reach.at(float(time))[2] + 1e-9).all()
    assert (occupied([prediction(spread=0.02)], 0.0).radius[5:] < region.radius[5:]).any()


def test_torso_and_head_count() -> None:
    region = occupied([prediction(spread=0.001)], 0.03)
    head = np.array([-1.2, 0.0, 0.75])
    distance, _ = region.signed_distance(head[None, None], region.times[:1])
    assert distance[0, 0] == pytest.approx(-region.radius[0, HEAD], abs=2e-3)
    assert region.radius.shape == (15, len(PARTS))


@pytest.mark.parametrize(
    "change", [{"status": status} for status in Status if status is not Status.OK] + [{"stamp": -0.2}], ids=str
)
def test_what_cannot_be_trusted_counts_as_the_reachable_set(change: dict[str, object]) -> None:
    doubtful = prediction(**change)  # type: ignore[arg-type]
    region, reach = occupied([doubtful], 0.0), reachable([doubtful], 0.0)
    np.testing.assert_array_equal(region.radius, reach.radius)
    np.testing.assert_array_equal(region.start, reach.start)
    options = OccupancyOptions()
    grown = options.forearm + options.hand_speed * (options.horizon - doubtful.stamp)
    assert reach.radius[-1, FOREARM] == pytest.approx(grown, abs=1e-9)


def test_a_prediction_of_nothing_but_nan_fills_everything() -> None:
    lost = prediction(status=Status.FAULT)
    lost = replace(lost, samples=np.full_like(lost.samples, np.nan), mean=np.full_like(lost.mean, np.nan))
    distance, gradient = occupied([lost], 0.0).signed_distance(np.array([[[1.0, 0.0, 0.5]]]), np.zeros(1))
    assert distance[0, 0] < -10
    assert np.isfinite(gradient).all()


def test_nan_samples_are_not_trusted_whatever_the_status_says() -> None:
    bad = prediction()
    samples = bad.samples.copy()
    samples[0, 0, 2] = np.nan
    assert np.isfinite(occupied([replace(bad, samples=samples)], 0.0).radius).all()


def test_an_unseen_wrist_may_be_anywhere_it_can_be_from_the_elbow() -> None:
    positions = prediction().mean[0].copy()
    whole = measured([SkeletonFrame(0.0, ARM_JOINTS, positions)], 0.0)
    positions[2] = np.nan
    part = measured([SkeletonFrame(0.0, ARM_JOINTS, positions)], 0.0)
    wrist = np.array([[[-0.9, 0.25, 0.15]]])
    assert part.signed_distance(wrist, np.zeros(1))[0] < 0
    assert part.radius[0, FOREARM] == pytest.approx(whole.radius[0, FOREARM] + 0.30)
    assert part.radius[0, PARTS.index("right_forearm")] == whole.radius[0, PARTS.index("right_forearm")]


def test_what_was_measured_does_not_grow_and_what_was_seen_does() -> None:
    frame = SkeletonFrame(0.0, ARM_JOINTS, prediction().mean[0])
    still, growing = measured([frame], 0.0), seen([frame], 0.0)
    np.testing.assert_allclose(still.at(3.0)[2], OccupancyOptions().radii)
    np.testing.assert_allclose(growing.at(0.0)[2], OccupancyOptions().radii)
    np.testing.assert_allclose(growing.at(0.25)[2], OccupancyOptions().radii + 0.25 * OccupancyOptions().speeds)


def test_persons_stand_side_by_side_at_all_their_times() -> None:
    one, other = prediction(x=-1.2), prediction(x=1.5, stamp=0.01)
    both = occupied([one, other], 0.05)
    assert both.radius.shape == (30, 2 * len(PARTS))
    alone = occupied([other], 0.05)
    for time in (0.05, 0.2, 0.4):
        np.testing.assert_allclose(both.at(time)[2][len(PARTS) :], alone.at(time)[2], atol=1e-12)


def test_nobody_is_infinitely_far_away() -> None:
    for empty in (Occupancy.empty(), occupied([], 0.0)):
        distance, gradient = empty.signed_distance(np.zeros((2, 3, 3)), np.zeros(2))
        assert np.isposinf(distance).all()
        assert (gradient == 0).all()


def test_distance_is_that_of_the_nearest_capsule_at_that_time() -> None:
    rng = np.random.default_rng(0)
    region, points = random_occupancy(rng), rng.normal(0, 0.6, (6, 5, 3))
    times = np.array([-1.0, 0.0, 0.05, 0.13, 0.3, 0.32])
    distance, _ = region.signed_distance(points, times)
    for w, time in enumerate(times):
        shapes = [Capsule(a, b, float(r)) for a, b, r in zip(*region.at(float(time)), strict=True)]
        expected = np.min([shape.signed_distance(points[w]) for shape in shapes], axis=0)
        np.testing.assert_allclose(distance[w], expected, atol=1e-12)


def test_gradient_is_the_derivative_and_of_length_one() -> None:
    rng = np.random.default_rng(1)
    region, points, times = random_occupancy(rng), rng.normal(0, 0.6, (4, 20, 3)), np.linspace(0, 0.4, 4)
    _, gradient = region.signed_distance(points, times)
    np.testing.assert_allclose(np.linalg.norm(gradient, axis=-1), 1, atol=1e-12)
    step = 1e-7
    for i in range(3):
        shift = step * np.eye(3)[i]
        slope = (
            region.signed_distance(points + shift, times)[0] - region.signed_distance(points - shift, times)[0]
        ) / (2 * step)
        # Where two capsules are as near, the derivative is neither's.
        assert np.mean(np.abs(slope - gradient[..., i]) < 1e-5) > 0.95


def test_on_the_axis_of_a_capsule_the_gradient_is_still_a_direction() -> None:
    region = Occupancy(0.0, np.zeros(1), np.zeros((1, 1, 3)), np.array([[[0.0, 0, 1]]]), np.full((1, 1), 0.1))
    distance, gradient = region.signed_distance(np.array([[[0.0, 0.0, 0.5], [0.0, 0.0, 0.0]]]), np.zeros(1))
    np.testing.assert_allclose(distance, -0.1)
    np.testing.assert_allclose(np.linalg.norm(gradient, axis=-1), 1)


def test_between_two_times_capsules_move_evenly_and_after_the_last_they_grow_to_a_limit() -> None:
    region = random_occupancy(np.random.default_rng(2))
    start, _, radius = region.at(0.15)
    np.testing.assert_allclose(start, 0.5 * (region.start[1] + region.start[2]), atol=1e-12)
    np.testing.assert_allclose(radius, 0.5 * (region.radius[1] + region.radius[2]), atol=1e-12)
    np.testing.assert_allclose(region.at(-5.0)[2], region.radius[0])
    np.testing.assert_allclose(region.at(0.35)[2], region.radius[-1] + 0.05 * region.reach_speed)
    np.testing.assert_allclose(region.at(90.0)[2], region.radius[-1] + region.growth_limit)


@pytest.mark.parametrize("options", [{"level": 0.0}, {"level": 1.1}, {"hand": -0.1}, {"reach_speed": np.nan}])
def test_impossible_options_are_refused(options: dict[str, float]) -> None:
    with pytest.raises(OptionError):
        OccupancyOptions(**options)
