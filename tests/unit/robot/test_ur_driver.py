"""A UR arm by RTDE: it follows, and stands within two cycles of anything that is not in order."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress

import numpy as np
import pytest
from benchmarks import rtde_server, ur_driver
from benchmarks.rtde_server import EMERGENCY, NORMAL, PROTECTIVE, READY, Controller, python_of

from kinecast.cli import commands
from kinecast.errors import ArmError, OptionError
from kinecast.robot.rtde import Rtde
from kinecast.robot.ur5 import UR5
from kinecast.robot.ur_driver import FOLLOWS, LEAD, STANDS, ArmStatus, UrDriver

HOME = np.array(READY)
SPEED = np.array([0.5, -0.2, 0.2, 0.3, 0.1, 0.8])
"""Of the arm in these tests [rad/s]."""


@pytest.fixture(params=[125.0, 500.0], ids=["cb3", "e-series"])
def controller(request: pytest.FixtureRequest, arm: UR5) -> Iterator[Controller]:
    with Controller(request.param, READY, arm) as served:
        yield served


@pytest.fixture
def driver(controller: Controller, arm: UR5) -> Iterator[UrDriver]:
    with closing(UrDriver(arm, "127.0.0.1", controller.port)) as opened:
        yield opened


def run(driver: UrDriver, cycles: int, towards: float = 1.0) -> list[tuple[int, np.ndarray]]:
    """So many cycles of going on at SPEED: which of the controller's each was, and what was sent."""
    sent = []
    for _ in range(cycles):
        driver.wait(2 * driver.dt)
        target = driver.move(driver.sent + towards * SPEED * driver.dt)
        sent.append((round(driver.reading.stamp / driver.dt), target))
    return sent


def until(condition: Callable[[], bool], driver: UrDriver | None = None) -> None:
    """Waits for it, ten seconds at most; a driver goes on being called."""
    deadline = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < deadline
        if driver is None:
            time.sleep(0.005)
        else:
            run(driver, 1)


def moving(driver: UrDriver, controller: Controller) -> None:
    """Has the arm move; a machine that is too busy for that may need more than one go."""
    start = controller.q.copy()
    for _ in range(20):
        if driver.resume() is ArmStatus.OK:
            until(lambda: np.abs(controller.q - start).max() > 0.02 or driver.status is not ArmStatus.OK, driver)
        if driver.status is ArmStatus.OK:
            return
        time.sleep(0.2)
    raise AssertionError(driver.status)


def stands(sent: list[tuple[int, np.ndarray]], event: int) -> None:
    """The target is the same from two of the controller's cycles after the event on."""
    after = np.array([target for cycle, target in sent if cycle >= event + 2] or [sent[-1][1]])
    assert (after == after[0]).all()
    assert (sent[-1][1] == sent[-3][1]).all()


def test_it_works_at_the_controllers_rate_and_stands_until_it_is_told(controller: Controller, driver: UrDriver) -> None:
    assert driver.dt == controller.dt
    assert driver.status is ArmStatus.WAITING
    sent = run(driver, 20)
    assert all((target == HOME).all() for _, target in sent)
    assert not controller.targets


def test_it_follows_and_accounts_for_every_cycle(controller: Controller, driver: UrDriver) -> None:
    moving(driver, controller)
    start = driver.sent.copy()
    sent = run(driver, round(0.5 / driver.dt))
    if driver.status is ArmStatus.OK:  # else this machine was too busy
        assert len(sent) > 1
        np.testing.assert_allclose(
            driver.sent - start, SPEED * driver.dt * (len(sent) - driver.counters.late), atol=0.05
        )
        assert np.abs(controller.q - driver.sent).max() < 0.1
    c = driver.counters
    assert c.cycles - (c.sent + c.skipped + c.overrun + c.bunched) in (0, 1)
    assert c.skipped <= controller.skipped


