"""The camera's pictures with what was predicted, as an MP4 file: a sink of `kinecast live`."""

from __future__ import annotations

import queue
import threading
import time
from collections import deque
from pathlib import Path

import numpy as np

from kinecast.cameras.overlay import Picture, drawn
from kinecast.errors import MissingExtraError
from kinecast.live.counters import SinkCounters
from kinecast.live.publication import Publication

try:
    import cv2
except ImportError as error:  # pragma: no cover - the tests install it
    raise MissingExtraError("pictures with predictions", "webcam") from error

MOST_WAITING = 30  # pictures that wait for the disc; more are dropped and counted
DELAY = 0.1  # a picture waits so long for its prediction [s]
RECENT = 0.2  # a prediction of a person who is not seen in the picture is drawn for so long [s]
LONGEST = 600  # pictures by which one is repeated where a camera was silent
LOOK = 0.05  # longest wait for a picture before looking whether to end [s]
CLOSING = 10.0  # longest wait for the end [s]


class Movie:
    """Writes each picture at its own time; an unfinished file has another name, and none stays without a picture.

    A file that is at the path is replaced at the end.
    """

    def __init__(self, path: Path) -> None:
        self.address, self._path = str(path), path
        self._part = path.with_name(f"{path.stem}.part{path.suffix}")
        self.counters = SinkCounters(self.address, "written", OSError)
        self._pictures: queue.Queue[tuple[float, Picture]] = queue.Queue(MOST_WAITING)
        self._published: dict[tuple[str, str], deque[Publication]] = {}
        self._lock = threading.Lock()
        self._writer: cv2.VideoWriter | None = None
        self._begun, self._written = 0.0, 0  # stamp of the first picture [s], and how many are in the file
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=self.address, daemon=True)
        self._thread.start()

    def publish(self, publication: Publication) -> None:
        """See kinecast.live.sinks.Sink."""
        with self._lock:
            self._published.setdefault(publication.key, deque(maxlen=MOST_WAITING)).append(publication)

    def take(self, picture: Picture) -> None:
        """A picture that was looked at; never waits."""
        try:
            self._pictures.put_nowait((time.monotonic(), picture))
        except queue.Full:
            self.counters.drop()

    def close(self) -> None:
        """See kinecast.live.sinks.Sink."""
        self._closing.set()
        self._thread.join(CLOSING)
        if self._thread.is_alive():
            self.counters.fail(TimeoutError(f"still writing after {CLOSING:g} s"))

    def _run(self) -> None:
        while not (self._closing.is_set() and self._pictures.empty()):
            try:
                came, picture = self._pictures.get(timeout=LOOK)
            except queue.Empty:
                continue
            self._closing.wait(max(came + DELAY - time.monotonic(), 0.0))
            if self.counters.attempt(self._write, picture):
                self.counters.sent(time.monotonic() - came)
            else:
                self.counters.drop()
        if self._writer is not None:
            self._writer.release()
            self.counters.attempt(self._part.replace, self._path)

    def _write(self, picture: Picture) -> None:
        if self._writer is None:
            size = picture.image.shape[1], picture.image.shape[0]
            self._writer = cv2.VideoWriter(str(self._part), cv2.VideoWriter.fourcc(*"mp4v"), picture.rate, size)
            if not self._writer.isOpened():
                self._writer = None
                raise OSError("OpenCV cannot write this video")
            self._begun = picture.stamp
        due = round((picture.stamp - self._begun) * picture.rate) + 1
        image = cv2.cvtColor(drawn(picture, self._of(picture)), cv2.COLOR_RGB2BGR)
        for _ in range(int(np.clip(due - self._written, 0, LONGEST))):
            self._writer.write(image)
            self._written += 1

    def _of(self, picture: Picture) -> list[Publication]:
        """The newest of each person that is no newer than the picture."""
        found = []
        with self._lock:
            for (source, _), publications in self._published.items():
                ages = [(picture.stamp - each.frame.stamp, each) for each in publications if source == picture.source]
                recent = [(age, each) for age, each in ages if 0 <= age <= RECENT]
                if recent:
                    found.append(min(recent, key=lambda pair: pair[0])[1])
        return found
