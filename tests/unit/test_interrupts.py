"""An answered signal reaches its handler and nobody else, and afterwards everything is as before."""

from __future__ import annotations

import os
import signal

from kinecast.interrupts import answered


def test_an_answered_signal_is_told_to_nobody_else() -> None:
    reader, writer = os.pipe()
    for end in (reader, writer):
        os.set_blocking(end, False)
    heard: list[int] = []
    outside = signal.signal(signal.SIGUSR1, lambda number, _: heard.append(-number))
    before = signal.set_wakeup_fd(writer)
    try:
        with answered(lambda number, _: heard.append(number), signal.SIGUSR1):
            signal.raise_signal(signal.SIGUSR1)
        assert heard == [signal.SIGUSR1]
        signal.raise_signal(signal.SIGUSR1)
        assert heard == [signal.SIGUSR1, -signal.SIGUSR1]
        assert os.read(reader, 9) == bytes([signal.SIGUSR1])  # the second alone
    finally:
        signal.set_wakeup_fd(before)
        signal.signal(signal.SIGUSR1, outside)
        os.close(reader)
        os.close(writer)