@pytest.mark.parametrize("stop", [PROTECTIVE, EMERGENCY], ids=["protective", "emergency"])
def test_a_stop_is_honoured_and_nothing_moves_again_without_being_told(
    stop: int, controller: Controller, driver: UrDriver
) -> None:
    moving(driver, controller)
    event = controller.cycle
    controller.safety = stop
    sent = run(driver, 12)
    stands(sent, event)
    status = ArmStatus.PROTECTIVE_STOP if stop == PROTECTIVE else ArmStatus.EMERGENCY_STOP
    assert driver.status is status
    assert driver.resume() is status
    controller.safety = NORMAL
    run(driver, 5)
    assert driver.resume() is ArmStatus.NO_PROGRAM  # paused, or ended: somebody has to play it
    count = len(controller.targets)
    controller.play()
    until(lambda: driver.reading.program == STANDS and driver.reading.runtime_state == 2, driver)
    q = controller.q.copy()
    sent = run(driver, 20)
    assert (sent[0][1] == sent[-1][1]).all()
    assert (controller.q == q).all()
    assert len(controller.targets) == count
    moving(driver, controller)


def test_a_lost_connection_stops_it_on_both_sides(controller: Controller, driver: UrDriver) -> None:
    moving(driver, controller)
    event = controller.cycle
    controller.hang_up()
    sent = run(driver, 4)
    stands(sent, event)
    assert driver.status is ArmStatus.DISCONNECTED
    assert np.isfinite(driver.reading.q).all()
    driver.grip(True)
    until(lambda: controller.written[24] == STANDS)
    last = [target for cycle, target in controller.targets if cycle >= event + 2]
    assert all((target == last[0]).all() for target in last)
    moving(driver, controller)  # connects again


def test_late_states_stop_it(controller: Controller, driver: UrDriver) -> None:
    moving(driver, controller)
    event = controller.cycle
    controller.delay = 0.4
    sent = run(driver, 4)
    stands(sent, event)
    until(lambda: driver.status is not ArmStatus.OK, driver)
    assert driver.status is ArmStatus.LATE
    time.sleep(0.5)
    driver.wait()
    assert driver.resume() is ArmStatus.LATE
    controller.delay = 0.0
    time.sleep(0.5)
    moving(driver, controller)


def test_the_program_stops_an_arm_that_nobody_leads(controller: Controller, driver: UrDriver) -> None:
    moving(driver, controller)
    until(lambda: controller.written[24] == STANDS)
    until(lambda: not controller.velocity.any())
    q, count = controller.q.copy(), len(controller.targets)
    sent = run(driver, 10)
    until(lambda: driver.status is not ArmStatus.OK, driver)
    assert driver.status in (ArmStatus.NO_PROGRAM, ArmStatus.LATE)
    assert len(controller.targets) == count
    assert (controller.q == q).all()
    assert len(sent) == 10
    moving(driver, controller)


def test_a_program_that_hangs_stops_it(controller: Controller, driver: UrDriver) -> None:
    moving(driver, controller)
    controller.frozen = True
    until(lambda: driver.status is not ArmStatus.OK, driver)
    assert driver.status is ArmStatus.NO_PROGRAM
    controller.frozen = False


def test_the_speed_slider_is_honoured(controller: Controller, driver: UrDriver, arm: UR5) -> None:
    moving(driver, controller)
    controller.slider = 0.25
    until(lambda: driver.reading.speed_fraction == 0.25, driver)
    targets = np.array([target for _, target in run(driver, 10, towards=100.0)])
    assert (np.abs(np.diff(targets, axis=0)) <= 0.25 * arm.max_speed * driver.dt + 1e-12).all()
    controller.slider = 0.0
    until(lambda: driver.reading.speed_fraction == 0.0, driver)
    targets = np.array([target for _, target in run(driver, 5)])
    assert (targets == targets[0]).all()


