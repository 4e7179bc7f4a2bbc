"""Windows of a recording: what a predictor sees, and what came next.

What is observed is repaired as it would be online, from the window alone. What came next is left as measured.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from kinecast.body.skeleton import ARM_JOINTS, require_arms
from kinecast.body.torso_frame import UpSource, torso_frame
from kinecast.body.tracking import Trouble, repair_windows
from kinecast.datasets.recording import Recording
from kinecast.datasets.repair import repair
from kinecast.datasets.resampling import RATE_RANGE, resample
from kinecast.errors import DatasetError, OptionError
from kinecast.tasks.workers import Progress, Serial, Workers

__all__ = ["WindowOptions", "Windows", "all_windows", "moving_part", "windows"]

LONGEST = 10.0
"""Longest window or horizon [s]."""

MOST_FRAMES = 300
"""Most frames in either: the joint Gaussian of 300 steps already has 5400 coordinates."""

STILL_SPEED = 0.1
"""A person whose wrists both stay slower than this stands still [m/s]."""

STILL_TIME = 0.5
"""Stillness kept at either end when a recording is trimmed [s]."""


@dataclass(frozen=True)
class WindowOptions:
    """Which windows are cut.

    Attributes:
        rate: frames per second [Hz].
        window: length of what is observed [s].
        horizon: length of what is to be predicted [s].
        stride: frames from one window to the next.
        label: only windows whose last observed frame has this label; None for all.
        whole: only windows in which every arm joint is there in every frame, before and after. Otherwise gaps
            in what is observed are repaired, and in what came next they are NaN.
        mend_future: what came next is repaired with hindsight, for training; scores need what was measured.
        trim: leave out stillness longer than `STILL_TIME` at both ends, as the paper does.
        extra_joints: joints observed beside the arms', all NaN where a recording lacks them.

    Raises:
        OptionError: a value out of its range.
    """

    rate: float = 30.0
    window: float = 0.2
    horizon: float = 0.5
    stride: int = 5
    label: str | None = None
    whole: bool = True
    mend_future: bool = False
    trim: bool = False
    extra_joints: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        lowest, highest = RATE_RANGE
        if not lowest <= self.rate <= highest:
            raise OptionError(f"rate is {self.rate} Hz, allowed is {lowest:g} to {highest:g} Hz")
        for name, seconds, least in (("window", self.window, 2), ("horizon", self.horizon, 1)):
            if not (0 < seconds <= LONGEST and least <= round(seconds * self.rate) <= MOST_FRAMES):
                allowed = f"{least / self.rate:.4g} to {min(LONGEST, MOST_FRAMES / self.rate):.4g} s"
                frames = f"{least} to {MOST_FRAMES} frames"
                raise OptionError(f"{name} is {seconds} s, allowed is {allowed} at {self.rate:g} Hz ({frames})")
        if self.stride < 1:
            raise OptionError(f"stride is {self.stride} frames, allowed is 1 or more")
        if set(self.extra_joints) & set(ARM_JOINTS) or len(set(self.extra_joints)) < len(self.extra_joints):
            raise OptionError(f"extra joints repeat, or are arm joints: {', '.join(self.extra_joints)}")

    @property
    def observed_steps(self) -> int:
        """N, frames observed."""
        return round(self.window * self.rate)

    @property
    def predicted_steps(self) -> int:
        """T, frames to be predicted."""
        return round(self.horizon * self.rate)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the P observed columns: the six arm joints, then the extra ones."""
        return ARM_JOINTS + self.extra_joints


@dataclass(frozen=True)
class Windows:
    """W windows of one recording.

    Attributes:
        name: of the recording.
        joints: P names, `ARM_JOINTS` first.
        rate: frames per second [Hz].
        observed: (W, N, P, 3) positions [m], repaired; finite in the arm joints.
        future: (W, T, 6, 3) arm joints after it [m]; NaN where not measured.
        stamps: (W,) time of the last observed frame [s].
        frames: (W,) its index in the resampled recording.
        up: (W, 3) direction up the torso at it.
        touched: (W, N, P) True where an observed value was repaired.
        trouble: (W, P) `kinecast.body.tracking.Trouble` flags.
        labels: label of each last observed frame, or None.
        lost: windows left out because an arm joint was lost in what is observed.
        not_whole: windows left out because an arm joint was not measured throughout.
    """

    name: str
    joints: tuple[str, ...]
    rate: float
    observed: Float[np.ndarray, "W N P 3"]
    future: Float[np.ndarray, "W T 6 3"]
    stamps: Float[np.ndarray, " W"]
    frames: Int[np.ndarray, " W"]
    up: Float[np.ndarray, "W 3"]
    touched: Bool[np.ndarray, "W N P"]
    trouble: UInt8[np.ndarray, "W P"]
    labels: tuple[str, ...] | None
    lost: int
    not_whole: int

    def __len__(self) -> int:
        return len(self.stamps)

    @cached_property
    def arms(self) -> Float[np.ndarray, "W N 6 3"]:
        """The observed arm joints alone [m]."""
        return self.observed[:, :, : len(ARM_JOINTS)]


def windows(recording: Recording, options: WindowOptions, truth: Recording | None = None) -> Windows:
    """Every window of one recording.

    Args:
        recording: on uniform stamps at `options.rate` (`kinecast.datasets.resampling.resample`).
        options: see WindowOptions; `mend_future` is for `all_windows`.
        truth: where what came next is read from, on the same stamps; None for the recording itself.

    Returns:
        The windows, in order of time; none where the recording is too short.

    Raises:
        OptionError: the label is not in this recording; the message lists those that are.
        DatasetError: stamps not uniform at `options.rate`, or no arms.
    """
    if options.label is not None and options.label not in (recording.labels or ()):
        raise _unknown_label(options.label, set(recording.labels or ()))
    return _cut(recording, options, recording if truth is None else truth)


