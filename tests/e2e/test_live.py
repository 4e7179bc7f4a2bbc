"""`kinecast live`: skeletons by WebSocket and UDP, predictions by WebSocket and in files, and what is refused."""

from __future__ import annotations

import json
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.cameras.pinhole import Intrinsics, PinholeCamera
from kinecast.cameras.rig import Rig
from kinecast.datasets.loading import load
from kinecast.geometry.transforms import transform
from kinecast.types import Status

ROOT = Path(__file__).resolve().parents[2]
MODEL = ROOT / "src" / "kinecast" / "data" / "models" / "zero_velocity.npz"
LONG = 240.0
"""Of a wait for another process, on however busy a machine [s]; most take a second."""


Start = Callable[..., Any]


@pytest.fixture(scope="session")
def motion(tables: tuple[Path, Path]) -> tuple[np.ndarray, np.ndarray]:
    """(N,) stamps and (N, 6, 3) arms of the first person."""
    (recording,) = load(tables[0])
    return recording.stamps, np.stack([recording.joint(joint) for joint in ARM_JOINTS], axis=1)


def skeleton(stamp: float, arms: np.ndarray, person: str) -> dict[str, Any]:
    """A message, with null for what is not seen."""
    positions = [[None if np.isnan(value) else float(value) for value in row] for row in arms]
    return {"stamp": float(stamp), "person": person, "joints": list(ARM_JOINTS), "positions": positions}


