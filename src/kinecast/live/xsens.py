"""Skeletons from Xsens MVN's network streamer, as it sends them by UDP."""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from kinecast.body.skeleton import XSENS_23
from kinecast.errors import OptionError
from kinecast.geometry.transforms import from_y_up
from kinecast.live.admission import FORGET, MOST_PERSONS, Admission
from kinecast.live.mailbox import Feed
from kinecast.live.message import FARTHEST, MessageError
from kinecast.live.xsens_datagram import BODY_SEGMENTS, EULER, MOST_CHARACTERS, Datagram, read
from kinecast.types import SkeletonFrame

__all__ = ["DEFAULT_PORT", "XsensAdmission", "XsensOptions"]

DEFAULT_PORT = 9763
"""MVN sends to this one unless told otherwise (2.3)."""
MOST_PENDING = 3
"""Samples of a character that wait for their other datagrams."""
REORDERED = 64
"""A sample at most so far behind the newest was overtaken on its way; one farther behind is of a new beginning."""
CENTIMETRES = 3.0
"""An upper arm beyond this is in cm. The specification says cm for all (2.5.6); with quaternions m have been seen."""
_UPPER_ARMS = tuple(
    tuple(XSENS_23.joints.index(f"{side}_{joint}") for joint in ("shoulder", "elbow")) for side in ("left", "right")
)


@dataclass(frozen=True)
class XsensOptions:
    """What MVN's datagrams leave open.

    Attributes:
        person: the only character to take (0..255); None for all.
        up: "z" or "y", as chosen in MVN; None for its default: y with Euler angles, z with quaternions.
        by_arrival: whether the time of arrival stamps a frame: for senders whose time code stands still.
    """

    person: int | None = None
    up: str | None = None
    by_arrival: bool = False

    @classmethod
    def parse(cls, settings: dict[str, str], text: str) -> XsensOptions:
        """From `person`, `up` and `stamps`.

        Args:
            settings: those given.
            text: of the source, for messages.

        Raises:
            OptionError: one outside its range.
        """
        person, up, stamps = (settings.get(name) for name in ("person", "up", "stamps"))
        if person is not None and not (person.isascii() and person.isdigit() and int(person) < MOST_CHARACTERS):
            raise OptionError(f"{text}: person {person!r} is no character's number, 0..{MOST_CHARACTERS - 1}")
        if up not in (None, "z", "y"):
            raise OptionError(f"{text}: up {up!r}, allowed are z, y")
        if stamps not in (None, "code", "arrival"):
            raise OptionError(f"{text}: stamps {stamps!r}, allowed are code, arrival")
        return cls(None if person is None else int(person), up, stamps == "arrival")


@dataclass
class _Sample:
    """What has come of one character's pose."""

    milliseconds: int
    positions: Float[np.ndarray, "23 3"] = field(default_factory=lambda: np.full((BODY_SEGMENTS, 3), np.nan))
    come: set[int] = field(default_factory=set)
    segments: set[int] = field(default_factory=set)
    parts: int | None = None

    @property
    def whole(self) -> bool:
        """Whether no segment of the body can come any more; fingers and props are not waited for."""
        return len(self.segments) == BODY_SEGMENTS or self.parts == len(self.come)

    def add(self, datagram: Datagram) -> None:
        if datagram.milliseconds != self.milliseconds:
            raise MessageError(f"sample {datagram.sample} has two time codes")
        if datagram.index in self.come:
            return
        if self.segments.intersection(datagram.segments):
            raise MessageError(f"sample {datagram.sample} has a segment twice")
        self.come.add(datagram.index)
        self.segments.update(datagram.segments)
        self.positions[list(datagram.segments)] = datagram.positions
        if datagram.last:
            self.parts = datagram.index + 1


