"""Cameras of a rig as one source: what each sees goes through the fusion in a thread, and persons come out."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

from kinecast.cameras.fusion.fusion import MOST_PEOPLE, Fusion
from kinecast.cameras.rig import Rig
from kinecast.errors import OptionError
from kinecast.live.detection import Detection, DetectionHandler
from kinecast.live.mailbox import Feed
from kinecast.types import SkeletonFrame

GATHER = 0.004  # people of one image who come in messages of their own come within this [s]
PATIENCE = 0.05  # after so long without any image [s] a round ends without the cameras that are missing
JUDGE, MOST_THROWN_OUT = 10.0, 30  # how often cameras are judged [s], and views that may be thrown out until then
LOOK, CLOSING = 0.1, 5.0  # longest waits before looking whether to end, and for the end [s]

log = logging.getLogger(__name__)


@dataclass
class _Image:
    """One that was not fused yet; when it is due [s], everybody in it came."""

    camera: str
    feed: Feed
    stamp: float
    acquired: float
    due: float
    people: list[Detection | SkeletonFrame]


class FusedSource:
    """Fuses what cameras deliver; the newest image of each camera wins, and no queue grows.

    Frames go to the feed, stamped with this machine's time [s since 1970], since the cameras' clocks are several.
    """

    def __init__(self, rig: Rig, feed: Feed) -> None:
        self.rig, self.cameras = rig, rig.cameras.keys()
        self.address = feed.name = f"fusion of {', '.join(rig.cameras)}"
        self.fusion = Fusion(rig)
        self._feed = feed
        self._inputs: set[Feed] = set()
        self._waiting: dict[str, _Image] = {}
        self._changed = threading.Condition()
        self._stop = False
        self._judged = time.monotonic()
        self._thread: threading.Thread | None = None
        self._epoch = time.time() - time.monotonic()

    def handler(self, camera: str, feed: Feed) -> DetectionHandler:
        """What a source of that camera of the rig gives its images to, counted in its feed; else an OptionError."""
        if camera not in self.rig.cameras:
            known = ", ".join(self.rig.cameras)
            raise OptionError(f"{feed.name}: camera {camera!r} is not in the rig, which has {known}")
        self.expect(feed)
        feed.fused = True
        return lambda stamp, people, acquired: self._put(
            _Image(camera, feed, stamp, acquired, time.monotonic(), list(people))
        )

    def expect(self, feed: Feed) -> None:
        """Does not end before that feed has: images of a camera may come by it."""
        self._inputs.add(feed)

    def put(self, camera: str, feed: Feed, person: Detection | SkeletonFrame, acquired: float) -> None:
        """One of perhaps several persons in an image; see `Feed.put`. Never waits."""
        self._put(_Image(camera, feed, person.stamp, acquired, time.monotonic() + GATHER, [person]))

    def start(self) -> None:
        self._thread = threading.Thread(target=self._run, name="fusion", daemon=True)
        self._thread.start()

    def close(self) -> None:
        with self._changed:
            self._stop = True
            self._changed.notify()
        if self._thread:
            self._thread.join(CLOSING)

    def _put(self, image: _Image) -> None:
        image.feed.received += 1
        image.feed.last = time.monotonic()
        image.acquired = min(image.acquired, image.feed.last)
        with self._changed:
            waiting = self._waiting.get(image.camera)
            if waiting is not None and waiting.stamp == image.stamp:
                waiting.people += image.people[: MOST_PEOPLE - len(waiting.people)]
                return
            if waiting is not None:
                waiting.feed.superseded += 1
            self._waiting[image.camera] = image
            self._changed.notify()

    def _run(self) -> None:
        while not self._stop:
            images = self._take()
            try:
                self._fuse(images)
            except Exception:  # whatever one camera says, the others go on
                log.exception("%s: a round could not be fused", self.address)
            if not images and all(feed.ended for feed in self._inputs):
                break
        self._feed.end()

    def _take(self) -> list[_Image]:
        """Images that are due, oldest first; none after a while."""
        with self._changed:
            if not self._waiting and not self._stop:
                self._changed.wait(PATIENCE if self.fusion.waiting else LOOK)
            ahead = min((each.due for each in self._waiting.values()), default=0.0) - time.monotonic()
            if ahead > 0 and not self._stop:
                self._changed.wait(ahead)
            now = time.monotonic()
            due = [each for each in self._waiting.values() if each.due <= now]
            for image in due:
                del self._waiting[image.camera]
        return sorted(due, key=lambda image: image.acquired)

    def _fuse(self, images: Sequence[_Image]) -> None:
        frames = [] if images else self.fusion.finish()
        for image in images:
            frames += self.fusion.add(image.camera, image.acquired, image.people)
        for frame in frames:
            self._feed.put(replace(frame, stamp=frame.stamp + self._epoch), frame.stamp)
        if time.monotonic() - self._judged > JUDGE:
            self._judged = time.monotonic()
            self._judge()

    def _judge(self) -> None:
        """Names cameras whose views were mostly thrown out lately: they may have been moved."""
        for camera, thrown_out in self.fusion.thrown_out.items():
            used = self.fusion.used[camera]
            if thrown_out > max(used, MOST_THROWN_OUT):
                log.warning(
                    "%s: camera %r contradicts the others in %d of %d views: has it moved since it was calibrated?",
                    self.address, camera, thrown_out, used + thrown_out,
                )  # fmt: skip
        self.fusion.used.clear()
        self.fusion.thrown_out.clear()
