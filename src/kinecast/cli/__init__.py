"""Where a person's arms will be over the next half second: train, score, predict."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any

import tyro

from kinecast.cli.demo import demo
from kinecast.cli.download import download
from kinecast.cli.evaluate import evaluate
from kinecast.cli.info import info
from kinecast.cli.predict import predict
from kinecast.cli.progress import CONSOLE
from kinecast.cli.train import train
from kinecast.errors import KinecastError

__all__ = ["main"]

COMMANDS: dict[str, Callable[..., Any]] = {
    "demo": demo,
    "info": info,
    "download": download,
    "train": train,
    "evaluate": evaluate,
    "predict": predict,
}

BAD_INPUT = 2


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs one command. Exit code 2, and one line on standard error, for anything wrong with the input."""
    try:
        tyro.extras.subcommand_cli_from_dict(COMMANDS, prog="kinecast", args=arguments, description=__doc__)
    except KinecastError as error:
        CONSOLE.print(f"kinecast: {error}", style="red", markup=False, highlight=False, soft_wrap=True)
        sys.exit(BAD_INPUT)
    except KeyboardInterrupt:
        CONSOLE.print("kinecast: interrupted; nothing was written", markup=False)
        sys.exit(130)
