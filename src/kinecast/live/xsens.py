"""Skeletons from Xsens MVN's network streamer, as it sends them by UDP.

Source: MVN real-time network streaming protocol specification, revision N (Xsens, 2018); numbers are its sections.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from msgspec import Meta

from kinecast.body.skeleton import XSENS_23
from kinecast.geometry.transforms import from_y_up
from kinecast.live.mailbox import Feed
from kinecast.live.message import FARTHEST, MessageError
from kinecast.live.sender_guard import FORGET, MOST_PERSONS, SenderGuard
from kinecast.types import SkeletonFrame

DEFAULT_PORT = 9763  # MVN sends to this one unless told otherwise (2.3)
BODY = 23  # segments with the ids 1 to 23 are the body (3.1); what follows are props and fingers
MOST_PENDING = 3  # samples of a character that wait for their other datagrams
REORDERED = 64
"""A sample at most so far behind the newest was overtaken on its way; one farther behind is of a new beginning."""
CENTIMETRES = 3.0
"""An upper arm beyond this is in cm. The specification says cm for all (2.5.6); with quaternions m have been seen."""

# 2.4.1: id, type, sample, datagram, items, time code, character, segments, props, fingers, reserved, payload's size
_HEADER = struct.Struct(">4s2sIBBIBBBBHH")
_LAST = 0x80
_EULER, _QUATERNION = 1, 2
_POSES = {
    _EULER: np.dtype([("segment", ">u4"), ("position", ">f4", 3), ("rotation", ">f4", 3)]),  # 2.5.2
    _QUATERNION: np.dtype([("segment", ">u4"), ("position", ">f4", 3), ("rotation", ">f4", 4)]),  # 2.5.3
}
_NO_POSES = frozenset((10, 11, 12, 13, 20, 21, 22, 23, 24, 25))
"""Names, scales, angles, speeds, times: streamed beside the pose, not needed."""
_UPPER_ARMS = np.array(
    [[XSENS_23.joints.index(f"{side}_{joint}") for joint in ("shoulder", "elbow")] for side in ("left", "right")]
)


@dataclass(frozen=True)
class XsensOptions:
    """What MVN's datagrams leave open."""

    person: Annotated[int, Meta(ge=0, le=255)] | None = None  # the only character to take; None for all
    up: Literal["z", "y"] | None = (
        None  # as chosen in MVN; None for its default: y with Euler angles, z with quaternions
    )
    stamps: Literal["code", "arrival"] = "code"  # what a frame's stamp is; time codes of some senders stand still


class _Datagram(NamedTuple):
    """A pose, or a part of one: origins of body segments 0..22 in the sender's unit and axes, NaN if not finite."""

    kind: int
    sample: int
    part: int
    last: bool
    milliseconds: int
    character: int
    segments: Int[np.ndarray, " N"]
    positions: Float[np.ndarray, "N 3"]


def _read(content: bytes) -> _Datagram | None:
    """What a datagram holds; None where it is one that holds no pose."""
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
    body = table[(table["segment"] >= 1) & (table["segment"] <= BODY)]
    segments = body["segment"].astype(np.intp) - 1
    if len(np.unique(segments)) < len(segments):
        raise MessageError(f"sample {sample} has a segment twice")
    with np.errstate(invalid="ignore"):  # a NaN may be a signalling one
        positions = body["position"].astype(np.float64)
    positions[~np.isfinite(positions).all(axis=1)] = np.nan
    last = bool(counter & _LAST)
    return _Datagram(kind, sample, counter & ~_LAST, last, milliseconds, character, segments, positions)


