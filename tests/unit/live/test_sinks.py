"""What goes out: messages, drawings, counts, files that fail, and clients that do not read."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from websockets.sync.client import connect

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.errors import OptionError
from kinecast.live import sinks
from kinecast.live.counters import SinkCounters
from kinecast.live.drawing import scene_update
from kinecast.live.loop import Live
from kinecast.live.mailbox import Mailbox
from kinecast.live.network import Address, Network
from kinecast.live.publication import Publication
from kinecast.live.sender_guard import SenderGuard
from kinecast.live.sinks import MOST_UNSENT, MOST_WAITING, FileSink, JsonlSink, WebSocketOptions, WebSocketSink
from kinecast.predictor import Predictor, PredictorOptions
from kinecast.types import SkeletonFrame, Status

REST = np.array([[0, 0.2, 1.4], [0, 0.25, 1.1], [0.2, 0.2, 1.0], [0, -0.2, 1.4], [0, -0.25, 1.1], [0.2, -0.2, 1.0]])
LONG = 120.0
DATA = Path(__file__).resolve().parents[3] / "src" / "kinecast" / "data"
MODEL = DATA / "models" / "zero_velocity.npz"
SCHEMA, SCENE_UPDATE = (
    json.loads((DATA / "schemas" / f"{name}.json").read_text())
    for name in ("kinecast.Prediction", "foxglove.SceneUpdate")
)


@pytest.fixture(scope="module")
def predictor() -> Predictor:
    return Predictor.load(MODEL, options=PredictorOptions(samples=40))


def publication(predictor: Predictor, number: int = 1, arms: np.ndarray = REST, person: str = "0") -> Publication:
    """Of one frame; NaN arms make one that knows nothing."""
    frame = SkeletonFrame(float(number), ARM_JOINTS, arms, person)
    return Publication.of(number, "camera", frame, predictor.observe(frame), 0.9, 0.0)


@pytest.mark.parametrize("arms", [REST, np.full((6, 3), np.nan), np.where(np.arange(6)[:, None] == 2, np.nan, REST)])
def test_a_message_says_the_same_in_both_encodings_and_leaves_the_samples(
    predictor: Predictor, arms: np.ndarray
) -> None:
    sent = publication(predictor, arms=arms)
    text, packed = json.loads(sent.json), msgspec.msgpack.decode(sent.msgpack)
    assert set(text) == set(packed) == set(SCHEMA["properties"])
    fits(text, SCHEMA)
    assert (text["status"], text["person"], text["tubes"]["level"]) == (sent.prediction.status.name, "0", 0.9)
    for name in ("mean", "covariance", "observed"):
        np.testing.assert_array_equal(np.array(text[name], dtype=float), packed[name])
    np.testing.assert_allclose(packed["mean"], sent.prediction.mean, atol=6e-5)
    np.testing.assert_allclose(np.array(packed["covariance"])[..., 3], sent.prediction.covariance[..., 1, 1], atol=1e-8)
    assert sent.prediction.samples.base is None
    assert sent.prediction.samples.nbytes == 0


def fits(value: Any, schema: dict[str, Any]) -> None:
    """As much of JSON Schema as is used."""
    if isinstance(schema.get("type"), list):
        assert value is None or isinstance(value, float | int)
    elif schema.get("type") == "object":
        assert set(schema.get("required", ())) <= set(value)
        for name, part in schema.get("properties", {}).items():
            fits(value[name], part)
    elif schema.get("type") == "array":
        for each in value:
            fits(each, schema["items"])
    elif "enum" in schema:
        assert value in schema["enum"]
    else:
        kinds: dict[str, tuple[type, ...]] = {
            "number": (int, float),
            "integer": (int,),
            "string": (str,),
            "boolean": (bool,),
        }
        assert isinstance(value, kinds[schema["type"]])
        assert schema.get("minimum", -np.inf) <= value if schema["type"] != "string" else True


@pytest.mark.parametrize("arms", [REST, np.full((6, 3), np.nan), np.where(np.arange(6)[:, None] == 2, np.nan, REST)])
def test_a_drawing_fits_the_schema_and_has_no_nan(predictor: Predictor, arms: np.ndarray) -> None:
    drawn = json.loads(json.dumps(scene_update(publication(predictor, arms=arms), 1234.5), allow_nan=False))
    fits(drawn, SCENE_UPDATE)
    (entity,) = drawn["entities"]
    assert entity["timestamp"] == {"sec": 1234, "nsec": 500_000_000}


def test_a_tube_is_drawn_where_it_is(predictor: Predictor) -> None:
    sent = publication(predictor)
    (entity,) = scene_update(sent, 0.0)["entities"]
    cylinder = entity["cylinders"][-1]
    start, end = sent.tubes.start[-1, -1], sent.tubes.end[-1, -1]
    x, y, z, w = (cylinder["pose"]["orientation"][name] for name in "xyzw")
    along = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])  # the turned z axis
    np.testing.assert_allclose(along, (end - start) / np.linalg.norm(end - start), atol=2e-3)
    np.testing.assert_allclose(list(cylinder["pose"]["position"].values()), (start + end) / 2, atol=1e-4)
    assert cylinder["size"]["z"] == pytest.approx(np.linalg.norm(end - start), abs=3e-4)
    assert cylinder["size"]["x"] == pytest.approx(2 * sent.tubes.radius[-1, -1], abs=2e-4)


class Slow(FileSink):
    """Writes when it is allowed to."""

    allowed = threading.Event()

    def write(self, publication: Publication) -> None:
        self.allowed.wait(LONG)
        self.file.write(publication.json)


def test_a_slow_disc_drops_and_never_makes_anyone_wait(predictor: Predictor, tmp_path: Path) -> None:
    sink = Slow(tmp_path / "slow")
    sent = publication(predictor)
    for _ in range(MOST_WAITING + 50):
        sink.publish(sent)
    assert 49 <= sink.counters.dropped <= 50  # one may be in the writer's hands
    sink.allowed.set()
    sink.close()
    assert sink.counters.published + sink.counters.dropped == MOST_WAITING + 50


def test_a_disc_that_hangs_ends_in_time_and_is_counted(
    predictor: Predictor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sinks, "CLOSING", 0.1)
    sink = Slow(tmp_path / "hung")
    sink.allowed = threading.Event()
    for _ in range(5):
        sink.publish(publication(predictor))
    sink.close()
    assert sink.counters.failure is not None
    assert "still writing after 0.1 s" in sink.counters.failure
    assert 4 <= sink.counters.dropped <= 5  # one may be in the writer's hands
    sink.allowed.set()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full: a full disc cannot be had")
def test_a_full_disc_is_said_once_and_ends_nothing(predictor: Predictor, caplog: pytest.LogCaptureFixture) -> None:
    sink = JsonlSink(Path("/dev/full"))
    for number in range(20):
        sink.publish(publication(predictor, number))
    sink.close()
    assert sink.counters.failure is not None
    assert "No space left" in sink.counters.failure
    assert sink.counters.published + sink.counters.dropped == 20
    assert len(caplog.records) == 1


def test_a_fault_costs_one_is_logged_once_and_percentiles_are_known_to_half_a_millisecond(
    caplog: pytest.LogCaptureFixture,
) -> None:
    counters = SinkCounters("sink", "drawn", OSError)
    assert [counters.attempt(int, text) for text in ("odd", "odd", "1")] == [False, False, True]
    assert caplog.text.count("sink: a prediction could not be drawn") == 1
    assert np.isnan(counters.latency(0.5))
    latencies = np.random.default_rng(0).exponential(0.02, 5000)
    for latency in latencies:
        counters.sent(float(latency))
    for share in (0.5, 0.99):
        assert 0 <= counters.latency(share) - np.quantile(latencies, share, method="inverted_cdf") <= 0.5e-3
    counters.sent(1e9)
    assert counters.latency(1.0) == np.inf
    assert counters.published == 5001


@pytest.fixture
def network() -> Iterator[Network]:
    network = Network()
    yield network
    network.close()


def test_a_client_that_does_not_read_misses_and_the_others_do_not(predictor: Predictor, network: Network) -> None:
    sink = WebSocketSink(Address("ws", "127.0.0.1", 0), network, WebSocketOptions())
    port = int(sink.address.rpartition(":")[2])
    with socket.socket() as idle, connect(sink.address, proxy=None, open_timeout=LONG) as reader:
        idle.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        idle.connect(("127.0.0.1", port))
        idle.sendall(
            f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
        )
        assert idle.recv(12) == b"HTTP/1.1 101"
        number = 0
        while sink.counters.dropped < 10:  # the kernel takes some megabytes before the client's silence is noticed
            number += 1
            assert number < 20_000
            sink.publish(publication(predictor, number))
            assert json.loads(reader.recv(timeout=LONG))["number"] == number
        unsent = [client.transport.get_write_buffer_size() for client in sink.clients]
        assert len(unsent) == 2
        assert max(unsent) <= MOST_UNSENT + 2 * len(publication(predictor).json)
    sink.close()


def test_a_page_of_another_site_is_turned_away(network: Network) -> None:
    sink = WebSocketSink(Address("ws", "127.0.0.1", 0), network, WebSocketOptions())
    with pytest.raises(Exception, match="HTTP 403"):
        connect(sink.address, proxy=None, open_timeout=LONG, origin="https://evil.example")  # type: ignore[arg-type]
    for origin in ("http://localhost:8080", "http://127.0.0.1"):
        connect(sink.address, proxy=None, open_timeout=LONG, origin=origin).close()  # type: ignore[arg-type]
    sink.close()


def test_an_address_that_is_taken_is_an_option_error(network: Network) -> None:
    sink = WebSocketSink(Address("ws", "127.0.0.1", 0), network, WebSocketOptions())
    with pytest.raises(OptionError, match="nothing can listen there"):
        WebSocketSink(Address.parse(sink.address), network, WebSocketOptions())
    sink.close()


class Broken:
    """A sink with a mistake in it."""

    address, counters = "broken", SinkCounters("broken", "sent")

    def publish(self, publication: Publication) -> None:
        raise RuntimeError(publication.number)

    def close(self) -> None:
        pass


def test_the_loop_goes_on_whatever_happens(
    predictor: Predictor, caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    mailbox = Mailbox()
    good, bad = mailbox.feed("good"), mailbox.feed("bad")
    sink = JsonlSink(tmp_path / "a.jsonl")
    live = Live(mailbox, {good: predictor, bad: predictor}, [sink, Broken()])
    frames = [SkeletonFrame(k / 30, ARM_JOINTS, REST) for k in range(12)]
    for k, frame in enumerate(frames):
        good.put(frame, 0.0)
        stamp = (np.nan, np.inf, -1e300, 1e300)[k % 4]
        bad.put(replace(frame, stamp=stamp, positions=REST[: k % 6]), 0.0)
        for _ in range(2):
            arrival = mailbox.take(0.0)
            assert arrival is not None
            live.step(arrival)
    sink.close()
    assert live.failures == 24
    assert len(caplog.records) >= 1
    lines = [json.loads(line) for line in (tmp_path / "a.jsonl").read_text().splitlines()]
    assert len(lines) == 24
    assert {line["status"] for line in lines if line["source"] == "bad"} == {Status.FAULT.name}


def test_a_source_that_lies_changes_nothing_for_another() -> None:
    """Whatever a liar gets past the decoder is predicted and drawn, and the other's predictions stay the same."""
    rng = np.random.default_rng(4)
    mailbox = Mailbox()
    camera, liar = mailbox.feed("camera"), mailbox.feed("liar")
    taken: list[Publication] = []
    sink = Kept(taken)
    theirs, his, alone = (Predictor.load(MODEL, options=PredictorOptions(samples=20)) for _ in range(3))
    live = Live(mailbox, {camera: theirs, liar: his}, [sink])
    guard = SenderGuard(liar)
    now = time.monotonic() + 1e6  # acquired in the future: no delay, however busy the machine is
    for k in range(80):
        frame = SkeletonFrame(k / 30, ARM_JOINTS, REST + 0.02 * np.sin(k / 5), "0")
        camera.put(frame, now)
        for _ in range(2):
            now += rng.choice((0.0, 0.01, 1.0))
            scale = 1.0 if k % 20 < 12 else rng.choice((0.0, 1e-6, 1.0, 30.0))
            stamp = (0.0, 1e9, -50.0, 9e10)[k // 20] + rng.choice((k / 30, k / 30, k / 30, 0.0))
            arms = (scale * (REST + rng.normal(0, 0.002, REST.shape))).tolist()
            if k % 20 > 7:
                arms[rng.integers(6)][rng.integers(3)] = rng.choice((None, 0.0, 9999.0))
            lie = {"stamp": stamp, "joints": ARM_JOINTS, "positions": arms, "person": str(rng.integers(3))}
            guard.take(json.dumps(lie, default=float), "liar", now)
        while (arrival := mailbox.take(0.0)) is not None:
            live.step(arrival)
        mine = next(each for each in reversed(taken) if each.source == "camera")
        np.testing.assert_array_equal(mine.prediction.mean, alone.observe(frame).mean)
    assert live.failures == 0
    assert liar.refused == 0
    assert liar.received == 160
    assert len({each.prediction.status for each in taken if each.source == "liar"}) > 3
    for each in taken[::11]:
        fits(json.loads(json.dumps(scene_update(each, 0.0), allow_nan=False)), SCENE_UPDATE)
        json.loads(each.json)


class Kept:
    """A sink in memory."""

    address, counters = "memory", SinkCounters("memory", "sent")

    def __init__(self, taken: list[Publication]) -> None:
        self.taken = taken

    def publish(self, publication: Publication) -> None:
        self.taken.append(publication)

    def close(self) -> None:
        pass
