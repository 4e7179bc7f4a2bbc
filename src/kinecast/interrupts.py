"""Signals that a part of a command answers itself, such as Ctrl-C where it ends a loop and nothing else."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def answered(handler: Callable[..., None], *signals: int) -> Iterator[None]:
    """Signals go to a handler alone, in the main thread, until the block ends.

    Nobody who waits for the wakeup descriptor is told of them: that thread (kinecast.cli) may look late, when the
    handler from before is back, and take an answered Ctrl-C for its own.
    """
    before = {number: signal.signal(number, handler) for number in signals}
    wakeup = signal.set_wakeup_fd(-1)
    try:
        yield
    finally:
        for number, each in before.items():
            signal.signal(number, each)
        signal.set_wakeup_fd(wakeup, warn_on_full_buffer=False)
