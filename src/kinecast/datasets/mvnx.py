"""Xsens motion: MVNX files of versions 3 and 4, parsed as a stream, and their csv twins as ANDY has them."""

from __future__ import annotations

import re
from array import array
from pathlib import Path
from xml.parsers import expat

import numpy as np
from jaxtyping import Float

from kinecast.body.skeleton import XSENS_23
from kinecast.datasets.files import MOST_POINTS, base_name, chunks, head, number, read_bytes, rows, split_lines
from kinecast.datasets.recording import Recording
from kinecast.errors import DatasetError

_NAMESPACE = "http://www.xsens.com/mvn/mvnx"
_MOST_SEGMENTS = 200
_LONGEST_POSITION = 40 * 3 * _MOST_SEGMENTS  # characters: 40 for a number is generous
_CSV_RATE = 240.0  # ANDY's MVNX files say so; their csv twins have no rate
_COLUMN = re.compile(r"position_(\w+)_([xyz])", re.IGNORECASE)


def matches(path: Path) -> bool:
    """Whether a file opens with an `mvnx` element, or its first line names a column like `position_<Segment>_x`."""
    return path.is_file() and (_is_mvnx(path) or _is_csv(path))


def _is_mvnx(path: Path) -> bool:
    return b"<mvnx" in head(path)


def _is_csv(path: Path) -> bool:
    names = head(path, 1 << 16).partition(b"\n")[0].decode("utf-8", errors="replace").split(",")
    return any(_COLUMN.fullmatch(name.strip()) for name in names)


def load(path: Path) -> list[Recording]:
    """One trial: the segments of its normal frames, each at its proximal joint.

    Segments are those known to Xsens 23, in file order. Time is the frame's index over the frame rate; the format's own
    whole milliseconds are too coarse. A csv twin is read at an assumed 240 Hz, from its columns
    `position_<Segment>_x`, `_y`, `_z` [m] in upper or lower case. Document types and entities are refused.
    """
    subject, rate, notes = "", _CSV_RATE, ["rate not stated by the format; 240 Hz assumed"]
    if not _is_mvnx(path) and _is_csv(path):
        segments, positions = _read_csv(path)
        stamps = np.arange(len(positions)) / _CSV_RATE
    else:
        document = _Document(path)
        subject, rate, segments = document.subject, document.rate, document.segments
        stamps = (np.array(document.indices) - document.indices[0]) / rate
        positions = np.array(document.positions).reshape(len(stamps), len(segments), 3)
        others = [name for name in segments if not XSENS_23.find(name)]
        notes = [f"segments left out: {', '.join(others)}"] if others else []
    known = [place for place, name in enumerate(segments) if XSENS_23.find(name)]
    return [
        Recording(
            name=sequence_name(path),
            joints=XSENS_23.canonical([segments[place] for place in known], path),
            stamps=stamps,
            positions=positions[:, known],
            rate=rate,
            source=path,
            format="mvnx",
            subject=subject,
            notes=tuple(notes),
        )
    ]


def sequence_name(path: Path) -> str:
    """Name of the trial: `Trial_2` for `Trial_2.xsens.mvnx.gz`."""
    return base_name(path).removesuffix(".xsens")


def _read_csv(path: Path) -> tuple[list[str], Float[np.ndarray, "N S 3"]]:
    """The known segments, and their positions."""
    (header,), data = split_lines(read_bytes(path), 1, path)
    names = [name.strip() for name in header.split(",")]
    segments: dict[str, dict[str, int]] = {}
    for column, name in enumerate(names):
        found = _COLUMN.fullmatch(name)
        if found and XSENS_23.find(found[1]):
            segments.setdefault(found[1], {})[found[2].lower()] = column
    for segment, axes in segments.items():
        if len(axes) < 3:
            problem = f"segment {segment} has columns for {', '.join(axes)}, expected x, y, z"
            raise DatasetError(f"{path}, line 1", problem)
    table = rows(data, len(names), path, first_line=2, use=[axes[axis] for axes in segments.values() for axis in "xyz"])
    return list(segments), table.reshape(len(table), len(segments), 3)


class _Document:
    """What a file holds: segment names, and indices and positions of its normal frames; refused if there are none."""

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
        try:
            for piece in chunks(path):
                self._parser.Parse(piece, False)
            self._parser.Parse(b"", True)
        except expat.ExpatError as error:
            raise DatasetError(f"{path}, line {error.lineno}", f"broken XML: {error}") from error
        if not self.indices:
            raise DatasetError(path, "no frame of type normal with positions")

    @property
    def _where(self) -> str:
        return f"{self.path}, line {self._parser.CurrentLineNumber}"

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        namespace, _, name = tag.rpartition(" ")
        if name == "mvnx" and namespace != _NAMESPACE:
            raise DatasetError(self._where, f"namespace is {namespace[:60]!r}, expected {_NAMESPACE!r}")
        if name == "subject":
            if self.rate:
                raise DatasetError(self._where, "a second subject; expected one in a file")
            self.subject = attributes.get("label", "")
            self.rate = number(attributes.get("frameRate", ""), self._where, "frameRate")
            if self.rate <= 0:
                raise DatasetError(self._where, f"frameRate is {self.rate}, expected more than 0")
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
