"""BVH: positions against forward kinematics by homogeneous matrices."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinecast.datasets import bvh
from kinecast.errors import DatasetError, OptionError

# A spine and two arms: (name, parent, offset [cm], channels).
FOREARM = [
    ("Hips", None, (0, 0, 0), "Xposition Yposition Zposition Zrotation Yrotation Xrotation"),
    ("Spine", "Hips", (0, 12, 1), "Zrotation Xrotation Yrotation"),
    ("LeftShoulder", "Spine", (4, 30, 0), "Zrotation Xrotation Yrotation"),
    ("LeftArm", "LeftShoulder", (14, 1, 0), "Xrotation Yrotation Zrotation"),
    ("LeftForeArm", "LeftArm", (28, 0, 1), "Yrotation Zrotation Xrotation"),
    ("LeftHand", "LeftForeArm", (25, 0, 0), "Zrotation"),
    ("LeftHandIndex1", "LeftHand", (8, 0, 0), "Zrotation"),
    ("RightShoulder", "Spine", (-4, 30, 0), "Zrotation Xrotation Yrotation"),
    ("RightArm", "RightShoulder", (-14, 1, 0), "Xrotation Yrotation Zrotation"),
    ("RightForeArm", "RightArm", (-28, 0, 1), "Yrotation Zrotation Xrotation"),
    ("RightHand", "RightForeArm", (-25, 0, 0), "Xposition Yposition Zposition Zrotation Xrotation Yrotation"),
]
COLLAR = {"Shoulder": "Collar", "Arm": "Shoulder", "ForeArm": "Elbow", "Hand": "Wrist"}
CHANNELS = sum(len(channels.split()) for *_, channels in FOREARM)


def motion(frames: int = 6) -> np.ndarray:
    table = np.random.default_rng(0).uniform(-60, 60, (frames, CHANNELS))
    table[:, :3] += [10, 95, -20]
    table[:, -6:-3] = [-25.5, 0, 0]
    return np.round(table, 4)


def text(table: np.ndarray, joints: list[tuple] = FOREARM, newline: str = "\n") -> str:
    lines = ["HIERARCHY"]

    def add(name: str, depth: int) -> None:
        _, parent, offset, channels = next(joint for joint in joints if joint[0] == name)
        children = [child for child, of, *_ in joints if of == name]
        tab = "\t" * depth
        lines.extend([f"{tab}{'JOINT' if parent else 'ROOT'} {name}", f"{tab}{{"])
        lines.append(f"{tab}\tOFFSET {offset[0]} {offset[1]} {offset[2]}")
        lines.append(f"{tab}\tCHANNELS {len(channels.split())} {channels}")
        for child in children:
            add(child, depth + 1)
        if not children:
            lines.extend([f"{tab}\tEnd Site", f"{tab}\t{{", f"{tab}\t\tOFFSET 1 0 0", f"{tab}\t}}"])
        lines.append(f"{tab}}}")

    add(joints[0][0], 0)
    lines += ["MOTION", f"Frames: {len(table)}", "Frame Time: 0.00833333"]
    lines += [" ".join(map(str, row)) + " " for row in table]
    return newline.join(lines) + newline


def expected(table: np.ndarray) -> dict[str, np.ndarray]:
    """(N, 3) positions of every joint in the file's unit and axes, one matrix product at a time."""
    positions: dict[str, list[np.ndarray]] = {name: [] for name, *_ in FOREARM}
    for row in table:
        values = iter(row)
        worlds: dict[str | None, np.ndarray] = {None: np.eye(4)}
        for name, parent, offset, channels in FOREARM:
            local = np.eye(4)
            local[:3, 3] = offset
            for channel in channels.split():
                axis, value = "XYZ".index(channel[0]), next(values)
                if channel.endswith("position"):
                    local[axis, 3] = value
                else:
                    c, s = np.cos(np.radians(value)), np.sin(np.radians(value))
                    turn = np.eye(4)
                    i, j = (axis + 1) % 3, (axis + 2) % 3
                    turn[i, i] = turn[j, j] = c
                    turn[i, j], turn[j, i] = -s, s
                    local = local @ turn
            worlds[name] = worlds[parent] @ local
            positions[name].append(worlds[name][:3, 3])
    return {name: np.array(points) for name, points in positions.items()}