class _Character:
    """One character's samples as they become whole."""

    def __init__(self, kind: int) -> None:
        self.kind = kind
        self.heard = 0.0
        self.scale = 1.0
        self.milliseconds: int | None = None
        self.pending: dict[int, _Sample] = {}
        self._out: deque[int] = deque(maxlen=8)

    def add(self, datagram: Datagram) -> tuple[list[_Sample], int]:
        """Takes in a part; samples that go out now, and how many never will.

        Raises:
            MessageError: it contradicts another part, or came too late.
        """
        number = datagram.sample
        if number in self._out:
            return [], 0  # sent twice, or fingers of a body that is out
        if self._out and _ahead(self._out[-1], number) <= REORDERED:
            raise MessageError(f"sample {number} came after sample {self._out[-1]}")
        sample = self.pending.setdefault(number, _Sample(datagram.milliseconds))
        sample.add(datagram)
        if sample.whole:
            behind = [other for other in self.pending if _ahead(other, number) > REORDERED or other == number]
            for other in behind:
                del self.pending[other]
            self._out.append(number)
            return [sample], len(behind) - 1
        if len(self.pending) <= MOST_PENDING:
            return [], 0
        oldest = next(iter(self.pending))
        self._out.append(oldest)
        return [self.pending.pop(oldest)], 0


def _ahead(number: int, other: int) -> int:
    """How far a sample's number is ahead of another's; the counter has 32 bits."""
    return (number - other) % (1 << 32)


class XsensAdmission(Admission):
    """Takes the datagrams of every sender to one port; whatever comes, nothing is raised.

    Frames are of Xsens 23, one as soon as its whole body is there, or once its rest is not waited for any more: what
    did not come is not seen (NaN) then. A person is named by the character's number.

    Args:
        feed: where frames go, and what is no pose, late or incomplete is counted.
        options: what the datagrams leave open.
    """

    def __init__(self, feed: Feed, options: XsensOptions) -> None:
        super().__init__(feed)
        self._options = options
        self._characters: dict[tuple[Hashable, int], _Character] = {}

    @property
    def waiting(self) -> int:
        """Samples that are not whole yet."""
        return sum(len(character.pending) for character in self._characters.values())

    def take(self, content: bytes | str, sender: Hashable, arrived: float) -> None:
        """One datagram; types that hold no pose, and characters that are not wanted, are passed over."""
        try:
            datagram = read(content if isinstance(content, bytes) else content.encode())
            if datagram is not None and self._options.person in (None, datagram.character):
                self._take(datagram, sender, arrived)
        except MessageError as problem:
            self._feed.refuse(str(problem))

    def _take(self, datagram: Datagram, sender: Hashable, arrived: float) -> None:
        character = self._character((sender, datagram.character), datagram.kind, arrived)
        if character.kind != datagram.kind:
            return  # the same pose, said in another way
        samples, lost = character.add(datagram)
        for _ in range(lost):
            self._feed.refuse("a sample is incomplete: a datagram was lost")
        for sample in samples:
            self.admit(self._frame(character, sample, str(datagram.character), arrived), sender, arrived)

    def _character(self, key: tuple[Hashable, int], kind: int, arrived: float) -> _Character:
        """Who it is; a new one takes the place of one that is silent."""
        if key not in self._characters or arrived - self._characters[key].heard >= FORGET:
            kept = {known: each for known, each in self._characters.items() if arrived - each.heard < FORGET}
            if len(kept) >= MOST_PERSONS:
                raise MessageError(f"more than {MOST_PERSONS} characters")
            self._characters = {**kept, key: _Character(kind)}
        self._characters[key].heard = arrived
        return self._characters[key]

    def _frame(self, character: _Character, sample: _Sample, person: str, arrived: float) -> SkeletonFrame:
        if not self._options.by_arrival and sample.milliseconds == character.milliseconds:
            raise MessageError("the time code stands still; ?stamps=arrival takes frames as they come")
        character.milliseconds = sample.milliseconds
        arms = sample.positions[np.array(_UPPER_ARMS)]
        lengths = np.linalg.norm(arms[:, 0] - arms[:, 1], axis=1)
        if np.isfinite(lengths).any():
            character.scale = 0.01 if np.nanmax(lengths) > CENTIMETRES else 1.0
        positions = character.scale * sample.positions
        farthest = np.abs(positions).max(initial=0.0, where=np.isfinite(positions))
        if farthest > FARTHEST:
            raise MessageError(f"a segment is {farthest:.3g} m away, at most {FARTHEST:g} m is taken")
        if self._options.up == "y" or (self._options.up is None and character.kind == EULER):
            positions = from_y_up(positions)
        stamp = arrived if self._options.by_arrival else sample.milliseconds / 1000
        return SkeletonFrame(stamp, XSENS_23.joints, positions, person)
