"""Types of the options that several commands share: how help names them and what it says of their defaults."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import FlagCreatePairsOff, Positional, arg

from kinecast.cli.formats import FORMAT_NAMES
from kinecast.errors import OptionError
from kinecast.prediction.methods import METHODS

__all__ = [
    "Action",
    "ClusterPlace",
    "File",
    "Folder",
    "FormatName",
    "Many",
    "MethodName",
    "MethodNames",
    "SceneFile",
    "Switch",
    "What",
    "check_seed",
]

_METHODS = "".join(f"\n• {name}: {about}" for name, about in METHODS.items())

Many = Annotated[tuple[Path, ...], arg(metavar="PATH [PATH ...]", help_behavior_hint="")]
What = Positional[Many]
File = Annotated[Path, arg(metavar="FILE")]
Folder = Annotated[Path, arg(metavar="FOLDER")]
Switch = FlagCreatePairsOff[bool]
SceneFile = Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: none)")]
ClusterPlace = Annotated[
    str | None,
    arg(
        metavar="ADDRESS|local[:N]",
        help_behavior_hint="(default: this process)",
    ),
]
Action = Annotated[str | None, arg(metavar="ACTION", help_behavior_hint="(default: all)")]
FormatName = Annotated[
    str | None,
    arg(
        metavar="NAME",
        help=f"format of the recordings: {', '.join(FORMAT_NAMES)}.",
        help_behavior_hint="(default: found by content)",
    ),
]
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
