"""Real-Time Data Exchange with a Universal Robots controller: what it says in every cycle, what is written to it.

Protocol: Universal Robots, Real-Time Data Exchange (RTDE) Guide, version 2 of the protocol, as of software 3.9 (CB3)
and 5.3 (e-Series), the first whose registers 24 to 47 are for clients like this. Why no library: docs/decisions/0027.
"""

from __future__ import annotations

import math
import select
import socket
import struct
import time
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from kinecast.errors import ArmError

PORT = 30004
RATES = {"CB3": 125.0, "e-Series": 500.0}  # of the controllers' real-time loops [Hz]
LONGEST = 1e9  # seconds that no controller has been running
AT_ONCE = 1 << 19  # bytes read at once: 5 s of states

OUTPUTS = {
    "timestamp": "DOUBLE", "actual_q": "VECTOR6D", "actual_TCP_pose": "VECTOR6D", "target_speed_fraction": "DOUBLE",
    "speed_scaling": "DOUBLE", "robot_mode": "INT32", "runtime_state": "UINT32", "safety_status_bits": "UINT32",
    "actual_digital_output_bits": "UINT64", "output_int_register_24": "INT32", "output_int_register_25": "INT32",
}  # fmt: skip
"""What the controller sends, and as what."""
_FORMATS = {"DOUBLE": "d", "VECTOR6D": "6d", "INT32": "i", "UINT32": "I", "UINT64": "Q", "UINT8": "B"}
_HEADER = struct.Struct(">HB")


class Reading(NamedTuple):
    """What the controller says in one of its cycles."""

    stamp: float  # on the controller's clock [s]
    q: Float[np.ndarray, "6"]  # [rad]
    tool: Float[np.ndarray, "6"]  # position [m] and rotation vector [rad] of the TCP in the base's frame
    speed_fraction: float  # speed slider times the controller's own scaling, 0..1
    robot_mode: int  # this and the next three as in the RTDE Guide
    runtime_state: int
    safety: int
    outputs: int
    program: int  # what `kinecast_ur.script` says it does
    echo: int  # the counter that it has seen


class Rtde:
    """One connection. Opening it takes up to `timeout` and raises; after that nothing waits and nothing raises.

    Args:
        host, port: of the controller.
        inputs: what will be written, and as what; none for a connection that changes nothing on the controller.
        timeout: for the whole opening [s].

    Attributes:
        version: of the controller's software; rate: of its cycles [Hz].

    Raises:
        ArmError: nobody is there, or speaks another protocol, or a name is unknown or already written by another.
    """

    def __init__(
        self, host: str, port: int = PORT, inputs: Mapping[str, str] | None = None, timeout: float = 2.0
    ) -> None:
        self._where, self._rest, self._room = f"{host}:{port}", b"", memoryview(bytearray(AT_ONCE))
        self._deadline = time.monotonic() + timeout
        try:
            self._socket = socket.create_connection((host, port), timeout)
        except OSError as error:
            raise ArmError(f"{self._where}: cannot be reached ({error})") from None
        try:
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            if not self._ask(b"V", struct.pack(">H", 2))[0]:
                raise ArmError(f"{self._where}: speaks no version 2 of RTDE; CB3 needs software 3.9 or newer")
            self.version: tuple[int, ...] = struct.unpack(">4I", self._ask(b"v"))
            self.rate = RATES["CB3" if self.version[0] < 5 else "e-Series"]
            self._outputs = self._recipe(b"O", OUTPUTS, struct.pack(">d", self.rate))
            self._inputs = self._recipe(b"I", inputs) if inputs else None
            if not self._ask(b"S")[0]:
                raise ArmError(f"{self._where}: does not start to send")
            self._socket.setblocking(False)
        except (OSError, struct.error, IndexError) as error:
            self.close()
            if isinstance(error, ArmError):
                raise
            raise ArmError(f"{self._where}: does not answer as RTDE ({error})") from None

    @property
    def closed(self) -> bool:
        """Whether the connection is gone."""
        return self._socket.fileno() < 0

    def close(self) -> None:
        """Ends it; also twice."""
        self._socket.close()

    def wait(self, seconds: float) -> None:
        """Until something has come, or so long."""
        if self.closed:
            time.sleep(seconds)
        else:
            select.select([self._socket], [], [], seconds)

    def readings(self) -> list[Reading]:
        """What has come since the last call, oldest first."""
        try:
            count = self._socket.recv_into(self._room)
        except BlockingIOError:
            return []
        except OSError:
            count = 0
        if count == 0:
            self.close()
        self._rest += self._room[:count]
        number, recipe = self._outputs
        found = []
        for kind, payload in self._packages():
            if kind == b"U" and len(payload) == recipe.size and payload[0] == number:
                _, stamp, *values = recipe.unpack(payload)
                if math.isfinite(stamp + sum(values)) and abs(stamp) < LONGEST:
                    speed = min(max(values[12] * values[13], 0.0), 1.0)
                    found.append(Reading(stamp, np.array(values[:6]), np.array(values[6:12]), speed, *values[14:]))
        return found

    def send(self, *values: int | float) -> None:
        """Writes the inputs, whole or not at all; a controller that takes nothing any more is lost."""
        if self._inputs is None:
            return
        number, recipe = self._inputs
        try:
            package = _package(b"U", recipe.pack(number, *values))
            if self._socket.send(package) < len(package):
                self.close()
        except (OSError, struct.error):
            self.close()

    def _packages(self) -> Iterator[tuple[bytes, bytes]]:
        """Those that have come whole: the kind of each, and what is in it."""
        at, rest, self._rest = 0, self._rest, b""
        while len(rest) - at >= _HEADER.size:
            size, kind = _HEADER.unpack_from(rest, at)
            if size < _HEADER.size:  # no package is as short: from here on nothing can be understood
                self.close()
                return
            if len(rest) - at < size:
                break
            yield bytes([kind]), rest[at + _HEADER.size : at + size]
            at += size
        self._rest = rest[at:]

    def _ask(self, question: bytes, payload: bytes = b"") -> bytes:
        """A question of the opening, and its answer."""
        self._socket.sendall(_package(question, payload))
        while not self.closed and (left := self._deadline - time.monotonic()) > 0:
            self._socket.settimeout(left)
            content = self._socket.recv(4096)
            self._rest += content
            for kind, answer in list(self._packages()):
                if kind == question:
                    return answer
            if not content:
                break
        raise ArmError(f"{self._where}: does not answer as RTDE")

    def _recipe(self, kind: bytes, names: Mapping[str, str], before: bytes = b"") -> tuple[int, struct.Struct]:
        """Agrees on what is sent, or written: the recipe's number, and how the packages are laid out."""
        answer = self._ask(kind, before + ",".join(names).encode())
        types = answer[1:].decode("ascii", "replace").split(",")
        if types != list(names.values()):
            pairs = zip(names, types, strict=False)
            wrong = [f"{name} as {found}" for name, found in pairs if found != names[name]]
            raise ArmError(f"{self._where}: gives {', '.join(wrong) or 'not what it is asked for'}")
        return answer[0], struct.Struct(">B" + "".join(_FORMATS[each] for each in types))


def _package(kind: bytes, payload: bytes) -> bytes:
    return _HEADER.pack(_HEADER.size + len(payload), ord(kind)) + payload
