"""The command `kinecast`. Nothing heavy is imported here, so that Ctrl-C ends it quietly however early it comes."""

from __future__ import annotations

import atexit
import os
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress

__all__ = ["main"]

INTERRUPTED = 130  # as a shell reports a program ended by Ctrl-C
PATIENCE, TIMES = 2.0, 2
"""While the command goes on, Ctrl-C comes again after so long [s], so many times; then the process ends at once."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs one command. Exit code 2, and one line on standard error, for anything wrong with the input.

    Ctrl-C: exit code 130 and one line, whenever it comes. While the command's modules are imported there is nothing to
    tidy up, and the process ends at once.

    Args:
        arguments: after the program's name; None for those of this process, which then ends after the command.
    """
    interrupted, ended = False, threading.Event()

    def interrupt(*_: object) -> None:
        nonlocal interrupted
        interrupted = True
        output = sys.modules.get("kinecast.output")
        if arguments is None and "jaxlib" in sys.modules and not (output and output.BEING_WRITTEN):
            _leave()  # an exception in the midst of JAX's compiler aborts the process, and there is nothing to tidy up
        raise KeyboardInterrupt

    def unraisable(problem: sys.UnraisableHookArgs) -> None:
        if problem.exc_type is not KeyboardInterrupt:  # lost in a destructor: it comes again
            hook(problem)

    hook = sys.unraisablehook
    ours = threading.current_thread() is threading.main_thread()
    ours = ours and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    try:
        try:
            if ours:
                signal.signal(signal.SIGINT, _leave)
                if arguments is None:  # handlers go before the interpreter: what is done was not interrupted
                    atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)
                sys.unraisablehook = unraisable
                reader, writer = os.pipe()
                os.set_blocking(writer, False)
                before = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
                threading.Thread(target=_insist, args=(reader, interrupt, ended), daemon=True).start()
            from kinecast.cli.commands import run

            if ours:
                signal.signal(signal.SIGINT, interrupt)
            run(sys.argv[1:] if arguments is None else arguments)
        finally:
            if ours:
                signal.signal(signal.SIGINT, _leave)
    except BaseException as error:
        if not interrupted and not isinstance(error, KeyboardInterrupt):
            raise
        if arguments is None:  # also where something made another exception of it
            _leave()
        print("kinecast: interrupted", file=sys.stderr)
        raise SystemExit(INTERRUPTED) from None
    finally:
        ended.set()
        if ours:
            signal.set_wakeup_fd(before)
            os.close(writer)  # then the thread closes the other end, and is done
            sys.unraisablehook = hook
            signal.signal(signal.SIGINT, _leave if arguments is None else signal.default_int_handler)


def _insist(reader: int, interrupt: Callable[..., None], ended: threading.Event) -> None:
    """A thread that is told of Ctrl-C by the interpreter at once, and sees to it that the command ends.

    The main thread may not hear it for long, in foreign code, and the exception that it raises may be lost: in a
    destructor, a callback, an import. A command that handles Ctrl-C itself is left alone.
    """
    while (number := os.read(reader, 1)) and (
        number[0] != signal.SIGINT or signal.getsignal(signal.SIGINT) != interrupt
    ):
        pass
    times = 0
    while not ended.wait(PATIENCE):
        if times == TIMES:
            _leave()
        times += 1
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
    os.close(reader)


def _leave(*_: object) -> None:
    """Ends the process here and now, and the processes that it began."""
    processes = sys.modules.get("multiprocessing.process")  # not imported: another thread may be importing for ever
    with suppress(Exception):
        for child in processes.active_children() if processes else ():
            child.kill()
    with suppress(OSError):
        os.write(2, b"kinecast: interrupted\n")
    os._exit(INTERRUPTED)
