"""The benchmark of a plain camera: its figures are of the right size, and its filter does not lag."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import pytest

if find_spec("benchmarks") is None:
    pytest.skip("no benchmarks: they come with the repository", allow_module_level=True)

from benchmarks import webcam


def test_the_scores_are_of_the_right_size_and_the_filter_does_not_lag(data_root: Path) -> None:
    motion = next(webcam._motions(data_root, 1))[:75]
    assert motion.shape == (75, 12, 3)
    score = webcam._scores([motion], webcam.CONDITIONS["feet on the floor"], 2.5, 0.0)
    assert abs(score["wrist_lag_ms"]) < 17  # half a picture
    assert score["wrist_jitter_mm"] < 0.6 * score["unfiltered_jitter_mm"]
    assert score["across_mm"] < 50
    assert score["joint_mm"] < 200
    assert 0.5 < score["inside_90"] <= 1.0
