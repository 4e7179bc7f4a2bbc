"""The benchmark of a picture's cost runs, and tells the network from the rest."""

from __future__ import annotations

from importlib.util import find_spec

import pytest

if find_spec("benchmarks") is None:
    pytest.skip("no benchmarks: they come with the repository", allow_module_level=True)

from benchmarks import camera_step


def test_the_parts_are_timed() -> None:
    result = camera_step.run(None, 5)
    parts = [result[name] for name in ("network", "estimate_without_network", "depths_and_skeleton")]
    assert [part["count"] for part in parts] == [5, 5, 5]
    assert all(0 < part["least_ms"] <= part["p50_ms"] <= part["p99_ms"] for part in parts)
