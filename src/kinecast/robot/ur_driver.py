"""A real Universal Robots arm (CB3, e-Series); on its controller runs `data/kinecast_ur.script`.

How to set it up: docs/ur.md. What was decided: docs/decisions/0027.
"""

from __future__ import annotations

import itertools
import time
from dataclasses import dataclass
from enum import Enum

import numpy as np
from jaxtyping import Float

from kinecast.errors import ArmError, OptionError
from kinecast.robot.rtde import PORT, Reading, Rtde
from kinecast.robot.ur5 import UR5

PATIENCE = 0.1
"""After so long without the other side [s] an arm that has to be told again stands; so does the program's own."""
LEAD = 0.4
"""Farthest a target may be ahead of the arm in any joint [rad]; at pi rad/s servoj is about 0.3 behind."""
FIRST = 1.0  # longest wait for the first state, and for an arm to come to rest [s]
LATE = 2.0  # cycles after which a state is too old for another target
DRIFT = 1e-3  # seconds a second by which the controller's clock may run apart from this computer's
STANDS, FOLLOWS = 2701, 2702  # what `kinecast_ur.script` writes into output_int_register_24
PLAYING, RUNNING = 2, 7  # values of runtime_state and robot_mode (RTDE Guide)


class ArmStatus(Enum):
    """What an arm does, and what helps where it stands. Any but OK stays until `resume`."""

    OK = "it follows"
    WAITING = "it stands until it is told to move: resume()"
    DISCONNECTED = "the connection is lost: mind cable and controller, then resume()"
    LATE = "the controller's states came too late: find what holds up network or computer, then resume()"
    EMERGENCY_STOP = "emergency stop: release it and switch the arm on at its pendant, then resume()"
    PROTECTIVE_STOP = "protective stop: find out why, unlock it at the pendant, play the program, then resume()"
    SAFEGUARD_STOP = "safeguard stop: clear the guarded space and reset it, then resume()"
    FAULT = "the safety system is in fault, violation or recovery: the pendant says why"
    SWITCHED_OFF = "the arm is not switched on, or its brakes are on: see the pendant"
    NO_PROGRAM = "kinecast_ur.script does not run on the controller, or has stopped the arm: play it, then resume()"
    REFUSED = "it was told to be where it may not, or cannot, be in time: go on from where it is, then resume()"


_SAFETY = (
    (0b000_1110_0000, ArmStatus.EMERGENCY_STOP),
    (0b000_0000_0100, ArmStatus.PROTECTIVE_STOP),
    (0b000_0001_0000, ArmStatus.SAFEGUARD_STOP),
    (0b011_0000_1000, ArmStatus.FAULT),
    (0b100_0000_0000, ArmStatus.SAFEGUARD_STOP),
)
"""Bits of safety_status_bits (RTDE Guide), the gravest first: 2 protective stop, 3 recovery, 4 safeguard stop, 5 to 7
emergency stops, 8 violation, 9 fault, 10 stopped for safety's sake. Bits 0 and 1 are normal and reduced mode."""


def trouble(reading: Reading) -> ArmStatus | None:
    """Why the arm cannot move, whoever tells it to; None where it can."""
    for bits, status in _SAFETY:
        if reading.safety & bits:
            return status
    if reading.robot_mode != RUNNING:
        return ArmStatus.SWITCHED_OFF
    ours = reading.runtime_state == PLAYING and reading.program in (STANDS, FOLLOWS)
    return None if ours else ArmStatus.NO_PROGRAM


@dataclass
class CycleCounters:
    """What became of the controller's cycles: each was `sent`, or is without a target for one of three causes."""

    cycles: int = 0  # since the connection was opened
    sent: int = 0  # a target, or the order to stand, was written in it
    skipped: int = 0  # the controller sent no state: it leaves some out when it is busy
    overrun: int = 0  # whoever calls took longer than a cycle
    bunched: int = 0  # the state came together with the next: network, or this computer's scheduler
    late: int = 0  # of those sent: the state was too old for another target, and the last one was sent again


