"""From recordings to windows, and one frame after another through the predictor: the main loop."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from kinecast.datasets.recording import Recording
from kinecast.datasets.windows import WindowOptions, Windows, all_windows
from kinecast.errors import DatasetError, OptionError
from kinecast.geometry.scene import Scene
from kinecast.prediction.observation import Observation, TrainingWindows
from kinecast.predictor import Predictor
from kinecast.tasks.workers import Progress, Workers
from kinecast.types import Prediction, SkeletonFrame

__all__ = [
    "every_frame",
    "followed",
    "frames",
    "observations",
    "stream",
    "training_windows",
    "training_windows_by_action",
]

FEWEST = 200
"""Windows that an action needs for a model of its own."""


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
    task_of = {recording.name: recording.task for recording in recordings}
    tasks = sorted({task_of[part.name] for part in parts})
    groups = [tasks.index(task_of[part.name]) if len(tasks) > 1 else k for k, part in enumerate(parts)]
    owner = np.concatenate([np.full(len(part), k) for k, part in enumerate(parts)])
    future = np.concatenate([part.future for part in parts])
    whole = np.isfinite(future).all(axis=(1, 2, 3))
    windows = TrainingWindows(
        np.concatenate([part.arms for part in parts])[whole],
        future[whole],
        np.concatenate([part.up for part in parts])[whole],
        owner[whole],
        1.0 / options.rate,
        np.concatenate([part.frames for part in parts])[whole],
        np.array(groups)[owner[whole]],
    )
    if scene is None:
        return windows
    free = windows.outside(scene)
    if len(free) == 0:
        raise OptionError(
            f"all {len(windows)} training windows end inside an obstacle; is the scene in the recordings' frame?"
        )
    return free


def training_windows_by_action(
    recordings: Sequence[Recording],
    options: WindowOptions,
    scene: Scene | None = None,
    workers: Workers | None = None,
) -> dict[str, TrainingWindows]:
    """The windows of each action with enough of them, by name: the frames' label where there are labels, else the task.

    Args:
        recordings, options, scene, workers: as for `training_windows`.

    Raises:
        OptionError: fewer than two actions have `FEWEST` windows.
    """
    labelled = [recording for recording in recordings if recording.labels is not None]
    found: dict[str, TrainingWindows] = {}
    counts: dict[str, int] = {}
    for action in sorted({label for recording in labelled for label in recording.labels or () if label}):
        own = [recording for recording in labelled if action in (recording.labels or ())]
        _keep(found, counts, action, own, replace(options, label=action), scene, workers)
    others = [recording for recording in recordings if recording.labels is None and recording.task]
    for task in sorted({recording.task for recording in others}):
        own = [recording for recording in others if recording.task == task]
        _keep(found, counts, task, own, options, scene, workers)
    if len(found) < 2:
        known = ", ".join(f"{name} {count}" for name, count in counts.items()) or "no labels and no tasks"
        raise OptionError(f"models per action need two actions with {FEWEST} windows or more; found: {known}")
    return found


def _keep(
    found: dict[str, TrainingWindows],
    counts: dict[str, int],
    action: str,
    recordings: Sequence[Recording],
    options: WindowOptions,
    scene: Scene | None,
    workers: Workers | None,
) -> None:
    """Adds an action's windows where there are enough."""
    try:
        windows = training_windows(recordings, options, scene, workers=workers)
    except (DatasetError, OptionError):  # none at all, or none outside obstacles
        counts[action] = 0
        return
    counts[action] = len(windows)
    if len(windows) >= FEWEST and action not in found:
        found[action] = windows


def observations(part: Windows) -> list[Observation]:
    """The windows of one recording as a predictor sees them."""
    return [
        Observation(arms, up, 1.0 / part.rate, float(stamp))
        for arms, up, stamp in zip(part.arms, part.up, part.stamps, strict=True)
    ]


def every_frame(options: WindowOptions) -> WindowOptions:
    """Options for the windows that end with each frame, gaps and all: what an online predictor sees."""
    return replace(options, stride=1, whole=False, label=None, trim=False)


def followed(history: Windows) -> list[tuple[int, Observation, Float[np.ndarray, "6 3"]]]:
    """Frame after frame: its index, the window that ends with it, and what was measured, NaN where it was not."""
    measured = np.where(history.touched[:, -1, :6, None], np.nan, history.arms[:, -1])
    return list(zip(history.frames.tolist(), observations(history), measured, strict=True))


def frames(recording: Recording) -> Iterator[SkeletonFrame]:
    """A recording as the camera gave it, frame after frame."""
    for stamp, positions in zip(recording.stamps, recording.positions, strict=True):
        yield SkeletonFrame(float(stamp), recording.joints, positions, recording.person)


def stream(recordings: Sequence[Recording], predictor: Predictor) -> Iterator[Prediction]:
    """Every frame of recordings made at the same time, one a person, through the online predictor."""
    for frame in heapq.merge(*map(frames, recordings), key=lambda frame: frame.stamp):
        yield predictor.observe(frame)
