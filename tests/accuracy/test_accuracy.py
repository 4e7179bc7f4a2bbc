"""Every method predicts as well as it did when recorded.json was written; comparing finds a model that does not.

A figure that is out of tolerance means that a change was not one of form alone. Where the change is wanted, record
anew: `python -m tests.accuracy.score --record`.
"""

from __future__ import annotations

import copy
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from .score import (
    CONSTRAINED,
    DATA,
    MODELS,
    RECORDED,
    RUNS,
    SCENES,
    TOLERANCES,
    differences,
    evaluated,
    fingerprint,
    generated_people,
    model_file,
    run,
    scored_by,
)

LONG = ("ha4m", "generated_goals", "fitted")
"""Runs that others are much like, or whose tolerances are wide; all are run with KINECAST_LONG=1."""
QUICK = ("damped_velocity", "kinecast")
"""Models that are scored without KINECAST_LONG=1."""
FASTER = 1.05
"""A model is made worse by making everything it expects to move go so many times as far."""


@pytest.fixture(scope="module")
def recorded() -> dict[str, Any]:
    """The entries of recorded.json."""
    entries: dict[str, Any] = json.loads(RECORDED.read_text())["entries"]
    return entries


def as_recorded(entry: dict[str, Any]) -> dict[str, dict[str, float]]:
    """Figures that agree with an entry to the last digit."""
    figures = {}
    for method, scores in entry["methods"].items():
        figures[method] = {name: line["value"] for name, line in scores.items()}
        if "energy_mm" in scores:
            figures[method] |= {f"violations_{name}": 0.0 for name in ("position", "speed", "scene")}
    return figures


@pytest.mark.parametrize("name", RUNS)
def test_scores_are_as_recorded(name: str, recorded: dict[str, Any], request: pytest.FixtureRequest) -> None:
    if name in LONG and "KINECAST_LONG" not in os.environ:
        pytest.skip("the other runs tell as much; set KINECAST_LONG=1 for all")
    if not RUNS[name].generated:
        request.getfixturevalue("data_root")
    elif DATA.exists() and "KINECAST_LONG" not in os.environ:
        pytest.skip("the recordings tell more; set KINECAST_LONG=1 for generated people too")
    quick = None if "KINECAST_LONG" in os.environ or RUNS[name].train else [model_file(each) for each in QUICK]
    found = run(name, models=quick)
    wrong = {entry: differences(*found[entry], recorded[entry]) for entry in found}
    assert not any(wrong.values()), "\n".join(f"{entry}: {each}" for entry, own in wrong.items() for each in own)


def test_every_run_and_method_is_recorded(recorded: dict[str, Any]) -> None:
    entries = {entry for each in RUNS.values() for entry in each.test} | {each.whole for each in RUNS.values()} - {None}
    assert set(recorded) == entries
    for name, each in RUNS.items():
        for entry in each.test:
            assert set(recorded[entry]["methods"]) == set(scored_by(name))
    assert {path.name for path in model_file("kinecast").parent.glob("*.npz")} == {f"{name}.npz" for name in MODELS}


def test_the_generated_people_are_those_recorded(tmp_path: Path) -> None:
    assert fingerprint(generated_people(tmp_path)) == json.loads(RECORDED.read_text())["generated_people"]


def test_a_model_whose_mean_goes_a_twentieth_too_far_is_found(recorded: dict[str, Any], tmp_path: Path) -> None:
    worse = tmp_path / "worse.npz"
    with np.load(model_file("damped_velocity")) as file:
        arrays = dict(file)
    arrays["weights"] = FASTER * arrays["weights"]  # of the window's frames, for each step; they add up to one
    arrays["weights"][:, -1] += 1.0 - FASTER
    np.savez(worse, **arrays)
    ((windows, found),) = run("generated", models=[worse]).values()
    wrong = differences(windows, found, recorded["generated"])
    assert any(each.startswith("damped_velocity mpjpe_mm") for each in wrong), wrong


class TestDifferences:
    """`differences` on figures made up."""

    @pytest.mark.parametrize("entry", ["generated", "fitted", "all_recordings", "cmu"])
    def test_none_in_what_was_recorded(self, entry: str, recorded: dict[str, Any]) -> None:
        assert differences(recorded[entry]["windows"], as_recorded(recorded[entry]), recorded[entry]) == []

    @pytest.mark.parametrize("score", TOLERANCES)
    @pytest.mark.parametrize("sign", [-1.0, 1.0])
    @pytest.mark.parametrize("method", MODELS)
    def test_each_score_beyond_its_tolerance_alone(
        self, method: str, sign: float, score: str, recorded: dict[str, Any]
    ) -> None:
        entry = recorded["generated"]
        line = entry["methods"][method][score]
        tolerance = line.get("tolerance", TOLERANCES[score])
        for share, found in ((0.99, 0), (1.01, 1)):
            figures = as_recorded(entry)
            figures[method][score] = line["value"] + sign * share * tolerance
            assert len(differences(entry["windows"], figures, entry)) == found
        assert tolerance >= TOLERANCES[score]

    def test_what_is_no_number(self, recorded: dict[str, Any]) -> None:
        figures = as_recorded(recorded["cmu"])
        figures["kinecast"]["nll"] = float("nan")
        assert len(differences(recorded["cmu"]["windows"], figures, recorded["cmu"])) == 1

    @pytest.mark.parametrize("what", ["position", "speed", "scene"])
    def test_one_violation_of_a_constrained_method(self, what: str, recorded: dict[str, Any]) -> None:
        entry = recorded["ha4m_scene"]
        for method in MODELS:
            figures = as_recorded(entry)
            figures[method][f"violations_{what}"] = 1e-9
            assert len(differences(entry["windows"], figures, entry)) == (method in CONSTRAINED)

    def test_a_score_or_a_window_that_is_missing(self, recorded: dict[str, Any]) -> None:
        entry = copy.deepcopy(recorded["precog"])
        figures = as_recorded(entry)
        del figures["kinecast"]["crps_mm"]
        assert len(differences(entry["windows"] - 1, figures, entry)) == 2


def test_an_evaluation_that_cannot_be_done_says_why() -> None:
    with pytest.raises(RuntimeError, match="no such file"):
        evaluated("--model", model_file("kinecast"), "--test", "missing.csv", "--scene", SCENES / "ha4m_table.yaml")
