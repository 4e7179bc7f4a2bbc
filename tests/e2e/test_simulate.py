"""`kinecast simulate`: a scenario as a user would run it."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jaxtyping
import pytest

Kinecast = Callable[..., Any]


@pytest.fixture(autouse=True)
def _without_checks() -> Iterator[None]:
    """Thousands of control steps are too many to check every shape in; the unit tests do."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


def test_replan_changes_the_cube_in_mid_motion_and_comes_back_for_the_other(kinecast: Kinecast, tmp_path: Path) -> None:
    done = kinecast("simulate", "--scenario", "replan", "--samples", 100, "--out", tmp_path)
    assert done.code == 0, done.err
    assert "change cube" in done.out
    content = json.loads((tmp_path / "episode.json").read_text())
    episode = content["episodes"]["replan"]
    decisions = episode["decisions"]
    switch = next(each for each in decisions if each["reaction"] == "change_cube")
    assert switch["target"] == "blue"
    assert switch["taken"]["green"] >= 0.5
    before = [each for each in decisions if each["stamp"] < switch["stamp"]]
    assert before[-1]["target"] == "green"
    assert before[-1]["state"] in ("moving", "slowed"), "on its way"
    assert list(episode["placed"]) == ["red", "blue", "green"]
    assert episode["outcome"]["contacts"] == 0
    for name in ("storyboard.png", "replan.gif", "replan_timeline.png"):
        assert (tmp_path / name).stat().st_size > 10_000


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--scenario", "dance"), "avoid, reorder, replan, none, all"),
        (("--scenario", "avoid", "--predictor", "stars"), "kinecast, gp_constrained"),
        (("--person", "/nowhere.csv"), "nowhere.csv"),
        (("--seed", -1), "seed"),
    ],
)
def test_bad_options_are_named(arguments: tuple[object, ...], words: str, kinecast: Kinecast, tmp_path: Path) -> None:
    done = kinecast("simulate", *arguments, "--out", tmp_path / "new")
    assert done.code == 2
    assert words in " ".join(done.err.split())
    assert not (tmp_path / "new").exists()
