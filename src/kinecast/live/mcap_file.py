"""Recordings as MCAP files: a message and a drawing for each frame, and what belongs to the whole as metadata."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import lz4.frame
import zstandard
from mcap.records import Channel, Chunk, Message, Metadata
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

from kinecast import __version__
from kinecast.datasets.files import STREAM_LIMIT, WHOLE_LIMIT
from kinecast.datasets.recording import Description, Recording, describe
from kinecast.errors import DatasetError
from kinecast.live.foxglove import SCENE_UPDATE, skeleton_update
from kinecast.live.mcap import PREDICTIONS, SCENE
from kinecast.live.message_file import labelled_frames, message, recordings_of

__all__ = ["SKELETONS", "load", "write"]

SKELETONS = "/kinecast/skeletons"
"""Topic of the frames."""
METADATA, RECORDINGS = "kinecast", "recordings"
LATEST = 2**63 - 1
"""Latest time that a reader in another language can hold [ns]."""


def _schema() -> dict[str, Any]:
    number: dict[str, Any] = {"type": ["number", "null"]}
    rows = {"type": "array", "items": {"type": "array", "items": number}}
    fields = {
        "stamp": {"type": "number"}, "person": {"type": "string"}, "positions": rows,
        "joints": {"type": "array", "items": {"type": "string"}}, "label": {"type": "string"},
    }  # fmt: skip
    return {"title": "kinecast.Skeleton", "type": "object", "properties": fields}


def write(path: Path, recordings: Sequence[Recording]) -> None:
    """Writes recordings of different persons so that `load` gives them back bit for bit.

    A message's log time is its stamp, or 0 where that is before 1970.

    Raises:
        OSError: the file cannot be written.
    """
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.LZ4)
        writer.start(profile="", library=f"kinecast {__version__}")
        described = json.dumps([asdict(describe(recording)) for recording in recordings])
        writer.add_metadata(METADATA, {RECORDINGS: described})
        skeletons, scene = (
            writer.register_channel(
                topic, "json", writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
            )
            for topic, name, schema in (
                (SKELETONS, "kinecast.Skeleton", _schema()),
                (SCENE, "foxglove.SceneUpdate", SCENE_UPDATE),
            )
        )
        for frame, label in labelled_frames(recordings):
            time = min(max(int(frame.stamp * 1e9), 0), LATEST)
            drawn = json.dumps(skeleton_update(frame, time / 1e9)).encode()
            for channel, content in ((skeletons, message(frame, label)), (scene, drawn)):
                writer.add_message(channel, log_time=time, data=content, publish_time=time)
        writer.finish()  # type: ignore[no-untyped-call]


def load(path: Path) -> list[Recording]:
    """One recording for each person, of skeletons or of predictions; those of `write` come back bit for bit.

    Raises:
        DatasetError: damaged, too large, or without either topic; or as `recordings_of`.
    """
    messages: list[tuple[str, bytes]] = []
    descriptions: list[Description] = []
    try:
        if path.stat().st_size > STREAM_LIMIT:
            raise DatasetError(path, f"larger than the limit of {STREAM_LIMIT >> 20} MiB")
        channels: dict[int, str] = {}
        held = 0
        for record in _records(path):
            if isinstance(record, Channel):
                channels[record.id] = record.topic if record.message_encoding == "json" else ""
            elif isinstance(record, Metadata) and record.name == METADATA:
                descriptions = [Description(**each) for each in json.loads(record.metadata[RECORDINGS])]
            elif isinstance(record, Message) and channels.get(record.channel_id) in (SKELETONS, PREDICTIONS):
                held += len(record.data)
                if held > WHOLE_LIMIT:
                    raise DatasetError(path, f"messages larger than the limit of {WHOLE_LIMIT >> 20} MiB")
                messages.append((f"{path}, message {len(messages) + 1}", record.data))
    except DatasetError:
        raise
    except Exception as error:  # a foreign file can fail in any way
        raise DatasetError(path, f"damaged MCAP file: {error or type(error).__name__}") from None
    if not messages:
        raise DatasetError(path, f"nothing on {SKELETONS} or {PREDICTIONS}")
    return recordings_of(messages, path, "mcap", descriptions)


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
    if chunk.compression == "lz4":
        data: bytes = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, size + 1)
    elif chunk.compression == "zstd":
        with zstandard.ZstdDecompressor(max_window_size=WHOLE_LIMIT).stream_reader(chunk.data) as reader:
            data = reader.read(size + 1)
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise ValueError(f"compression {chunk.compression!r}; lz4 and zstd are read")
    if len(data) != size:
        raise ValueError(f"a chunk says {size} bytes and holds others")
    return data
