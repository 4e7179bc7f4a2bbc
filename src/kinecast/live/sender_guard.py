"""What a network source lets in: whole messages, few persons, and one sender for each person."""

from __future__ import annotations

from collections.abc import Collection, Hashable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from kinecast.live.clock import SourceClock
from kinecast.live.detection import Detection
from kinecast.live.mailbox import Feed
from kinecast.live.message import MessageError, decode
from kinecast.types import SkeletonFrame

MOST_PERSONS = 16  # persons of one source, or of one camera of it, at once
MOST_SENDERS = 16  # senders of one source at once
FORGET = 2.0  # after so much silence [s] a person's name, or a sender's place, is free for another


@runtime_checkable
class CameraFusion(Protocol):
    """Where what the cameras of a rig see goes (kinecast.cameras)."""

    @property
    def cameras(self) -> Collection[str]: ...  # names of those in the rig

    def put(self, camera: str, feed: Feed, person: Detection | SkeletonFrame, acquired: float) -> None: ...


@dataclass(frozen=True)
class SenderOptions:
    """What messages do not say themselves."""

    camera: str = ""  # of the rig, whose frames all are; "" where messages say it


class SenderGuard:
    """Takes the messages of every sender to one source; whatever comes, nothing is raised.

    Args:
        feed: where good frames go and bad messages are counted.
        fused: where frames of a rig's cameras go instead; None without a rig.
        camera: of which all are; empty where messages say it themselves.
    """

    def __init__(self, feed: Feed, fused: CameraFusion | None = None, camera: str = "") -> None:
        self._feed = feed
        self._fused = fused
        self._camera = camera
        self._senders: dict[Hashable, tuple[SourceClock, float]] = {}
        self._persons: dict[tuple[str, str], tuple[Hashable, float]] = {}

    @property
    def senders(self) -> int:
        """How many are known now."""
        return len(self._senders)

    def take(self, content: bytes | str, sender: Hashable, arrived: float) -> None:
        """One message (see `decode`) of a sender: a connection or an address; `arrived` [s] is on `time.monotonic`."""
        try:
            self.admit(decode(content), sender, arrived)
        except MessageError as problem:
            self._feed.refuse(str(problem))

    def admit(self, frame: SkeletonFrame | Detection, sender: Hashable, arrived: float) -> None:
        """A frame that was read already; see `take`.

        A MessageError where too many send, its person is another sender's, or its camera is none of the rig's.
        """
        camera = self._camera_of(frame)
        clock = self._clock_of(sender, arrived)
        self._claim((camera, frame.person), sender, arrived)
        jumps = clock.jumps
        acquired = clock.acquired(frame.stamp, arrived)
        self._feed.clock_jumps += clock.jumps - jumps
        self._feed.difference = clock.difference
        if self._fused is not None and camera:
            self._fused.put(camera, self._feed, frame, acquired)
        elif isinstance(frame, SkeletonFrame):
            self._feed.put(frame, acquired)

    def leave(self, sender: Hashable) -> None:
        """A sender has gone: its persons' names are free."""
        self._senders.pop(sender, None)
        self._persons = {person: owner for person, owner in self._persons.items() if owner[0] != sender}

    def _clock_of(self, sender: Hashable, arrived: float) -> SourceClock:
        """The sender's clock; one that is new takes the place of one that is silent."""
        if sender not in self._senders:
            self._senders = {known: kept for known, kept in self._senders.items() if arrived - kept[1] < FORGET}
            if len(self._senders) >= MOST_SENDERS:
                raise MessageError(f"more than {MOST_SENDERS} senders")
        clock = self._senders[sender][0] if sender in self._senders else SourceClock()
        self._senders[sender] = clock, arrived
        return clock

    def _claim(self, person: tuple[str, str], sender: Hashable, arrived: float) -> None:
        """A person of a camera belongs to the first who sends it, until that sender is silent about it."""
        owner, last = self._persons.get(person, (sender, arrived))
        if owner != sender and arrived - last < FORGET:
            raise MessageError(f"person {person[1]!r} is sent by another sender too")
        if person not in self._persons:
            self._persons = {known: kept for known, kept in self._persons.items() if arrived - kept[1] < FORGET}
            if sum(camera == person[0] for camera, _ in self._persons) >= MOST_PERSONS:
                raise MessageError(f"more than {MOST_PERSONS} persons")
        self._persons[person] = sender, arrived

    def _camera_of(self, frame: SkeletonFrame | Detection) -> str:
        """The rig's camera whose frame it is; empty for a skeleton in the world."""
        pixels = isinstance(frame, Detection)
        if self._fused is None:
            if pixels:
                raise MessageError("pixels need --rig, a file of cameras")
            return ""
        cameras = self._fused.cameras
        named = frame.camera if isinstance(frame, Detection) else frame.frame_id if frame.frame_id in cameras else ""
        if named and self._camera and named != self._camera:
            raise MessageError(f"camera {named!r}, but this source is of camera {self._camera!r}")
        camera = named or self._camera
        if pixels and camera not in cameras:
            raise MessageError(f"camera {camera!r} is not in the rig, which has {', '.join(cameras)}")
        return camera
