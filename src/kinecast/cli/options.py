"""Options that several commands share: how help names them, and what is checked before the work starts."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

from tyro.conf import FlagCreatePairsOff, Positional, arg

from kinecast.cli.progress import compiling, note
from kinecast.errors import OptionError
from kinecast.geometry.scene import Scene
from kinecast.prediction.methods import METHODS
from kinecast.predictor import Predictor, PredictorOptions
from kinecast.tasks import Serial, Workers, cluster_at

SHIPPED_HORIZON = 0.5
"""How far the shipped model predicts [s] where a robot acts on it and nothing is told; it could twice as far."""
_METHODS = "".join(f"\n• {name}: {about}" for name, about in METHODS.items())

Many = Annotated[tuple[Path, ...], arg(metavar="PATH [PATH ...]", help_behavior_hint="")]
What = Positional[Many]
File = Annotated[Path, arg(metavar="FILE")]
Switch = FlagCreatePairsOff[bool]
OptionalFile = Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: none)")]
ModelFile = Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: the shipped one)")]
Horizon = Annotated[float | None, arg(metavar="SECONDS", help_behavior_hint="(default: all that the model does)")]
ClusterPlace = Annotated[str | None, arg(metavar="ADDRESS|local[:N]", help_behavior_hint="(default: this process)")]
Action = Annotated[str | None, arg(metavar="ACTION", help_behavior_hint="(default: all)")]
MethodName = Annotated[
    str,
    arg(metavar="NAME", help=f"the method:{_METHODS}", help_behavior_hint=lambda default: f"\n(default: {default})"),
]
MethodNames = Annotated[
    str,
    arg(
        metavar="NAME,NAME,...",
        help=f"methods to train:{_METHODS}\nor MODULE:FUNCTION, your own (docs/predictor.md)",
        help_behavior_hint=lambda default: f"\n(default: {default.replace(',', ', ')})",
    ),
]


def check_seed(seed: int) -> None:
    """Raises OptionError for a seed that no random generator takes."""
    if seed < 0:
        raise OptionError(f"seed is {seed}, allowed is 0 or more")


def read_predictor(model: Path | None, scene: Scene | None, options: PredictorOptions) -> Predictor:
    """The predictor of a model file, or the shipped one, compiled."""
    with compiling():
        return Predictor.load(model, scene, options) if model else Predictor.shipped(scene, options)


@contextmanager
def worker_pool(where: str | None) -> Iterator[Workers]:
    """Workers for as long as they are needed: of a cluster (kinecast.tasks.cluster_at), or this process."""
    if where is None:
        yield Serial()
        return
    with cluster_at(where) as cluster:
        count = len(cluster.workers)
        note(f"cluster {where}: {count} worker{'s' * (count != 1)}")
        yield cluster


def check_file(out: Path, endings: tuple[str, ...], option: str = "--out") -> None:
    """Raises OptionError, which names the option, unless a file of one of these endings can be written or replaced."""
    if out.suffix not in endings:
        raise OptionError(f"{option} {out}: its name must end in {' or '.join(endings)}")
    if out.is_dir():
        raise OptionError(f"{option} {out}: is a folder, and folders are never replaced: remove it, or name another")
    folder = out.absolute().parent
    if not folder.is_dir():
        raise OptionError(f"{option} {out}: there is no folder {folder}")
    _check_writable(out, folder, option)


def check_folder(out: Path) -> None:
    """Raises OptionError unless a folder is there or can be made, and files in it."""
    place = next(place for place in (out.absolute(), *out.absolute().parents) if place.exists())
    if not place.is_dir():
        raise OptionError(f"--out {out}: {place} is a file, not a folder")
    _check_writable(out, place, "--out")


def _check_writable(out: Path, folder: Path, option: str) -> None:
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OptionError(f"{option} {out}: nothing can be written in {folder} ({error.strerror})") from None
