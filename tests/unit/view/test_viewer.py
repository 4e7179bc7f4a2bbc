"""What is published to browsers, the panel's controls, and runs in the background."""

from __future__ import annotations

import re
import signal
import socket
import threading
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from kinecast.errors import OptionError
from kinecast.robot.camera import Camera, CameraOptions
from kinecast.robot.cell import Cell
from kinecast.robot.person import PlayedPerson
from kinecast.robot.simulation import Simulation
from kinecast.types import Decision, Reaction, RobotState
from kinecast.view.runs import Runs, Setting
from kinecast.view.server import check_address, open_server, stop_server
from kinecast.view.viewer import Viewer
from kinecast.view.words import decisions_html, figures_html, state_html

JOINTS = ("left_shoulder", "left_elbow", "left_wrist", "right_shoulder", "right_elbow", "right_wrist")
POSE = np.array(
    [[1.15, -0.2, 0.5], [1.1, -0.25, 0.2], [0.9, -0.2, 0.08], [1.15, 0.2, 0.5], [1.1, 0.25, 0.2], [0.9, 0.2, 0.08]]
)
LONG = 240.0
"""Of a wait for another thread, on however busy a machine [s]; it takes milliseconds, or a minute to compile."""


def simulation(limit: float = 0.4) -> Simulation:
    """Somebody who stands still, and no prediction: quick."""
    person = PlayedPerson("0", JOINTS, np.array([0.0]), POSE[None], np.eye(4))
    camera = Camera(CameraOptions(lost=0.0, dropped=0.0))
    return Simulation([person], lambda _frame, _now: None, camera, Cell(), limit=limit, dt=0.02)


class House:
    """A viewer, and the ends of its runs."""

    def __init__(self, make: Callable[[Setting], Simulation]) -> None:
        self.asked: list[Setting] = []
        self.ended = threading.Event()
        self.told: list[Decision] = []

        def begin(setting: Setting) -> Simulation:
            self.asked.append(setting)
            return make(setting)

        def end(_setting: Setting, _simulation: Simulation) -> str:
            self.ended.set()
            return "all done"

        self.viewer = Viewer(
            "127.0.0.1", 0, Setting("avoid", "none"), ("avoid", "replan"), ("none", "oracle"), Cell(), begin,
            self.told.append, end,
        )  # fmt: skip


@pytest.fixture
def house() -> Iterator[House]:
    found = House(lambda _setting: simulation())
    yield found
    found.viewer.close()


def test_a_finished_run_can_be_gone_through(house: House) -> None:
    viewer, panel, stage = house.viewer, house.viewer._panel, house.viewer._stage
    assert house.ended.wait(LONG)
    viewer._runs.close()  # waits for the other thread's last line
    film = viewer.playback.film
    assert film.finished
    assert len(film) >= 8
    assert [each.reason for each in house.told] == [each.reason for each in film.decisions(np.inf, 100)][::-1]

    viewer.playback.seek(film.end)
    viewer.refresh()
    moment = film.at(film.end)
    assert moment is not None
    np.testing.assert_allclose(
        stage._links[3].position, stage._arm.capsules(moment.q[None]).start[0, 3] / 2
        + stage._arm.capsules(moment.q[None]).end[0, 3] / 2, atol=1e-6,
    )  # fmt: skip
    assert set(stage._cubes) == {"red", "green", "blue"}
    np.testing.assert_allclose(stage._cubes["red"].position, moment.cubes["red"])
    skin, shirt = stage._people._bodies[0]
    assert skin.visible
    assert np.abs(np.concatenate([skin._node.vertices, shirt._node.vertices]) - [1.1, 0, 0.4]).max() < 0.8
    assert "all done" in panel._decisions.content
    assert panel._slider.value == pytest.approx(film.end, abs=0.03)
    assert panel._play.label == "Play"


def test_controls_ask_for_another_run(house: House) -> None:
    viewer, panel = house.viewer, house.viewer._panel
    first = viewer.playback.film
    panel._change(Setting("replan", "oracle", 0.8))
    assert viewer.playback.film is not first
    assert viewer.playback.playing
    second = viewer.playback.film
    panel._change(Setting("replan", "oracle", 0.8))  # the same again is no change
    assert viewer.playback.film is second
    assert house.ended.wait(LONG)
    house.viewer._runs.close()
    assert house.asked[-1] == Setting("replan", "oracle", 0.8)


def test_what_is_hidden_is_not_shown(house: House) -> None:
    viewer, stage = house.viewer, house.viewer._stage
    assert house.ended.wait(LONG)
    viewer.playback.seek(0.3)
    stage.layers.update(plan=False, samples=False, region=False)
    viewer.refresh()
    assert not any(node.visible for node in (stage._way, stage._tip, stage._cloud, stage._tubes))


def test_a_run_that_fails_is_told_and_another_can_follow() -> None:
    def make(setting: Setting) -> Simulation:
        if setting.scenario == "broken":
            raise OptionError("no such thing")
        return simulation(0.1)

    ended = threading.Event()

    def end(_setting: Setting, _simulation: Simulation) -> str:
        ended.set()
        return "done"

    runs = Runs(make, lambda _decision: None, end)
    broken = runs.begin(Setting("broken", "none"))
    for _ in range(int(100 * LONG)):
        if not broken.finished:
            ended.wait(0.01)
    assert broken.ending == "The simulation failed: no such thing"
    runs.begin(Setting("avoid", "none"))
    assert ended.wait(LONG)
    runs.close()


def test_a_run_is_given_up_for_the_next() -> None:
    begun, gate = threading.Event(), threading.Event()
    ended: list[str] = []
    done = threading.Event()

    def make(setting: Setting) -> Simulation:
        if setting.scenario == "first":
            begun.set()
            gate.wait(LONG)
        return simulation(0.1)

    def end(setting: Setting, _simulation: Simulation) -> str:
        ended.append(setting.scenario)
        done.set()
        return "done"

    runs = Runs(make, lambda _decision: None, end)
    first = runs.begin(Setting("first", "none"))
    assert begun.wait(LONG)
    runs.begin(Setting("second", "none"))
    gate.set()
    assert done.wait(LONG)
    runs.close()
    assert ended == ["second"]
    assert len(first) == 0


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
            check_address("127.0.0.1", port, "the view")
    with pytest.raises(OptionError, match="allowed is 0"):
        check_address("127.0.0.1", 70000, "the view")
    with pytest.raises(OptionError, match="nothing can listen"):  # reserved for documentation: nobody's
        check_address("192.0.2.1", 0, "the view")


def test_the_server_listens_where_it_was_told_and_opens_no_tunnel(house: House) -> None:
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+", house.viewer.url)
    assert house.viewer._server.get_host() == "127.0.0.1"
    assert house.viewer._server.request_share_url() is None


def test_ctrl_c_ends_it_between_two_pictures(house: House, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = []

    def refresh() -> None:
        signal.raise_signal(signal.SIGINT)
        drawn.append("to its end")

    monkeypatch.setattr(house.viewer, "refresh", refresh)
    before = signal.getsignal(signal.SIGINT)
    house.viewer.serve()
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


def test_a_level_outside_its_range_is_named() -> None:
    with pytest.raises(OptionError, match="level 0"):
        Setting("avoid", "none", 0.0)
