"""`kinecast robot`: checks a real arm, and has it pick and place beside the people that a source shows."""

from __future__ import annotations

import gc
import itertools
import re
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import numpy as np
from tyro.conf import arg

from kinecast.cli.options import SHIPPED_HORIZON, ModelFile, Switch, check_seed, read_predictor
from kinecast.cli.progress import compiling
from kinecast.errors import ArmError, OptionError
from kinecast.geometry.transforms import apply, from_rotation_vector, inverse, rotation_vector, transform
from kinecast.predictor import Predictor, PredictorOptions
from kinecast.types import Prediction, SkeletonFrame

if TYPE_CHECKING:
    from kinecast.live.mailbox import Mailbox
    from kinecast.robot.rtde import Reading
    from kinecast.robot.ur5 import UR5
    from kinecast.robot.ur_driver import UrDriver

WATCHED = 2.0  # the controller's clock is watched for so long [s]
NEAR, TURNED = 0.01, 0.035  # apart so far, in metres and radians, two poses of the tool are one
MARGIN = 0.1  # from the end of a joint's range that an arm should keep [rad]
STEP = 0.008  # of the supervisor's control [s]; a faster controller is led there in a straight line

Seen = deque[tuple[SkeletonFrame, Prediction]]
Check = tuple[str, bool, str]  # its name, whether it is in order, and the figures
DriverName = Annotated[str, arg(name="driver", metavar="ur:HOST", help="the arm; ur:HOST:PORT where it is not 30004.")]
SourceName = Annotated[
    str | None, arg(metavar="SOURCE", help="where the skeletons come from, as in kinecast live; --move needs it.")
]
BasePlace = Annotated[tuple[float, float, float, float], arg(metavar="X Y Z YAW")]


def robot(
    driver: DriverName,
    dry_run: Switch = False,
    move: Switch = False,
    source: SourceName = None,
    base: BasePlace = (0.0, 0.0, 0.0, 0.0),
    gripper: int = 0,
    model: ModelFile = None,
    samples: int = 200,
    seed: int = 0,
) -> None:
    """Drives a UR5 (CB3, e-Series) through the cell's episode. No safety function: read docs/ur.md first.

    Args:
        dry_run: checks limits, tool, frames and clock; writes nothing to the arm and moves nothing.
        move: the arm may move. It is checked first, too.
        base: where the arm's base stands in the frame of the skeletons: metres, and degrees about z.
        gripper: digital output that closes the gripper: 0 to 7, configurable 8 to 15, at the tool 16 and 17.
        model: a model file, or MODULE:FUNCTION that gives your own method (docs/predictor.md).
        samples: motions drawn per prediction.
        seed: of the draws.
    """
    from kinecast.robot.ur5 import UR5  # here, since the robot is an extra

    host, port = _address(driver)
    if dry_run == move:
        raise OptionError("either --dry-run, which checks and moves nothing, or --move, with which the arm moves")
    if move and source is None:
        raise OptionError("--move: needs --source, the skeletons of who is beside the arm")
    check_seed(seed)
    if not np.isfinite(base).all():
        raise OptionError(f"--base {' '.join(map(str, base))}: must be finite")
    arm = UR5()
    check_arm(arm, host, port)
    if dry_run:
        print("nothing was written, nothing has moved")
        return
    from kinecast.cli.endpoint import opened, read_source
    from kinecast.robot.ur_driver import UrDriver

    assert source is not None
    turn = from_rotation_vector(np.array([0.0, 0.0, np.radians(base[3])]))
    with compiling():
        warm_up(samples)
    predictor = read_predictor(model, None, PredictorOptions(samples, seed, SHIPPED_HORIZON if model is None else None))
    T_base_world = inverse(transform(turn, np.array(base[:3])))
    with (
        opened([read_source(source)], []) as (mailbox, (people, *_), _),
        predicted(mailbox, predictor, T_base_world) as seen,
        closing(UrDriver(arm, host, port, gripper)) as ur,
    ):
        people.start()
        print("the arm moves; Ctrl-C stops it", flush=True)
        for line in episode(arm, ur, seen, lambda: mailbox.finished and not seen):
            print(line, flush=True)
        print(ur.counters)
        if ur.status.name != "OK":
            raise ArmError(f"{driver}: {ur.status.name}: {ur.status.value}")


def _address(driver: str) -> tuple[str, int]:
    from kinecast.robot.rtde import PORT

    found = re.fullmatch(r"ur:([^:/]+|\[[^\]/]+\])(?::(\d{1,5}))?", driver)
    if found is None or int(found[2] or PORT) > 65535:
        raise OptionError(f"--driver {driver}: expected ur:HOST or ur:HOST:PORT")
    return found[1].strip("[]"), int(found[2] or PORT)


def check_arm(arm: UR5, host: str, port: int) -> None:
    """Looks at an arm for two seconds without writing anything to it, and says what is in order.

    An ArmError where it cannot be reached, or may not move.
    """
    from kinecast.robot.rtde import Rtde

    readings: list[Reading] = []
    arrivals: list[float] = []
    with closing(Rtde(host, port)) as rtde:
        until = time.monotonic() + WATCHED
        while time.monotonic() < until and not rtde.closed:
            rtde.wait(0.1)
            news = rtde.readings()
            readings += news
            arrivals += [time.monotonic()] * len(news)
    if len(readings) < 2:
        raise ArmError(f"{host}:{port}: sends no states")
    kind = "CB3" if rtde.rate < 200 else "e-Series"
    print(f"ok   software  {'.'.join(map(str, rtde.version[:3]))} ({kind}), {rtde.rate:g} cycles a second")
    found = [_clock(readings, np.array(arrivals), rtde.rate), *_checks(arm, readings[-1])]
    for name, passed, text in found:
        print(f"{'ok ' if passed else 'NOT'}  {name:8}  {text}")
    if failed := ", ".join(name for name, passed, _ in found if not passed):
        raise ArmError(f"ur:{host}:{port}: the arm may not move: {failed}")


