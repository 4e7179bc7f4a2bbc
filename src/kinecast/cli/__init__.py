"""The command `kinecast`. Nothing heavy is imported here, so that Ctrl-C ends it quietly however early it comes."""

from __future__ import annotations

import atexit
import os
import signal
import sys
import threading
from contextlib import suppress

__all__ = ["main"]

INTERRUPTED = 130  # as a shell reports a program ended by Ctrl-C
PATIENCE, TIMES = 2.0, 2
"""While the command goes on, Ctrl-C comes again after so long [s], so many times; then the process ends at once."""


def main() -> None:
    """Runs the command that this process was begun for.

    Ctrl-C: exit code 130 and one line, whenever it comes. While the command's modules are imported there is nothing to
    tidy up, and the process ends at once.
    """
    heard = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # not by a job in the background
    if heard:
        signal.signal(signal.SIGINT, _leave)
        atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)  # what is done was not interrupted
        sys.unraisablehook = _unraisable
    from kinecast.cli.commands import run

    ended = threading.Event()
    try:
        try:
            if heard:
                reader, writer = os.pipe()
                os.set_blocking(writer, False)
                signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
                threading.Thread(target=_insist, args=(reader, ended), daemon=True).start()
                signal.signal(signal.SIGINT, _interrupt)
            run(sys.argv[1:])
        finally:
            ended.set()
            if heard:
                signal.signal(signal.SIGINT, _leave)
    except BaseException as error:
        if _interrupted.is_set() or isinstance(error, KeyboardInterrupt):
            _leave()  # also where something made another exception of it
        raise


_interrupted = threading.Event()


def _interrupt(*_: object) -> None:
    _interrupted.set()
    output = sys.modules.get("kinecast.output")
    if "jaxlib" in sys.modules and not (output and output.BEING_WRITTEN):
        _leave()  # an exception in the midst of JAX's compiler aborts the process, and there is nothing to tidy up
    raise KeyboardInterrupt


def _unraisable(problem: sys.UnraisableHookArgs) -> None:
    if problem.exc_type is not KeyboardInterrupt:  # lost in a destructor: it comes again
        sys.__unraisablehook__(problem)


def _insist(reader: int, ended: threading.Event) -> None:
    """A thread that is told of Ctrl-C by the interpreter at once, and sees to it that the command ends.

    The main thread may not hear it for long, in foreign code, and the exception that it raises may be lost: in a
    destructor, a callback, an import. A command that handles Ctrl-C itself is left alone.
    """
    while os.read(reader, 1)[0] != signal.SIGINT or signal.getsignal(signal.SIGINT) != _interrupt:
        pass
    for _ in range(TIMES):
        if ended.wait(PATIENCE):
            return
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
    if not ended.wait(PATIENCE):
        _leave()


def _leave(*_: object) -> None:
    """Ends the process here and now, and the processes that it began."""
    processes = sys.modules.get("multiprocessing.process")  # not imported: another thread may be importing for ever
    with suppress(Exception):
        for child in processes.active_children() if processes else ():
            child.kill()
    with suppress(OSError):
        os.write(2, b"kinecast: interrupted\n")
    os._exit(INTERRUPTED)
