"""From recordings to windows, and one frame after another through the predictor: the main loop."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from kinecast.datasets.recording import Recording
from kinecast.datasets.windows import WindowOptions, Windows, all_windows
from kinecast.errors import OptionError
from kinecast.geometry.scene import Scene
from kinecast.prediction.observation import Observation
from kinecast.prediction.training_windows import TrainingWindows
from kinecast.predictor import Predictor
from kinecast.tasks import Progress, Workers
from kinecast.types import Prediction, SkeletonFrame


def training_windows(
    recordings: Sequence[Recording],
    options: WindowOptions,
    scene: Scene | None = None,
    progress: Progress | None = None,
    workers: Workers | None = None,
) -> TrainingWindows:
    """Every window of several recordings, for training: gaps and jumps of what came next repaired with hindsight.

    Args:
        recordings: to train on.
        options: which windows; their stride and `whole` do not matter.
        scene: windows that end inside an obstacle are left out.
        progress: called with (done, total) recordings.
        workers: that cut the windows; None for this process.

    Raises:
        DatasetError: no recording has a single window.
        OptionError: the label occurs in none of them, or every window ends inside an obstacle.
    """
    parts = all_windows(recordings, replace(options, stride=1, whole=False, mend_future=True), progress, workers)
    by_name = {recording.name: recording for recording in recordings}
    used = [by_name[part.name] for part in parts]
    names = [(each.collection, each.task, f"{each.collection}/{each.subject}") for each in used]
    collections, tasks, subjects = (np.unique(of, return_inverse=True)[1] for of in zip(*names, strict=True))
    groups = _same_people(used) if collections.any() else tasks if tasks.any() else np.arange(len(parts))
    owner = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    frames = np.concatenate([part.frames for part in parts])
    # Single precision: a tenth of a micrometre, and half the room.
    arms, track = (
        np.concatenate([getattr(part, name) for part in parts], dtype=np.float32) for name in ("arms", "track")
    )
    first = np.cumsum([0, *(len(part.track) for part in parts)])[owner]  # row of each recording's first frame in track
    windows = TrainingWindows(
        arms,
        track[(first + frames)[:, None] + options.ahead],
        np.concatenate([part.up for part in parts]),
        owner,
        1.0 / options.rate,
        frames,
        groups[owner],
        collections[owner],
        subjects[owner],
    )
    if scene is None:
        return windows
    free = windows.outside(scene)
    if len(free) == 0:
        raise OptionError(
            f"all {len(windows)} training windows end inside an obstacle; is the scene in the recordings' frame?"
        )
    return free


def _same_people(recordings: Sequence[Recording]) -> Int[np.ndarray, " R"]:
    """(R,) a number for each recording: collections in which one person occurs have the same."""
    group = {recording.collection: k for k, recording in enumerate(recordings)}
    first: dict[str, str] = {}
    for recording in recordings:
        if recording.subject:
            one, other = group[first.setdefault(recording.subject, recording.collection)], group[recording.collection]
            group = {name: min(one, other) if k in (one, other) else k for name, k in group.items()}
    return np.array([group[recording.collection] for recording in recordings])


def every_frame(options: WindowOptions) -> WindowOptions:
    """Options for the windows that end with each frame, gaps and all: what an online predictor sees."""
    return replace(options, stride=1, whole=False, label=None)


def followed(history: Windows) -> list[tuple[int, Observation, Float[np.ndarray, "6 3"]]]:
    """Frame after frame: its index, the window that ends with it, and what was measured, NaN where it was not."""
    measured = np.where(history.touched[:, -1, :, None], np.nan, history.arms[:, -1])
    each = zip(history.frames.tolist(), history.arms, history.up, history.stamps.tolist(), measured, strict=True)
    dt = 1.0 / history.options.rate
    return [(frame, Observation(arms, up, dt, stamp), now) for frame, arms, up, stamp, now in each]


def frames(recording: Recording) -> Iterator[SkeletonFrame]:
    """A recording as the camera gave it, frame after frame."""
    for stamp, positions in zip(recording.stamps, recording.positions, strict=True):
        yield SkeletonFrame(float(stamp), recording.joints, positions, recording.person)


def labelled_frames(recordings: Sequence[Recording]) -> Iterator[tuple[SkeletonFrame, str | None]]:
    """Every frame of recordings made at the same time, one a person, with its label, by stamp."""
    each = [zip(frames(one), one.labels or (None,) * len(one.stamps), strict=True) for one in recordings]
    return heapq.merge(*each, key=lambda labelled: labelled[0].stamp)


def merged_frames(recordings: Sequence[Recording]) -> Iterator[SkeletonFrame]:
    """The same without labels."""
    return (frame for frame, _ in labelled_frames(recordings))


def stream(recordings: Sequence[Recording], predictor: Predictor) -> Iterator[Prediction]:
    """Every frame of recordings made at the same time through the online predictor."""
    for frame in merged_frames(recordings):
        yield predictor.observe(frame)
