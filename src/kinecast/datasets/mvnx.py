"""Xsens MVNX motion files, versions 3 and 4, parsed as a stream."""

from __future__ import annotations

from array import array
from pathlib import Path
from xml.parsers import expat

import numpy as np

from kinecast.body.skeleton import XSENS_23
from kinecast.datasets.compressed import MOST_POINTS, base_name, chunks, head
from kinecast.datasets.delimited import number
from kinecast.datasets.recording import Recording
from kinecast.errors import DatasetError

__all__ = ["load", "matches", "sequence_name"]

_NAMESPACE = "http://www.xsens.com/mvn/mvnx"
_MOST_SEGMENTS = 200
_LONGEST_POSITION = 40 * 3 * _MOST_SEGMENTS  # characters: 40 for a number is generous


def matches(path: Path) -> bool:
    """Whether a file opens with an `mvnx` element."""
    return path.is_file() and b"<mvnx" in head(path)


def load(path: Path) -> list[Recording]:
    """One trial: the segments of its normal frames, each at its proximal joint.

    Time is the frame's index over the frame rate; the format's own whole milliseconds are too coarse.

    Args:
        path: an MVNX file, plain or compressed.

    Returns:
        One recording of the segments known to Xsens 23, in file order.

    Raises:
        DatasetError: not XML, a document type or entity (refused), or not as Xsens writes it; names the line.
    """
    document = _Document(path)
    for piece in chunks(path):
        document.feed(piece)
    return [document.recording()]


def sequence_name(path: Path) -> str:
    """Name of the trial: `Trial_2` for `Trial_2.xsens.mvnx.gz`."""
    return base_name(path).removesuffix(".xsens")


class _Document:
    """What has been read of one file: segment names, and the positions of the normal frames so far."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.subject = ""
        self.rate = 0.0
        self.segments: list[str] = []
        self.indices = array("d")
        self.positions = array("d")
        self._in_frame = False
        self._text: list[str] | None = None  # pieces of the position being read
        self._parser = expat.ParserCreate(namespace_separator=" ")
        self._parser.buffer_text = True
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.StartDoctypeDeclHandler = self._refuse_doctype

    @property
    def _where(self) -> str:
        return f"{self.path}, line {self._parser.CurrentLineNumber}"

    def feed(self, piece: bytes, last: bool = False) -> None:
        try:
            self._parser.Parse(piece, last)
        except expat.ExpatError as error:
            raise DatasetError(f"{self.path}, line {error.lineno}", f"broken XML: {error}") from error

    def recording(self) -> Recording:
        self.feed(b"", last=True)
        if not self.indices:
            raise DatasetError(self.path, "no frame of type normal with positions")
        stamps = (np.array(self.indices) - self.indices[0]) / self.rate
        positions = np.array(self.positions).reshape(len(stamps), len(self.segments), 3)
        known = [place for place, name in enumerate(self.segments) if XSENS_23.find(name)]
        others = [name for name in self.segments if not XSENS_23.find(name)]
        return Recording(
            name=sequence_name(self.path),
            joints=XSENS_23.canonical((self.segments[place] for place in known), self.path),
            stamps=stamps,
            positions=positions[:, known],
            rate=self.rate,
            source=self.path,
            format="mvnx",
            subject=self.subject,
            notes=(f"segments left out: {', '.join(others)}",) if others else (),
        )

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        namespace, _, name = tag.rpartition(" ")
        if name == "mvnx" and namespace != _NAMESPACE:
            raise DatasetError(self._where, f"namespace is {namespace[:60]!r}, expected {_NAMESPACE!r}")
        if name == "subject":
            self._start_subject(attributes)
        elif name == "segment":
            self.segments.append(attributes.get("label", ""))
            if len(self.segments) > _MOST_SEGMENTS:
                raise DatasetError(self._where, f"more than {_MOST_SEGMENTS} segments")
        elif name == "frame" and attributes.get("type") == "normal":
            self._in_frame = True
            index = attributes.get("index") or str(len(self.indices))
            self.indices.append(number(index, self._where, "frame index"))
            if len(self.indices) * len(self.segments) > MOST_POINTS:
                raise DatasetError(self._where, f"more than {MOST_POINTS} segment positions")
        elif name == "position" and self._in_frame:
            self._text = []
            self._parser.CharacterDataHandler = self._characters

    def _start_subject(self, attributes: dict[str, str]) -> None:
        if self.rate:
            raise DatasetError(self._where, "a second subject; expected one in a file")
        self.subject = attributes.get("label", "")
        self.rate = number(attributes.get("frameRate", ""), self._where, "frameRate")
        if self.rate <= 0:
            raise DatasetError(self._where, f"frameRate is {self.rate}, expected more than 0")

    def _characters(self, text: str) -> None:
        if self._text is None or sum(map(len, self._text)) + len(text) > _LONGEST_POSITION:
            raise DatasetError(self._where, f"a position of more than {_LONGEST_POSITION} characters")
        self._text.append(text)

    def _end(self, tag: str) -> None:
        name = tag.rpartition(" ")[2]
        if name == "position" and self._text is not None:
            self._end_position("".join(self._text).split())
            self._text = None
            self._parser.CharacterDataHandler = None
        elif name == "frame" and self._in_frame:
            self._in_frame = False
            if len(self.positions) != 3 * len(self.segments) * len(self.indices):
                raise DatasetError(self._where, "a normal frame without one position element")

    def _end_position(self, words: list[str]) -> None:
        if not self.rate:
            raise DatasetError(self._where, "a frame before any subject with a frameRate")
        if len(words) != 3 * len(self.segments):
            found = f"{len(words)} numbers in position"
            raise DatasetError(self._where, f"{found}, expected 3 for each of {len(self.segments)} segments")
        try:
            self.positions.extend(map(float, words))
        except ValueError:
            for word in words:
                number(word, self._where, "position")

    def _refuse_doctype(self, *_: object) -> None:
        raise DatasetError(self._where, "a document type declaration; entities are refused")
