"""One person as they come over a network, JSON or msgpack: the schema in docs/live.md, and what is refused."""

from __future__ import annotations

from functools import lru_cache

import msgspec
import numpy as np
from jaxtyping import Float

from kinecast.body.skeleton import JOINTS, SKELETONS, Skeleton, require_arms
from kinecast.errors import DatasetError
from kinecast.live.detection import Detection
from kinecast.types import SkeletonFrame

LARGEST_MESSAGE = 65_536  # bytes of one message; 33 joints as JSON take about 3000
MOST_JOINTS = 128
LONGEST_NAME = 64  # characters of a joint's, person's or coordinate frame's name
LONGEST_QUOTE = 200  # characters of what a message is quoted with in the log
LATEST_STAMP = 1e11
"""Largest believable stamp [s]: Unix time in seconds is 1.8e9, in milliseconds 1.8e12, in nanoseconds 1.8e18."""
FARTHEST = 10_000.0  # largest believable coordinate [m], as in recordings


class MessageError(ValueError):
    """A message that is nobody; the text says what was found and what is allowed."""


class SkeletonMessage(msgspec.Struct, gc=False):
    """The fields of a message; unknown ones are passed over."""

    stamp: float
    positions: list[list[float | None]] | None = None
    pixels: list[list[float | None] | None] | None = None
    joints: list[str] | None = None
    skeleton: str | None = None
    person: str | int = "0"
    frame_id: str = "world"
    std: list[float | None] | None = None
    camera: str = ""
    pixel_std: list[float | None] | None = None
    depth: list[float | None] | None = None
    depth_std: list[float | None] | None = None
    confidence: list[float | None] | None = None


_JSON = msgspec.json.Decoder(SkeletonMessage)
_MSGPACK = msgspec.msgpack.Decoder(SkeletonMessage)
_SKELETONS = {skeleton.name: skeleton for skeleton in SKELETONS}
_CANONICAL = Skeleton("kinecast", JOINTS, {joint: joint for joint in JOINTS})


def decode(content: bytes | str) -> SkeletonFrame | Detection:
    """A person from a message: a skeleton, or where one camera sees their joints.

    Args:
        content: JSON where the first character is `{`, else msgpack. At most `LARGEST_MESSAGE` bytes.

    Returns:
        The frame, or the view where there are pixels; joints that kinecast has no name for are left out, one with a
        coordinate that is null or not finite is not seen (NaN).

    Raises:
        MessageError: anything else is wrong with it, and nothing else is ever raised.
    """
    raw = content.encode("utf-8", "replace") if isinstance(content, str) else content
    if len(raw) > LARGEST_MESSAGE:
        raise MessageError(f"{len(raw)} bytes, at most {LARGEST_MESSAGE} are taken")
    try:
        message = (_JSON if raw[:64].lstrip()[:1] == b"{" else _MSGPACK).decode(raw)
    except (msgspec.MsgspecError, ValueError, OverflowError, RecursionError) as error:
        raise MessageError(_short(str(error) or type(error).__name__)) from None
    return person_of(message)


def person_of(message: SkeletonMessage) -> SkeletonFrame | Detection:
    """The person whom a message's fields describe; see `decode`."""
    if not abs(message.stamp) <= LATEST_STAMP:
        raise MessageError(f"stamp {message.stamp:g} is no time in seconds")
    if (message.positions is None) == (message.pixels is None):
        raise MessageError("expected either positions or pixels")
    return skeleton_frame(message) if message.pixels is None else _detection(message, message.pixels)


