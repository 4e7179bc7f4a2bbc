"""The table in the terminal: what it says of sources and sinks, whatever their names hold."""

from __future__ import annotations

import io

import numpy as np
import pytest
from rich.console import Console

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.cli import live as command
from kinecast.live.counters import SinkCounters
from kinecast.live.loop import Live
from kinecast.live.mailbox import Mailbox
from kinecast.live.publication import Publication
from kinecast.prediction.methods import read_shipped
from kinecast.predictor import Predictor
from kinecast.types import SkeletonFrame


class Counted:
    """A sink that only counts."""

    address = "mcap:[bold]a.mcap"

    def __init__(self) -> None:
        self.counters = SinkCounters(self.address, "written")

    def publish(self, publication: Publication) -> None:
        self.counters.sent(0.0121)

    def close(self) -> None:
        pass


def test_the_terminal_shows_sources_sinks_and_statuses(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = io.StringIO()
    monkeypatch.setattr(command, "CONSOLE", Console(file=screen, force_terminal=True, width=160))
    mailbox = Mailbox()
    camera, silent = mailbox.feed("ws://camera"), mailbox.feed("udp://silent")
    live = Live(mailbox, {camera: Predictor(read_shipped("zero_velocity")[1])}, [Counted()])
    for k in range(3):
        camera.put(SkeletonFrame(k / 30, ARM_JOINTS, np.zeros((6, 3))), 0.0)
    camera.refuse("half a message")
    with command.shown(live):
        arrival = mailbox.take(0.0)
        assert arrival is not None
        live.step(arrival)
    silent.end()
    words = command.plain(command.tables(live, running=False))
    for text in (screen.getvalue(), words):
        assert "[bold]a.mcap" in text
        assert "udp://silent" in text
        assert "p99 [ms]" in text
    assert ["ws://camera", "–", "3", "2", "1", "0", "same", "0"] in [line.split() for line in words.splitlines()]
    assert ["mcap:[bold]a.mcap", "1", "0", "12.5", "12.5"] in [line.split() for line in words.splitlines()]
    assert "WARMING_UP: 1  (Fewer frames" in words or "IMPLAUSIBLE: 1  (" in words
