"""One datagram of Xsens MVN's network streamer: what it holds, and what is refused.

Source: MVN real-time network streaming protocol specification, revision N (Xsens, 2018); numbers are its sections.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from kinecast.live.message import MessageError

__all__ = ["BODY_SEGMENTS", "EULER", "MOST_CHARACTERS", "QUATERNION", "Datagram", "read"]

BODY_SEGMENTS = 23
"""Segments with the ids 1 to 23 are the body (3.1); what follows are props and fingers."""
MOST_CHARACTERS = 256
EULER, QUATERNION = 1, 2
"""Types of datagram that hold absolute positions (2.4.1.1)."""

# 2.4.1: id, type, sample, datagram, items, time code, character, segments, props, fingers, reserved, payload's size
_HEADER = struct.Struct(">4s2sIBBIBBBBHH")
_LAST = 0x80
_POSES = {
    EULER: np.dtype([("segment", ">u4"), ("position", ">f4", 3), ("rotation", ">f4", 3)]),  # 2.5.2
    QUATERNION: np.dtype([("segment", ">u4"), ("position", ">f4", 3), ("rotation", ">f4", 4)]),  # 2.5.3
}
_NO_POSES = frozenset((10, 11, 12, 13, 20, 21, 22, 23, 24, 25))
"""Names, scales, angles, speeds, times: streamed beside the pose, not needed."""


@dataclass(frozen=True)
class Datagram:
    """A pose, or a part of one.

    Attributes:
        kind: EULER or QUATERNION.
        sample: number of the instant.
        index: which part of the sample it is, from 0.
        last: whether no other part comes after it.
        milliseconds: since the recording's start.
        character: number of the person.
        segments: index of each body segment in it, 0..22, each once.
        positions: (N, 3) origin of each, in the sender's unit and axes; NaN where it is not finite.
    """

    kind: int
    sample: int
    index: int
    last: bool
    milliseconds: int
    character: int
    segments: tuple[int, ...]
    positions: Float[np.ndarray, "N 3"]


def read(content: bytes) -> Datagram | None:
    """What a datagram holds; None where it is one that holds no pose.

    Raises:
        MessageError: it is no datagram of MVN's, or not whole, or says no absolute positions.
    """
    if len(content) < _HEADER.size or content[:4] != b"MXTP" or not content[4:6].isdigit():
        raise MessageError(f"{len(content)} bytes are no datagram of MVN's")
    _, digits, sample, counter, items, milliseconds, character, *_, size = _HEADER.unpack_from(content)
    kind = int(digits)
    if kind in _NO_POSES:
        return None
    if kind not in _POSES:
        raise MessageError(f"type {kind:02d}: choose position and orientation (quaternion) in MVN's network streamer")
    layout, payload = _POSES[kind], content[_HEADER.size :]
    if len(payload) != items * layout.itemsize or size not in (0, len(payload)):  # 0 is of MVN before 2019
        raise MessageError(f"{len(payload)} bytes for {items} segments of {layout.itemsize} bytes, said to be {size}")
    table = np.frombuffer(payload, layout)
    body = table[(table["segment"] >= 1) & (table["segment"] <= BODY_SEGMENTS)]
    segments = tuple(int(segment) - 1 for segment in body["segment"])
    if len(set(segments)) < len(segments):
        raise MessageError(f"sample {sample} has a segment twice")
    with np.errstate(invalid="ignore"):  # a NaN may be a signalling one
        positions = body["position"].astype(np.float64)
    positions[~np.isfinite(positions).all(axis=1)] = np.nan
    last = bool(counter & _LAST)
    return Datagram(kind, sample, counter & ~_LAST, last, milliseconds, character, segments, positions)