def predictions(path: Path) -> list[dict[str, Any]]:
    """All that is in an MCAP file, once it is checked to be whole."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        messages = list(reader.iter_messages())
    assert len(messages) == summary.statistics.message_count
    scenes = [message for schema, _, message in messages if schema and schema.name == "foxglove.SceneUpdate"]
    found = [message for schema, _, message in messages if schema and schema.name == "kinecast.Prediction"]
    assert len(scenes) == len(found)
    for message in scenes:
        (entity,) = json.loads(message.data)["entities"]
        assert entity["lines"]
        assert entity["texts"][0]["text"].split(": ")[1] in Status.__members__
    assert all(message.publish_time >= message.log_time for message in found)
    return sorted((json.loads(message.data) for message in found), key=lambda each: each["number"])


def test_two_networks_in_and_every_sink_out(
    start: Start, motion: tuple[np.ndarray, np.ndarray], tmp_path: Path
) -> None:
    stamps, arms = motion
    arguments = ("--source", "ws://:0", "--source", "udp://:0", "--sink", "ws://:0", "--sink", "ws://:0?format=msgpack")
    live = start(*arguments, "--sink", "mcap:live.mcap", "--sink", "jsonl:live.jsonl")
    web, datagrams = live.sources
    host, port = datagrams.removeprefix("udp://").split(":")
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as camera,
        connect(live.sinks[0], proxy=None, open_timeout=LONG) as listener,
        connect(live.sinks[1], proxy=None, open_timeout=LONG) as packed,
    ):
        camera.connect((host, int(port)))

        def sent_and_heard(send: Callable[[dict[str, Any]], object], source: str, person: str, frames: range) -> Any:
            """Frame after frame, each once the prediction of the one before has come."""
            for k in frames:
                send(skeleton(stamps[k], arms[k], person))
                heard = json.loads(listener.recv(timeout=LONG))
                assert (heard["source"], heard["person"]) == (source, person)
                content = packed.recv(timeout=LONG)
                assert isinstance(content, bytes)
                assert msgspec.msgpack.decode(content)["number"] == heard["number"]
            return heard

        with connect(web, proxy=None, open_timeout=LONG) as client:
            heard = sent_and_heard(lambda each: client.send(json.dumps(each)), web, "anna", range(20))
            # What lies is counted, and stops nobody.
            client.send(b"\x00half a packet")
            client.send(json.dumps(skeleton(stamps[20], arms[20] * 1e6, "anna")))
            heard = sent_and_heard(lambda each: client.send(msgspec.msgpack.encode(each)), web, "anna", range(20, 25))
        assert np.shape(heard["mean"]) == (len(heard["times"]), 6, 3)
        assert np.shape(heard["covariance"]) == (len(heard["times"]), 6, 6)
        assert np.shape(heard["tubes"]["radius"]) == (len(heard["times"]), 4)
        assert heard["stamp"] == pytest.approx(stamps[24])
        assert all(time > heard["stamp"] for time in heard["times"])
        np.testing.assert_allclose(heard["mean"][0], arms[24], atol=0.2)

        sent_and_heard(lambda each: camera.send(json.dumps(each).encode()), datagrams, "ben", range(10))
        camera.send(b"{")
        sent_and_heard(lambda each: camera.send(msgspec.msgpack.encode(each)), datagrams, "ben", range(10, 15))

        with connect(web, proxy=None, open_timeout=LONG) as client:  # it returns
            sent_and_heard(lambda each: client.send(json.dumps(each)), web, "anna", range(25, 40))
            client.send("x" * 10_000_000)
            with pytest.raises(ConnectionClosed, match="1009"):
                client.recv(timeout=LONG)
        sent_and_heard(lambda each: camera.send(json.dumps(each).encode()), datagrams, "ben", range(15, 20))

    rest = live.end(signal.SIGTERM)
    assert re.search(rf"{web}\s+–\s+40\s+0\s+3\s", rest)
    assert re.search(rf"{datagrams}\s+–\s+20\s+0\s+1\s", rest)
    written = predictions(tmp_path / "live.mcap")
    assert len(written) == 60
    assert [each["number"] for each in written] == list(range(1, 61))
    lines = (tmp_path / "live.jsonl").read_text().splitlines()
    assert [json.loads(line) for line in lines] == written


def cameras() -> Rig:
    """Two, 3 m away and 1.5 m up: one looks along x, one along y."""
    ahead = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    aside = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    lens = Intrinsics(1280, 720, 910.0, 910.0, 640.0, 360.0)
    places = {"ahead": (ahead, [-3.0, 0.0, 1.2]), "aside": (aside, [0.0, -3.0, 1.2])}
    return Rig({name: PinholeCamera(name, lens, transform(R, np.array(t))) for name, (R, t) in places.items()}, "cell")


def test_what_the_cameras_of_a_rig_see_is_one_person(
    start: Start, motion: tuple[np.ndarray, np.ndarray], tmp_path: Path
) -> None:
    rig, (_, arms) = cameras(), motion
    middle = np.nanmean(arms[0], axis=0) - (0.0, 0.0, 1.2)
    (tmp_path / "rig.yaml").write_text(rig.to_yaml())
    live = start("--rig", "rig.yaml", "--source", "ws://:0", "--source", "udp://:0?camera=aside", "--sink", "ws://:0")
    assert live.sources[0] == "fusion"
    host, port = live.sources[2].removeprefix("udp://").split(":")
    heard: dict[str, Any] | None = None
    with (
        connect(live.sources[1], proxy=None, open_timeout=LONG) as client,
        connect(live.sinks[0], proxy=None, open_timeout=LONG) as listener,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as datagrams,
    ):
        datagrams.connect((host, int(port)))
        for k in range(2000):
            place = arms[k // 4 % len(arms)] - middle
            for name, offset in (("ahead", 500.0), ("aside", -900.0)):  # clocks of their own
                pixels, depth = rig.cameras[name].project(place)
                content = {"stamp": k / 30 + offset, "joints": list(ARM_JOINTS), "person": str(k % 2)}
                content |= {"pixels": pixels.tolist(), "depth": depth.tolist(), "pixel_std": [3.0] * 6}
                if name == "ahead":
                    client.send(json.dumps(content | {"camera": name}))
                else:
                    datagrams.send(json.dumps(content).encode())
            try:
                heard = json.loads(listener.recv(timeout=1 / 30))
            except TimeoutError:
                continue
            if heard["number"] >= 10:
                break
    assert heard is not None
    assert (heard["source"], heard["person"], heard["frame_id"]) == ("fusion of ahead, aside", "1", "cell")
    assert abs(heard["stamp"] - time.time()) < LONG
    np.testing.assert_allclose(heard["observed"], place, atol=0.1)
    rest = live.end()
    assert "fusion of ahead, aside" in rest


def test_a_recording_is_played_and_ends(
    kinecast: Callable[..., Any], tables: tuple[Path, Path], scene_file: Path, tmp_path: Path
) -> None:
    out = tmp_path / "played.mcap"
    source = f"recording:{tables[0]}?speed=5"
    done = kinecast(
        "live", "--source", source, "--model", MODEL, "--scene", scene_file, "--samples", 20, "--sink", f"mcap:{out}"
    )
    assert done.code == 0, done.err
    frames, stale = map(int, re.findall(r"ended\s+(\d+)\s+(\d+)", done.out)[0])
    assert frames == len(load(tables[0])[0].stamps)
    assert len(predictions(out)) == frames - stale > 0


def test_the_example_clients_work_as_printed(start: Start, tmp_path: Path) -> None:
    node = shutil.which("node")
    sources = ("--source", "ws://:0", "--source", "udp://:0", "--source", "xsens://:0?person=0")
    live = start(*sources, "--sink", "ws://:0", "--sink", "jsonl:live.jsonl")
    examples = ROOT / "examples" / "live"
    arguments = [sys.executable, "-W", "error", str(examples / "client.py"), live.sources[0], live.sinks[0]]
    done = subprocess.run(arguments, capture_output=True, text=True, timeout=LONG, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("right wrist in half a second") == 90
    senders = [(sys.executable, examples / "mvn.py", live.sources[2])]
    if node is not None:
        senders.append((node, examples / "client.mjs", live.sources[1]))
    for program, script, source in senders:
        command = [program, script, source.rpartition(":")[2]]
        done = subprocess.run(command, capture_output=True, text=True, timeout=LONG, check=False)
        assert done.returncode == 0, done.stderr
    live.end()
    lines = [json.loads(line) for line in (tmp_path / "live.jsonl").read_text().splitlines()]
    assert {line["source"] for line in lines} == {live.sources[0], *(source for _, _, source in senders)}
    of_suit = [line for line in lines if line["source"] == live.sources[2]]
    assert {line["person"] for line in of_suit} == {"0"}
    np.testing.assert_allclose(of_suit[-1]["observed"][1], [0, 0.25, 1.1], atol=1e-4)  # the left elbow
    if node is None:
        pytest.skip("no node: the client in JavaScript was not run")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ("--source", "ftp://x:1", "--sink", "ws://:0"),
            "--source ftp://x:1: expected one of recording:, ws://HOST:PORT",
        ),
        (("--source", "ws://:0?speed=2", "--sink", "ws://:0"), "speed unknown; allowed are camera"),
        (
            ("--source", "ws://nowhere.invalid:80", "--sink", "ws://:0"),
            "ws://nowhere.invalid:80: nothing can listen there",
        ),
        (("--source", "ws://:99999", "--sink", "ws://:0"), "ws://:99999: Port out of range"),
        (("--source", "udp://127.0.0.1", "--sink", "ws://:0"), "expected udp://HOST:PORT"),
        (("--source", "xsens://:99999", "--sink", "ws://:0"), "xsens://:99999: Port out of range"),
        (("--source", "xsens://?person=anna", "--sink", "ws://:0"), "person 'anna', expected a whole number in 0..255"),
        (("--source", "xsens://?up=x", "--sink", "ws://:0"), "up 'x', expected y or z"),
        (("--source", "xsens://?stamps=now", "--sink", "ws://:0"), "stamps 'now', expected arrival or code"),
        (("--source", "xsens://?name=a", "--sink", "ws://:0"), "name unknown; allowed are person, up, stamps"),
        (("--source", "nowhere.csv", "--sink", "ws://:0"), "nowhere.csv: no such file or folder"),
        (("--source", "recording:{table}?speed=fast", "--sink", "ws://:0"), "speed 'fast', expected 0.01..1000"),
        (("--source", "recording:{table}?speed=0", "--sink", "ws://:0"), "speed '0', expected 0.01..1000"),
        (("--sink", "ws://:0"), "--source: at least one is needed"),
        (("--source", "ws://:0", "--sink", "printer"), "--sink printer: expected one of view://HOST:PORT"),
        (("--source", "ws://:0", "--sink", "mcap:out.bag"), "its name must end in .mcap"),
        (("--source", "ws://:0", "--sink", "mcap:/nowhere/out.mcap"), "there is no folder /nowhere"),
        (("--source", "ws://:0", "--sink", "ws://:0?format=xml"), "format 'xml', expected json or msgpack"),
        (("--source", "{table}", "--source", "{table}", "--sink", "ws://:0"), "is there twice"),
        (("--source", "ws://:0", "--sink", "ws://:0", "--scene", "none.yaml"), "none.yaml"),
        (("--source", "ws://:0", "--sink", "ws://:0", "--model", "none.npz"), "none.npz"),
        (("--source", "ws://:0", "--sink", "ws://:0", "--rig", "none.yaml"), "none.yaml: no such file"),
        (("--source", "ws://:0?camera=left", "--sink", "ws://:0"), "a camera needs --rig"),
        (("--source", "udp://:0?camera=x", "--sink", "ws://:0", "--rig", "{rig}"), "camera 'x' is not in the rig"),
        (("--source", "ws://:0", "--sink", "ws://:0", "--level", "2"), "--level 2.0 is outside 0..1"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_starts(
    arguments: tuple[str, ...], words: str, kinecast: Callable[..., Any], tables: tuple[Path, Path], tmp_path: Path
) -> None:
    kept = tmp_path / "kept.mcap"
    kept.write_text("of yesterday")
    rig = tmp_path / "rig.yaml"
    rig.write_text(cameras().to_yaml())
    filled = [argument.format(table=tables[0], rig=rig) for argument in arguments]
    model = () if "--model" in arguments else ("--model", MODEL)
    done = kinecast("live", *filled, "--sink", f"mcap:{kept}", *model, "--samples", 2)
    assert done.code == 2
    assert words in " ".join(done.err.split())
    assert "source:" not in done.out
    assert kept.read_text() == "of yesterday"


def test_a_port_that_is_taken_is_named(kinecast: Callable[..., Any], tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        sink = f"ws://127.0.0.1:{port}"
        done = kinecast(
            "live", "--source", "ws://:0", "--sink", sink, "--sink", f"mcap:{tmp_path / 'a.mcap'}", "--model", MODEL
        )
    assert done.code == 2
    assert f"{sink}: nothing can listen there" in " ".join(done.err.split())
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("missing", "source", "extra"),
    [
        ("websockets", "ws://:0", "live"),
        ("pyrealsense2", "realsense:?model=a.onnx", "camera"),
    ],
)
def test_without_the_extra_the_command_says_what_to_install(
    missing: str, source: str, extra: str, tmp_path: Path
) -> None:
    """In a process of its own, where the package is not there."""
    command = f"import sys; sys.modules[{missing!r}] = None; from kinecast.cli import main; main()"
    arguments = ("live", "--source", source, "--sink", "ws://:0", "--model", str(MODEL))
    done = subprocess.run(
        [sys.executable, "-c", command, *arguments], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert f"pip install 'kinecast[{extra}]'" in " ".join(done.stderr.split())
