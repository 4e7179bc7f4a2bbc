"""A made-up person, and files of the person in the exact form of each format."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from kinecast.body.skeleton import AZURE_KINECT_32, VICON, XSENS_23

_BODY = {
    "pelvis": (0.0, 0.0, 1.0), "spine": (0.0, 0.0, 1.15), "chest": (0.0, 0.0, 1.3), "neck": (0.0, 0.0, 1.5),
    "head": (0.05, 0.0, 1.6), "collar": (0.05, 0.0, 1.45),
    "left_shoulder": (0.0, 0.2, 1.45), "left_elbow": (0.05, 0.24, 1.17), "left_wrist": (0.25, 0.2, 1.1),
    "right_shoulder": (0.0, -0.2, 1.45), "right_elbow": (0.0, -0.25, 1.16), "right_wrist": (0.22, -0.2, 1.05),
}  # fmt: skip


@pytest.fixture(scope="session")
def motion() -> Callable[[Sequence[str], int], np.ndarray]:
    """motion(joints, frames) → (frames, joints, 3) positions [m], z up, to the micrometre."""

    def make(joints: Sequence[str], frames: int = 8) -> np.ndarray:
        rng = np.random.default_rng(0)
        base = np.array([_BODY.get(joint, tuple(rng.uniform(0.0, 1.0, 3))) for joint in joints])
        sway = np.cumsum(rng.normal(0.0, 0.01, (frames, 1, 3)), axis=0)
        return np.round(base + sway, 6)

    return make


@pytest.fixture(scope="session")
def vicon_text(motion: Callable[..., np.ndarray]) -> Callable[..., str]:
    """vicon_text(...) → a Vicon Tracker csv of the given objects; positions and rate can be overridden."""

    def make(
        objects: Sequence[str] = tuple(VICON.aliases),
        positions: np.ndarray | None = None,
        rate: str = "100",
        units: str = "mm",
        frames: int = 8,
    ) -> str:
        if positions is None:
            positions = motion([VICON.find(name) or name for name in objects], frames)
        lines = [
            "\ufeffObjects",
            rate,
            ",," + "".join(f"Global Angle {name}:{name},,,,,," for name in objects),
            ",".join(["Frame", "Sub Frame"] + ["RX", "RY", "RZ", "TX", "TY", "TZ"] * len(objects)),
            ",".join(["", ""] + (["rad"] * 3 + [units] * 3) * len(objects)),
        ]
        for number, frame in enumerate(positions, 1):
            cells = [str(number), "0"]
            for point in frame * 1000.0:
                seen = np.isfinite(point).all()
                cells += ["0.100000", "-0.200000", "0.300000", *(f"{x:.6f}" for x in point)] if seen else [""] * 6
            lines.append(",".join(cells))
        return "\n".join(lines) + "\n"

    return make


@pytest.fixture(scope="session")
def write_ha4m(motion: Callable[..., np.ndarray]) -> Callable[..., np.ndarray]:
    """write_ha4m(folder, frames) → a raw HA4M clip of one camera; returns its positions in world axes [m]."""

    def make(
        folder: Path, frames: Sequence[int] = range(10, 18), bodies: Sequence[int] = (1,), camera: str = "Camera0"
    ) -> np.ndarray:
        positions = motion(AZURE_KINECT_32.joints, len(frames))
        place = folder / "Skeletons" / camera
        place.mkdir(parents=True)
        for number, frame in zip(frames, positions, strict=True):
            lines = ["\t".join(f"Column{column}" for column in range(14))]
            for body in bodies:
                for joint, (x, y, z) in enumerate(frame + 0.5 * (body - bodies[0])):
                    camera_axes = [f"{value * 1000.0:.4f}" for value in (x, -z, y)]
                    cells = [str(body), str(joint), "2", *camera_axes, "1", "0", "0", "0", "10", "20", "30", "40"]
                    lines.append("\t".join(cells))
            (place / f"FrameID{number}_{number * 33333}.txt").write_text("\n".join(lines) + "\n")
        return positions

    return make


@pytest.fixture(scope="session")
def mvnx_text(motion: Callable[..., np.ndarray]) -> Callable[..., str]:
    """mvnx_text(version) → an Xsens MVNX document: that version's calibration frames, then 8 normal ones."""

    def make(
        version: int = 3,
        segments: Sequence[str] = tuple(XSENS_23.aliases),
        positions: np.ndarray | None = None,
        rate: str = "240",
        before: str = "",
    ) -> str:
        if positions is None:
            positions = motion([XSENS_23.find(name) or name for name in segments], 8)

        def frame(kind: str, index: str, points: np.ndarray) -> str:
            time = round(1000 * int(index or 0) / 240)
            numbers = " ".join(f"{value:.6f}" for value in points.ravel())
            turns = " ".join(["1.0 0.0 0.0 0.0"] * len(segments))
            return (
                f'<frame time="{time}" index="{index}" tc="00:00:00:00" ms="0" type="{kind}">'
                f"<orientation>{turns}</orientation><position>{numbers}</position>"
                f"<velocity>{numbers}</velocity></frame>"
            )

        still = np.full((len(segments), 3), 9.0)
        poses = ("npose", "tpose") if version == 3 else ("identity", "tpose", "tpose-isb")
        tags = "".join(
            f'<segment label="{name}" id="{number}">'
            '<points><point label="p"><pos_b>7 7 7</pos_b></point></points></segment>'
            for number, name in enumerate(segments, 1)
        )
        frames = "".join(frame(kind, "", still) for kind in poses)
        frames += "\n".join(frame("normal", str(index), points) for index, points in enumerate(positions))
        return (
            f'<?xml version="1.0" encoding="UTF-8"?>\n{before}'
            f'<mvnx xmlns="http://www.xsens.com/mvn/mvnx" version="{version}">\n'
            f'<subject label="Suit" frameRate="{rate}" segmentCount="{len(segments)}">\n'
            f"<segments>{tags}</segments>\n"
            f"<frames>\n{frames}\n</frames>\n</subject>\n</mvnx>\n"
        )

    return make