def all_windows(
    recordings: Iterable[Recording],
    options: WindowOptions,
    progress: Progress | None = None,
    workers: Workers | None = None,
) -> list[Windows]:
    """The windows of many recordings, resampled to `options.rate`.

    Recordings without a window are passed over.

    Args:
        recordings: of persons.
        options: which windows.
        progress: called with (done, total) recordings.
        workers: that cut them; None for this process.

    Raises:
        OptionError: the label was in none of them.
        DatasetError: there was no window at all, or a recording cannot be used.
    """
    recordings = list(recordings)
    workers = workers or Serial()
    tasks = [workers.submit(_cut_resampled, recording, options) for recording in recordings]
    found = [cut for cut in workers.results(tasks, progress) if len(cut)]
    labels = {label for recording in recordings for label in recording.labels or ()}
    if options.label is not None and options.label not in labels:
        raise _unknown_label(options.label, labels)
    if not found:
        names = [recording.name for recording in recordings]
        needed = options.window + options.horizon
        tracked = "with both arms tracked throughout" if options.whole else "with both arms tracked"
        raise DatasetError(", ".join(names) or "recordings", f"no window of {needed:g} s {tracked}")
    return found


def _cut_resampled(recording: Recording, options: WindowOptions) -> Windows:
    # Smoothing would let the window see ahead.
    resampled = resample(recording, options.rate, smooth=False)
    truth = resample(repair(recording)[0], options.rate, smooth=False) if options.mend_future else resampled
    return _cut(resampled, options, truth)


def moving_part(recording: Recording) -> slice:
    """The frames from `STILL_TIME` before the first motion of a wrist to as long after the last; all if none.

    Motion is a wrist's mean velocity over 0.2 s above `STILL_SPEED`.
    """
    stamps = recording.stamps
    ahead = np.searchsorted(stamps, stamps + 0.2 - 1e-6)
    start = np.flatnonzero(ahead < len(stamps))
    end = ahead[start]
    moving = np.zeros(len(start), dtype=bool)
    for wrist in ("left_wrist", "right_wrist"):
        path = recording.joint(wrist)
        distance = np.linalg.norm(path[end] - path[start], axis=-1)
        moving |= distance > STILL_SPEED * (stamps[end] - stamps[start])
    if not moving.any():
        return slice(0, len(stamps))
    first = stamps[start[moving][0]] - STILL_TIME
    last = stamps[end[moving][-1]] + STILL_TIME
    return slice(int(np.searchsorted(stamps, first)), int(np.searchsorted(stamps, last, side="right")))


def _cut(recording: Recording, options: WindowOptions, truth: Recording) -> Windows:
    where = recording.source or recording.name
    require_arms(recording.joints, where)
    if np.any(np.abs(np.diff(recording.stamps) * options.rate - 1) > 0.01):
        raise DatasetError(where, f"stamps are not uniform at {options.rate:g} Hz: resample first")
    n, steps = options.observed_steps, options.predicted_steps
    part = moving_part(recording) if options.trim else slice(0, len(recording.stamps))
    last = np.arange(part.start + n - 1, part.stop - steps, options.stride)
    labels = recording.labels
    if options.label is not None:
        last = np.array([i for i in last if labels and labels[i] == options.label], dtype=int)
    before, after = last[:, None] + np.arange(1 - n, 1), last[:, None] + np.arange(1, steps + 1)

    seen = np.stack([recording.joint(name) for name in options.joints], axis=1)[before]
    future = np.stack([truth.joint(name) for name in ARM_JOINTS], axis=1)[after]
    repaired = repair_windows(seen, recording.stamps[before])
    arms = len(ARM_JOINTS)
    lost = (repaired.trouble[:, :arms] & Trouble.LOST).any(axis=1)
    measured = np.isfinite(seen[:, :, :arms]).all(axis=(1, 2, 3)) & np.isfinite(future).all(axis=(1, 2, 3))
    keep = ~lost & measured if options.whole else ~lost & np.isfinite(future).any(axis=(1, 2, 3))
    last = last[keep]
    return Windows(
        name=recording.name,
        joints=options.joints,
        rate=options.rate,
        observed=repaired.positions[keep],
        future=future[keep],
        stamps=recording.stamps[last],
        frames=last,
        up=_up(recording, last, repaired.positions[keep, -1, :arms]),
        touched=repaired.touched[keep],
        trouble=repaired.trouble[keep],
        labels=None if labels is None else tuple(labels[i] for i in last),
        lost=int(np.count_nonzero(lost)),
        not_whole=int(np.count_nonzero(~keep & ~lost)),
    )


def _up(
    recording: Recording, frames: Int[np.ndarray, " W"], arms: Float[np.ndarray, "W 6 3"]
) -> Float[np.ndarray, "W 3"]:
    """Up the torso: the lean seen so far, on the repaired shoulders."""
    lean = torso_frame(recording.joints, recording.positions).lean[frames][:, None]
    upright = torso_frame(ARM_JOINTS, arms, UpSource.WORLD).T_world_torso
    up: Float[np.ndarray, "W 3"] = np.cos(lean) * upright[:, :3, 2] + np.sin(lean) * upright[:, :3, 0]
    return up


def _unknown_label(label: str, present: set[str]) -> OptionError:
    known = ", ".join(sorted(present)) if present else "none: the recordings have no labels"
    return OptionError(f"label {label!r} does not occur; labels present: {known}")
