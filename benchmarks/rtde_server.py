"""A UR controller as RTDE shows it, to try `kinecast.robot.ur_driver` on; it runs the very program that the arm would.

python -m benchmarks.rtde_server [--rate 125|500]

prints its port, and goes on until its input ends: then what it has counted, as JSON.

Made from Universal Robots' RTDE Guide, version 2 of the protocol. Cycles come in real time; the arm's joints follow
servoj's target with a lag; safety stops, pauses, late packages and hang-ups are had by setting attributes.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import select
import socket
import struct
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib.resources import files
from typing import Any

import numpy as np

from kinecast.geometry.transforms import rotation_vector
from kinecast.robot.ur5 import UR5

NORMAL, PROTECTIVE, EMERGENCY = 1, 0b101 & ~1, 0b1010_0000
STOPS = 0b111_1111_1100
STOPPED, PLAYING, PAUSED = 1, 2, 4
LAG = 0.03
"""Time constant of the joints [s]."""
TYPES = {
    "timestamp": "DOUBLE", "actual_q": "VECTOR6D", "actual_TCP_pose": "VECTOR6D", "target_speed_fraction": "DOUBLE",
    "speed_scaling": "DOUBLE", "robot_mode": "INT32", "runtime_state": "UINT32", "safety_status_bits": "UINT32",
    "actual_digital_output_bits": "UINT64", "output_int_register_24": "INT32", "output_int_register_25": "INT32",
    "input_int_register_24": "INT32", "input_int_register_25": "INT32",
    **{f"input_double_register_{k}": "DOUBLE" for k in range(24, 30)},
    **{f"{bank}_digital_output": "UINT8" for bank in ("standard", "configurable", "tool")},
    **{f"{bank}_digital_output_mask": "UINT8" for bank in ("standard", "configurable", "tool")},
}  # fmt: skip
FORMATS = {"DOUBLE": "d", "VECTOR6D": "6d", "INT32": "i", "UINT32": "I", "UINT64": "Q", "UINT8": "B"}


READY = (-0.9, -1.5, -1.6, -1.6, 1.57, 0.0)
"""Elbow up, the tool over the table [rad]."""


def main() -> None:
    """Serves."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rate", type=float, default=125.0)
    with Controller(parser.parse_args().rate, READY, UR5()) as controller:
        print(controller.port, flush=True)
        sys.stdin.read()
        print(json.dumps(controller.counts()))


class ProgramStopped(Exception):  # noqa: N818 - nothing went wrong
    """Leaves the program that runs on the controller."""


def python_of(script: str) -> str:
    """URScript as Python, as far as kinecast_ur.script needs it: `end` and `local` are left out."""
    lines = [re.sub(r"\blocal ", "", line) for line in script.splitlines() if line.strip() != "end"]
    return "\n".join(lines)


class Client:
    """Who is connected."""

    def __init__(self, link: socket.socket) -> None:
        link.setblocking(False)
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.link, self.rest, self.started = link, b"", False
        self.outputs: list[str] = []
        self.inputs: list[str] = []
        self.every, self.waiting = 1, deque[tuple[float, bytes]]()


