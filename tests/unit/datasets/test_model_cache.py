"""Models by name, from a server on loopback: whole, in an archive, cut and resumed, wrong."""

from __future__ import annotations

import hashlib
import io
import threading
import zipfile
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

from kinecast.datasets import model_cache
from kinecast.datasets.download import PublicSet, public_sets
from kinecast.datasets.model_cache import cache_folder, cached_model, fetch_model
from kinecast.errors import DownloadError, OptionError

NETWORK = np.random.default_rng(1).bytes(200_000)


class Server(ThreadingHTTPServer):
    """Serves one file, as far as it is told to."""

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.content = b""
        self.breaks_after: int | None = None
        self.starts: list[int] = []


class Handler(BaseHTTPRequestHandler):
    server: Server

    def do_GET(self) -> None:
        content = self.server.content
        start = int(self.headers.get("Range", "bytes=0-").removeprefix("bytes=").removesuffix("-"))
        self.server.starts.append(start)
        self.send_response(206 if start else 200)
        if start:
            self.send_header("Content-Range", f"bytes {start}-{len(content) - 1}/{len(content)}")
        self.send_header("Content-Length", str(len(content) - start))
        self.end_headers()
        end = None if self.server.breaks_after is None else start + self.server.breaks_after
        self.wfile.write(content[start:end])
        self.close_connection = True

    def log_message(self, *_: object) -> None:
        """Silence."""


@pytest.fixture
def server() -> Iterator[Server]:
    with Server() as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def archive_of(**files: bytes) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, each in files.items():
            archive.writestr(f"2023/{name}.onnx", each)
        archive.writestr("2023/../../detail.json", b"{}")
    return content.getvalue()


@pytest.fixture
def known(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    """A model `net` in an archive on the server."""
    server.content = archive_of(end2end=NETWORK)

    def facts(content: bytes) -> dict[str, str | int]:
        return {"sha256": hashlib.sha256(content).hexdigest(), "bytes": len(content)}

    url = f"http://127.0.0.1:{server.server_port}/"
    model = {"name": "net.onnx", **facts(NETWORK)}
    public = PublicSet("net", "a network", "MIT", "home", url, {"net.zip": facts(server.content)}, model)
    monkeypatch.setattr("kinecast.datasets.download.public_sets", lambda: {"net": public})
    monkeypatch.setattr(model_cache, "public_sets", lambda: {"net": public})


def names_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.rglob("*"))


@pytest.mark.usefixtures("known")
def test_a_model_comes_out_of_its_archive_and_is_fetched_once(server: Server, tmp_path: Path) -> None:
    path = fetch_model("net", tmp_path, patience=0.0)
    assert (path.read_bytes(), names_in(tmp_path)) == (NETWORK, ["net.onnx"])
    assert fetch_model("net", tmp_path, patience=0.0) == path
    assert server.starts == [0]


@pytest.mark.usefixtures("known")
def test_a_download_that_was_cut_goes_on_where_it_was(server: Server, tmp_path: Path) -> None:
    whole, server.content = server.content, server.content[:150_000]
    server.breaks_after = 150_000
    with pytest.raises(DownloadError, match=r"150000 of 200\d\d\d bytes are kept: the same command continues there"):
        fetch_model("net", tmp_path, patience=0.0)
    assert [name for name in names_in(tmp_path) if not name.endswith(".part")] == []
    server.content, server.breaks_after, server.starts = whole, None, []
    assert fetch_model("net", tmp_path, patience=0.0).read_bytes() == NETWORK
    assert server.starts == [150_000]
    assert names_in(tmp_path) == ["net.onnx"]


@pytest.mark.usefixtures("known")
def test_another_file_of_the_same_size_is_refused(server: Server, tmp_path: Path) -> None:
    server.content = server.content[:-1] + b"?"
    with pytest.raises(DownloadError, match="checksum"):
        fetch_model("net", tmp_path, patience=0.0)
    assert names_in(tmp_path) == []


@pytest.mark.parametrize("files", [{}, {"a": NETWORK, "b": NETWORK}, {"a": NETWORK[::-1]}])
def test_an_archive_with_something_else_gives_no_model(
    files: dict[str, bytes], server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    server.content = archive_of(**files)
    whole = {"sha256": hashlib.sha256(server.content).hexdigest(), "bytes": len(server.content)}
    model = {"name": "net.onnx", "sha256": hashlib.sha256(NETWORK).hexdigest(), "bytes": len(NETWORK)}
    public = PublicSet("net", "", "MIT", "home", f"http://127.0.0.1:{server.server_port}/", {"net.zip": whole}, model)
    monkeypatch.setattr("kinecast.datasets.download.public_sets", lambda: {"net": public})
    monkeypatch.setattr(model_cache, "public_sets", lambda: {"net": public})
    with pytest.raises(DownloadError, match=r"net\.zip: .*(expected one|checksum)"):
        fetch_model("net", tmp_path, patience=0.0)
    assert names_in(tmp_path) == ["net.zip"]


def test_what_is_there_is_found_and_what_is_not_is_named_with_its_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("KINECAST_MODELS", str(tmp_path))
    assert cache_folder() == tmp_path
    with pytest.raises(OptionError, match=r"fetch it once with: kinecast download rtmpose-m$"):
        cached_model("rtmpose-m")
    (tmp_path / "rtmpose-m.onnx").touch()
    assert cached_model("rtmpose-m") == tmp_path / "rtmpose-m.onnx"
    with pytest.raises(OptionError, match="there are pose-landmarker, rtmpose-m, yolox-m"):
        cached_model("andy")


def test_every_models_real_address_size_and_checksum_are_complete() -> None:
    models = [each for each in public_sets().values() if each.model]
    assert {each.name for each in models} == {"pose-landmarker", "rtmpose-m", "yolox-m"}
    for each in models:
        assert each.files is not None
        assert each.model is not None
        assert each.url.startswith("https://storage.googleapis.com/") or each.url.startswith(
            "https://download.openmmlab.com/"
        )
        assert "Apache" in each.licence
        for facts in (*each.files.values(), each.model):
            assert len(bytes.fromhex(str(facts["sha256"]))) == 32
            assert 5_000_000 < int(facts["bytes"]) < 200_000_000
