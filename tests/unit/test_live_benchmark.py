"""The benchmark of `kinecast live` runs for a moment, and accounts for every frame."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import pytest

if find_spec("benchmarks") is None:
    pytest.skip("no benchmarks: they come with the repository", allow_module_level=True)

from benchmarks import live


def test_every_frame_is_accounted_for(tmp_path: Path) -> None:
    result = live.run(None, 0.02, 20, tmp_path)
    assert result["rate_hz"] == 100.0
    assert result["frames"] == result["stale"] + result["published"]
    assert result["published"] > 0
    assert result["unaccounted"] == result["dropped_by_file"] == 0
    assert 0 < result["to_file"]["p50_ms"] <= result["to_file"]["p99_ms"]
    assert result["to_client"]["count"] + result["missed_by_client"] <= result["published"]
    assert result["to_view"]["count"] > 0
    assert result["to_view"]["count"] + result["to_view"]["replaced"] <= result["published"]
