"""A RealSense camera, or a recording of one, as a source: colour and depth to people's joints."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinecast.cameras.camera import PinholeCamera
from kinecast.cameras.depth import DepthImage
from kinecast.cameras.lifting import lifted, standing, view_of
from kinecast.cameras.people import PeopleTracker
from kinecast.cameras.person_detector import PersonDetector
from kinecast.cameras.pose_estimator import PoseEstimator
from kinecast.cameras.realsense_stream import Picture, RealSenseStream
from kinecast.errors import OptionError
from kinecast.live.clock import SourceClock
from kinecast.live.detection import Deliver, View
from kinecast.live.mailbox import Feed
from kinecast.live.settings import number, whole_number

__all__ = ["RealSenseOptions", "RealSenseSource"]

RETRY = 1.0
"""Before a camera that failed is opened anew [s]."""


@dataclass(frozen=True)
class RealSenseOptions:
    """How a camera is used.

    Attributes:
        model: the pose estimator's ONNX file.
        detector: the person detector's; None to follow one person without.
        size: width and height of both images [px].
        rate: pictures in a second.
        tilt: by how much the camera looks down [deg].
        height: of the camera above the world's origin [m].
    """

    model: Path
    detector: Path | None = None
    size: tuple[int, int] = (848, 480)
    rate: int = 30
    tilt: float = 0.0
    height: float = 0.0

    @classmethod
    def parse(cls, settings: Mapping[str, str], text: str) -> RealSenseOptions:
        """From what stands behind the question mark.

        Args:
            settings: those given.
            text: of the source, for messages.

        Raises:
            OptionError: one outside its range, or no model.
        """
        if not settings.get("model"):
            raise OptionError(f"{text}: model=FILE is needed, a pose estimator in ONNX (docs/cameras.md)")
        width, _, height = settings.get("size", "848x480").partition("x")
        if not (width.isdecimal() and height.isdecimal() and 0 < int(width) <= 4096 and 0 < int(height) <= 4096):
            raise OptionError(f"{text}: size {settings['size']!r}, expected a size such as 848x480")
        detector = settings.get("detector")
        return cls(
            Path(settings["model"]),
            Path(detector) if detector else None,
            (int(width), int(height)),
            whole_number(settings, "rate", cls.rate, text, 1.0, 300.0),
            number(settings, "tilt", cls.tilt, text, -90.0, 90.0),
            number(settings, "height", cls.height, text, -10.0, 10.0),
        )


class RealSenseSource:
    """Estimates everybody's pose in each picture, in a thread of its own; a camera that fails is opened anew.

    Args:
        name: for messages.
        feed: where frames go, and failures are counted.
        place: a serial number, the path of a recording, or nothing.
        options: how.
        deliver: takes what is seen; None for skeletons from this camera alone, in a world that begins below it.

    Attributes:
        stream: of the camera.
        intrinsics: of the colour image.

    Raises:
        OptionError: there is no such camera.
        ModelError: a network is none.
    """

    def __init__(
        self, name: str, feed: Feed, place: str, options: RealSenseOptions, deliver: Deliver | None = None
    ) -> None:
        detector = None if options.detector is None else PersonDetector(options.detector)
        self._people = PeopleTracker(PoseEstimator(options.model), detector)
        self.stream = RealSenseStream(place, options.size, options.rate)
        self.address = name
        self.intrinsics = self.stream.intrinsics
        self._camera = PinholeCamera(name, self.intrinsics, standing(options.height, float(np.radians(options.tilt))))
        self._feed = feed
        self._deliver = deliver or self._lift
        self._clock = SourceClock()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begins."""
        self._thread = threading.Thread(target=self._run, name=self.address, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stops, and waits until it has."""
        self._stop.set()
        if self._thread:
            self._thread.join()

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                for picture in self.stream.pictures(self._stop):
                    self._see(picture, time.monotonic())
            except Exception as problem:  # of librealsense, onnxruntime, the camera: none may end the others
                self._feed.refuse(f"{type(problem).__name__}: {problem}")
            else:
                break
            if self.stream.recorded or self._stop.wait(RETRY):
                break
        self._feed.end()

    def _see(self, picture: Picture, arrived: float) -> None:
        found = self._people.follow(picture.colour)
        depths = DepthImage(picture.depth, self.stream.unit, self.intrinsics.fx, self.stream.noise)
        joints = self._people.estimator.joints
        views = [view_of(picture.stamp, self.address, name, joints, each, depths) for name, each in found.items()]
        jumps = self._clock.jumps
        acquired = self._clock.acquired(picture.stamp, arrived)
        self._feed.clock_jumps += self._clock.jumps - jumps
        self._feed.difference = self._clock.difference
        self._deliver(picture.stamp, views, acquired)

    def _lift(self, _stamp: float, views: Sequence[View], acquired: float) -> None:
        for view in views:
            self._feed.put(lifted(view, self._camera), acquired)
