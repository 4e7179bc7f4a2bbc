"""An MCAP file: predictions as messages of docs/live.md, and as a scene that Foxglove draws."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import IO

import msgspec
from mcap.writer import CompressionType, Writer

from kinecast import __version__
from kinecast.live.foxglove import SCENE_UPDATE, scene_update
from kinecast.live.publication import SCHEMA, Publication
from kinecast.live.sinks import FileSink

__all__ = ["PREDICTIONS", "SCENE", "McapSink"]

PREDICTIONS, SCENE = "/kinecast/predictions", "/kinecast/scene"
"""Topics."""


class McapSink(FileSink):
    """Writes both topics; a message's log time is when its frame was acquired, its publish time when it was written.

    Args:
        path: of the file; one that is there is replaced.

    Raises:
        OSError: it cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        self._unix_less_monotonic = time.time() - time.monotonic()
        self._encoder = msgspec.json.Encoder()
        super().__init__(path)

    def begin(self, file: IO[bytes]) -> None:
        """See FileSink."""
        self._writer = Writer(file, compression=CompressionType.LZ4)
        self._writer.start(profile="", library=f"kinecast {__version__}")
        schemas = {
            PREDICTIONS: ("kinecast.Prediction", SCHEMA),
            SCENE: ("foxglove.SceneUpdate", SCENE_UPDATE),
        }
        self._channels = {
            topic: self._writer.register_channel(
                topic, "json", self._writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
            )
            for topic, (name, schema) in schemas.items()
        }

    def write(self, file: IO[bytes], publication: Publication) -> None:  # noqa: ARG002
        """See FileSink."""
        acquired = publication.acquired + self._unix_less_monotonic
        scene = self._encoder.encode(scene_update(publication, acquired))
        for topic, content in ((PREDICTIONS, publication.json), (SCENE, scene)):
            self._writer.add_message(
                self._channels[topic],
                log_time=int(acquired * 1e9),
                data=content,
                publish_time=time.time_ns(),
                sequence=publication.number,
            )

    def finish(self, file: IO[bytes]) -> None:  # noqa: ARG002
        """See FileSink."""
        self._writer.finish()  # type: ignore[no-untyped-call]
