"""A rig: the cameras around a cell, each at its place, and the YAML file that holds them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from kinecast.cameras.pinhole import Intrinsics, PinholeCamera
from kinecast.errors import OptionError
from kinecast.geometry.entries import Entry, read_text
from kinecast.geometry.transforms import from_quaternion, to_quaternion, transform

MOST_CAMERAS, LONGEST_NAME = 16, 64
LARGEST_IMAGE, LARGEST_FOCAL, LARGEST_COEFFICIENT = 20e3, 1e6, 1e3  # of a rig file; the first two in pixels


@dataclass(frozen=True)
class Rig:
    """Cameras by name, each at its place in the world."""

    cameras: Mapping[str, PinholeCamera]
    frame_id: str = "world"  # name of the world's coordinate frame, z up

    def __post_init__(self) -> None:
        if not 0 < len(self.cameras) <= MOST_CAMERAS:
            raise OptionError(f"{len(self.cameras)} cameras: 1 to {MOST_CAMERAS} make a rig")

    @classmethod
    def load(cls, path: str | Path) -> Rig:
        """Reads a rig file (docs/rig.md); a DatasetError names file, entry, what was found and what is allowed."""
        return cls.from_yaml(read_text(Path(path)), path)

    @classmethod
    def from_yaml(cls, text: str, where: object = "rig") -> Rig:
        """The rig a YAML text describes, found in `where`; see `load`."""
        root = Entry.read(text, where, "frame_id", "cameras")
        frame_id = root.values.get("frame_id", "world")
        if not isinstance(frame_id, str) or not _is_name(frame_id):
            raise root.error(f"expected a name of 1 to {LONGEST_NAME} characters, found {frame_id!r}", "frame_id")
        cameras = root.named_children("cameras", _camera)
        return root.build(lambda _: cls(cameras, frame_id))

    def to_yaml(self) -> str:
        """The text of a rig file; reading it gives the same rig."""
        cameras: dict[str, dict[str, object]] = {}
        for name, camera in self.cameras.items():
            i, T = camera.intrinsics, camera.T_world_camera
            cameras[name] = {"size": [i.width, i.height], "focal": [i.fx, i.fy], "center": [i.cx, i.cy]}
            if i.distortion:
                cameras[name]["distortion"] = list(i.distortion)
            cameras[name]["position"] = np.round(T[:3, 3], 6).tolist()
            cameras[name]["quaternion"] = np.round(to_quaternion(T[:3, :3]), 9).tolist()
        return yaml.safe_dump({"frame_id": self.frame_id, "cameras": cameras}, sort_keys=False, default_flow_style=None)


def _is_name(text: str) -> bool:
    return 0 < len(text) <= LONGEST_NAME and text.isprintable()


def _camera(entry: Entry) -> PinholeCamera:
    name = entry.name.removeprefix("cameras.")
    if not _is_name(name):
        raise entry.error(f"a camera's name has 1 to {LONGEST_NAME} printable characters")
    entry.only("size", "focal", "center", "distortion", "position", "quaternion")
    width, height = entry.vector("size", 2, "px", LARGEST_IMAGE)
    if width != int(width) or height != int(height):
        raise entry.error("an image has a whole number of pixels", "size")
    found = entry.values.get("distortion", [])
    if not isinstance(found, list):
        raise entry.error("expected a list of numbers", "distortion")
    distortion = entry.vector("distortion", len(found), "", LARGEST_COEFFICIENT) if found else ()
    fx, fy = map(float, entry.vector("focal", 2, "px", LARGEST_FOCAL))
    cx, cy = map(float, entry.vector("center", 2, "px", LARGEST_FOCAL))
    intrinsics = Intrinsics(int(width), int(height), fx, fy, cx, cy, tuple(map(float, distortion)))
    rotation = from_quaternion(entry.vector("quaternion", 4, "w, x, y, z"))
    return PinholeCamera(name, intrinsics, transform(rotation, entry.vector("position", 3, "m")))
