"""BVH motion files: a hierarchy of joints and their rotations, turned into positions."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from jaxtyping import Float

from kinecast.body.skeleton import ARM_JOINTS, BVH_COLLAR, BVH_FOREARM
from kinecast.datasets.files import MOST_POINTS, base_name, head, number, read_bytes, rows
from kinecast.datasets.recording import Recording
from kinecast.errors import DatasetError, OptionError
from kinecast.geometry.transforms import from_y_up

_CHANNELS = {f"{axis}{kind}" for axis in "XYZ" for kind in ("position", "rotation")}
_MOST_JOINTS = 1000


@dataclass
class _Joint:
    """One joint of the hierarchy, or the end of a chain (no name)."""

    name: str
    depth: int
    offset: tuple[float, ...] = (0.0, 0.0, 0.0)
    channels: list[str] = field(default_factory=list)


def matches(path: Path) -> bool:
    """Whether a file opens with the word HIERARCHY."""
    return path.is_file() and head(path).lstrip().startswith(b"HIERARCHY")


def load(path: Path, metres_per_unit: float = 0.01, up: str = "y") -> list[Recording]:
    """One motion, named as its file, of the joints whose names are known; the notes say how many are left out.

    The file does not state its unit [m] and its vertical axis, `y` or `z`: most are in centimetres, y up. An
    OptionError where they are none.
    """
    if not (0 < metres_per_unit <= 1000 and up in ("y", "z")):
        raise OptionError(f"metres_per_unit {metres_per_unit} is outside 0..1000, or up {up!r} neither 'y' nor 'z'")
    text = read_bytes(path)
    motion = re.search(rb"(?m)^[ \t]*MOTION[ \t\r]*$", text)
    if not motion:
        raise DatasetError(path, "no line MOTION")
    joints = _hierarchy(text[: motion.start()].decode("utf-8-sig", errors="replace"), path)
    step, table = _motion(text, motion.start(), joints, path)

    named = [joint.name for joint in joints if joint.name]
    # The way of naming that fits more of the arms.
    skeleton = max((BVH_FOREARM, BVH_COLLAR), key=lambda each: len(set(map(each.find, named)) & set(ARM_JOINTS)))
    found = {joint: place for place, joint in reversed(list(enumerate(map(skeleton.find, named)))) if joint}
    if not set(ARM_JOINTS) <= set(found):
        raise DatasetError(path, f"no known names of both arms' joints; the joints are {', '.join(named)}")
    kept = {place: joint for joint, place in sorted(found.items(), key=lambda item: item[1])}
    positions = _positions(joints, table)[:, list(kept)] * metres_per_unit
    others = len(named) - len(kept)
    return [
        Recording(
            name=base_name(path),
            joints=tuple(kept.values()),
            stamps=np.arange(len(table)) * step,
            positions=from_y_up(positions) if up == "y" else positions,
            rate=1.0 / step,
            source=path,
            format="bvh",
            notes=(f"{others} joints of other names left out",) if others else (),
        )
    ]


def _hierarchy(text: str, path: Path) -> list[_Joint]:
    """Joints and chain ends, each after its parent."""
    joints: list[_Joint] = []
    depth = 0
    for line, statement in _statements(text):
        where = f"{path}, line {line}"
        match statement.split():
            case ["HIERARCHY"]:
                pass
            case ["ROOT", *_] if joints:
                raise DatasetError(where, "a second ROOT; expected one person in a file")
            case ["ROOT" | "JOINT" as kind, _, *_] if (kind == "ROOT") == (depth == 0):
                # Some exporters write the person before the joint: `mixamorig:LeftArm`.
                joints.append(_Joint(statement.split(None, 1)[1].rpartition(":")[2].strip(), depth))
            case ["End", *_]:
                joints.append(_Joint("", depth))
            case ["{"]:
                depth += 1
            case ["}"] if depth > 0:
                depth -= 1
            case ["OFFSET", x, y, z] if joints:
                joints[-1].offset = tuple(number(word, where, "offset") for word in (x, y, z))
            case ["CHANNELS", count, *channels] if (
                joints and count == str(len(set(channels))) == str(len(channels)) and _CHANNELS.issuperset(channels)
            ):
                joints[-1].channels = channels
            case _:
                raise DatasetError(where, f"found {statement[:60]!r}, which is no BVH hierarchy")
        if len(joints) > _MOST_JOINTS:
            raise DatasetError(where, f"more than {_MOST_JOINTS} joints")
    if depth or not joints:
        raise DatasetError(path, "the hierarchy is not complete: braces do not match or there is no ROOT")
    return joints


def _statements(text: str) -> list[tuple[int, str]]:
    """(line, statement) pairs; a brace is a statement by itself wherever it stands."""
    pieces = ((line, piece) for line, whole in enumerate(text.split("\n"), 1) for piece in re.split(r"([{}])", whole))
    return [(line, piece.strip()) for line, piece in pieces if piece.strip()]


def _motion(text: bytes, start: int, joints: list[_Joint], path: Path) -> tuple[float, Float[np.ndarray, "N C"]]:
    """Frame time [s] and the channel values of every frame."""
    line = text.count(b"\n", 0, start) + 1
    _, frames, frame_time, data, *_ = *text[start:].split(b"\n", 3), b"", b"", b""
    counted = re.fullmatch(rb"\s*Frames:\s*(\d+)\s*", frames)
    timed = re.fullmatch(rb"\s*Frame Time:\s*(\S+)\s*", frame_time)
    if not counted or not timed:
        raise DatasetError(f"{path}, line {line + 1}", "expected the lines 'Frames: <N>' and 'Frame Time: <seconds>'")
    step = number(timed[1].decode("utf-8", errors="replace"), f"{path}, line {line + 2}", "frame time")
    if step <= 0:
        raise DatasetError(f"{path}, line {line + 2}", f"frame time is {step} s, expected more than 0")
    columns = sum(len(joint.channels) for joint in joints)
    if not columns:
        raise DatasetError(path, "the hierarchy has no CHANNELS")
    table = rows(data, columns, path, delimiter=None, first_line=line + 3)
    if len(table) != int(counted[1]):
        raise DatasetError(path, f"{len(table)} frames of motion, but line {line + 1} says {int(counted[1])}")
    if len(table) * len(joints) > MOST_POINTS:
        raise DatasetError(path, f"{len(table)} frames of {len(joints)} joints, at most {MOST_POINTS} positions")
    return step, table


def _positions(joints: list[_Joint], table: Float[np.ndarray, "N C"]) -> Float[np.ndarray, "N J 3"]:
    """(N, J, 3) positions of the named joints, in the file's unit and axes.

    Position channels replace a joint's offset; rotation channels apply in the order they are written.
    """
    origins: list[Float[np.ndarray, "N 3"]] = []  # of the joints on the way from the root, by depth
    Rotation = scipy.spatial.transform.Rotation  # found when used: commands that read no BVH start sooner
    turns: list[Any] = []
    positions = []
    column = 0
    for joint in joints:
        del origins[joint.depth :], turns[joint.depth :]
        values = dict(zip(joint.channels, table[:, column : column + len(joint.channels)].T, strict=True))
        column += len(joint.channels)
        offset = dict(zip("XYZ", np.tile(joint.offset, (len(table), 1)).T, strict=True))
        local = np.stack([values.get(f"{axis}position", offset[axis]) for axis in "XYZ"], axis=-1)
        order = [channel[0] for channel in joint.channels if channel.endswith("rotation")]
        turn = Rotation.identity(len(table))
        if order:
            angles = np.stack([values[f"{axis}rotation"] for axis in order], axis=-1)
            turn = Rotation.from_euler("".join(order), angles, degrees=True)
        origins.append(origins[-1] + turns[-1].apply(local) if origins else local)
        turns.append(turns[-1] * turn if turns else turn)
        if joint.name:
            positions.append(origins[-1])
    return np.stack(positions, axis=1)
