"""Where predictions go: every sink takes them without ever making the predictor wait."""

from __future__ import annotations

import queue
import threading
import time
from pathlib import Path
from typing import IO, Protocol, runtime_checkable

from kinecast.live.attempts import Attempts
from kinecast.live.publication import Publication
from kinecast.live.tally import Tally

__all__ = ["FileSink", "JsonlSink", "Sink"]

MOST_WAITING = 100
"""Publications that wait for a disc; more are dropped and counted."""


@runtime_checkable
class Sink(Protocol):
    """Takes publications.

    Attributes:
        address: where they go, for messages.
        tally: what was sent and dropped.
    """

    address: str
    tally: Tally

    @property
    def failure(self) -> str | None:
        """Why it has stopped, or None."""
        ...

    def publish(self, publication: Publication) -> None:
        """Takes one; neither waits nor raises."""
        ...

    def close(self) -> None:
        """Sends or writes what it has taken, and ends."""
        ...


class FileSink:
    """A file that is written in a thread of its own.

    Args:
        path: of the file; one that is there is replaced.

    Raises:
        OSError: it cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        self.address = str(path)
        self.tally = Tally()
        self._attempts = Attempts(self.address, "written", OSError)
        self._file: IO[bytes] = path.open("wb")
        self._waiting: queue.Queue[Publication | None] = queue.Queue(MOST_WAITING)
        self.begin(self._file)
        self._thread = threading.Thread(target=self._run, name=self.address, daemon=True)
        self._thread.start()

    def begin(self, file: IO[bytes]) -> None:
        """Writes what comes first."""

    def write(self, file: IO[bytes], publication: Publication) -> None:
        """Writes one."""
        raise NotImplementedError

    def finish(self, file: IO[bytes]) -> None:
        """Writes what comes last."""

    @property
    def failure(self) -> str | None:
        """See Sink."""
        return self._attempts.failure

    def publish(self, publication: Publication) -> None:
        """See Sink."""
        try:
            self._waiting.put_nowait(publication)
        except queue.Full:
            self.tally.dropped += 1

    def close(self) -> None:
        """See Sink."""
        self._waiting.put(None)
        self._thread.join()

    def _run(self) -> None:
        while (publication := self._waiting.get()) is not None:
            if self._attempts.succeeds(self.write, self._file, publication):
                self.tally.sent(time.monotonic() - publication.acquired)
            else:
                self.tally.dropped += 1
        self._attempts.succeeds(self.finish, self._file)
        try:
            self._file.close()
        except OSError as error:
            self._attempts.fail(error)


class JsonlSink(FileSink):
    """A line of JSON for each prediction (docs/live.md)."""

    def write(self, file: IO[bytes], publication: Publication) -> None:
        """See FileSink."""
        file.write(publication.json + b"\n")