class Controller:
    """Listens on a free port of this machine from `with` on.

    Args:
        rate: of its cycles [Hz].
        q: (6,) where the arm is [rad].
        arm: whose tool it has.

    Attributes to set: `safety`, `robot_mode`, `slider`, `delay` of packages [s], `silent` (sends nothing), `frozen`
    (the program gets no further); to read: `q`, `target`, `targets` (cycle, target) of every servoj, `cycle`,
    `starved` (cycles under servoj without a new counter), `doubled` (counters that came beside another one), `skipped`
    cycles that this machine was too slow for, `lateness` of the others [s].
    """

    def __init__(self, rate: float, q: Sequence[float], arm: UR5, version: tuple[int, int, int, int] | None = None):
        self.rate, self.dt, self.arm = rate, 1.0 / rate, arm
        self.version = version or ((3, 15, 8, 0) if rate < 200 else (5, 11, 1, 0))
        self.q, self.target, self.velocity = np.array(q, float), np.array(q, float), np.zeros(6)
        self.safety, self.robot_mode, self.runtime_state, self.slider = NORMAL, 7, PLAYING, 1.0
        self.delay, self.silent, self.frozen, self.tcp = 0.0, False, False, np.eye(4)
        self.digital, self.registers, self.written = 0, dict.fromkeys(TYPES, 0.0), {24: 0, 25: 0}
        self.cycle, self.starved, self.doubled, self.skipped = 0, 0, 0, 0
        self.targets, self.lateness = deque[tuple[int, np.ndarray]](maxlen=5000), list[float]()
        self._seen, self._clients, self._ended = 0.0, list[Client](), threading.Event()
        self._values(["actual_TCP_pose"])  # compiled before anybody connects
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.setblocking(False)
        self.port: int = self._listener.getsockname()[1]
        self._thread = threading.Thread(target=self.run, daemon=True)

    def __enter__(self) -> Controller:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join(5)
        for link in (self._listener, *(client.link for client in self._clients)):
            link.close()

    def hang_up(self) -> None:
        """Ends every connection."""
        for client in self._clients:
            client.link.shutdown(socket.SHUT_RDWR)

    def play(self) -> None:
        """What the button on the pendant does."""
        self.safety, self.runtime_state = NORMAL, PLAYING

    def counts(self) -> dict[str, float]:
        """What became of its cycles; lateness in milliseconds."""
        p50, p99, most = np.percentile(self.lateness, [50, 99, 100]) * 1e3
        counts = {name: getattr(self, name) for name in ("cycle", "starved", "doubled", "skipped")}
        return {**counts, "late_p50_ms": p50, "late_p99_ms": p99, "late_most_ms": most}

    def run(self) -> None:
        """Until the end: the program where it is to be played, else nothing."""
        source = python_of((files("kinecast") / "data" / "kinecast_ur.script").read_text(encoding="utf-8"))
        commands: dict[str, Any] = {
            "get_steptime": lambda: self.dt,
            "get_actual_joint_positions": self.q.tolist,
            "read_input_integer_register": lambda k: int(self.registers[f"input_int_register_{k}"]),
            "read_input_float_register": lambda k: self.registers[f"input_double_register_{k}"],
            "write_output_integer_register": self.written.__setitem__,
            "servoj": self._servoj, "stopj": self._stopj, "sync": self._step,
        }  # fmt: skip
        exec(compile(source, "kinecast_ur.script", "exec"), commands)
        self._due = time.monotonic()
        while not self._ended.is_set():
            with suppress(ProgramStopped):
                if self.runtime_state == PLAYING:
                    commands["kinecast_ur"]()
                self._step()

    def _servoj(self, q: list[float], t: float, lookahead_time: float, gain: float) -> None:
        assert 0.03 <= lookahead_time <= 0.2
        assert 100 <= gain <= 2000
        self.target = np.array(q)
        self.targets.append((self.cycle, self.target))
        self.starved += self.registers["input_int_register_24"] == self._seen
        self._seen = self.registers["input_int_register_24"]
        self._step(lambda: self.q + (self.target - self.q) * (1 - math.exp(-self.dt / LAG)))

    def _stopj(self, a: float) -> None:
        while np.abs(self.velocity).max() > 1e-3:
            slower = np.maximum(1 - a * self.dt / np.abs(self.velocity).max(), 0.0)
            self._step(lambda slower=slower: self.q + slower * self.velocity * self.dt)

    def _step(self, moved: Callable[[], np.ndarray] | None = None) -> None:
        """One cycle of the program; while a stop or a pause lasts, as many as it takes, and the arm stands."""
        q = self.q if moved is None else moved()
        self.velocity = (q - self.q) / self.dt
        self.q[:] = q
        self._cycle()
        while not self._ended.is_set() and (self.safety & STOPS or self.runtime_state != PLAYING or self.frozen):
            if self.safety & STOPS:
                self.runtime_state = STOPPED if self.safety & EMERGENCY else PAUSED
            self.velocity = np.zeros(6)
            self._cycle()
            if self.runtime_state == STOPPED:
                raise ProgramStopped
        if self._ended.is_set():
            raise ProgramStopped

    def _cycle(self) -> None:
        """Waits for the next cycle to begin, writes what is, reads what is wanted."""
        self._due += self.dt
        late = time.monotonic() - self._due
        missed = max(int(late * self.rate), 0)
        self.cycle += 1 + missed
        self.skipped += missed
        self._due += missed * self.dt
        while (left := self._due - time.monotonic()) > 0:
            self._serve(left)
        self.lateness.append(-left)
        for client in self._clients:
            if client.started and not self.silent and self.cycle % client.every == 0:
                package = self._package("U", b"\1" + self._values(client.outputs))
                client.waiting.append((time.monotonic() + self.delay, package))
        self._serve(0.0)

    def _serve(self, seconds: float) -> None:
        """Sends what is due, and takes in what comes for so long."""
        now = time.monotonic()
        for client in self._clients:
            while client.waiting and client.waiting[0][0] <= now:
                with suppress(OSError):
                    client.link.send(client.waiting.popleft()[1])
        with suppress(OSError, ValueError):  # a link that is just being closed
            ready, _, _ = select.select([self._listener, *(each.link for each in self._clients)], [], [], seconds)
            for link in ready:
                if link is self._listener:
                    self._clients.append(Client(link.accept()[0]))
                else:
                    self._hear(next(each for each in self._clients if each.link is link))

    def _hear(self, client: Client) -> None:
        content = client.link.recv(65536)
        if not content:
            self._clients.remove(client)
            client.link.close()
            return
        client.rest += content
        while len(client.rest) >= 3 and len(client.rest) >= (size := struct.unpack_from(">H", client.rest)[0]):
            kind, payload, client.rest = chr(client.rest[2]), client.rest[3:size], client.rest[size:]
            answer = self._answer(client, kind, payload)
            if answer is not None:
                client.link.send(self._package(kind, answer))

    def _answer(self, client: Client, kind: str, payload: bytes) -> bytes | None:
        if kind == "V":
            return bytes([payload == b"\0\2"])
        if kind == "v":
            return struct.pack(">4I", *self.version)
        if kind == "S":
            client.started = True
            return b"\1"
        if kind == "O":
            client.every = round(self.rate / struct.unpack_from(">d", payload)[0])
            client.outputs = payload[8:].decode().split(",")
            return b"\1" + ",".join(TYPES.get(name, "NOT_FOUND") for name in client.outputs).encode()
        if kind == "I":
            taken = {name for each in self._clients for name in each.inputs}
            client.inputs = payload.decode().split(",")
            types = ["IN_USE" if name in taken else TYPES.get(name, "NOT_FOUND") for name in client.inputs]
            return b"\1" + ",".join(types).encode()
        if kind == "U":
            before = self.registers["input_int_register_24"]
            values = struct.unpack(">" + "".join(FORMATS[TYPES[name]] for name in client.inputs), payload[1:])
            self.registers.update(zip(client.inputs, values, strict=True))
            self.doubled += (
                bool(self.targets) and before != self._seen and self.registers["input_int_register_24"] != before
            )
            for shift, bank in ((0, "standard"), (8, "configurable"), (16, "tool")):
                mask = int(self.registers[f"{bank}_digital_output_mask"]) << shift
                self.digital = self.digital & ~mask | int(self.registers[f"{bank}_digital_output"]) << shift & mask
        return None

    def _values(self, names: list[str]) -> bytes:
        T = self.arm.forward_kinematics(self.q) @ self.tcp
        now: dict[str, Any] = {
            "timestamp": self.cycle * self.dt, "actual_q": self.q,
            "actual_TCP_pose": np.concatenate([T[:3, 3], rotation_vector(T[:3, :3])]),
            "target_speed_fraction": self.slider, "speed_scaling": 1.0, "robot_mode": self.robot_mode,
            "runtime_state": self.runtime_state, "safety_status_bits": self.safety,
            "actual_digital_output_bits": self.digital, "output_int_register_24": self.written[24],
            "output_int_register_25": self.written[25],
        }  # fmt: skip
        return b"".join(struct.pack(">" + FORMATS[TYPES[name]], *np.atleast_1d(now[name]).tolist()) for name in names)

    @staticmethod
    def _package(kind: str, payload: bytes) -> bytes:
        return struct.pack(">HB", 3 + len(payload), ord(kind)) + payload


if __name__ == "__main__":
    main()
