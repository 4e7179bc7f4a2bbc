"""Torso frame: origin midway between the shoulders, y from right to left, z up the torso, x = y × z forward.

"Up the torso" is read from the first of `UpSource` that is tracked and not along the shoulder line. It is one
number, the lean about the shoulder line: where its joints are lost, the last lean is held and turns with the
shoulders.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float
from numba import njit

from kinecast.errors import DatasetError

__all__ = ["Torso", "UpSource", "torso_frame", "up_source"]

LEAST_LENGTH = 0.08
"""A joint nearer than this to the middle of the shoulders, off their line, gives no direction [m]."""

LEAST_SINE = 0.35
"""A direction nearer than 20° to the shoulder line gives no up."""

SHORT = 1e-6
"""A line shorter than this [m] has no direction."""

LEAST_RISE = 0.7
"""Neck and head must lie within 45° of world up, seen along the shoulder line: both nod and crane forward."""


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
    """The torso of one frame, or of a series of them.

    Attributes:
        T_world_torso: (…, 4, 4) rigid transform, p_world = T_world_torso · p_torso; NaN where a shoulder is.
        lean: (…) forward lean about the shoulder line, 0 for world up [rad].
        source: what up is read from.
        held: (…) True where the source was lost and the last lean is held.
    """

    T_world_torso: Float[np.ndarray, "*batch 4 4"]
    lean: Float[np.ndarray, "*batch"]
    source: UpSource
    held: Bool[np.ndarray, "*batch"]


def up_source(joints: Sequence[str], positions: Float[np.ndarray, "N J 3"]) -> UpSource:
    """The source a recording's up direction is read from: the first that serves at least half of its frames.

    Args:
        joints: canonical joint names.
        positions: (N, J, 3) joint positions [m], world z up.

    Returns:
        The source; `WORLD` where none serves.

    Raises:
        DatasetError: a shoulder is not among the joints.
    """
    shoulders = _Shoulders(joints, positions)
    tracked = shoulders.tracked.sum()
    for source in UpSource:
        if source is UpSource.WORLD:
            break
        if 2 * np.isfinite(_lean(source, joints, positions, shoulders)).sum() >= max(tracked, 1):
            return source
    return UpSource.WORLD


def torso_frame(
    joints: Sequence[str],
    positions: Float[np.ndarray, "*N J 3"],
    source: UpSource | None = None,
    lean: float = 0.0,
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
    shoulders = _Shoulders(joints, series)
    seen = _lean(source, joints, series, shoulders)
    held = np.isnan(seen)
    leans = _hold(seen, lean)

    sine, cosine = np.sin(leans)[:, None], np.cos(leans)[:, None]
    T = np.zeros((len(series), 4, 4))
    T[:, :3, 0] = cosine * shoulders.forward - sine * shoulders.up
    T[:, :3, 1] = shoulders.leftward
    T[:, :3, 2] = cosine * shoulders.up + sine * shoulders.forward
    T[:, :3, 3] = shoulders.middle
    T[:, 3, 3] = 1.0
    T[~shoulders.tracked] = np.nan
    batch = positions.shape[:-2]
    return Torso(T.reshape(*batch, 4, 4), leans.reshape(batch), source, held.reshape(batch))


class _Shoulders:
    """The frame the shoulders alone give: leftward along them, up as near world up as can be, forward."""

    def __init__(self, joints: Sequence[str], positions: Float[np.ndarray, "N J 3"]) -> None:
        for name in ("left_shoulder", "right_shoulder"):
            if name not in joints:
                found = ", ".join(joints) or "no joint"
                raise DatasetError("torso frame", f"{name} is needed; the joints are {found}")
        left = np.asarray(positions[:, joints.index("left_shoulder")], dtype=np.float64)
        right = np.asarray(positions[:, joints.index("right_shoulder")], dtype=np.float64)
        self.middle = 0.5 * (left + right)
        self.tracked = np.isfinite(self.middle).all(axis=-1)
        axes = np.empty((3, len(left), 3))
        _shoulder_axes(left, right, axes)
        self.forward, self.leftward, self.up = axes


@njit(cache=True)
@no_type_check
def _shoulder_axes(
    left: Float[np.ndarray, "N 3"], right: Float[np.ndarray, "N 3"], axes: Float[np.ndarray, "3 N 3"]
) -> None:
    """Unit vectors forward, leftward and up of each shoulder line; NaN where a shoulder is.

    Coincident shoulders face along world x, an upright shoulder line as near to it as can be: any choice, but never
    NaN.
    """
    for n in range(len(left)):
        x, y, z = left[n, 0] - right[n, 0], left[n, 1] - right[n, 1], left[n, 2] - right[n, 2]
        width = math.sqrt(x * x + y * y + z * z)
        x, y, z = (0.0, 1.0, 0.0) if width <= SHORT else (x / width, y / width, z / width)
        # Forward is leftward × world up; where these are one line, world x freed of what lies along the line.
        level = math.sqrt(x * x + y * y)
        ahead = (y * y + z * z, -x * y, -x * z) if level <= SHORT else (y, -x, 0.0)
        length = math.sqrt(ahead[0] ** 2 + ahead[1] ** 2 + ahead[2] ** 2)
        fx, fy, fz = ahead[0] / length, ahead[1] / length, ahead[2] / length
        axes[0, n] = fx, fy, fz
        axes[1, n] = x, y, z
        axes[2, n] = fy * z - fz * y, fz * x - fx * z, fx * y - fy * x


def _lean(
    source: UpSource, joints: Sequence[str], positions: Float[np.ndarray, "N J 3"], shoulders: _Shoulders
) -> Float[np.ndarray, " N"]:
    """Forward lean [rad] as the source shows it; NaN where it is missing or degenerate."""
    if source is UpSource.WORLD:
        return np.where(shoulders.tracked, 0.0, np.nan)
    if source is UpSource.HIPS:
        if not set(source.value) <= set(joints):
            return np.full(len(positions), np.nan)
        point = positions[:, [joints.index(name) for name in source.value]].mean(axis=1)
    else:
        point = np.full((len(positions), 3), np.nan)
        for name in reversed(source.value):
            if name in joints:
                other = positions[:, joints.index(name)]
                point = np.where(np.isfinite(other), other, point)
    above = source in (UpSource.NECK, UpSource.HEAD)
    up = point - shoulders.middle if above else shoulders.middle - point
    ahead = np.sum(up * shoulders.forward, axis=-1)
    rise = np.sum(up * shoulders.up, axis=-1)
    off_line = np.hypot(ahead, rise)
    clear = (off_line > LEAST_LENGTH) & (off_line > LEAST_SINE * np.linalg.norm(up, axis=-1))
    if above:
        clear &= rise > LEAST_RISE * off_line
    return np.where(clear, np.arctan2(ahead, rise), np.nan)


def _hold(values: Float[np.ndarray, " N"], before: float) -> Float[np.ndarray, " N"]:
    """Each NaN replaced by the last value that is not, `before` at the start."""
    known = np.where(np.isnan(values), -1, np.arange(len(values)))
    last = np.maximum.accumulate(known) if len(values) else known
    return np.where(last < 0, before, values[last])
