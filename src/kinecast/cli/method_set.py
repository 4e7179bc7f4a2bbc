"""The methods an evaluation compares: trained for it, or read from model files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from pathlib import Path
from typing import Any

from kinecast.body.limits import JointLimits
from kinecast.cli.progress import note, progress_bar
from kinecast.cli.recordings import listed
from kinecast.datasets.recording import Recording
from kinecast.datasets.windows import WindowOptions
from kinecast.errors import ModelError, OptionError
from kinecast.geometry.scene import Scene
from kinecast.pipeline import training_windows
from kinecast.prediction.kinecast.model import Kinecast, ablations
from kinecast.prediction.method import Method, shortened
from kinecast.prediction.methods import check_names, limits_of, read_method, train
from kinecast.prediction.plugins import is_plugin, train_plugin
from kinecast.tasks import Workers


@dataclass(frozen=True)
class MethodSet:
    """Methods for the same windows."""

    methods: Mapping[str, Method[Any]]  # by the name they are reported under
    limits: JointLimits  # against which all their samples are counted
    trained_on: Sequence[str]  # names of the recordings
    windows: WindowOptions  # what they are made for
    files: Mapping[str, str] = field(default_factory=dict)  # that they were read from, by name

    def with_ablations(self) -> MethodSet:
        """With, before `kinecast`, what is left of it with each stage switched off; OptionError if it is not there."""
        whole = self.methods.get("kinecast")
        if not isinstance(whole, Kinecast):
            raise OptionError(f"--ablate takes kinecast apart; the methods are {', '.join(self.methods)}")
        parts = {f"kinecast, {name}": part for name, part in ablations(whole).items()}
        others = {name: method for name, method in self.methods.items() if method is not whole}
        return replace(self, methods={**others, **parts, "kinecast": whole})

    def warn_of_known(self, test: Sequence[Recording]) -> None:
        """A note where models of files were trained on recordings of the test recordings' names."""
        known = [recording.name for recording in test if recording.name in self.trained_on]
        if known and self.files:
            note(f"the models were trained on recordings of these names, so scores may flatter them: {listed(known)}")


def method_names(text: str) -> list[str]:
    """Names with commas between them, each once; OptionError if one is no method. MODULE:FUNCTION is one too."""
    names = list(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    own = [name for name in names if not is_plugin(name)]
    if own or not names:
        check_names(own)
    return names


def train_methods(
    names: Sequence[str],
    recordings: Sequence[Recording],
    options: WindowOptions,
    scene: Scene | None,
    seed: int,
    workers: Workers,
) -> MethodSet:
    """Methods trained on every window of recordings, as `kinecast train` does; those from elsewhere in this process.

    A DatasetError, ModelError or OptionError for too few windows, or where what a function gives is no method.
    """
    with progress_bar("cutting windows") as progress:
        data = training_windows(recordings, options, scene, progress, workers)
    methods = {name: train_plugin(name, data) for name in names if is_plugin(name)}
    with progress_bar("training") as progress:
        methods |= train([name for name in names if name not in methods], data, seed, progress, workers)
    methods = {name: methods[name] for name in names}
    return MethodSet(methods, limits_of(data), [recording.name for recording in recordings], options)


def windows_told(told: Mapping[str, float | None], default: WindowOptions | None = None) -> WindowOptions:
    """Windows of the `rate` [Hz], `window` and `horizon` [s] told; None for those of the default."""
    own: dict[str, Any] = {name: value for name, value in told.items() if value is not None}
    return replace(default or WindowOptions(), **own)


def read_models(paths: Sequence[Path], told: Mapping[str, float | None]) -> MethodSet:
    """Saved models, at least one, of one rate and window; what is told must be theirs.

    They predict as far as told, or as the least of them does. A ModelError where a file is no model, or made for other
    windows; an OptionError for windows that there are not.
    """
    cards, methods = zip(*map(read_method, paths), strict=True)
    first = cards[0]
    least = min(card.steps * card.dt for card in cards)
    options = windows_told(told, WindowOptions(first.rate, first.frames / first.rate, least))
    wanted = (options.observed_steps, options.predicted_steps, options.rate)
    frames = "{} frames seen and {} predicted at {:g} Hz"
    for path, card in zip(paths, cards, strict=True):
        made = (card.frames, card.steps, card.rate)
        if made[::2] != wanted[::2] or made[1] < wanted[1]:
            raise ModelError(f"{path}: made for {frames.format(*made)}, not {frames.format(*wanted)}")
    methods = tuple(shortened(method, options.horizon) for method in methods)
    named = [card.method for card in cards]
    names = [f"{name} #{named[: k + 1].count(name)}" if named.count(name) > 1 else name for k, name in enumerate(named)]
    # The least that every constrained model keeps, else those found in training.
    held = [card.limits for card in cards if card.method == "kinecast" or card.method.endswith("_constrained")]
    return MethodSet(
        dict(zip(names, methods, strict=True)),
        reduce(JointLimits.union, held or [first.limits]),
        sorted({name for card in cards for name in card.trained_on}),
        options,
        dict(zip(names, map(str, paths), strict=True)),
    )