def test_forward_kinematics_units_and_axes(tmp_path: Path) -> None:
    path = tmp_path / "walk.bvh"
    table = motion()
    path.write_text(text(table))
    assert bvh.matches(path)
    (recording,) = bvh.load(path)
    assert recording.name == "walk"
    assert recording.rate == pytest.approx(120.0, rel=1e-5)
    assert recording.notes == ("1 joints of other names left out",)
    points = expected(table)
    names = {
        "Hips": "pelvis", "Spine": "spine", "LeftShoulder": "left_clavicle", "LeftArm": "left_shoulder",
        "LeftForeArm": "left_elbow", "LeftHand": "left_wrist", "RightHand": "right_wrist",
    }  # fmt: skip
    for source, joint in names.items():
        x, y, z = points[source].T / 100.0
        np.testing.assert_allclose(recording.joint(joint), np.stack([x, -z, y], axis=-1), atol=1e-12)
    (z_up,) = bvh.load(path, metres_per_unit=0.5, up="z")
    np.testing.assert_allclose(z_up.joint("left_wrist"), points["LeftHand"] * 0.5, atol=1e-10)


def test_the_other_way_of_naming_prefixes_and_line_ends(tmp_path: Path) -> None:
    def renamed(name: str | None) -> str | None:
        if name is None:
            return None
        for side in ("Left", "Right"):
            name = (
                f"{side}{COLLAR[name.removeprefix(side)]}"
                if name.removeprefix(side) in COLLAR and name.startswith(side)
                else name
            )
        return f"person1:{name}"

    table = motion()
    joints = [(renamed(name), renamed(parent), offset, channels) for name, parent, offset, channels in FOREARM]
    plain, other = tmp_path / "a.bvh", tmp_path / "b.bvh"
    plain.write_text(text(table))
    other.write_bytes(text(table, joints, "\r\n").encode())
    (first,), (second,) = bvh.load(plain), bvh.load(other)
    for joint in ("left_clavicle", "left_shoulder", "left_elbow", "left_wrist", "right_wrist"):
        np.testing.assert_array_equal(second.joint(joint), first.joint(joint))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("CHANNELS 6 ", "CHANNELS 5 ", r"a\.bvh, line 5: found 'CHANNELS 5"),
        ("Zrotation Yrotation Xrotation\n", "Zrotation Zrotation Xrotation\n", r"line 5: found 'CHANNELS 6"),
        ("OFFSET 0 12 1", "OFFSET 0 far 1", r"line 8: offset is 'far', expected a number"),
        ("OFFSET 0 12 1", "OFFSET 0 12", r"line 8: found 'OFFSET 0 12'"),
        ("JOINT Spine", "ROOT Spine", r"line 6: a second ROOT"),
        ("MOTION", "}\nMOTION", r"found '}'"),
        ("MOTION", "NOTHING", r"no line MOTION"),
        ("Frames: 6", "Frames: 7", r"6 frames of motion, but line \d+ says 7"),
        ("Frame Time: 0.00833333", "Frame Time: 0", r"frame time is 0.0 s, expected more than 0"),
        ("Frame Time: 0.00833333", "Time: 1", r"expected the lines 'Frames: <N>'"),
        ("LeftForeArm", "LeftTentacle", r"no known names of both arms' joints; .*LeftTentacle"),
        ("95", "ninety", r"a\.bvh, line \d+: column \d+ is .*ninety"),
    ],
)  # fmt: skip
def test_a_spoilt_file_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    table = motion()
    table[0, 1] = 95
    path = tmp_path / "a.bvh"
    good = text(table)
    assert old in good
    path.write_text(good.replace(old, new, 1))
    with pytest.raises(DatasetError, match=message):
        bvh.load(path)


def test_a_truncated_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.bvh"
    good = text(motion())
    for end in (good.index("MOTION") + 6, good.index("Frame Time"), good.rindex(" ", 0, -20)):
        path.write_text(good[:end])
        with pytest.raises(DatasetError):
            bvh.load(path)


@pytest.mark.parametrize(("unit", "up"), [(0.0, "y"), (-1.0, "y"), (float("nan"), "y"), (1.0, "x")])
def test_options_are_checked(tmp_path: Path, unit: float, up: str) -> None:
    with pytest.raises(OptionError, match="metres_per_unit"):
        bvh.load(tmp_path / "a.bvh", unit, up)
