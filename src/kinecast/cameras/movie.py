"""The camera's pictures with what was predicted, as an MP4 file: a sink of `kinecast live`."""

from __future__ import annotations

import threading
import time
from collections import deque
from pathlib import Path

import numpy as np

from kinecast.cameras.opencv import cv2
from kinecast.cameras.overlay import Picture, drawn
from kinecast.live.publication import Publication
from kinecast.live.sinks import BackgroundWriter

MOST_WAITING = 30  # pictures that wait for the disc; more are dropped and counted
DELAY = 0.1  # a picture waits so long for its prediction [s]
RECENT = 0.2  # a prediction of a person who is not seen in the picture is drawn for so long [s]
LONGEST = 600  # pictures by which one is repeated where a camera was silent


class Movie(BackgroundWriter):
    """Writes each picture at its own time; an unfinished file has another name, and none stays without a picture.

    A file that is at the path is replaced at the end.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._part = path, path.with_name(f"{path.stem}.part{path.suffix}")
        self._published: dict[tuple[str, str], deque[Publication]] = {}
        self._lock = threading.Lock()
        self._writer: cv2.VideoWriter | None = None
        self._begun, self._written = 0.0, 0  # stamp of the first picture [s], and how many are in the file
        super().__init__(str(path), MOST_WAITING)

    def publish(self, publication: Publication) -> None:
        """See kinecast.live.sinks.Sink."""
        with self._lock:
            self._published.setdefault(publication.key, deque(maxlen=MOST_WAITING)).append(publication)

    def take(self, picture: Picture) -> None:
        """A picture that was looked at; never waits."""
        self.put((picture, time.monotonic()), time.monotonic())

    def write(self, item: tuple[Picture, float]) -> None:
        """Writes one, when its prediction may be there, and it again where the camera was silent."""
        picture, came = item
        self._closing.wait(max(came + DELAY - time.monotonic(), 0.0))
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

    def finish(self) -> None:
        """Gives the file its name."""
        if self._writer is not None:
            self._writer.release()
            self._part.replace(self._path)

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
