"""The command `kinecast`. Nothing heavy is imported here, so that Ctrl-C ends it quietly however early it comes."""

from __future__ import annotations

import atexit
import os
import shutil
import signal
import sys
import threading
import time
from contextlib import suppress

__all__ = ["main"]

INTERRUPTED = 130  # as a shell reports a program ended by Ctrl-C
PATIENCE = 5.0  # longest wait for a command that ends by itself [s]
UNWOUND = "robot"  # the command in which Ctrl-C is an exception: an arm must be stopped


def main() -> None:
    """Runs the command that this process was begun for.

    Ctrl-C ends it at once, whatever it does: exit code 130, one line, and no draft or process of its own is left. A
    command that has a handler of its own is left alone.
    """
    if heard := signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not by a job in the background
        signal.signal(signal.SIGINT, _hold)
        reader, writer = os.pipe()
        os.set_blocking(writer, False)
        signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
        threading.Thread(target=_watch, args=(reader,), daemon=True).start()
        atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)  # what is done was not interrupted
    from kinecast.cli.commands import run

    if heard and sys.argv[1:2] == [UNWOUND]:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        run(sys.argv[1:])
    except KeyboardInterrupt:
        _leave()


def _hold(*_: object) -> None:
    """Keeps the main thread from going on while `_watch` ends the process."""
    time.sleep(PATIENCE)
    _leave()


def _watch(reader: int) -> None:
    """A thread that is told of Ctrl-C by the interpreter at once, whatever foreign code the main thread is in."""
    while True:
        if os.read(reader, 1)[0] == signal.SIGINT:
            handler = signal.getsignal(signal.SIGINT)
            if handler is signal.default_int_handler:
                time.sleep(PATIENCE)  # the exception may be lost: in a destructor, a callback, an import
            if handler in (_hold, signal.default_int_handler):
                _leave()


def _leave() -> None:
    """Ends the process here and now, with its drafts and the processes that it began."""
    output, processes = sys.modules.get("kinecast.output"), sys.modules.get("multiprocessing.process")
    with suppress(Exception):  # neither is imported here: another thread may be importing for ever
        for child in processes.active_children() if processes else ():
            child.kill()
        for draft in list(output.DRAFTS) if output else ():
            shutil.rmtree(draft, ignore_errors=True)
    with suppress(OSError):
        cursor = b"\r\x1b[K\x1b[?25h" if os.isatty(2) else b""  # a progress bar hides it
        os.write(2, cursor + b"kinecast: interrupted\n")
    os._exit(INTERRUPTED)
