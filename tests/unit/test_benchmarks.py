"""Both benchmarks run, in a tiny setting, and say what they should."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

# ruff: noqa: E402 - what may be missing is looked for first
# Looked for, not imported: pyswarms opens a log file on import unless benchmarks.naive comes first.
for name, where in (("sklearn", "kinecast[bench]"), ("pyswarms", "kinecast[bench]"), ("benchmarks", "the repository")):
    if find_spec(name) is None:
        pytest.skip(f"no {name}: it comes with {where}", allow_module_level=True)

from benchmarks import inverse_kinematics, online_step
from benchmarks.generated_people import SyntheticOptions, generate
from benchmarks.machine import facts, save

from kinecast.body.posture import arm_vectors


@pytest.fixture(scope="module")
def step() -> dict[str, Any]:
    """A few frames of the online step, a handful of samples."""
    [recording] = generate(SyntheticOptions(subjects=1, recordings=1, duration=4.0), seed=0)
    return online_step.run(recording, 12, naive_count=1, samples=20, naive_points=20, trained=("ridge",))


def test_every_method_is_timed_on_the_same_frames(step: dict[str, Any]) -> None:
    counts = {row["count"] for row in step["steps"].values()}
    assert {"gp_constrained", "gp_angles", "zero_velocity", "ridge"} <= set(step["steps"])
    assert len(counts) == 1
    assert counts.pop() > 0
    for row in step["steps"].values():
        assert 0 < row["least_ms"] <= row["p50_ms"] <= row["p99_ms"]


def test_the_naive_stack_is_slower_and_its_parts_add_up(step: dict[str, Any]) -> None:
    assert step["naive_over_gp_constrained"] > 1
    assert set(step["naive"]["share"]) == {
        "particle swarm", "Gaussian processes", "truncated normals", "forward kinematics",
    }  # fmt: skip
    assert 0.5 < sum(step["naive"]["share"].values()) <= 1


def test_the_table_names_every_method(step: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> None:
    online_step.report(step)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(step["steps"]) + 3
    assert "naive stack" in lines[-2]


def test_several_persons_take_longer_than_one() -> None:
    [recording] = generate(SyntheticOptions(subjects=1, recordings=1, duration=4.0), seed=0)
    rows = online_step.crowd(recording, 30, persons=(1, 4), samples=16)
    assert rows["4"]["count"] == rows["1"]["count"] > 0
    assert rows["4"]["p50_ms"] > rows["1"]["p50_ms"]


def test_closed_form_is_exact_and_the_fastest() -> None:
    solvers = inverse_kinematics.run(3)["solvers"]
    exact = solvers["closed form"]
    assert exact["p99_error_mm"] < 1e-9
    assert exact["within_1_mm"] == 1
    assert all(exact["p50_ms"] < row["p50_ms"] for name, row in solvers.items() if name != "closed form")


def test_the_stacks_own_kinematics_are_kinecasts() -> None:
    theta = np.random.default_rng(0).uniform(inverse_kinematics.LOWER, inverse_kinematics.UPPER, (10, 4))
    naive = np.stack(inverse_kinematics.arm(theta, 0.3, 0.25, -1.0), axis=1)
    own = np.cumsum([arm_vectors(tuple(angles.tolist()), 0.3, 0.25, -1.0) for angles in theta], axis=1)
    np.testing.assert_allclose(naive, own, atol=1e-15)


def test_a_result_is_written_with_the_machines_facts(tmp_path: Path) -> None:
    save("any", {"figure": 1.0}, tmp_path / "deep" / "any.json", facts())
    written = json.loads((tmp_path / "deep" / "any.json").read_text())
    assert written["figure"] == 1.0
    assert {"cores", "load", "load_before", "numpy", "numba", "pyswarms"} <= set(written["machine"])
