"""What is published to browsers, and the panel's controls."""

from __future__ import annotations

import re
import signal
import socket
from collections.abc import Iterator

import numpy as np
import pytest

from kinecast.errors import OptionError
from kinecast.robot.cell import Cell
from kinecast.types import Decision, Reaction, RobotState
from kinecast.view.panel import decisions_html, figures_html, state_html
from kinecast.view.playback import Setting, Simulations
from kinecast.view.server import open_server, stop_server
from kinecast.view.viewer import Viewer

from .simulated import LONG, simulation


@pytest.fixture(scope="module")
def viewer() -> Iterator[Viewer]:
    """Whose run has come to its end, before and after each test."""
    simulations = Simulations(
        ("avoid", "replan"), ("none", "oracle"), Cell(), lambda _: simulation(), lambda _: None, lambda *_: "all done"
    )
    opened = Viewer("127.0.0.1", 0, Setting("avoid", "none"), simulations)
    opened.playback.run._thread.join(LONG)
    yield opened
    opened.close()


def test_a_finished_run_can_be_gone_through(viewer: Viewer) -> None:
    panel, stage, run = viewer.panel, viewer.stage, viewer.playback.run
    assert run.ending == "all done"
    assert len(run.episode.scenes) >= 8
    viewer.playback.seek(run.last)
    viewer.refresh()
    moment = run.episode.scenes[-1]
    links = stage.arm.capsules(moment.q)
    corners = stage.links["bones"]._node.vertices  # the forearm's are the last
    around = links[3, :3] / 2 + links[3, 3:6] / 2
    np.testing.assert_allclose(corners[len(corners) // 2 :].mean(axis=0), around, atol=1e-6)
    assert set(stage.cubes) == {"red", "green", "blue"}
    np.testing.assert_allclose(stage.cubes["red"].position, moment.cubes["red"])
    body = np.concatenate([node._node.vertices for node in (stage.people.skin, stage.people.shirts)])
    assert stage.people.skin.visible
    assert np.abs(body - [1.1, 0, 0.4]).max() < 0.8
    assert "all done" in panel.decisions.content
    assert panel.slider.value == pytest.approx(run.last, abs=0.03)
    assert panel.play.label == "Play"


def test_controls_ask_for_another_run(viewer: Viewer) -> None:
    first = viewer.playback.run
    viewer.panel.change(scenario="replan", predictor="oracle", level=0.8)
    second = viewer.playback.run
    assert second is not first
    assert second.setting == Setting("replan", "oracle", 0.8)
    assert viewer.playback.playing
    viewer.panel.change(level=0.8)  # the same again is no change
    assert viewer.playback.run is second
    second._thread.join(LONG)
    viewer.panel.change(scenario="avoid", predictor="none", level=0.95)
    viewer.playback.run._thread.join(LONG)


def test_what_is_hidden_is_not_shown(viewer: Viewer) -> None:
    stage = viewer.stage
    viewer.playback.seek(0.3)
    stage.layers.update(path=False, samples=False, region=False)
    viewer.refresh()
    assert not any(node.visible for node in (stage.way, stage.tip, stage.cloud, stage.tubes))
    stage.layers.update(path=True, samples=True, region=True)


def test_a_moment_in_words() -> None:
    decision = Decision(
        3.25, RobotState.SLOWED, "Slowly: <a person> is near.", "green", Reaction.CHANGE_CUBE, 0.4, 0.31, 0.12,
        {"red": 0.0, "green": 0.87},
    )  # fmt: skip
    said = state_html(decision, 3.25)
    assert "slowed" in said
    assert "&lt;a person&gt;" in said
    figures = figures_html(decision, Cell())
    for words in ("87 %", "40 %", "0.31 m", "stops below 0.12 m"):
        assert words in figures
    assert "change cube:" in decisions_html([decision])
    assert "nobody near" in figures_html(Decision(0.0, RobotState.MOVING, "On its way."), Cell())


def test_an_address_where_nothing_can_listen_is_named() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(OptionError, match=r"the view: nothing can listen there \(Address already in use"):
            open_server("127.0.0.1", port, "the view")
    with pytest.raises(OptionError, match="allowed is 0"):
        open_server("127.0.0.1", 70000, "the view")
    with pytest.raises(OptionError, match="nothing can listen"):  # reserved for documentation: nobody's
        open_server("192.0.2.1", 0, "the view")


def test_the_server_listens_where_it_was_told_and_opens_no_tunnel(viewer: Viewer) -> None:
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+", viewer.url)
    assert viewer.server.get_host() == "127.0.0.1"
    assert viewer.server.request_share_url() is None


def test_ctrl_c_ends_it_between_two_pictures(viewer: Viewer, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = []

    def refresh() -> None:
        signal.raise_signal(signal.SIGINT)
        drawn.append("to its end")

    monkeypatch.setattr(viewer, "refresh", refresh)
    before = signal.getsignal(signal.SIGINT)
    viewer.serve()
    assert drawn == ["to its end"]
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.parametrize("content", [b"", b"GET / HT"])
def test_a_connection_that_a_browser_leaves_is_not_in_the_log(content: bytes, caplog: pytest.LogCaptureFixture) -> None:
    server = open_server("127.0.0.1", 0, "the view")
    with socket.create_connection(("127.0.0.1", server.get_port()), timeout=LONG) as left:
        left.sendall(content)
        left.shutdown(socket.SHUT_WR)
        assert left.recv(1) == b""  # the server has seen it
    stop_server(server)
    assert not caplog.records