class _Character:
    """One character's samples as they become whole."""

    def __init__(self, kind: int) -> None:
        self.kind = kind
        self.heard = 0.0
        self.scale = 1.0
        self.milliseconds: int | None = None
        self.pending: dict[int, dict[int, _Datagram]] = {}  # parts, by sample
        self._out: deque[int] = deque(maxlen=8)

    def add(self, new: _Datagram) -> tuple[list[_Datagram], int]:
        """Takes in a part; all parts of the sample that goes out now, and how many samples never will.

        A sample goes out once no segment of the body can come any more: fingers and props are not waited for.
        """
        number = new.sample
        if number in self._out:
            return [], 0  # sent twice, or fingers of a body that is out
        if self._out and _ahead(self._out[-1], number) <= REORDERED:
            raise MessageError(f"sample {number} came after sample {self._out[-1]}")
        parts = self.pending.setdefault(number, {})
        for other in parts.values():
            if other.milliseconds != new.milliseconds:
                raise MessageError(f"sample {number} has two time codes")
            if other.part != new.part and np.isin(other.segments, new.segments).any():
                raise MessageError(f"sample {number} has a segment twice")
        parts.setdefault(new.part, new)
        lost = 0
        whole = sum(len(each.segments) for each in parts.values()) == BODY
        if whole or any(each.last and each.part + 1 == len(parts) for each in parts.values()):
            kept = {k: other for k, other in self.pending.items() if k != number and _ahead(k, number) <= REORDERED}
            lost = len(self.pending) - 1 - len(kept)
            self.pending = kept
        elif len(self.pending) > MOST_PENDING:
            number = next(iter(self.pending))
            parts = self.pending.pop(number)
        else:
            return [], 0
        self._out.append(number)
        return list(parts.values()), lost


def _ahead(number: int, other: int) -> int:
    """How far a sample's number is ahead of another's; the counter has 32 bits."""
    return (number - other) % (1 << 32)


class XsensGuard(SenderGuard):
    """Takes the datagrams of every sender to one port; whatever comes, nothing is raised.

    Frames are of Xsens 23, one as soon as its whole body is there, or once its rest is not waited for any more: what
    did not come is not seen (NaN) then. A person is named by the character's number.
    """

    def __init__(self, feed: Feed, options: XsensOptions) -> None:
        super().__init__(feed)
        self._options = options
        self.characters: dict[tuple[Hashable, int], _Character] = {}

    def take(self, content: bytes | str, sender: Hashable, arrived: float) -> None:
        """One datagram; types that hold no pose, and characters that are not wanted, are passed over."""
        try:
            datagram = _read(content if isinstance(content, bytes) else content.encode())
            if datagram is None or self._options.person not in (None, datagram.character):
                return
            character = self._character((sender, datagram.character), datagram.kind, arrived)
            if character.kind != datagram.kind:
                return  # the same pose, said in another way
            parts, lost = character.add(datagram)
            for _ in range(lost):
                self._feed.refuse("a sample is incomplete: a datagram was lost")
            if parts:
                self.admit(self._frame(character, parts, arrived), sender, arrived)
        except MessageError as problem:
            self._feed.refuse(str(problem))

    def _character(self, key: tuple[Hashable, int], kind: int, arrived: float) -> _Character:
        """Who it is; a new one takes the place of one that is silent."""
        if key not in self.characters or arrived - self.characters[key].heard >= FORGET:
            kept = {known: each for known, each in self.characters.items() if arrived - each.heard < FORGET}
            if len(kept) >= MOST_PERSONS:
                raise MessageError(f"more than {MOST_PERSONS} characters")
            self.characters = {**kept, key: _Character(kind)}
        self.characters[key].heard = arrived
        return self.characters[key]

    def _frame(self, character: _Character, parts: list[_Datagram], arrived: float) -> SkeletonFrame:
        milliseconds = parts[0].milliseconds
        by_arrival = self._options.stamps == "arrival"
        if not by_arrival and milliseconds == character.milliseconds:
            raise MessageError("the time code stands still; ?stamps=arrival takes frames as they come")
        character.milliseconds = milliseconds
        positions = np.full((BODY, 3), np.nan)
        for each in parts:
            positions[each.segments] = each.positions
        lengths = np.linalg.norm(np.diff(positions[_UPPER_ARMS], axis=1), axis=2)
        if np.isfinite(lengths).any():
            character.scale = 0.01 if np.nanmax(lengths) > CENTIMETRES else 1.0
        positions *= character.scale
        farthest = np.abs(positions).max(initial=0.0, where=np.isfinite(positions))
        if farthest > FARTHEST:
            raise MessageError(f"a segment is {farthest:.3g} m away, at most {FARTHEST:g} m is taken")
        if self._options.up == "y" or (self._options.up is None and character.kind == _EULER):
            positions = from_y_up(positions)
        stamp = arrived if by_arrival else milliseconds / 1000
        return SkeletonFrame(stamp, XSENS_23.joints, positions, str(parts[0].character))