def test_a_target_goes_on_once_a_cycle_however_often_it_is_called(
    controller: Controller, driver: UrDriver, arm: UR5
) -> None:
    moving(driver, controller)
    driver.wait()
    before, cycle = driver.sent, driver.counters.cycles
    for _ in range(100):
        driver.move(before + 0.1)
    furthest = arm.max_speed * driver.dt * (driver.counters.cycles - cycle + 1)
    assert (np.abs(driver.sent - before) <= furthest + 1e-12).all()
    assert driver.resume() is driver.status  # of an arm that moves nothing changes
    assert (driver.sent == driver.move(driver.sent)).all()


@pytest.mark.parametrize(
    "wrong", [HOME * np.nan, HOME + 7.0, HOME + 2 * LEAD, np.zeros(5)], ids=["nan", "range", "far", "shape"]
)
def test_targets_that_cannot_be_are_refused(wrong: np.ndarray, arm: UR5) -> None:
    with Controller(500.0, READY, arm) as controller, closing(UrDriver(arm, "127.0.0.1", controller.port)) as driver:
        moving(driver, controller)
        driver.wait()
        before = driver.sent.copy()
        with suppress(Exception):  # types are checked in tests alone
            driver.move(wrong)
        if wrong.shape == (6,):
            assert driver.status is ArmStatus.REFUSED
        assert (driver.sent == before).all()


@pytest.mark.parametrize("output", [0, 7, 9, 17])
def test_the_gripper_is_a_digital_output(output: int, arm: UR5) -> None:
    with Controller(500.0, READY, arm) as controller:
        controller.digital = before = 0b10_0000_0100_0010_0100 & ~(1 << output)
        with closing(UrDriver(arm, "127.0.0.1", controller.port, output)) as driver:
            driver.grip(True)
            run(driver, 5)
            assert controller.digital == before  # it has not been told to move
            moving(driver, controller)
            driver.grip(True)
            until(lambda: driver.gripped, driver)
            assert controller.digital == before | 1 << output
            driver.grip(False)
            until(lambda: not driver.gripped, driver)
            assert controller.digital == before
    with pytest.raises(OptionError, match="0 to 17"):
        UrDriver(arm, "127.0.0.1", controller.port, 18)


def test_what_is_no_controller_is_said_at_once(arm: UR5, monkeypatch: pytest.MonkeyPatch) -> None:
    with Controller(500.0, READY, arm) as controller:
        with closing(UrDriver(arm, "127.0.0.1", controller.port)), pytest.raises(ArmError, match="IN_USE"):
            UrDriver(arm, "127.0.0.1", controller.port)
        until(lambda: not controller._clients)
        with monkeypatch.context() as patch:
            patch.setitem(rtde_server.TYPES, "actual_q", "DOUBLE")
            with pytest.raises(ArmError, match="actual_q as DOUBLE"):
                Rtde("127.0.0.1", controller.port)
        monkeypatch.delitem(rtde_server.TYPES, "speed_scaling")
        with pytest.raises(ArmError, match="speed_scaling as NOT_FOUND"):
            Rtde("127.0.0.1", controller.port)
        port = controller.port
    with pytest.raises(ArmError, match="cannot be reached"):
        Rtde("127.0.0.1", port)


@pytest.mark.parametrize("answer", [b"", b"HTTP/1.1 400\r\n\r\n", b"\0\1\0", b"\0\4V\0", b"\xff\xffV"])
def test_foreign_servers_are_refused(answer: bytes) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            link, _ = server.accept()
            with link:
                link.recv(100)
                link.send(answer)

        thread = threading.Thread(target=serve)
        thread.start()
        with pytest.raises(ArmError, match=r"RTDE|answer"):
            Rtde("127.0.0.1", server.getsockname()[1], timeout=0.3)
        thread.join(5)


