"""The simulated arm decides beside a person as it did when episodes.json was written."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jaxtyping
import pytest

from kinecast.cli.commands import run

from .episodes import LEAST, RECORDED, SCENARIOS, SEEDS, Facts, differences, facts_of, play

CONTENT = json.loads(RECORDED.read_text())


@pytest.fixture(autouse=True)
def _without_checks() -> Iterator[None]:
    """Thousands of control steps are too many to check every shape in; the unit tests do."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


def entry_of(scenario: str, seed: int) -> tuple[dict[str, Any], float]:
    """What was recorded, and the tolerance of the time to done [s]."""
    return CONTENT["episodes"][scenario][str(seed)], CONTENT["time_to_done"][scenario]["tolerance"]


def as_recorded(scenario: str, seed: int) -> Facts:
    """An episode that agrees with what was recorded."""
    entry, _ = entry_of(scenario, seed)
    lists = ("reactions", "targets", "placed", "result", "done")
    return {"contacts": 0} | {name: entry[name][-1] for name in lists}


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_decisions_are_as_recorded(scenario: str, seed: int) -> None:
    if "KINECAST_LONG" not in os.environ:
        pytest.skip("one episode is played below; set KINECAST_LONG=1 for all")
    assert differences(play(scenario, seed), *entry_of(scenario, seed)) == []


def test_replan_changes_the_cube_in_mid_motion_and_leaves_decisions_and_pictures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run(["simulate", "--scenario", "replan", "--seed", "2", "--out", str(tmp_path)])
    assert "change cube" in capsys.readouterr().out
    episode = json.loads((tmp_path / "episode.json").read_text())["episodes"]["replan"]
    assert differences(facts_of(episode), *entry_of("replan", 2)) == []
    decisions = episode["decisions"]
    switch = next(k for k, each in enumerate(decisions) if each["reaction"] == "change_cube")
    assert decisions[switch]["target"] == "blue"
    assert decisions[switch]["taken"]["green"] >= 0.5
    assert decisions[switch - 1]["target"] == "green"
    assert decisions[switch - 1]["state"] in ("moving", "slowed"), "on its way"
    assert json.loads((tmp_path / "outcome.json").read_text())["contacts"] == 0
    for name in ("storyboard.png", "replan.gif", "replan_timeline.png"):
        assert (tmp_path / name).stat().st_size > 10_000


def test_every_episode_is_recorded_and_none_had_a_contact() -> None:
    assert set(CONTENT["episodes"]) == set(SCENARIOS)
    for scenario in SCENARIOS:
        assert set(CONTENT["episodes"][scenario]) == set(map(str, SEEDS))
        for seed in SEEDS:
            entry, tolerance = entry_of(scenario, seed)
            assert entry["contacts"] == 0
            assert tolerance >= LEAST
            assert differences(as_recorded(scenario, seed), entry, tolerance) == []


@pytest.mark.parametrize(
    "changed",
    [
        {"contacts": 1},
        {"reactions": []},
        {"reactions": [["change_cube", "red"]]},
        {"targets": ["red", "green", "red", "blue"]},
        {"placed": ["green", "red", "blue"]},
        {"result": "without blue"},
        {"done": 0.0},
        {"done": 60.0},
        {"done": float("nan")},
    ],
)
def test_another_course_of_things_is_found(changed: Facts) -> None:
    found = as_recorded("replan", 0) | changed
    assert len(differences(found, *entry_of("replan", 0))) == 1


def test_decisions_are_counted_where_they_change() -> None:
    told = [("moving", "red", None), ("moving", "red", None), ("replanning", "blue", "change_cube"),
            ("replanning", "blue", None), ("moving", "blue", None), ("done", None, None)]  # fmt: skip
    facts = facts_of(
        {
            "decisions": [{"state": s, "target": t, "reaction": r} for s, t, r in told],
            "placed": {"blue": 2.0, "red": 4.0},
            "outcome": {"result": "done", "contacts": 0, "time_to_done": 4.0},
        }
    )
    assert facts["reactions"] == [["change_cube", "blue"]]
    assert facts["targets"] == ["red", "blue"]
    assert len(facts["steps"]) == 5
