"""A plain camera, a video or pictures as a source: nothing but pictures, MediaPipe's landmarks and a stated size."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from kinecast.cameras.keypoints import detection
from kinecast.cameras.landmarker import JOINTS, MOST_PEOPLE, Landmarker, Landmarks
from kinecast.cameras.overlay import Picture, Watcher
from kinecast.cameras.pinhole import Intrinsics, PinholeCamera, level_pose
from kinecast.cameras.rig import Rig
from kinecast.cameras.single_view import RESTART, ScaleOptions, SingleView
from kinecast.cameras.video import Colour, VideoStream
from kinecast.datasets.remote_file import cached_model
from kinecast.errors import OptionError
from kinecast.live.detection import LEAST_CONFIDENCE, Detection, DetectionHandler
from kinecast.live.mailbox import Feed
from kinecast.live.settings import Meta, Size, width_height

MODEL = "pose-landmarker"
FIELD_OF_VIEW = 65.0  # of most webcams, from the left edge to the right [deg]: makers give 60 to 70
UNSTATED_STD, STATED_STD = 0.10, 0.02  # relative errors of the focal length
RETRY = 1.0  # before a camera that is lost is opened anew [s]
CLOSING = 5.0  # longest wait for the end [s]


@dataclass(frozen=True)
class WebcamOptions:
    """How a camera is used."""

    model: Path | None = None  # the network's file; None for the one that was downloaded
    people: Annotated[int, Meta(ge=1, le=MOST_PEOPLE)] = 1  # at most so many are followed
    size: Size | None = None  # asked of a webcam
    rate: Annotated[float, Meta(ge=1, le=300)] | None = None  # pictures in a second, asked of a webcam, and of a folder
    fov: Annotated[float, Meta(ge=10, le=150)] | None = None  # from the left edge to the right [deg]
    lens: Path | None = None  # a rig file with one camera, whose lens it has
    tilt: Annotated[float, Meta(ge=-90, le=90)] = 0.0  # by how much the camera looks down [deg]
    height: Annotated[float, Meta(ge=-10, le=10)] = 0.0  # of the camera above the world's origin [m]
    body: Annotated[float, Meta(ge=0.8, le=2.5)] | None = None  # height of everybody who comes [m]
    feet: Literal["floor"] | None = None  # the scale is taken from where feet stand
    confidence: Annotated[float, Meta(ge=0, le=1)] = LEAST_CONFIDENCE  # from which a joint counts as seen
    speed: Annotated[float, Meta(ge=0.01, le=100)] = 1.0  # of a file or folder; 2 plays it twice as fast
    camera: str = ""  # of the rig

    def __post_init__(self) -> None:
        if self.feet and self.height < 0.5:
            raise OptionError("feet=floor needs the camera's height=, 0.5 m or more above the floor")
        if self.feet and self.body:
            raise OptionError("body= and feet=floor both say how large people are: give one")
        if self.fov and self.lens:
            raise OptionError("fov= and lens= both say what the lens is: give one")

    def intrinsics(self, size: tuple[int, int]) -> Intrinsics:
        """Of pictures of a size [px]; an OptionError where the lens file is of others."""
        width, height = size
        if self.lens is None:
            focal = width / 2 / np.tan(np.radians(self.fov or FIELD_OF_VIEW) / 2)
            return Intrinsics(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
        found = [each.intrinsics for each in Rig.load(self.lens).cameras.values()]
        if len(found) != 1 or (found[0].width, found[0].height) != size:
            sizes = ", ".join(f"{each.width}x{each.height}" for each in found)
            raise OptionError(f"lens={self.lens}: expected one camera of {width}x{height} pixels, found {sizes}")
        return found[0]

    @property
    def scale(self) -> ScaleOptions:
        """What is known of sizes."""
        focal_std = 0.0 if self.lens else STATED_STD if self.fov else UNSTATED_STD
        return ScaleOptions(self.body, self.feet == "floor", focal_std, self.confidence)


class WebcamSource:
    """Finds people in the newest picture, in a thread of its own; another reads pictures; a lost camera is opened anew.

    The handler takes what is seen; without, skeletons go to the feed, in a world that begins below the camera. Every
    picture that was looked at goes to the watchers. An OptionError where there is no such camera (see VideoStream), a
    ModelError for a bad network.
    """

    def __init__(
        self,
        name: str,
        feed: Feed,
        place: str,
        options: WebcamOptions,
        watchers: Sequence[Watcher] = (),
        handler: DetectionHandler | None = None,
    ) -> None:
        self.stream = VideoStream(place, width_height(options.size) if options.size else None, options.rate)
        self._landmarker = Landmarker(options.model or cached_model(MODEL), options.people)
        self.address, self.intrinsics = name, options.intrinsics(self.stream.size)
        pose = level_pose(options.height, float(np.radians(options.tilt)))
        self._camera = PinholeCamera(name, self.intrinsics, pose)
        self._feed, self._options, self._watchers, self._handler = feed, options, watchers, handler
        self._views: dict[str, SingleView] = {}
        self._newest: queue.SimpleQueue[tuple[float, Colour, float] | None] = queue.SimpleQueue()  # at most one picture
        self._stop = threading.Event()
        self._threads = [threading.Thread(target=each, name=name, daemon=True) for each in (self._read, self._run)]

    def start(self) -> None:
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        self._stop.set()
        self._newest.put(None)
        for thread in self._threads:
            if thread.is_alive():
                thread.join(CLOSING)
        self._landmarker.close()

    def _read(self) -> None:
        """Holds the newest picture; one that nobody looked at in time is counted as stale."""
        while not self._stop.is_set():
            try:
                for picture in self._played():
                    with suppress(queue.Empty):
                        self._newest.get_nowait()
                        self._feed.received += 1
                        self._feed.superseded += 1
                    self._newest.put(picture)
            except Exception as problem:  # of OpenCV, the camera, the file: none may end the others
                self._feed.refuse(f"{type(problem).__name__}: {problem}")
            if not self.stream.live or self._stop.wait(RETRY):
                break
        self._newest.put(None)

    def _played(self) -> Iterator[tuple[float, Colour, float]]:
        """Pictures with their stamps, and when they came or were due [s] on `time.monotonic`."""
        begun: float | None = None  # of a file's clock, on this one
        for stamp, picture in self.stream.pictures(self._stop):
            due = time.monotonic()
            if not self.stream.live:
                begun = due - stamp / self._options.speed if begun is None else begun
                due = begun + stamp / self._options.speed
                if self._stop.wait(max(due - time.monotonic(), 0.0)):
                    return
            yield stamp, picture, due

    def _run(self) -> None:
        looked_at = placed = 0
        while (newest := self._newest.get()) is not None and not self._stop.is_set():
            try:
                placed += self._look(*newest)
            except Exception as problem:  # of MediaPipe
                self._feed.refuse(f"{type(problem).__name__}: {problem}")
            looked_at += 1
        unread = f"{self.stream.lost} pictures could not be read" if self.stream.lost else ""
        nobody = f"nobody was seen in {looked_at} pictures" if looked_at and not placed else ""
        if unread or nobody:
            self._feed.refuse(", ".join(filter(None, (unread, nobody))))
        self._feed.end()

    def _look(self, stamp: float, picture: Colour, acquired: float) -> int:
        """How many people were placed."""
        people = self._landmarker.update(picture, stamp)
        if self._handler is not None:
            self._handler(stamp, [self._detection(stamp, name, each) for name, each in people.items()], acquired)
            frames = []
        else:
            self._views = {name: view for name, view in self._views.items() if stamp - view.stamp <= RESTART}
            for name in people.keys() - self._views:
                self._views[name] = SingleView(self._camera, self._options.scale)
            frames = [self._views[name].update(stamp, person, name) for name, person in people.items()]
        for watcher in self._watchers:
            watcher(Picture(self._feed.name, stamp, picture, self._camera, self.stream.rate))
        for frame in frames:
            if frame is not None:
                self._feed.put(frame, acquired, 1.0 if self.stream.live else self._options.speed)
        return len(people)

    def _detection(self, stamp: float, name: str, person: Landmarks) -> Detection:
        """For the fusion: pixels, and no depth."""
        seen = detection(JOINTS, person.pixels, person.confidence, self._options.confidence)
        return replace(seen, stamp=stamp, camera=self.address, person=name)
