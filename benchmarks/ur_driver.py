"""`kinecast.robot.ur_driver` before a controller in a process of its own: every missed deadline, counted and explained.

python -m benchmarks.ur_driver [--minutes N] [--rates 125 500] [--out JSON]

The arm takes the cell's cubes to their places and back, over and over. A deadline is missed where the controller's
servoj finds no new target in a cycle. Of those (`starved`) some found two in the next (`doubled`: the target came a
little late); the others had none, since the driver was called too late (`overrun`) or got states in bunches
(`bunched`): computer and network. What is left is `unexplained`. As on a real arm's computer, nothing else should run,
and with `chrt -f 20` before the command nothing else comes first.
"""

from __future__ import annotations

import argparse
import gc
import itertools
import json
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import ruckig

from benchmarks.machine import facts, milliseconds, save
from benchmarks.rtde_server import READY
from kinecast.robot.cell import Cell
from kinecast.robot.ur5 import UR5
from kinecast.robot.ur_driver import ArmStatus, CycleCounters, UrDriver

SHARE = 0.6
"""Of the arm's speed, acceleration and jerk."""


def main() -> None:
    """Runs, prints, writes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--rates", type=float, nargs="+", default=[125.0, 500.0])
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    before = facts()
    results = {f"{rate:g}_hz": run(rate, 60 * arguments.minutes) for rate in arguments.rates}
    save("ur_driver", results, arguments.out, before)
    print(f"load {before['load']:.1f} before, {facts()['load']:.1f} after, on {before['cores']} cores")
    print(json.dumps(results, indent=1))


def run(rate: float, seconds: float) -> dict[str, Any]:
    """Picks and places for so long, at one of the controllers' rates.

    Args:
        rate: 125 (CB3) or 500 (e-Series) [Hz].
        seconds: of real time.
    """
    command = (sys.executable, "-m", "benchmarks.rtde_server", "--rate", f"{rate:g}")
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        arm, port = UR5(), int(server.stdout.readline())
        with closing(UrDriver(arm, "127.0.0.1", port)) as driver:
            gc.collect()
            gc.freeze()
            lags, waits, stops, cubes = drive(driver, arm, seconds)
            gc.unfreeze()
            c = driver.counters
        served = json.loads(server.communicate()[0])
    return {
        "rate_hz": rate, "seconds": seconds, "cubes": cubes, "stops": stops, **asdict(c),
        "unaccounted": c.cycles - c.sent - c.skipped - c.overrun - c.bunched,
        "controller": served, "unexplained": served["starved"] - served["doubled"] - c.overrun - c.bunched,
        "cycle_begins_to_target_sent": milliseconds(waits),
        "arm_behind_target_rad": {"p99": float(np.percentile(lags, 99)), "most": float(np.max(lags))},
    }  # fmt: skip


def drive(driver: UrDriver, arm: UR5, seconds: float) -> tuple[list[float], list[float], dict[str, int], int]:
    """Leads the arm; how far it is behind [rad], how long each step takes [s], what stopped it, cubes moved."""
    lags, waits, stops, cubes = list[float](), list[float](), Counter[str](), 0
    motion, wish, place = ruckig.Ruckig(6, driver.dt), ruckig.InputParameter(6), ruckig.OutputParameter(6)
    limits = (arm.max_speed, arm.max_acceleration, arm.max_jerk)
    wish.max_velocity, wish.max_acceleration, wish.max_jerk = ((SHARE * each).tolist() for each in limits)
    way = postures(arm)
    driver.wait()
    driver.move(driver.sent)
    driver.counters = CycleCounters()
    until, arrived = time.monotonic() + seconds, True
    while time.monotonic() < until:
        if driver.status is not ArmStatus.OK:
            if driver.status is not ArmStatus.WAITING:
                stops[driver.status.name] += 1
            driver.resume()
            wish.current_position = driver.sent.tolist()
            wish.current_velocity = wish.current_acceleration = [0.0] * 6
            wish.target_position = wish.target_position if stops else driver.sent.tolist()
        driver.wait()
        began = time.perf_counter()
        if arrived:
            q, closed = next(way)
            cubes += driver.gripped and not closed
            driver.grip(closed)
            wish.target_position = q.tolist()
        arrived = motion.update(wish, place) == ruckig.Result.Finished
        driver.move(np.array(place.new_position))
        waits.append(time.perf_counter() - began)
        place.pass_to_input(wish)
        lags.append(float(np.abs(driver.sent - driver.reading.q).max()))
    return lags, waits, dict(stops), cubes


def postures(arm: UR5) -> Iterator[tuple[np.ndarray, bool]]:
    """Where the arm goes, and whether its gripper is closed on the way: each cube to its place and back."""
    cell, q = Cell(), np.array(READY)
    for back in itertools.cycle((False, True)):
        for cube in cell.cubes:
            ends = (cube.place, cube.position) if back else (cube.position, cube.place)
            for point, held in zip(ends, (False, True), strict=True):
                for above, closed in ((cell.hover, held), (0.0, held), (cell.hover, not held)):
                    found = arm.inverse_kinematics(cell.grasp(point, above))
                    q = found[np.abs(found - q).max(axis=1).argmin()]
                    yield q, closed


if __name__ == "__main__":
    main()