def skeleton_frame(message: SkeletonMessage) -> SkeletonFrame:
    """The frame that a message's positions describe; a MessageError where they describe none. See `decode`."""
    rows = message.positions or []
    columns, joints = _columns(message, len(rows))
    if any(len(rows[column]) != 3 for column in columns):
        raise MessageError("a position is not three numbers")
    positions = np.array([rows[column] for column in columns], dtype=np.float64)  # None is NaN
    farthest = np.abs(positions).max(initial=0.0, where=np.isfinite(positions))
    if farthest > FARTHEST:
        raise MessageError(f"a position is {farthest:.3g} m away, at most {FARTHEST:g} m is taken")
    positions[~np.isfinite(positions).all(axis=1)] = np.nan
    std = None if message.std is None else _of_each("std", message.std, len(rows))[columns]
    if std is not None and (std < 0).any():
        raise MessageError("std is below 0")
    person, frame_id = name_in("person", str(message.person)), name_in("frame_id", message.frame_id)
    return SkeletonFrame(float(message.stamp), joints, positions, person, frame_id, std)


def _detection(message: SkeletonMessage, rows: list[list[float | None] | None]) -> Detection:
    columns, joints = _columns(message, len(rows))
    if any(row is not None and len(row) != 2 for row in rows):
        raise MessageError("a pixel is not two numbers")
    pixels = np.array([row or (None, None) for row in rows], dtype=np.float64)
    said = {name: getattr(message, name) for name in ("pixel_std", "depth", "depth_std", "confidence")}
    unsaid = {name: [1.0 if name == "confidence" else None] * len(rows) for name, each in said.items() if each is None}
    each = {name: _of_each(name, values, len(rows))[columns] for name, values in (said | unsaid).items()}
    camera = name_in("camera", message.camera) if message.camera else ""
    person = name_in("person", str(message.person))
    return Detection(float(message.stamp), camera, joints, pixels[columns], **each, person=person)


def _of_each(name: str, values: list[float | None], rows: int) -> Float[np.ndarray, " N"]:
    """A field with one number for each row; null is NaN."""
    if len(values) != rows:
        raise MessageError(f"{len(values)} {name} for {rows} rows")
    return np.array(values, dtype=np.float64)


def _columns(message: SkeletonMessage, rows: int) -> tuple[list[int], tuple[str, ...]]:
    """Which rows are used, and the canonical names of their joints."""
    if rows > MOST_JOINTS:
        raise MessageError(f"{rows} rows, at most {MOST_JOINTS} are taken")
    return _known_columns(message.skeleton, None if message.joints is None else tuple(message.joints), rows)


@lru_cache(maxsize=64)
def _known_columns(skeleton: str | None, names: tuple[str, ...] | None, rows: int) -> tuple[list[int], tuple[str, ...]]:
    if skeleton is not None and skeleton not in _SKELETONS:
        raise MessageError(f"skeleton {_short(skeleton)!r} is unknown; known are {', '.join(_SKELETONS)}")
    if names is None and skeleton is None:
        raise MessageError("neither joints nor skeleton say which joint each row is of")
    known = _CANONICAL if skeleton is None else _SKELETONS[skeleton]
    canonical = known.joints if names is None else tuple(known.find(name_in("joint", name)) for name in names)
    if len(canonical) != rows:
        raise MessageError(f"{rows} rows for {len(canonical)} joints")
    used = {column: joint for column, joint in enumerate(canonical) if joint is not None}
    joints = tuple(used.values())
    if len(set(joints)) < len(joints):
        raise MessageError(f"joint {next(joint for joint in joints if joints.count(joint) > 1)} is there twice")
    try:
        require_arms(joints, "joints")
    except DatasetError as error:
        raise MessageError(_short(str(error))) from None
    return list(used), joints


def name_in(field: str, text: str) -> str:
    """A name as it was sent; a MessageError where it is none."""
    if not 0 < len(text) <= LONGEST_NAME or not text.isprintable():
        raise MessageError(f"{field} {_short(text)!r}: 1 to {LONGEST_NAME} printable characters are taken")
    return text


def _short(text: str) -> str:
    """Fit for a line in a log, whatever was sent."""
    line = "".join(letter if letter.isprintable() else "?" for letter in text[:LONGEST_QUOTE])
    return line if len(text) <= LONGEST_QUOTE else f"{line}…"