class UrDriver:
    """A UR arm that follows while everything is in order, and stands until `resume` after anything that was not.

    Call `wait`, then `move`, in every cycle. There is no thread: what is not called writes nothing, and the program
    on the controller stops the arm when nothing is written. `move`, `grip` and `wait` never raise; `move` and `grip`
    never wait.

    Args:
        arm: its limits.
        host, port: of the controller.
        gripper: digital output that closes it: 0 to 7 standard, 8 to 15 configurable, 16 and 17 at the tool.

    Attributes:
        status: see ArmStatus; counters: see CycleCounters.
        reading: the newest state, also where the connection is lost; sent: (6,) the newest target [rad].

    Raises:
        ArmError: see Rtde.
    """

    def __init__(self, arm: UR5, host: str, port: int = PORT, gripper: int = 0) -> None:
        if not 0 <= gripper <= 17:
            raise OptionError(f"gripper {gripper}: digital outputs are 0 to 17")
        bank = ("standard", "configurable", "tool")[gripper // 8]
        self._inputs = {
            "input_int_register_24": "INT32", "input_int_register_25": "INT32",
            **{f"input_double_register_{k}": "DOUBLE" for k in range(24, 30)},
            f"{bank}_digital_output_mask": "UINT8", f"{bank}_digital_output": "UINT8",
        }  # fmt: skip
        self._arm, self._host, self._port, self._gripper = arm, host, port, gripper
        self._orders = itertools.count(int(time.time()) & 0xFFFFFF)  # that no earlier connection has used
        self.counters = CycleCounters()
        self._counter = self._order = 0
        self._grip: bool | None = None  # what the gripper is yet to be told
        self._unserved = False  # whether the newest state had no answer
        self._since = 0.0
        self._connect()

    def _connect(self) -> None:
        """Opens the connection, and waits for the first state."""
        rtde = Rtde(self._host, self._port, self._inputs)
        deadline = time.monotonic() + FIRST
        while not (readings := rtde.readings()):
            if rtde.closed or time.monotonic() > deadline:
                rtde.close()
                raise ArmError(f"{self._host}:{self._port}: sends no states")
            rtde.wait(0.1)
        self._rtde, self.reading, self.status = rtde, readings[-1], ArmStatus.WAITING
        self._offset = time.monotonic() - self.reading.stamp
        self.sent = self.reading.q

    @property
    def dt(self) -> float:
        """Time between two steps [s]: of the controller's cycle."""
        return 1.0 / self._rtde.rate

    @property
    def age(self) -> float:
        """How much later than the fastest one the newest state has come, and the time since [s]."""
        return time.monotonic() - self.reading.stamp - self._offset

    def wait(self, seconds: float = 0.1) -> None:
        """Until there is a state of the controller's that had no answer, or so long."""
        self._look()
        if not self._unserved:
            self._rtde.wait(seconds)
            self._look(waited=True)

    @property
    def gripped(self) -> bool:
        """Whether the gripper was closed in the newest state."""
        return bool(self.reading.outputs >> self._gripper & 1)

    def move(self, q: Float[np.ndarray, "6"]) -> Float[np.ndarray, "6"]:
        """Sends the next target [rad]: q, or as far on the way there as speeds and the speed slider allow.

        Returns:
            (6,) the one sent; the same again while the arm is to stand.
        """
        self._look()
        if self.status is ArmStatus.OK and not self._may_be(q):
            self._stop(ArmStatus.REFUSED)
        if self.status is ArmStatus.OK and self._unserved:  # one step a cycle, however often it is called
            if self.age > LATE * self.dt:
                self.counters.late += 1
            else:
                furthest = self._arm.max_speed * self.dt * self.reading.speed_fraction
                way = q - self.sent
                slowest = float(np.max(np.abs(way) / np.maximum(furthest, 1e-300)))  # cycles that its joint needs
                self.sent = self.sent + way / max(slowest, 1.0)
        self._send()
        return self.sent.copy()

    def grip(self, closed: bool) -> None:
        """Closes or opens the gripper with the next target; not while the arm is to stand."""
        if self.status is ArmStatus.OK:
            self._grip = closed

    def resume(self) -> ArmStatus:
        """Says that the arm may move again, from where it is; connects again, and waits for it to be at rest, first.

        Returns:
            OK, or why it still may not.

        Raises:
            ArmError: the controller cannot be reached.
        """
        if self._rtde.closed:
            self._connect()
        self._look()
        if self.status is ArmStatus.OK:
            return self.status
        deadline = time.monotonic() + FIRST
        while not (problem := trouble(self.reading)) and self.reading.program == FOLLOWS:
            if time.monotonic() > deadline:
                problem = ArmStatus.NO_PROGRAM
                break
            self._rtde.wait(self.dt)
            self._look()
        self.status = problem or (ArmStatus.LATE if self.age > PATIENCE else ArmStatus.OK)
        self.sent, self._order, self._grip = self.reading.q, next(self._orders), None
        self._since = time.monotonic()
        return self.status

    def close(self) -> None:
        """Tells the arm to stand and hangs up."""
        self._stop(ArmStatus.WAITING)
        self._rtde.close()

    def _look(self, waited: bool = False) -> None:
        """Takes in the states that have come, and stops the arm where it must."""
        readings, now, c = self._rtde.readings(), time.monotonic(), self.counters
        for reading in readings:
            passed = max(round((reading.stamp - self.reading.stamp) * self._rtde.rate), 1)
            c.cycles += passed
            c.skipped += passed - 1
            self._offset = min(self._offset + DRIFT * passed * self.dt, now - reading.stamp)
            self.reading = reading
        if readings:
            c.overrun += self._unserved + (0 if waited else len(readings) - 1)
            c.bunched += len(readings) - 1 if waited else 0
            self._unserved = True
        if self._rtde.closed:
            self._stop(ArmStatus.DISCONNECTED)
        elif self.status is ArmStatus.OK and (problem := self._problem()) is not None:
            self._stop(problem)

    def _problem(self) -> ArmStatus | None:
        """What is not in order, of an arm that should follow."""
        reading = self.reading
        if (problem := trouble(reading)) is not None:
            return problem
        if self.age > PATIENCE:
            return ArmStatus.LATE
        deaf = reading.program != FOLLOWS or self._counter - reading.echo > PATIENCE * self._rtde.rate
        return ArmStatus.NO_PROGRAM if deaf and time.monotonic() - self._since > 2 * PATIENCE else None

    def _may_be(self, q: Float[np.ndarray, "6"]) -> bool:
        """Whether a target is finite, in range, and not too far ahead of the arm."""
        low, high = self._arm.q_range.T
        if np.shape(q) != (6,) or not ((q >= low) & (q <= high)).all():
            return False
        return bool(np.abs([q - self.sent, self.sent - self.reading.q]).max() <= LEAD)

    def _stop(self, status: ArmStatus) -> None:
        """Tells the arm to stand, at once."""
        if self.status is ArmStatus.OK or status is ArmStatus.DISCONNECTED:
            self.status = status
            self._send()

    def _send(self) -> None:
        self._counter += 1
        order = self._order if self.status is ArmStatus.OK else 0
        bit = 1 << self._gripper % 8
        outputs = (0, 0) if self._grip is None or not order else (bit, bit * self._grip)
        self._rtde.send(self._counter & 0x7FFFFFFF, order, *self.sent.tolist(), *outputs)
        self._grip = None
        self.counters.sent += self._unserved
        self._unserved = False
