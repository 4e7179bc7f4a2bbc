"""Trivial and linear predictors where the right answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from kinecast.errors import ModelError
from kinecast.prediction.linear import (
    LinearMap,
    WindowFilter,
    constant_velocity,
    damped_velocity,
    fit_ridge,
    kalman,
    kalman_filter,
    mean_from_arrays,
    zero_velocity,
)

DT = 1.0 / 30.0
N, T = 6, 4


def lines(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Windows (W, N, 6) and futures (W, T, 6) of points on straight lines at constant speed."""
    start, velocity = rng.standard_normal((2, count, 1, 6))
    time = np.arange(N + T)[None, :, None]
    path = start + velocity * time
    return path[:, :N], path[:, N:]


def test_zero_velocity_holds_the_last_value() -> None:
    windows, _ = lines(np.random.default_rng(0), 5)
    np.testing.assert_array_equal(zero_velocity(N, T).mean(windows), np.repeat(windows[:, -1:], T, axis=1))


@pytest.mark.parametrize("frames", [2, 3, 6])
def test_constant_velocity_is_exact_on_straight_lines(frames: int) -> None:
    windows, futures = lines(np.random.default_rng(0), 5)
    np.testing.assert_allclose(constant_velocity(frames, T).mean(windows[:, -frames:]), futures, atol=1e-12)


def test_constant_velocity_is_the_slope_over_two_intervals() -> None:
    window = np.array([9.0, 9.0, 9.0, 1.0, 7.0, 3.0])[None, :, None]
    np.testing.assert_allclose(constant_velocity(N, T).mean(window)[0, :, 0], [4.0, 5.0, 6.0, 7.0])


def test_every_row_of_every_filter_sums_to_one() -> None:
    windows, futures = lines(np.random.default_rng(1), 30)
    filters = [zero_velocity(N, T), constant_velocity(N, T), damped_velocity(windows, futures, DT)]
    filters += [kalman_filter(N, T, ratio) for ratio in (1e-4, 1.0, 1e4)]
    for model in filters:
        np.testing.assert_allclose(model.weights.sum(axis=1), 1.0, atol=1e-9)


@pytest.mark.parametrize("ratio", [1e-4, 1e-2, 1.0, 1e4])
def test_the_kalman_filter_is_exact_on_straight_lines(ratio: float) -> None:
    windows, futures = lines(np.random.default_rng(2), 5)
    np.testing.assert_allclose(kalman_filter(N, T, ratio).mean(windows), futures, atol=1e-9)


def test_the_kalman_filter_is_least_squares_without_and_the_last_interval_with_much_acceleration() -> None:
    time = np.arange(N) - (N - 1.0)
    steps = np.arange(1, T + 1)
    fit = np.linalg.pinv(np.stack([np.ones(N), time], axis=1))
    np.testing.assert_allclose(kalman_filter(N, T, 1e-12).weights, fit[0] + steps[:, None] * fit[1], atol=1e-6)
    last = np.zeros((T, N))
    last[:, -1], last[:, -2] = 1.0 + steps, -steps
    # Even with unlimited acceleration the filter keeps a share of older slopes; the value itself it takes as it is.
    stiff = kalman_filter(N, T, 1e9).weights
    np.testing.assert_allclose(stiff[:, :-2].sum(axis=1) + stiff[:, -2] + stiff[:, -1], 1.0, atol=1e-9)
    assert np.abs(stiff - last).max() < np.abs(kalman_filter(N, T, 1e-2).weights - last).max()


def test_the_kalman_filter_agrees_with_a_textbook_one() -> None:
    ratio, window = 0.3, np.random.default_rng(3).standard_normal(N)
    F, H = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    Q = ratio * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]])
    # A flat prior at the first frame, made proper by a huge variance.
    x, P = np.zeros(2), 1e9 * np.eye(2)
    for z in window:
        K = P @ H.T / (H @ P @ H.T + 1.0)
        x, P = x + (K * (z - H @ x)).ravel(), (np.eye(2) - K @ H) @ P
        x, P = F @ x, F @ P @ F.T + Q
    expected = x[0] + x[1] * np.arange(T)
    np.testing.assert_allclose(kalman_filter(N, T, ratio).weights @ window, expected, atol=1e-5)


def test_kalman_takes_smooth_weights_for_noise_and_sharp_ones_for_turns() -> None:
    rng = np.random.default_rng(4)
    windows, futures = lines(rng, 200)
    noisy = kalman(windows + 0.5 * rng.standard_normal(windows.shape), futures)
    walk = np.cumsum(np.cumsum(rng.standard_normal((200, N + T, 6)), axis=1), axis=1)
    sharp = kalman(walk[:, :N], walk[:, N:])
    assert np.abs(noisy.weights[0]).max() < 1.0 < np.abs(sharp.weights[0]).max()


