"""Windows of a recording: what a predictor sees, and what came next.

What is observed is repaired as it would be online, from the window alone. What came next is left as measured.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from kinecast.body.skeleton import ARM_JOINTS, require_arms
from kinecast.body.torso_frame import UpSource, torso_frame
from kinecast.body.tracking import Trouble, repair_windows
from kinecast.datasets.recording import Recording
from kinecast.datasets.repair import repair
from kinecast.datasets.resampling import check_rate, resample
from kinecast.errors import DatasetError, OptionError
from kinecast.tasks import Progress, Serial, Workers

LONGEST = 10.0  # longest window or horizon [s]
MOST_FRAMES = 300  # most frames in either: the joint Gaussian of 300 steps already has 5400 coordinates


@dataclass(frozen=True)
class WindowOptions:
    """Which windows are cut; OptionError for a value out of its range."""

    rate: float = 30.0  # frames per second [Hz]
    window: float = 0.2  # length of what is observed [s]
    horizon: float = 0.5  # length of what is to be predicted [s]
    stride: int = 5  # frames from one window to the next
    label: str | None = None  # only windows whose last observed frame has this label; None for all
    whole: bool = True
    """Only windows in which every arm joint is there in every frame, before and after. Otherwise gaps in what is
    observed are repaired, and in what came next they are NaN."""
    mend_future: bool = False
    """What came next is repaired with hindsight, and all there, for training; scores need what was measured."""

    def __post_init__(self) -> None:
        check_rate(self.rate)
        for name, seconds, least in (("window", self.window, 2), ("horizon", self.horizon, 1)):
            if not (0 < seconds <= LONGEST and least <= round(seconds * self.rate) <= MOST_FRAMES):
                allowed = f"{least / self.rate:.4g} to {min(LONGEST, MOST_FRAMES / self.rate):.4g} s"
                frames = f"{least} to {MOST_FRAMES} frames"
                raise OptionError(f"{name} is {seconds} s, allowed is {allowed} at {self.rate:g} Hz ({frames})")
        if self.stride < 1:
            raise OptionError(f"stride is {self.stride} frames, allowed is 1 or more")

    @property
    def observed_steps(self) -> int:
        """N, frames observed."""
        return round(self.window * self.rate)

    @property
    def predicted_steps(self) -> int:
        """T, frames to be predicted."""
        return round(self.horizon * self.rate)

    @property
    def ahead(self) -> Int[np.ndarray, " T"]:
        """(T,) frames from the last observed one to each predicted one: 1, 2, …, T."""
        return np.arange(1, self.predicted_steps + 1)


@dataclass(frozen=True)
class Windows:
    """W windows of one recording."""

    name: str
    options: WindowOptions
    arms: Float[np.ndarray, "W N 6 3"]
    """Observed arm joints [m], repaired; finite."""
    track: Float[np.ndarray, "F 6 3"]
    """Arm joints of all frames [m], where what came next is read; NaN where not measured."""
    stamps: Float[np.ndarray, " W"]
    """Times of the last observed frames [s]."""
    frames: Int[np.ndarray, " W"]
    """Their indices in the resampled recording."""
    up: Float[np.ndarray, "W 3"]
    """Direction up the torso at them."""
    touched: Bool[np.ndarray, "W N 6"]
    """True where an observed value was repaired."""
    left_out: int  # windows in which an arm joint was lost or not measured

    def __len__(self) -> int:
        return len(self.stamps)

    @property
    def future(self) -> Float[np.ndarray, "W T 6 3"]:
        """(W, T, 6, 3) arm joints after each window [m]; NaN where not measured."""
        return self.track[self.frames[:, None] + self.options.ahead]


def windows(recording: Recording, options: WindowOptions) -> Windows:
    """Every window of one recording, resampled; in order of time, none where it is too short or never has the label.

    Raises:
        DatasetError: no arms, or a recording that cannot be resampled.
    """
    require_arms(recording.joints, recording.source or recording.name)
    seen = resample(recording, options.rate)
    arms, n = seen.arms, options.observed_steps
    track = resample(repair(recording), options.rate).arms if options.mend_future else arms
    last = np.arange(n - 1, len(arms) - options.predicted_steps, options.stride)
    if options.label is not None:
        last = last[np.array(seen.labels or ("",) * len(arms))[last] == options.label]
    before, after = last[:, None] + np.arange(1 - n, 1), last[:, None] + options.ahead
    repaired = repair_windows(arms[before], seen.stamps[before])
    keep = ~(repaired.trouble & Trouble.LOST).any(axis=1)
    measured = np.isfinite(track)
    if options.whole or options.mend_future:
        keep &= measured.all(axis=(1, 2))[after].all(axis=1)
    else:
        keep &= measured.any(axis=(1, 2))[after].any(axis=1)
    if options.whole:
        keep &= np.isfinite(arms).all(axis=(1, 2))[before].all(axis=1)
    last, positions = last[keep], repaired.positions[keep]
    return Windows(
        name=recording.name,
        options=options,
        arms=positions,
        track=track,
        stamps=seen.stamps[last],
        frames=last,
        up=_up(seen, last, positions[:, -1]),
        touched=repaired.touched[keep],
        left_out=int(np.count_nonzero(~keep)),
    )


def all_windows(
    recordings: Iterable[Recording],
    options: WindowOptions,
    progress: Progress | None = None,
    workers: Workers | None = None,
) -> list[Windows]:
    """The windows of many recordings, resampled to `options.rate`; recordings without a window are passed over.

    `progress` is called with (done, total) recordings; `workers` cut them, or this process.

    Raises:
        OptionError: the label was in none of them; the message lists those that are.
        DatasetError: there was no window at all, or a recording cannot be used.
    """
    recordings = list(recordings)
    workers = workers or Serial()
    tasks = [workers.submit(windows, recording, options) for recording in recordings]
    found = [cut for cut in workers.results(tasks, progress) if len(cut)]
    labels = {label for recording in recordings for label in recording.labels or ()}
    if options.label is not None and options.label not in labels:
        present = ", ".join(sorted(labels)) or "none: the recordings have no labels"
        raise OptionError(f"label {options.label!r} does not occur; labels present: {present}")
    if not found:
        places = dict.fromkeys(str(recording.source or recording.name) for recording in recordings)
        tracked = "with both arms tracked throughout" if options.whole else "with both arms tracked"
        problem = f"no window of {options.window + options.horizon:g} s {tracked}"
        raise DatasetError(", ".join(places) or "recordings", problem)
    return found


def _up(recording: Recording, frames: Int[np.ndarray, " W"], arms: Float[np.ndarray, "W 6 3"]) -> np.ndarray:
    """Up the torso: the lean seen so far, on the repaired shoulders."""
    lean = torso_frame(recording.joints, recording.positions).lean[frames][:, None]
    upright = torso_frame(ARM_JOINTS, arms, UpSource.WORLD).T_world_torso
    return np.asarray(np.cos(lean) * upright[:, :3, 2] + np.sin(lean) * upright[:, :3, 0])
