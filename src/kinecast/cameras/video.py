"""Pictures as they come: of a webcam, an IP camera, a video file or a folder of pictures, by OpenCV."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from kinecast.cameras.opencv import cv2
from kinecast.errors import OptionError

os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # read when the first video is opened; it would print of its own
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)

Colour = UInt8[np.ndarray, "h w 3"]
ENDINGS = (".png", ".jpg", ".jpeg", ".bmp", ".webp", ".tif", ".tiff")
STREAMS = ("http://", "https://", "rtsp://", "udp://")
RATE = 30.0  # pictures in a second of a folder, and of a video that does not say
ASKED = (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT, cv2.CAP_PROP_FPS)  # of a webcam, if at all
SILENT = 5000  # after so long without a picture an IP camera counts as lost [ms]


class VideoStream:
    """RGB pictures of one place: a webcam's number, an IP camera's address, a video file, a folder of pictures.

    A webcam is asked for a size [px] and a rate [1/s], and may give others; a folder has that rate. An OptionError
    where there is no such camera, file or folder, or it gives no picture.

    Attributes:
        live: whether it is a camera: pictures are stamped as they come and a lost one can be opened anew.
        size: width and height of the pictures [px].
        rate: pictures in a second, as far as the camera or file says.
        lost: pictures of a folder that cannot be read or are of another size, and what a video that breaks off lacks.
    """

    def __init__(self, place: str, size: tuple[int, int] | None = None, rate: float | None = None) -> None:
        self.place, self._asked = place, (*(size or (None, None)), rate)
        self.live = place.isdecimal() or place.startswith(STREAMS)
        self.rate = rate or RATE
        self.lost = 0
        self._epoch = time.time() - time.monotonic()
        first = next(self._pictures(threading.Event()), None)
        if first is None:
            raise OptionError(f"camera:{place}: {self._why_none()}")
        self.size: tuple[int, int] = first[1].shape[1], first[1].shape[0]
        self.lost = 0

    def pictures(self, stop: threading.Event) -> Iterator[tuple[float, Colour]]:
        """From the beginning, each with its stamp [s]: Unix time of a camera, a video's own, at the rate of a folder.

        Ends when told to, or with the file. A RuntimeError where a camera gives no more.
        """
        for stamp, picture in self._pictures(stop):
            if (picture.shape[1], picture.shape[0]) == self.size:
                yield stamp, picture
            else:
                self.lost += 1
        if self.live and not stop.is_set():
            raise RuntimeError("gives no picture any more")

    def _pictures(self, stop: threading.Event) -> Iterator[tuple[float, Colour]]:
        folder = Path(self.place)
        if not self.live and folder.is_dir():
            for index, path in enumerate(sorted(each for each in folder.iterdir() if each.suffix.lower() in ENDINGS)):
                picture = cv2.imread(str(path), cv2.IMREAD_COLOR_RGB)
                self.lost += picture is None
                if picture is not None and not stop.is_set():
                    yield index / self.rate, picture
            return
        if self.place.isdecimal():
            capture = cv2.VideoCapture(int(self.place))
        else:
            waits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, SILENT, cv2.CAP_PROP_READ_TIMEOUT_MSEC, SILENT]
            capture = cv2.VideoCapture(self.place, cv2.CAP_FFMPEG, waits)
        try:
            yield from self._decoded(capture, stop)
        finally:
            capture.release()

    def _decoded(self, capture: cv2.VideoCapture, stop: threading.Event) -> Iterator[tuple[float, Colour]]:
        for number, value in zip(ASKED, self._asked, strict=True):
            if value and self.live:
                capture.set(number, value)
        told = capture.get(cv2.CAP_PROP_FPS)
        self.rate = float(told) if 1.0 <= told <= 1000.0 else self.rate
        index, last = 0, -np.inf
        while not stop.is_set():
            came, picture = capture.read()
            if not came:
                self.lost += 0 if self.live else max(int(capture.get(cv2.CAP_PROP_FRAME_COUNT)) - index, 0)
                return
            stamp = self._epoch + time.monotonic()
            if not self.live:
                stamp = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
                stamp = stamp if stamp > last else last + 1 / self.rate if index else 0.0
            index, last = index + 1, stamp
            yield stamp, cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)

    def _why_none(self) -> str:
        if self.place.isdecimal():
            return f"no camera {self.place} is there, or another program uses it"
        if self.live:
            return "nobody sends pictures there"
        if Path(self.place).is_dir():
            return f"the folder holds no picture that can be read ({', '.join(ENDINGS)})"
        if Path(self.place).is_file():
            return "is no video with a picture that can be read"
        return "no such file or folder"
