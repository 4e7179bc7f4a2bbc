"""All methods by name: what is trained, what is shared, and what a model file makes of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from kinecast.body.limits import AngleLimit, JointLimits
from kinecast.body.posture import postures_from_points
from kinecast.errors import ModelError, OptionError
from kinecast.prediction.gaussian import PositionGaussian, PostureGaussian
from kinecast.prediction.method import Method, forecast_in_scene
from kinecast.prediction.methods import (
    METHODS,
    SHIPPED,
    card_of,
    check_names,
    shipped_methods,
    train,
)
from kinecast.prediction.observation import Observation
from kinecast.prediction.paper import PositionSeries, PostureSeries
from kinecast.prediction.training_windows import TrainingWindows


def test_every_name_makes_its_method(trained: dict[str, Method[Any]], windows: TrainingWindows) -> None:
    assert set(METHODS) - set(trained) <= {"kinecast", "mixer", "mixer_constrained"}
    for name, method in trained.items():
        if name == "gp_xyz":
            kind: type = PositionSeries
        elif name.startswith("gp_"):
            kind = PostureSeries
        else:
            kind = PostureGaussian if name.endswith(("_angles", "_constrained")) else PositionGaussian
        assert type(method) is kind, name
        assert isinstance(method, Method)
        assert (method.frames, method.steps, method.dt) == (6, 3, windows.dt)
        if kind in (PostureGaussian, PostureSeries):
            assert (method.limits is not None) == name.endswith("_constrained"), name


def test_constrained_methods_hold_limits_widened_to_the_training_postures(
    trained: dict[str, Method[Any]], windows: TrainingWindows
) -> None:
    limits = windows.limits
    for name in ("kalman_constrained", "ridge_constrained", "gp_constrained"):
        assert trained[name].limits == limits
        assert trained[name].noise == windows.noise
    postures = postures_from_points(windows.points, continuous=True)[:, -1]
    elbows = postures[:, [9, 15]]
    wide = JointLimits(elbow=AngleLimit(1.0, 1.01, 12.0)).widened(postures).elbow
    assert wide.lower < np.quantile(elbows, 0.01)
    assert wide.upper > np.quantile(elbows, 0.99)
    assert wide.speed == 12.0


@pytest.mark.parametrize("base", ["kalman", "ridge"])
def test_free_and_constrained_share_one_fit(trained: dict[str, Method[Any]], base: str) -> None:
    free, held = trained[f"{base}_angles"].to_arrays(), trained[f"{base}_constrained"].to_arrays()
    for name in free:
        np.testing.assert_array_equal(free[name], held[name])


def test_training_is_repeatable(windows: TrainingWindows, trained: dict[str, Method[Any]]) -> None:
    again = train(["damped_velocity", "ridge"], windows)
    for name, method in again.items():
        for array, values in method.to_arrays().items():
            np.testing.assert_allclose(values, trained[name].to_arrays()[array], atol=1e-12)


def test_predictions_beat_guessing(trained: dict[str, Method[Any]], windows: TrainingWindows) -> None:
    rows = np.arange(5, len(windows), 12)
    errors = {}
    for name, method in trained.items():
        means = [
            forecast_in_scene(
                method,
                method.init_state(),
                Observation(windows.observed[row].astype(float), windows.up[row], windows.dt),
                np.random.default_rng(0),
                50,
                None,
            ).mean
            for row in rows
        ]
        errors[name] = np.linalg.norm(np.array(means) - windows.future[rows], axis=-1).mean()
    assert errors["damped_velocity"] < errors["zero_velocity"]
    assert errors["ridge"] < errors["zero_velocity"]
    assert max(errors.values()) < 2.0 * errors["zero_velocity"], errors


def test_too_little_data_is_refused(windows: TrainingWindows) -> None:
    with pytest.raises(ModelError, match="49 training windows; at least 50"):
        train(["zero_velocity"], windows.take(np.arange(49)))


@pytest.mark.parametrize("names", [[], ["zero"], ["ridge", "gp"]])
def test_unknown_names_are_refused_with_those_that_are(names: list[str]) -> None:
    with pytest.raises(OptionError, match=r"unknown method .*; methods are zero_velocity, "):
        check_names(names)


def test_a_card_says_what_the_model_is(trained: dict[str, Method[Any]], windows: TrainingWindows) -> None:
    card = card_of("ridge", trained["ridge"], windows, "reaching", ["a"], ["MIT"])
    assert (card.method, card.frames, card.steps) == ("ridge", 6, 3)
    assert card.rate == pytest.approx(30.0)
    assert card.dt == pytest.approx(windows.dt)
    assert card.windows == len(windows)
    assert (card.label, card.trained_on, card.notes) == ("reaching", ("a",), ("MIT",))
    assert card.limits == windows.limits


def test_the_shipped_models_can_be_read_and_predict() -> None:
    card, methods = shipped_methods()
    assert tuple(methods) == SHIPPED
    assert card.method == SHIPPED[-1]
    rest = np.array([[0, 0.2, 1.4], [0, 0.25, 1.1], [0.2, 0.2, 1.0], [0, -0.2, 1.4], [0, -0.25, 1.1], [0.2, -0.2, 1.0]])
    for method in methods.values():
        window = np.repeat(rest[None], method.frames, axis=0)
        seen = Observation(window, np.array([0.0, 0.0, 1.0]), method.dt)
        forecast = forecast_in_scene(method, method.init_state(), seen, np.random.default_rng(0), 20, None)
        assert forecast.samples.shape == (20, method.steps, 6, 3)
        assert np.linalg.norm(forecast.mean - rest, axis=-1).max() < 0.2
