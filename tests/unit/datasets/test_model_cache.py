"""Models by name, from a server on loopback: whole, in an archive, cut and resumed, wrong."""

from __future__ import annotations

import hashlib
import io
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest

from kinecast.datasets import model_cache, remote_file
from kinecast.datasets.model_cache import cache_folder, cached_model, fetch_model
from kinecast.datasets.remote_file import PublicSet, RemoteFile, public_sets
from kinecast.errors import DownloadError, OptionError

from ...conftest import Server

NETWORK = np.random.default_rng(1).bytes(200_000)


def archive_of(**files: bytes) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, each in files.items():
            archive.writestr(f"2023/{name}.onnx", each)
        archive.writestr("2023/../../detail.json", b"{}")
    return content.getvalue()


def offer(server: Server, archive: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    """A model `net` in an archive on the server."""

    def remote(name: str, content: bytes) -> RemoteFile:
        return RemoteFile(name, f"sha256:{hashlib.sha256(content).hexdigest()}", len(content))

    server.files["net.zip"] = archive
    files = (remote("net.zip", archive),)
    public = PublicSet("net", "a network", "MIT", "home", server.url, files, remote("net.onnx", NETWORK))
    for module in (remote_file, model_cache):
        monkeypatch.setattr(module, "public_sets", lambda: {"net": public})


@pytest.fixture
def known(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    offer(server, archive_of(end2end=NETWORK), monkeypatch)


def names_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.rglob("*"))


@pytest.mark.usefixtures("known")
def test_a_model_comes_out_of_its_archive_and_is_fetched_once(server: Server, tmp_path: Path) -> None:
    path = fetch_model("net", tmp_path, patience=0.0)
    assert (path.read_bytes(), names_in(tmp_path)) == (NETWORK, ["net.onnx"])
    assert fetch_model("net", tmp_path, patience=0.0) == path
    assert server.requests == [("net.zip", None)]


@pytest.mark.usefixtures("known")
def test_another_file_of_the_same_size_is_refused(server: Server, tmp_path: Path) -> None:
    server.files["net.zip"] = server.files["net.zip"][:-1] + b"?"
    with pytest.raises(DownloadError, match="checksum"):
        fetch_model("net", tmp_path, patience=0.0)
    assert names_in(tmp_path) == []


@pytest.mark.parametrize("files", [{}, {"a": NETWORK, "b": NETWORK}, {"a": NETWORK[::-1]}])
def test_an_archive_with_something_else_gives_no_model(
    files: dict[str, bytes], server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    offer(server, archive_of(**files), monkeypatch)
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
        for file in (*each.files, each.model):
            assert re.fullmatch("sha256:[0-9a-f]{64}", file.checksum)
            assert 5_000_000 < file.size < 200_000_000
