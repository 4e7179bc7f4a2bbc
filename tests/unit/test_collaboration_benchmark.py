"""The closed-loop benchmark runs, goes on where it stopped, and compares predictors in the same episodes."""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import jaxtyping
import numpy as np
import pytest

if find_spec("benchmarks") is None:
    pytest.skip("no benchmarks: they come with the repository", allow_module_level=True)

from benchmarks import collaboration
from benchmarks.collaboration_report import summarise
from benchmarks.least_time import Ways

from kinecast.robot.cell import Cell
from kinecast.robot.collaboration import generated_person
from kinecast.robot.episode import Outcome
from kinecast.robot.simulated_person import PlayedPerson


def run(monkeypatch: pytest.MonkeyPatch, folder: Path, episodes: int, limit: float = 0.4) -> dict[str, Any]:
    """The command, in a tiny setting; its JSON."""
    out = folder / "out.json"
    arguments = ["", "--episodes", episodes, "--first", 2000, "--limit", limit, "--predictors", "reachable,none"]
    paths = ["--data", folder, "--out", out, "--plot", folder / "plot.png"]
    monkeypatch.setattr("sys.argv", [str(each) for each in (*arguments, *paths)])
    collaboration.main()
    result: dict[str, Any] = json.loads(out.read_text())
    return result


@pytest.fixture
def without_checks() -> Iterator[None]:
    """Hundreds of steps are too many to check every shape in; the tests of the simulation do."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.mark.usefixtures("without_checks")
def test_it_goes_on_where_it_stopped_and_refuses_other_settings(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first = run(monkeypatch, tmp_path, 1)
    capsys.readouterr()
    both = run(monkeypatch, tmp_path, 2)
    said = capsys.readouterr().out
    assert " 2001 none" in said
    assert " 2000 none" not in said, "it was done before"
    assert both["outcomes"]["none"]["2000"] == first["outcomes"]["none"]["2000"]
    assert both["summary"]["reachable"]["episodes"] == 2
    assert (tmp_path / "plot.png").stat().st_size > 1000
    with pytest.raises(SystemExit, match="limit_s"):
        run(monkeypatch, tmp_path, 2, limit=0.5)


def outcome(time_to_done: float, stops: int) -> Outcome:
    return Outcome("done", 0, 0, 0.1, 0.0, time_to_done, stops, 0.3 * stops, 1, 0, 5.0, 9.0, 10.0, 40.0, 6, 0.1, 0.9)


def test_differences_are_of_the_same_episodes() -> None:
    ours = {1: outcome(20.0, 1), 2: outcome(30.0, 0), 3: outcome(99.0, 9)}
    theirs = {1: outcome(30.0, 2), 2: outcome(45.0, 3)}
    result = summarise({"kinecast": ours, "reachable": theirs})
    row = result["differences"]["kinecast - reachable"]
    assert row["episodes"] == 2
    assert row["time_to_done"]["mean"] == pytest.approx(-12.5)
    assert row["time_to_done"]["error"] == pytest.approx(2.5)
    assert row["stops"]["mean"] == pytest.approx(-2.0)
    assert row["time_saved"] == pytest.approx(1 / 3)


def test_what_nobody_could_avoid_is_nothing_beside_who_stays_away_and_much_beside_who_reaches_over_the_table() -> None:
    cell = Cell()
    ways, busy = Ways(cell), generated_person(0, cell)
    away = PlayedPerson("away", busy.joints, busy.stamps, busy.positions + np.array([2.0, 0.0, 0.0]))
    empty = ways.least_time(None)
    assert 15.0 < empty < 30.0
    assert ways.least_time(away) == pytest.approx(empty)
    assert ways.least_time(busy) > empty + 2.0
