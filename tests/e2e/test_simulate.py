"""`kinecast simulate`: bad options; tests/accuracy/test_episodes.py plays a scenario as a user would."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Kinecast = Callable[..., Any]


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
