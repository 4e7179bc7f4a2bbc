"""The command `kinecast`. Nothing is imported here, so that Ctrl-C ends it quietly however early it comes."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Sequence

__all__ = ["main"]

INTERRUPTED = 130
"""As a shell reports a program ended by Ctrl-C."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs one command. Exit code 2, and one line on standard error, for anything wrong with the input.

    Ctrl-C: exit code 130 and one line, whenever it comes. While modules are imported, and after the command, there is
    nothing to tidy up, and the process ends at once; so it does when Ctrl-C comes again during tidying up.

    Args:
        arguments: after the program's name; None for those of this process, which then ends after the command.
    """
    interrupted = threading.Event()

    def interrupt(*_: object) -> None:
        if interrupted.is_set():
            _leave()
        interrupted.set()
        raise KeyboardInterrupt

    def unraisable(problem: sys.UnraisableHookArgs) -> None:
        """Where no exception can be raised, in a callback or a destructor, Ctrl-C is not lost: it comes again."""
        if problem.exc_type is KeyboardInterrupt:
            interrupted.clear()
            threading.Timer(0.01, signal.pthread_kill, [threading.main_thread().ident, signal.SIGINT]).start()
        else:
            hook(problem)

    hook = sys.unraisablehook
    ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    ours = ours and threading.current_thread() is threading.main_thread()
    try:
        if ours:
            sys.unraisablehook = unraisable
            signal.signal(signal.SIGINT, _leave)
        from kinecast.cli.commands import run

        if ours:
            signal.signal(signal.SIGINT, interrupt)
        run(sys.argv[1:] if arguments is None else arguments)
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt) or (interrupted.is_set() and not isinstance(error, SystemExit)):
            print("kinecast: interrupted", file=sys.stderr)  # also where something made another exception of it
            raise SystemExit(INTERRUPTED) from None
        raise
    finally:
        if ours:
            sys.unraisablehook = hook
            signal.signal(signal.SIGINT, _leave if arguments is None else signal.default_int_handler)


def _leave(*_: object) -> None:
    """Ends the process here and now."""
    os.write(2, b"kinecast: interrupted\n")
    os._exit(INTERRUPTED)
