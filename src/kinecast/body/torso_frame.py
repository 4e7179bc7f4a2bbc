"""Torso frame: origin midway between the shoulders, y from right to left, z up the torso, x = y × z forward.

"Up the torso" is read from the first of `UpSource` that is tracked and not along the shoulder line. It is one
number, the lean about the shoulder line: where its joints are lost, the last lean is held and turns with the
shoulders.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from kinecast.errors import DatasetError
from kinecast.geometry.transforms import rotation_y, transform

LEAST_LENGTH = 0.08
"""A joint nearer than this to the middle of the shoulders, off their line, gives no direction [m]."""

LEAST_SINE = 0.35
"""A direction nearer than 20° to the shoulder line gives no up."""

SHORT = 1e-6
"""A line shorter than this [m] has no direction."""

LEAST_RISE = 0.7
"""Neck and head must lie within 45° of world up, seen along the shoulder line: both nod and crane forward."""


Series: TypeAlias = Float[np.ndarray, "N J 3"]
Frames: TypeAlias = Float[np.ndarray, "N 4 4"]


class UpSource(Enum):
    """Where the torso's up direction is read from, best first; the value is the joints, any of them in order.

    `WORLD` is world up, for skeletons of arms alone.
    """

    PELVIS = ("pelvis",)
    HIPS = ("left_hip", "right_hip")
    SPINE = ("lumbar", "spine", "thorax")
    CHEST = ("chest",)
    NECK = ("neck",)
    HEAD = ("head",)
    WORLD = ()


@dataclass(frozen=True)
class Torso:
    """The torso of one frame, or of a series of them."""

    T_world_torso: Float[np.ndarray, "*batch 4 4"]  # p_world = T_world_torso · p_torso; NaN where a shoulder is
    lean: Float[np.ndarray, "*batch"]  # forward, about the shoulder line, 0 for world up [rad]
    source: UpSource  # what up is read from


def up_source(joints: Sequence[str], positions: Series) -> UpSource:
    """The source a recording's up direction is read from: the first that serves at least half of its frames.

    Takes joint names and positions (N, J, 3) [m], world z up; `WORLD` where none serves.

    Raises:
        DatasetError: a shoulder is not among the joints.
    """
    T = _shoulder_frame(joints, positions)
    tracked = max(np.isfinite(T[:, 0, 3]).sum(), 1)
    served = (source for source in UpSource if 2 * np.isfinite(_lean(source, joints, positions, T)).sum() >= tracked)
    return next(served, UpSource.WORLD)


def torso_frame(
    joints: Sequence[str], positions: Float[np.ndarray, "*N J 3"], source: UpSource | None = None, lean: float = 0.0
) -> Torso:
    """Torso frame of one frame (J, 3) or of a series (N, J, 3): columns y × z, y, z, middle of the shoulders.

    Online, pass on the last result's `source` and `lean`, so that a lost joint changes nothing.

    Args:
        joints: canonical joint names.
        positions: (J, 3) or (N, J, 3) joint positions [m], world z up; NaN where missing.
        source: what to read up from; None for `up_source` of these positions.
        lean: held until the source is first seen [rad].

    Returns:
        The torso; finite wherever both shoulders are.

    Raises:
        DatasetError: a shoulder is not among the joints.
    """
    series = positions.reshape(-1, *positions.shape[-2:])
    source = up_source(joints, series) if source is None else source
    T = _shoulder_frame(joints, series)
    seen = _lean(source, joints, series, T)
    last_seen = np.maximum.accumulate(np.where(np.isnan(seen), -1, np.arange(len(seen))))
    leans = np.where(last_seen < 0, lean, seen[last_seen]) if len(seen) else seen
    T = T @ transform(rotation_y(leans), np.zeros((len(leans), 3)))
    batch = positions.shape[:-2]
    return Torso(T.reshape(*batch, 4, 4), leans.reshape(batch), source)


def _shoulder_frame(joints: Sequence[str], positions: Series) -> Frames:
    """The frame the shoulders alone give: leftward along them, up as near world up as can be; NaN where one is.

    Coincident shoulders face along world x, an upright shoulder line as near to it as can be: any choice, but never
    NaN.
    """
    for name in ("left_shoulder", "right_shoulder"):
        if name not in joints:
            found = ", ".join(joints) or "no joint"
            raise DatasetError("torso frame", f"{name} is needed; the joints are {found}")
    left = np.asarray(positions[:, joints.index("left_shoulder")], dtype=np.float64)
    right = np.asarray(positions[:, joints.index("right_shoulder")], dtype=np.float64)
    line = left - right
    width = np.sqrt((line**2).sum(axis=-1, keepdims=True))
    leftward = np.where(width <= SHORT, [0.0, 1.0, 0.0], line / np.where(width <= SHORT, 1.0, width))
    x, y, z = leftward.T
    # Forward is leftward × world up; where these are one line, world x freed of what lies along the line.
    upright = (np.hypot(x, y) <= SHORT)[:, None]
    ahead = np.where(upright, np.stack([y * y + z * z, -x * y, -x * z], axis=-1), np.stack([y, -x, 0.0 * z], axis=-1))
    forward = ahead / np.sqrt((ahead**2).sum(axis=-1, keepdims=True))
    fx, fy, fz = forward.T
    up = np.stack([fy * z - fz * y, fz * x - fx * z, fx * y - fy * x], axis=-1)
    T = transform(np.stack([forward, leftward, up], axis=-1), 0.5 * (left + right))
    T[~np.isfinite(T).all(axis=(1, 2))] = np.nan
    return T


def _lean(source: UpSource, joints: Sequence[str], positions: Series, T: Frames) -> Float[np.ndarray, " N"]:
    """Forward lean [rad] from the shoulders' frame as the source shows it; NaN where it is missing or degenerate."""
    middle = T[:, :3, 3]
    if source is UpSource.WORLD:
        return 0.0 * middle.sum(axis=-1)
    point = np.full((len(positions), 3), np.nan)
    if source is not UpSource.HIPS:
        for name in reversed(source.value):
            if name in joints:
                other = positions[:, joints.index(name)]
                point = np.where(np.isfinite(other), other, point)
    elif set(source.value) <= set(joints):
        point = positions[:, [joints.index(name) for name in source.value]].mean(axis=1)
    above = source in (UpSource.NECK, UpSource.HEAD)
    up = point - middle if above else middle - point
    ahead, rise = np.einsum("ni,nij->jn", up, T[:, :3, [0, 2]])
    off_line = np.hypot(ahead, rise)
    clear = (off_line > LEAST_LENGTH) & (off_line > LEAST_SINE * np.linalg.norm(up, axis=-1))
    if above:
        clear &= rise > LEAST_RISE * off_line
    return np.where(clear, np.arctan2(ahead, rise), np.nan)
