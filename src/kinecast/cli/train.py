"""`kinecast train`: recordings in, one model file out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from kinecast.cli.progress import progress_bar
from kinecast.datasets.loading import load_all
from kinecast.datasets.windows import WindowOptions
from kinecast.errors import OptionError
from kinecast.geometry.scene import Scene
from kinecast.pipeline import training_windows
from kinecast.prediction.methods import TrainingOptions, card_of, check_names, save_method
from kinecast.prediction.methods import train as fit

__all__ = ["train"]

TRAINING_STRIDE = 1
"""Frames from one training window to the next."""


def train(
    paths: Annotated[tuple[Path, ...], tyro.conf.Positional],
    out: Path,
    method: str = "gp_constrained",
    rate: float = 30.0,
    window: float = 0.2,
    horizon: float = 0.5,
    label: str | None = None,
    scene: Path | None = None,
    seed: int = 0,
    format: str | None = None,
) -> None:
    """Trains one method on recordings and writes it to a file, whole or not at all.

    Args:
        paths: recordings, or folders of them.
        out: the model file, ending in .npz.
        method: one of those that `kinecast evaluate --help` lists.
        rate: frames per second the model works at [Hz].
        window: what is observed [s].
        horizon: what is predicted [s].
        label: train only where the recording's label is this action.
        scene: obstacles; training windows that start inside one are left out.
        seed: of everything random.
        format: read recordings as this format instead of finding it by content.
    """
    check_names([method])
    if out.suffix != ".npz":
        raise OptionError(f"--out {out}: a model file ends in .npz")
    if not out.resolve().parent.is_dir():
        raise OptionError(f"--out {out}: the folder {out.resolve().parent} does not exist")
    options = WindowOptions(rate=rate, window=window, horizon=horizon, stride=TRAINING_STRIDE, label=label, whole=False)
    obstacles = None if scene is None else Scene.load(scene)
    recordings = load_all(paths, format)
    data = training_windows(recordings, options)
    if obstacles is not None:
        data = data.outside(obstacles)
    settings = TrainingOptions(seed=seed)
    with progress_bar(f"training {method}") as progress:
        trained = fit([method], data, settings, progress)[method]
    card = card_of(method, trained, data, settings, label or "", [recording.name for recording in recordings])
    save_method(out, card, trained)
    print(f"{out}: {method}, trained on {len(data)} windows of {len(recordings)} recordings")
