"""MCAP files: predictions as they come, and recordings; each message of docs/live.md with a drawing for Foxglove."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from importlib.resources import files
from pathlib import Path
from typing import IO, Any

import lz4.frame
import msgspec
import zstandard
from mcap.records import Channel, Chunk, Message, Metadata
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

from kinecast import __version__
from kinecast.datasets.files import STREAM_LIMIT, WHOLE_LIMIT
from kinecast.datasets.recording import Recording, describe
from kinecast.errors import DatasetError
from kinecast.live.drawing import scene_update, skeleton_update
from kinecast.live.message_file import message, read, recordings_of
from kinecast.live.publication import Publication
from kinecast.live.sinks import FileSink
from kinecast.pipeline import labelled_frames

PREDICTIONS, SKELETONS, SCENE = "/kinecast/predictions", "/kinecast/skeletons", "/kinecast/scene"  # topics
_SCHEMAS = {PREDICTIONS: "kinecast.Prediction", SKELETONS: "kinecast.Skeleton", SCENE: "foxglove.SceneUpdate"}
"""Their names, and those of files in data/schemas; `foxglove.SceneUpdate` is without the parts that stay empty."""
METADATA, RECORDINGS = "kinecast", "recordings"
LATEST = 2**63 - 1  # latest time that a reader in another language can hold [ns]


class _JsonWriter(Writer):
    """Writes JSON messages on two topics: what is said, and the drawing of it."""

    def __init__(self, file: IO[bytes], topic: str) -> None:
        super().__init__(file, compression=CompressionType.LZ4)
        self.start(profile="", library=f"kinecast {__version__}")
        self._topics = []
        for each in (topic, SCENE):
            content = (files("kinecast") / "data" / "schemas" / f"{_SCHEMAS[each]}.json").read_bytes()
            schema = self.register_schema(_SCHEMAS[each], "jsonschema", content)
            self._topics.append(self.register_channel(each, "json", schema))

    def add(self, content: bytes, drawing: dict[str, Any], logged: int, published: int, sequence: int = 0) -> None:
        for topic, data in zip(self._topics, (content, msgspec.json.encode(drawing)), strict=True):
            self.add_message(topic, logged, data, published, sequence)


class McapSink(FileSink):
    """Writes predictions; a log time is when the frame was acquired, a publish time when the message was written."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._unix_less_monotonic = time.time() - time.monotonic()
        self._writer = _JsonWriter(self.file, PREDICTIONS)

    def write(self, publication: Publication) -> None:
        acquired = publication.acquired + self._unix_less_monotonic
        drawing = scene_update(publication, acquired)
        self._writer.add(publication.json, drawing, int(acquired * 1e9), time.time_ns(), publication.number)

    def finish(self) -> None:
        self._writer.finish()  # type: ignore[no-untyped-call]


def write(path: Path, recordings: Sequence[Recording]) -> None:
    """Writes recordings of different persons so that `load` gives them back bit for bit.

    A message's log time is its stamp, or 0 where that is before 1970. An OSError where the file cannot be written.
    """
    with path.open("wb") as file:
        writer = _JsonWriter(file, SKELETONS)
        described = json.dumps([asdict(describe(recording)) for recording in recordings])
        writer.add_metadata(METADATA, {RECORDINGS: described})
        for frame, label in labelled_frames(recordings):
            logged = min(max(int(frame.stamp * 1e9), 0), LATEST)
            writer.add(message(frame, label), skeleton_update(frame, logged / 1e9), logged, logged)
        writer.finish()  # type: ignore[no-untyped-call]


def load(path: Path) -> list[Recording]:
    """One recording for each person, of skeletons or of predictions; those of `write` come back bit for bit.

    A DatasetError for a file that is damaged, too large, or without either topic; or as `recordings_of`.
    """
    messages: list[bytes] = []
    described: list[dict[str, Any]] = []
    channels: dict[int, str] = {}
    held = 0
    try:
        if path.stat().st_size > STREAM_LIMIT:
            raise DatasetError(path, f"larger than the limit of {STREAM_LIMIT >> 20} MiB")
        for record in _records(path):
            if isinstance(record, Channel):
                channels[record.id] = record.topic if record.message_encoding == "json" else ""
            elif isinstance(record, Metadata) and record.name == METADATA:
                described = list(json.loads(record.metadata[RECORDINGS]))
            elif isinstance(record, Message) and channels.get(record.channel_id) in (SKELETONS, PREDICTIONS):
                held += len(record.data)
                if held > WHOLE_LIMIT:
                    raise DatasetError(path, f"messages larger than the limit of {WHOLE_LIMIT >> 20} MiB")
                messages.append(record.data)
    except DatasetError:
        raise
    except Exception as error:  # a foreign file can fail in any way
        raise DatasetError(path, f"damaged MCAP file: {error or type(error).__name__}") from None
    if not messages:
        raise DatasetError(path, f"nothing on {SKELETONS} or {PREDICTIONS}")
    places = ((f"{path}, message {number}", content) for number, content in enumerate(messages, 1))
    return recordings_of((read(*each) for each in places), path, "mcap", described)


def _records(path: Path) -> Iterator[object]:
    """Every record, those of chunks too; a chunk is never larger than it says, nor than a limit."""
    with path.open("rb") as file:
        for record in StreamReader(file, emit_chunks=True, record_size_limit=WHOLE_LIMIT).records:
            if isinstance(record, Chunk):
                yield from breakup_chunk(replace(record, compression="", data=_decompressed(record)))
            else:
                yield record


def _decompressed(chunk: Chunk) -> bytes:
    size = chunk.uncompressed_size
    if size > WHOLE_LIMIT:
        raise ValueError(f"a chunk of {size} bytes, at most {WHOLE_LIMIT} are taken")
    match chunk.compression:
        case "lz4":
            data: bytes = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, size + 1)
        case "zstd":
            unpacking = zstandard.ZstdDecompressor(max_window_size=WHOLE_LIMIT)
            data = unpacking.stream_reader(chunk.data).read(size + 1)
        case "":
            data = chunk.data
        case other:
            raise ValueError(f"compression {other!r}; lz4 and zstd are read")
    if len(data) != size:
        raise ValueError(f"a chunk says {size} bytes and holds others")
    return data
