"""The estimate of the cluster benchmark adds up what it says it does."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

import pytest

if find_spec("benchmarks") is None or find_spec("psutil") is None:
    pytest.skip("no benchmarks or psutil: the repository and the extra cluster have them", allow_module_level=True)

from benchmarks import cluster


def measured(windows: int, network: float, spread: float) -> dict[str, Any]:
    costs = {
        "resampled_windows": {"count": 10, "seconds": 2.0, "longest": 0.5},
        "network": {"count": 4, "seconds": 4 * network, "longest": network},
        "error_model": {"count": 1, "seconds": spread, "longest": spread},
        "score_recording": {"count": 8, "seconds": 6.0, "longest": 1.0},
    }
    return {
        "training_windows": windows, "frames": 2000, "scored_windows": 100, "window_bytes": 3000.0,
        "fit_bytes": 10_000.0, "read_s_per_hour": 2.0, "costs": costs,
    }  # fmt: skip


def test_tasks_of_recordings_become_more_and_tasks_of_all_data_longer() -> None:
    found = cluster.estimate(measured(1000, 3.0, 1.0), measured(2000, 3.5, 0.5))
    stages = {each["stage"]: each for each in found["stages"]}
    frames = 45 * 3600 * 30
    training = 0.9 * frames
    assert found["training_windows"] == pytest.approx(training)
    assert found["scored_windows"] == pytest.approx(0.1 * frames / 5)
    cut = stages["cut windows"]
    assert cut["cpu_s"] == pytest.approx(2.0 / 2000 * training)
    assert cut["wall_s"] == pytest.approx(cut["cpu_s"] / 64)
    fits = stages["fit experts and baselines"]
    longest = 3.5 + (3.5 - 3.0) / 1000 * (training - 2000)
    assert fits["longest_task_s"] == fits["wall_s"] == pytest.approx(longest)
    assert fits["cpu_s"] == pytest.approx(4 * longest)
    assert stages["fit the error model"]["wall_s"] == 0.5  # a fit that was faster on more data is taken as constant
    assert stages["score"]["cpu_s"] == pytest.approx(6.0 / 100 * found["scored_windows"])
    assert found["wall_hours"] * 3600 == pytest.approx(sum(each["wall_s"] for each in found["stages"]))
    assert len(cluster.table(found).splitlines()) == len(stages) + 3


def test_the_command_leaves_the_tested_task_to_the_test() -> None:
    parser = {"test": "Lifting", "methods": "ridge", "samples": 10, "repeats": 0}
    line = cluster.command(cluster.Path("data"), cluster.argparse.Namespace(**parser), cluster.Path("out"), ("--x",))
    assert line[line.index("--test") + 1] == "data/Lifting"
    assert line[-1] == "--x"
