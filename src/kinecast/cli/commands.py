"""Where a person's arms will be over the next half second: train, score, predict."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from typing import Any

import tyro

from kinecast import __version__
from kinecast.cli.calibrate import calibrate
from kinecast.cli.download import download
from kinecast.cli.evaluate import demo, evaluate
from kinecast.cli.live import live
from kinecast.cli.predict import predict
from kinecast.cli.progress import note
from kinecast.cli.recordings import convert, info
from kinecast.cli.robot import robot
from kinecast.cli.simulate import simulate
from kinecast.cli.train import train
from kinecast.errors import KinecastError

COMMANDS: dict[str, Callable[..., Any]] = {
    command.__name__: command
    for command in (demo, info, convert, download, train, evaluate, predict, live, calibrate, simulate, robot)
}

BAD_INPUT = 2
READER_GONE = 141  # as a shell reports a program whose output nobody reads any more


def run(arguments: Sequence[str]) -> None:
    """Runs one command; what is wrong with the input is said in one line and ends the process."""
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
