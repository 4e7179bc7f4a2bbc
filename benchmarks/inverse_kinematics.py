"""Inverse kinematics of one arm: closed form, SciPy's least squares, particle swarm.

python -m benchmarks.inverse_kinematics [--targets N] [--out JSON]

All solve for the same poses, drawn inside the joints' ranges; each starts from the pose one frame earlier, which the
swarm cannot use.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from benchmarks.machine import facts, milliseconds, save
from benchmarks.naive import LOWER, UPPER, arm, swarm_angles
from kinecast.body.posture import OUTSIDE_WEIGHT, arm_angles

LENGTHS = np.array([0.29, 0.26])
SIDE = 1.0


Solver = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""From (2, 3) elbow and wrist [m] and (4,) angles one frame earlier to (4,) angles."""


def main() -> None:
    """Times, prints, writes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--targets", type=int, default=100)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    before = facts()
    result = run(arguments.targets)
    save("inverse_kinematics", result, arguments.out, before)
    report(result)


def run(targets: int) -> dict[str, Any]:
    """Every solver on every target in turn: time, distance of the worse of elbow and wrist, share within 1 mm."""
    rng = np.random.default_rng(0)
    truth = rng.uniform(LOWER + 0.1, UPPER - 0.1, (targets, 4))
    earlier = np.clip(truth + rng.normal(0.0, 0.05, truth.shape), LOWER, UPPER)
    points = np.stack(arm(truth, *LENGTHS, SIDE), axis=1)
    each = solvers()
    seconds: dict[str, list[float]] = {name: [] for name in each}
    errors: dict[str, list[float]] = {name: [] for name in each}
    for solve in each.values():
        solve(points[0], earlier[0])
    for target, start in zip(points, earlier, strict=True):
        for name, solve in each.items():
            begin = time.perf_counter()
            theta = solve(target, start)
            seconds[name].append(time.perf_counter() - begin)
            errors[name].append(float(np.linalg.norm(np.stack(arm(theta, *LENGTHS, SIDE)) - target, axis=1).max()))
    return {
        "solvers": {
            name: {
                **milliseconds(seconds[name]),
                "median_error_mm": 1e3 * float(np.median(errors[name])),
                "p99_error_mm": 1e3 * float(np.percentile(errors[name], 99)),
                "within_1_mm": float(np.mean(np.array(errors[name]) < 1e-3)),
            }
            for name in each
        }
    }


def solvers() -> dict[str, Solver]:
    """All solvers by name."""

    def by_closed_form(points: np.ndarray, start: np.ndarray) -> np.ndarray:
        elbow, wrist = points
        return np.array(arm_angles(tuple(elbow), tuple(wrist - elbow), SIDE, tuple(start), OUTSIDE_WEIGHT))

    def by_scipy(points: np.ndarray, start: np.ndarray) -> np.ndarray:
        def miss(theta: np.ndarray) -> np.ndarray:
            return (np.stack(arm(theta, *LENGTHS, SIDE)) - points).ravel()

        return np.asarray(least_squares(miss, start, bounds=(LOWER, UPPER)).x)

    def by_small_swarm(points: np.ndarray, _start: np.ndarray) -> np.ndarray:
        return swarm_angles(points[0], points[1], SIDE)

    def by_large_swarm(points: np.ndarray, _start: np.ndarray) -> np.ndarray:
        return swarm_angles(points[0], points[1], SIDE, particles=50, iterations=200)

    return {
        "closed form": by_closed_form,
        "SciPy least_squares": by_scipy,
        "particle swarm, 20 × 50": by_small_swarm,
        "particle swarm, 50 × 200": by_large_swarm,
    }


def report(result: Mapping[str, Any]) -> None:
    """Prints the table."""
    print(f"{'solver':26}{'p50 ms':>9}{'p99 ms':>9}{'median error mm':>18}{'within 1 mm':>13}")
    for name, row in result["solvers"].items():
        figures = f"{row['p50_ms']:9.3f}{row['p99_ms']:9.3f}{row['median_error_mm']:18.2e}{row['within_1_mm']:13.0%}"
        print(f"{name:26}{figures}")


if __name__ == "__main__":
    main()
