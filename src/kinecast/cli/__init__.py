"""Where a person's arms will be over the next half second: train, score, predict."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from typing import Any

import tyro

from kinecast import __version__
from kinecast.cli.calibrate import calibrate
from kinecast.cli.convert import convert
from kinecast.cli.demo import demo
from kinecast.cli.download import download
from kinecast.cli.evaluate import evaluate
from kinecast.cli.info import info
from kinecast.cli.live import live
from kinecast.cli.predict import predict
from kinecast.cli.progress import note
from kinecast.cli.simulate import simulate
from kinecast.cli.train import train
from kinecast.errors import KinecastError

__all__ = ["main"]

COMMANDS: dict[str, Callable[..., Any]] = {
    "demo": demo,
    "info": info,
    "convert": convert,
    "download": download,
    "train": train,
    "evaluate": evaluate,
    "predict": predict,
    "live": live,
    "calibrate": calibrate,
    "simulate": simulate,
}

BAD_INPUT = 2
INTERRUPTED = 130
READER_GONE = 141
"""As a shell reports a program ended by Ctrl-C, and one whose output nobody reads any more."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs one command. Exit code 2, and one line on standard error, for anything wrong with the input."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if list(arguments) == ["--version"]:
        print(f"kinecast {__version__}")
        return
    try:
        tyro.extras.subcommand_cli_from_dict(COMMANDS, prog="kinecast", args=arguments, description=__doc__)
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or Python complains once more at its end
        sys.exit(READER_GONE)
    except (KinecastError, OSError) as error:
        note(str(error), "red")
        sys.exit(BAD_INPUT)
    except MemoryError:
        note("out of memory: fewer or shorter recordings, fewer samples or a shorter horizon need less", "red")
        sys.exit(BAD_INPUT)
    except KeyboardInterrupt:
        note("interrupted")
        sys.exit(INTERRUPTED)
