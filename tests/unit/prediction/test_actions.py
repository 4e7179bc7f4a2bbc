"""Models per action: weighted by their errors, kept in one file, and refused where the file is wrong."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kinecast.datasets.recording import Recording
from kinecast.datasets.synthetic import SyntheticOptions, generate
from kinecast.datasets.windows import WindowOptions
from kinecast.errors import ModelError, OptionError
from kinecast.pipeline import training_windows_by_action
from kinecast.prediction.kinecast.actions import Actions
from kinecast.prediction.kinecast.method import Horizon
from kinecast.prediction.kinecast.training import HorizonOptions, fit_actions
from kinecast.prediction.methods import read_method, save_method, shipped_methods
from kinecast.prediction.model_file import ModelCard, write_model_file
from kinecast.prediction.observation import Observation, TrainingWindows

SMALL = HorizonOptions(pseudo_inputs=12, network_steps=20, folds=2, networks=1)
UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def horizon() -> Horizon:
    """The shipped model with two of its own experts as models of two actions."""
    shipped = shipped_methods()[1]["kinecast"]
    assert isinstance(shipped, Horizon)
    first, second, third = shipped.mixture.experts
    actions = Actions(("lift", "stack"), ((first, third), (second,)))
    return replace(shipped, mixture=replace(shipped.mixture, actions=actions))


@pytest.fixture(scope="module")
def card(horizon: Horizon) -> ModelCard:
    return ModelCard("kinecast", horizon.frames, horizon.steps, 1.0 / horizon.dt)


def seen(windows: TrainingWindows, row: int) -> Observation:
    return Observation(windows.observed[row], UP, windows.dt, row * windows.dt)


def test_a_file_holds_all_of_it(horizon: Horizon, card: ModelCard, windows: TrainingWindows, tmp_path: Path) -> None:
    save_method(tmp_path / "model.npz", card, horizon)
    _, read = read_method(tmp_path / "model.npz")
    assert isinstance(read, Horizon)
    assert read.mixture.actions is not None
    assert read.mixture.actions.labels == ("lift", "stack")
    kept = replace(read, limits=horizon.limits, noise=horizon.noise)
    one, other = (each.forecast(seen(windows, 30), np.random.default_rng(0), 20) for each in (horizon, kept))
    np.testing.assert_array_equal(one.samples, other.samples)
    assert {"action lift", "action stack"} <= set(one.diagnostics)


def test_the_action_that_explains_the_last_second_gets_the_weight(horizon: Horizon, windows: TrainingWindows) -> None:
    actions, window = horizon.mixture.actions, windows.observed[10]
    assert actions is not None
    unseen = np.full((6, 3), np.nan)
    for right in (0, 1):
        memory = actions.memory(horizon.steps)
        # The general mean and the other action are always 5 cm off, the right one 1 cm.
        off = np.full(3, 0.05)
        off[1 + right] = 0.01
        said = np.broadcast_to(off[:, None, None, None] * UP, (3, horizon.steps, 6, 3))
        for _ in range(30):
            memory.observe(np.zeros((6, 3)))
            memory.predicted(said)
        still = np.tile(window[-1], (horizon.steps, 1, 1))
        _, shares = actions.follow(memory, window, unseen, still)
        _, fresh = actions.follow(actions.memory(horizon.steps), window, unseen, still)
        assert list(shares.values())[right] > 0.95
        assert sum(fresh.values()) < 0.1


def test_before_anything_is_known_and_without_actions_the_general_mean_counts(
    horizon: Horizon, windows: TrainingWindows
) -> None:
    plain = replace(horizon, mixture=replace(horizon.mixture, actions=None))
    first = horizon.forecast(seen(windows, 0), np.random.default_rng(0), 10)
    general = plain.forecast(seen(windows, 0), np.random.default_rng(0), 10)
    assert first.diagnostics["action lift"] + first.diagnostics["action stack"] < 0.1
    assert "action lift" not in general.diagnostics
    np.testing.assert_allclose(first.mean, general.mean, atol=0.01)


Break = Callable[[dict[str, np.ndarray]], None]


def labels(text: str) -> np.ndarray:
    return np.frombuffer(text.encode(), np.uint8)


@pytest.mark.parametrize(
    "broken",
    [
        lambda arrays: arrays.pop("actions.labels"),
        lambda arrays: arrays.update({"actions.labels": labels("[1, 2]")}),
        lambda arrays: arrays.update({"actions.labels": labels('["lift", "lift"]')}),
        lambda arrays: arrays.update({"actions.labels": labels('["lift"]')}),
        lambda arrays: arrays.update({"actions.labels": labels('{"lift": 1, "stack": 2}')}),
        lambda arrays: arrays.update({"actions.labels": labels("[" * 5000)}),
        lambda arrays: arrays.update({"actions.labels": np.array([-1.0, 300.0])}),
        lambda arrays: arrays.update({"action0.0.weights": arrays["action0.0.weights"][1:]}),
        lambda arrays: arrays.update({"action0.1.W1": arrays["action0.1.W1"][:, 1:]}),
        lambda arrays: arrays.pop("action1.0.mean"),
        lambda arrays: arrays.update({"action1.7.mean": arrays["action1.0.mean"]}),
        lambda arrays: arrays.update({"action1.x.mean": arrays["action1.0.mean"]}),
        lambda arrays: arrays.update({"action5.0.mean": arrays["action1.0.mean"]}),
    ],
)
def test_a_malformed_file_is_refused(horizon: Horizon, card: ModelCard, tmp_path: Path, broken: Break) -> None:
    arrays = dict(horizon.to_arrays())
    broken(arrays)
    write_model_file(tmp_path / "model.npz", card, arrays)
    with pytest.raises(ModelError):
        read_method(tmp_path / "model.npz")


def test_a_pickle_in_place_of_the_labels_is_never_opened(horizon: Horizon, card: ModelCard, tmp_path: Path) -> None:
    arrays: dict[str, np.ndarray] = {**horizon.to_arrays(), "card": labels(card.to_json())}
    arrays["actions.labels"] = np.array([{"lift": 1}], dtype=object)
    np.savez(tmp_path / "model.npz", **arrays)
    with pytest.raises(ModelError, match="not a readable model file"):
        read_method(tmp_path / "model.npz")


def test_labels_make_actions_and_tasks_where_there_are_none() -> None:
    recordings: list[Recording] = generate(SyntheticOptions(subjects=2, recordings=2, duration=20.0), seed=0)
    found = training_windows_by_action(recordings, WindowOptions())
    present = {label for recording in recordings for label in recording.labels or ()}
    assert len(found) >= 2
    assert set(found) <= present
    tasks = [replace(recording, labels=None) for recording in recordings]
    assert set(training_windows_by_action(tasks, WindowOptions())) <= {recording.task for recording in recordings}
    one = [replace(recording, labels=None, task="one") for recording in recordings]
    with pytest.raises(OptionError, match=r"need two actions with 200 windows or more; found: one \d+"):
        training_windows_by_action(one, WindowOptions())


def test_each_action_learns_from_its_own_windows(windows: TrainingWindows) -> None:
    half = len(windows) // 2
    parts = {"lift": windows.take(np.arange(half)), "stack": windows.take(np.arange(half, 2 * half))}
    told: list[tuple[int, int]] = []
    actions = fit_actions(parts, SMALL, lambda done, total: told.append((done, total)))
    assert actions.labels == ("lift", "stack")
    assert told == [(k, 10) for k in range(1, 11)]
    errors = np.linalg.norm(actions.forecasts(windows.observed, 3) - windows.future[:, None], axis=-1).mean(axis=(2, 3))
    assert errors[:half, 0].mean() < errors[:half, 1].mean()
    assert errors[half:, 1].mean() < errors[half:, 0].mean()


def test_labels_are_plain_json(horizon: Horizon) -> None:
    assert isinstance(horizon.mixture.actions, Actions)
    stored = horizon.mixture.actions.to_arrays()["actions.labels"]
    assert json.loads(stored.tobytes()) == ["lift", "stack"]