def _clock(readings: Sequence[Reading], arrivals: np.ndarray, rate: float) -> Check:
    """Whether the controller's states come one a cycle, and on time."""
    stamps = np.array([each.stamp for each in readings])
    cycles = (stamps[-1] - stamps[0]) * rate
    skipped = cycles + 1 - len(stamps)
    p99, longest = np.percentile(np.diff(arrivals) * rate, [99, 100])
    drift = (arrivals[-1] - arrivals[0]) / (stamps[-1] - stamps[0]) - 1
    text = (
        f"{skipped:.0f} of {cycles:.0f} cycles without a state; {p99:.2f} cycles between two at"
        f" p99, {longest:.2f} at most; runs {1e6 * drift:+.0f} ppm apart from this computer's"
    )
    return "clock", bool(skipped <= 0.01 * cycles and p99 <= 2 and abs(drift) < 0.01), text


def _checks(arm: UR5, last: Reading) -> Iterator[Check]:
    """What else must be in order before an arm may move."""
    from kinecast.robot.ur_driver import trouble

    problem = trouble(last)
    yield "state", problem is None, "kinecast_ur.script waits" if problem is None else problem.value
    yield "speed", last.speed_fraction > 0, f"the speed slider lets it go at {last.speed_fraction:.0%}"
    left = np.minimum(last.q - arm.q_range[:, 0], arm.q_range[:, 1] - last.q)
    text = f"joint {left.argmin() + 1} is {left.min():.2f} rad from the end of its range, the others are further"
    yield "limits", bool(left.min() > MARGIN), text
    # Whether the controller puts the tool where this model of the arm does tells another arm, tool or base frame.
    T = arm.forward_kinematics(last.q)
    apart = np.linalg.norm(last.tool[:3] - T[:3, 3])
    turned = np.linalg.norm(rotation_vector(T[:3, :3].T @ from_rotation_vector(last.tool[3:])))
    text = f"the controller's TCP is {1e3 * apart:.1f} mm and {np.degrees(turned):.1f}° from the model's"
    passed = bool(apart < NEAR and turned < TURNED)
    yield "tool", passed, text if passed else f"{text}: another arm, TCP or base frame (docs/ur.md)"


@contextmanager
def predicted(mailbox: Mailbox, predictor: Predictor, T_base_world: np.ndarray) -> Iterator[Seen]:
    """Frames of whoever comes, in the frame of the arm's base and on this computer's clock, and their predictions."""
    ended, seen, R = threading.Event(), Seen(maxlen=8), T_base_world[:3, :3]

    def watch() -> None:
        while not ended.is_set():
            if (arrival := mailbox.take(0.1)) is not None:
                frame = arrival.frame
                covariance = None if frame.covariance is None else R @ frame.covariance @ R.T
                places = apply(T_base_world, frame.positions)
                frame = replace(frame, stamp=arrival.acquired, positions=places, covariance=covariance, frame_id="cell")
                seen.append((frame, predictor.observe(frame, time.monotonic())))

    thread = threading.Thread(target=watch, name="people", daemon=True)
    thread.start()
    try:
        yield seen
    finally:
        ended.set()
        thread.join(5.0)


def warm_up(samples: int) -> None:
    """Three simulated seconds: what is compiled while an arm moves comes too late."""
    from kinecast.robot.collaboration import simulate_scenario

    steps = simulate_scenario("avoid", "kinecast", 0, samples).steps()
    deque(itertools.islice(steps, round(3.0 / STEP)), maxlen=0)
    gc.collect()
    gc.freeze()  # what is there by now stays: looking through all of it would hold everything up for 0.1 s
    sys.setswitchinterval(5e-4)  # predictor and planner are threads, and give way to the arm sooner


def episode(arm: UR5, driver: UrDriver, seen: Seen, ended: Callable[[], bool]) -> Iterator[str]:
    """The cell's episode by a real arm, until there is no source or something stops it; what is decided, in lines."""
    from kinecast.robot.async_planner import AsyncPlanner
    from kinecast.robot.cell import Cell
    from kinecast.robot.choice import Chooser
    from kinecast.robot.people import CameraFrame
    from kinecast.robot.supervisor import Supervisor

    cell, per_step, newest = Cell(), max(round(STEP / driver.dt), 1), 0.0
    driver.wait()
    q, closed = driver.reading.q, driver.gripped
    with closing(AsyncPlanner(Chooser(arm, cell).choose, threaded=True)) as planner:
        supervisor = Supervisor(arm, cell, planner, q, per_step * driver.dt)
        driver.resume()
        while driver.status.name == "OK" and not supervisor.done and not ended():
            now = time.monotonic()
            while seen:  # a shot each: two of one instant would pass for the same one
                frame, prediction = seen.popleft()
                newest = max(frame.stamp, newest + 1e-6)
                supervisor.see(CameraFrame(newest, (frame,)), [prediction], now)
            supervisor.executor.slider = driver.reading.speed_fraction
            command = supervisor.control(now)
            if command.news:
                yield f"{command.decision.state.name.lower():10}  {command.decision.reason}"
            if command.closed != closed:
                closed = command.closed
                driver.grip(closed)
            for part in range(1, per_step + 1):
                driver.wait()
                driver.move(q + (command.q - q) * part / per_step)
            q = command.q
