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
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from kinecast.errors import ArmError

__all__ = ["PORT", "Reading", "Rtde"]

PORT = 30004
RATES = {"CB3": 125.0, "e-Series": 500.0}
"""Of the controllers' real-time loops [Hz]."""
LONGEST = 1e9
"""Seconds that no controller has been running."""
AT_ONCE = 65536
"""Bytes read at once, at most eight times: 5 s of states."""

OUTPUTS = (
    "timestamp", "actual_q", "actual_TCP_pose", "target_speed_fraction", "speed_scaling", "robot_mode", "runtime_state",
    "safety_status_bits", "actual_digital_output_bits", "output_int_register_24", "output_int_register_25",
)  # fmt: skip
_VECTORS = ("actual_q", "actual_TCP_pose")
_TYPES = {
    "BOOL": "?", "UINT8": "B", "UINT32": "I", "UINT64": "Q", "INT32": "i", "DOUBLE": "d",
    "VECTOR3D": "3d", "VECTOR6D": "6d", "VECTOR6INT32": "6i", "VECTOR6UINT32": "6I",
}  # fmt: skip
_HEADER = struct.Struct(">HB")


@dataclass(frozen=True)
class Reading:
    """What the controller says in one of its cycles.

    Attributes:
        stamp: on the controller's clock [s].
        q: (6,) [rad]; tool: (6,) position [m] and rotation vector [rad] of the TCP in the base's frame.
        speed_fraction: speed slider times the controller's own scaling, 0..1.
        robot_mode, runtime_state, safety, outputs: as in the RTDE Guide.
        program: what `kinecast_ur.script` says it does; echo: the counter that it has seen.
    """

    stamp: float
    q: Float[np.ndarray, "6"]
    tool: Float[np.ndarray, "6"]
    speed_fraction: float
    robot_mode: int
    runtime_state: int
    safety: int
    outputs: int
    program: int
    echo: int

    @classmethod
    def of(cls, values: Sequence[Any]) -> Reading:
        """From the values of `OUTPUTS`."""
        stamp, q, tool, (slider, scaling) = values[0], values[1:7], values[7:13], values[13:15]
        return cls(stamp, np.array(q), np.array(tool), min(max(slider * scaling, 0.0), 1.0), *values[15:])


class Rtde:
    """One connection. Opening it takes up to `timeout` and raises; after that nothing waits and nothing raises.

    Args:
        host, port: of the controller.
        inputs: names of what will be written; none for a connection that changes nothing on the controller.
        timeout: for the whole opening [s].

    Attributes:
        version: of the controller's software; rate: of its cycles [Hz].

    Raises:
        ArmError: nobody is there, or speaks another protocol, or a name is unknown or already written by another.
    """

    def __init__(self, host: str, port: int = PORT, inputs: Sequence[str] = (), timeout: float = 2.0) -> None:
        self._where, self._rest = f"{host}:{port}", b""
        self._deadline = time.monotonic() + timeout
        try:
            self._socket: socket.socket | None = socket.create_connection((host, port), timeout)
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
        return self._socket is None

    def close(self) -> None:
        """Ends it; also twice."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def wait(self, seconds: float) -> None:
        """Until something has come, or so long."""
        if self._socket is None:
            time.sleep(seconds)
        else:
            select.select([self._socket], [], [], seconds)

    def readings(self) -> list[Reading]:
        """What has come since the last call, oldest first."""
        for _ in range(8):
            try:
                content = self._socket.recv(AT_ONCE) if self._socket else b""
            except BlockingIOError:
                break
            except OSError:
                content = b""
            if not content:
                self.close()
                break
            self._rest += content
            if len(content) < AT_ONCE:
                break
        found = []
        for kind, payload in self._packages():
            if kind == b"U" and len(payload) == self._outputs.size and payload[0] == self._recipe_id:
                values = self._outputs.unpack(payload)[1:]
                if math.isfinite(sum(values)) and abs(values[0]) < LONGEST:
                    found.append(Reading.of(values))
        return found

    def send(self, *values: int | float) -> None:
        """Writes the inputs, whole or not at all; a controller that takes nothing any more is lost."""
        if self._socket is None or self._inputs is None:
            return
        try:
            payload = self._inputs.pack(self._inputs_id, *values)
            package = _HEADER.pack(_HEADER.size + len(payload), ord("U")) + payload
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
        assert self._socket is not None
        self._socket.sendall(_HEADER.pack(_HEADER.size + len(payload), ord(question)) + payload)
        while self._socket is not None and (left := self._deadline - time.monotonic()) > 0:
            self._socket.settimeout(left)
            content = self._socket.recv(AT_ONCE)
            self._rest += content
            for kind, answer in list(self._packages()):
                if kind == question:
                    return answer
            if not content:
                break
        raise ArmError(f"{self._where}: does not answer as RTDE")

    def _recipe(self, kind: bytes, names: Sequence[str], before: bytes = b"") -> struct.Struct:
        """Agrees on what is sent, or written."""
        answer = self._ask(kind, before + ",".join(names).encode())
        types = answer[1:].decode("ascii", "replace").split(",")
        wrong = [f"{name} ({each})" for name, each in zip(names, types, strict=False) if each not in _TYPES]
        if wrong or len(types) != len(names):
            raise ArmError(f"{self._where}: does not give {', '.join(wrong) or 'what it is asked for'}")
        recipe = struct.Struct(">B" + "".join(_TYPES[each] for each in types))
        if len(recipe.unpack(bytes(recipe.size))) != 1 + sum(6 if name in _VECTORS else 1 for name in names):
            raise ArmError(f"{self._where}: gives {', '.join(map(' as '.join, zip(names, types, strict=True)))}")
        if kind == b"O":
            self._recipe_id = answer[0]
        else:
            self._inputs_id = answer[0]
        return recipe
