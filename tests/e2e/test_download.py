"""`kinecast download` against a server on loopback."""

from __future__ import annotations

import functools
import gzip
import hashlib
import json
import threading
from collections.abc import Callable, Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

Kinecast = Callable[..., Any]

MOTION = b"whatever the record lists"


class Quiet(SimpleHTTPRequestHandler):
    """Serves a folder and says nothing."""

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def server(tmp_path: Path) -> Iterator[tuple[Path, str]]:
    """A folder, and the address it is served under."""
    root = tmp_path / "server"
    root.mkdir()
    with ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(root))) as http:
        thread = threading.Thread(target=http.serve_forever)
        thread.start()
        yield root, f"http://127.0.0.1:{http.server_port}/"
        http.shutdown()
        thread.join()


def record(root: Path, url: str, checksum: str) -> str:
    """A Zenodo record of one file; its address."""
    (root / "walk.mvnx").write_bytes(MOTION)
    entry = {"key": "walk.mvnx", "size": len(MOTION), "checksum": checksum, "links": {"self": url + "walk.mvnx"}}
    (root / "record").write_text(json.dumps({"metadata": {}, "files": [entry]}))
    return url + "record"


def test_lists_the_sets_with_their_licences(kinecast: Kinecast) -> None:
    outcome = kinecast("download")
    assert outcome.code == 0
    sets = ("human-robot-animations", "human-assembly-data", "handovers", "andy")
    models = ("pose-landmarker", "rtmpose-m", "yolox-m")
    for name in (*sets, *models):
        assert f"{name}\n  " in outcome.out
    assert outcome.out.count("licence: ") == len(sets) + len(models)


def test_a_models_licence_is_printed_and_what_is_not_that_model_leaves_nothing(
    kinecast: Kinecast, server: tuple[Path, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root, url = server
    (root / "pose_landmarker_full.task").write_bytes(bytes(9_398_198))
    monkeypatch.setenv("KINECAST_MODELS", str(tmp_path / "cache"))
    outcome = kinecast("download", "pose-landmarker", "--url", url)
    assert "licence: Apache License 2.0, The MediaPipe Authors" in outcome.out
    assert outcome.code == 2
    assert outcome.err.startswith("kinecast: pose_landmarker_full.task: ")
    assert outcome.err.count("\n") == 1
    assert not list((tmp_path / "cache").rglob("*.task"))


def test_a_whole_record(kinecast: Kinecast, server: tuple[Path, str], tmp_path: Path) -> None:
    url = record(*server, f"md5:{hashlib.md5(MOTION).hexdigest()}")
    outcome = kinecast("download", "andy", "--url", url, "--out", tmp_path / "recordings")
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out == f"1 file in {tmp_path / 'recordings' / 'andy'}\n"
    assert (tmp_path / "recordings" / "andy" / "walk.mvnx").read_bytes() == MOTION


def test_a_wrong_checksum_leaves_nothing(kinecast: Kinecast, server: tuple[Path, str], tmp_path: Path) -> None:
    url = record(*server, f"md5:{hashlib.md5(b'else').hexdigest()}")
    outcome = kinecast("download", "andy", "--url", url, "--out", tmp_path / "recordings")
    assert outcome.code == 2
    assert outcome.err.startswith("kinecast: walk.mvnx: ")
    assert "checksum" in outcome.err
    assert outcome.err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["server"]


def test_what_is_downloaded_can_be_used(
    kinecast: Kinecast, server: tuple[Path, str], data_root: Path, tmp_path: Path
) -> None:
    root, url = server
    name = "Task1/Human1/trial1.txt"
    (root / name).parent.mkdir(parents=True)
    (root / name).write_bytes(gzip.decompress((data_root / "human_assembly_data" / f"{name}.gz").read_bytes()))
    out = tmp_path / "recordings"
    assert kinecast("download", "human-assembly-data", "--only", name, "--url", url, "--out", out).code == 0
    assert kinecast("info", out).out.startswith("Task1/Human1/trial1: lego, 925 frames")