@pytest.mark.parametrize("tau", [0.04, 0.2, 1.0])
def test_damped_velocity_finds_the_time_constant(tau: float) -> None:
    rng = np.random.default_rng(5)
    start, velocity = rng.standard_normal((2, 50, 1, 6))
    time = DT * (np.arange(N + T) - (N - 1.0))[None, :, None]
    # Straight up to now, then fading out: all estimators see the same velocity.
    path = start + velocity * np.where(time <= 0, time, -tau * np.expm1(-np.maximum(time, 0) / tau))
    model = damped_velocity(path[:, :N], path[:, N:], DT)
    np.testing.assert_allclose(model.mean(path[:, :N]), path[:, N:], atol=1e-9)


def test_damped_velocity_prefers_the_long_estimator_under_noise_and_the_parabola_on_turns() -> None:
    rng = np.random.default_rng(6)
    windows, futures = lines(rng, 300)
    noisy = damped_velocity(windows + 0.5 * rng.standard_normal(windows.shape), futures, DT)
    slope = noisy.weights[0] - noisy.weights[0].mean()
    assert np.abs(np.corrcoef(slope[:-1], np.arange(N - 1))[0, 1]) > 0.99  # a line's slope weighs time linearly
    time = np.arange(N + T)[None, :, None] - (N - 1.0)
    turn = rng.standard_normal((300, 1, 6)) * time**2
    curved = damped_velocity(turn[:, :N], turn[:, N:], DT)
    # A parabola at its vertex stands still: only the quadratic fit sees that its velocity is zero there.
    np.testing.assert_allclose(curved.mean(turn[:, :N]), 0.0, atol=1e-9)


def test_damped_velocity_is_never_worse_on_its_training_data_than_the_baselines_it_contains() -> None:
    rng = np.random.default_rng(7)
    path = np.cumsum(rng.standard_normal((100, N + T, 6)), axis=1)
    windows, futures = path[:, :N], path[:, N:]

    def error(model: WindowFilter) -> float:
        return float(np.linalg.norm((model.mean(windows) - futures).reshape(100, T, 2, 3), axis=-1).mean())

    # Time constants of 20 ms and 20 s: all but nothing moves on, all but everything does.
    assert error(damped_velocity(windows, futures, DT)) < 1.01 * error(zero_velocity(N, T))
    assert error(damped_velocity(windows, futures, DT)) < 1.01 * error(constant_velocity(N, T))


def test_ridge_recovers_a_linear_law() -> None:
    rng = np.random.default_rng(8)
    windows = rng.standard_normal((800, N, 3))
    features = np.concatenate([(windows[:, :-1] - windows[:, -1:]).reshape(800, -1), windows[:, -1]], axis=1)
    law, offset = rng.standard_normal((features.shape[1], T * 3)), rng.standard_normal(T * 3)
    futures = windows[:, -1:] + (features @ law + offset).reshape(800, T, 3)
    model = fit_ridge(windows, futures, np.arange(800) % 4)
    fresh = rng.standard_normal((5, N, 3))
    features = LinearMap.features(fresh)
    np.testing.assert_allclose(model.mean(fresh), fresh[:, -1:] + (features @ law + offset).reshape(5, T, 3), atol=1e-4)


def test_ridge_shrinks_to_the_mean_displacement_where_there_is_nothing_to_learn() -> None:
    rng = np.random.default_rng(9)
    windows = rng.standard_normal((120, N, 3))
    futures = windows[:, -1:] + 0.7 + 3.0 * rng.standard_normal((120, T, 3))
    model = fit_ridge(windows, futures, np.arange(120) % 4)
    assert np.abs(model.matrix[:-1]).max() < 0.2
    np.testing.assert_allclose(model.matrix[-1], (futures - windows[:, -1:]).mean(axis=0).ravel(), atol=1e-12)


def test_ridge_copes_with_coordinates_that_never_change_and_with_one_fold() -> None:
    windows = np.ones((60, N, 3))
    model = fit_ridge(windows, np.ones((60, T, 3)), np.zeros(60, dtype=int))
    np.testing.assert_allclose(model.mean(windows[:2]), 1.0)


def test_arrays_round_trip() -> None:
    rng = np.random.default_rng(10)
    windows, futures = lines(rng, 60)
    for model in (constant_velocity(N, T), fit_ridge(windows, futures, np.arange(60) % 3)):
        back = mean_from_arrays(model.to_arrays(), N, T, 6)
        np.testing.assert_array_equal(back.mean(windows), model.mean(windows))


def test_arrays_of_another_shape_or_kind_are_refused() -> None:
    weights = constant_velocity(N, T).to_arrays()
    with pytest.raises(ModelError, match=r"weights of shape \(4, 6\); expected \(4, 5\)"):
        mean_from_arrays(weights, N - 1, T, 6)
    with pytest.raises(ModelError, match="expected weights, or centre"):
        mean_from_arrays({"knots": np.zeros(3)}, N, T, 6)
    windows, futures = lines(np.random.default_rng(11), 30)
    arrays = fit_ridge(windows, futures, np.zeros(30, dtype=int)).to_arrays()
    for name in arrays:
        with pytest.raises(ModelError, match=name):
            mean_from_arrays({**arrays, name: arrays[name][:-1]}, N, T, 6)
    with pytest.raises(ModelError, match="scale"):
        mean_from_arrays({**arrays, "scale": 0.0 * arrays["scale"]}, N, T, 6)