def test_rubbish_in_the_stream_ends_the_connection(controller: Controller, driver: UrDriver) -> None:
    moving(driver, controller)
    controller.silent = True
    client = controller._clients[0]
    nan = struct.pack(">HBBd", 12, 85, 1, np.nan)
    size = 4 + struct.calcsize(">d6d6d2diIIQii")
    nan = struct.pack(">HBB", size, 85, 1) + nan[4:] + bytes(size - 12)
    before = driver.reading
    client.waiting.extend([(0.0, nan), (0.0, struct.pack(">HB", 4, 77) + b"x")])  # a state of NaN, a message
    driver.wait(0.05)
    assert np.isfinite(driver.reading.stamp)
    assert driver.reading.stamp - before.stamp < 1.0
    client.waiting.append((0.0, struct.pack(">HB", 1, 85)))
    until(lambda: driver.status is not ArmStatus.OK, driver)
    assert driver.status in (ArmStatus.DISCONNECTED, ArmStatus.LATE)
    run(driver, 2)
    assert driver._rtde.closed


def test_the_program_takes_no_old_order_and_no_leap(controller: Controller, driver: UrDriver) -> None:
    """An order under which it was stopped is not followed again; nor is a target that is far."""
    moving(driver, controller)
    run(driver, 2)
    order = controller.registers["input_int_register_25"]
    driver.close()
    until(lambda: controller.written[24] == STANDS)
    count = len(controller.targets)
    controller.registers["input_int_register_25"] = order
    for k in range(20):
        controller.registers["input_int_register_24"] = 1_000_000 + k
        time.sleep(controller.dt)
    controller.registers["input_double_register_24"] = controller.q[0] + 1.1 * LEAD
    controller.registers["input_int_register_25"] = order + 1
    for k in range(20):
        controller.registers["input_int_register_24"] = 2_000_000 + k
        time.sleep(controller.dt)
    assert len(controller.targets) == count
    assert controller.written[24] == STANDS
    assert STANDS != FOLLOWS


def test_end_and_local_are_all_that_is_translated() -> None:
    assert python_of("def f():\n  local a = 1\n  while a < 3:\n    a = a + 1\n  end\n  return a\nend") == (
        "def f():\n  a = 1\n  while a < 3:\n    a = a + 1\n  return a"
    )


def dry_run(controller: Controller, capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    code = 0
    try:
        commands.run(["robot", "--driver", f"ur:127.0.0.1:{controller.port}", "--dry-run"])
    except SystemExit as stopped:
        code = int(stopped.code or 0)
    out, error = capsys.readouterr()
    return code, out, " ".join(error.split())


def test_a_dry_run_checks_and_changes_nothing(
    arm: UR5, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("kinecast.cli.robot.WATCHED", 0.5)
    with Controller(125.0, READY, arm) as controller:
        code, out, error = dry_run(controller, capsys)
        assert code in (0, 2)
        assert error in ("", f"kinecast: ur:127.0.0.1:{controller.port}: the arm may not move: clock")  # busy machine
        assert [line.split()[1] for line in out.splitlines()[:6]] == [
            "software", "clock", "state", "speed", "limits", "tool",
        ]  # fmt: skip
        assert not any(controller.registers.values())
        controller.tcp[2, 3], controller.safety, controller.slider = 0.05, PROTECTIVE, 0.0
        code, out, error = dry_run(controller, capsys)
        assert code == 2
        assert "state, speed, tool" in error
        assert "50.0 mm" in out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["ur:", "--dry-run"], "expected ur:HOST"),
        (["kuka:1.2.3.4", "--dry-run"], "expected ur:HOST"),
        (["ur:127.0.0.1:99999", "--dry-run"], "expected ur:HOST"),
        (["ur:127.0.0.1"], "either --dry-run"),
        (["ur:127.0.0.1", "--dry-run", "--move"], "either --dry-run"),
        (["ur:127.0.0.1", "--move"], "needs --source"),
        (["ur:127.0.0.1:1", "--dry-run"], "cannot be reached"),
    ],
)
def test_wrong_options_are_said(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        commands.run(["robot", "--driver", *words])
    assert stopped.value.code == 2
    assert message in " ".join(capsys.readouterr().err.split())


def test_the_benchmark_explains_every_missed_deadline() -> None:
    result = ur_driver.run(500.0, seconds=1.0)
    assert result["cycles"] > 100
    assert result["unaccounted"] in (0, 1)
