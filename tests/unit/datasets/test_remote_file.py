"""Downloads against a server on loopback: whole, resumed, truncated, wrong, and hostile."""

from __future__ import annotations

import gzip
import hashlib
import io
import os
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from rich.progress import Progress

from kinecast.datasets import remote_file
from kinecast.datasets.remote_file import PublicSet, RemoteFile, cache_folder, cached_model, download, public_sets
from kinecast.errors import DownloadError, OptionError

from ...conftest import Server

CONTENT = np.random.default_rng(0).bytes(300_000)


def fetch(server: Server, folder: Path, only: str = "*") -> list[Path]:
    return download("andy", folder, only=only, url=server.url + "record", patience=0.0)


def everything_in(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def test_files_arrive_whole_and_are_not_fetched_twice(server: Server, tmp_path: Path) -> None:
    server.record(**{"a.bin": CONTENT, "sub/b c.txt": b"hello", "empty": b""})
    paths = fetch(server, tmp_path / "new")
    assert [path.read_bytes() for path in paths] == [CONTENT, b"hello", b""]
    assert everything_in(tmp_path / "new") == {"a.bin", "sub/b c.txt", "empty"}
    server.requests.clear()
    assert fetch(server, tmp_path / "new") == paths
    assert [path for path, _ in server.requests] == ["record"]


def test_a_damaged_file_is_fetched_again(server: Server, tmp_path: Path) -> None:
    server.record(**{"a.bin": CONTENT})
    (tmp_path / "a.bin").write_bytes(CONTENT[:-1] + b"!")
    (path,) = fetch(server, tmp_path)
    assert path.read_bytes() == CONTENT


def test_only_takes_some_files(server: Server, tmp_path: Path) -> None:
    server.record(**{"a.mvnx": b"1", "a.csv": b"2"})
    fetch(server, tmp_path, only="*.mvnx")
    assert everything_in(tmp_path) == {"a.mvnx"}
    with pytest.raises(DownloadError, match=r"no file matches '\*\.bvh'"):
        fetch(server, tmp_path, only="*.bvh")


def test_a_broken_connection_is_resumed_where_it_broke(server: Server, tmp_path: Path) -> None:
    server.record(**{"a.bin": CONTENT})
    server.breaks_after = 130_000
    (path,) = fetch(server, tmp_path)
    assert path.read_bytes() == CONTENT
    wanted = [wanted for name, wanted in server.requests if name == "files/a.bin"]
    assert wanted == [None, "bytes=130000-", "bytes=260000-"]


def test_a_run_that_was_stopped_is_continued_by_the_next(server: Server, tmp_path: Path) -> None:
    server.record(**{"a.bin": CONTENT})
    server.breaks_after = 0
    digest = hashlib.md5(CONTENT).hexdigest()
    part = tmp_path / f"a.bin.{digest[:8]}.part"
    part.write_bytes(CONTENT[:100_000])
    with pytest.raises(DownloadError, match=r"a\.bin: .*100000 of 300000 bytes are kept") as caught:
        fetch(server, tmp_path)
    assert isinstance(caught.value, OSError)
    assert everything_in(tmp_path) == {part.name}, "an incomplete file never has its final name"
    server.breaks_after = None
    server.requests.clear()
    (path,) = fetch(server, tmp_path)
    assert path.read_bytes() == CONTENT
    assert ("files/a.bin", "bytes=100000-") in server.requests
    assert everything_in(tmp_path) == {"a.bin"}


def test_a_server_without_ranges_starts_again(server: Server, tmp_path: Path) -> None:
    server.record(**{"a.bin": CONTENT})
    server.ranges = False
    (tmp_path / f"a.bin.{hashlib.md5(CONTENT).hexdigest()[:8]}.part").write_bytes(b"x" * 1000)
    (path,) = fetch(server, tmp_path)
    assert path.read_bytes() == CONTENT


def test_a_part_that_is_too_long_or_stale_is_thrown_away(server: Server, tmp_path: Path) -> None:
    server.record(**{"a.bin": CONTENT})
    part = tmp_path / f"a.bin.{hashlib.md5(CONTENT).hexdigest()[:8]}.part"
    part.write_bytes(CONTENT + b"more")
    assert fetch(server, tmp_path)[0].read_bytes() == CONTENT
    (tmp_path / "a.bin").unlink()
    part.write_bytes(b"?" * 100)  # of the right length to resume, but other bytes
    with pytest.raises(DownloadError, match="checksum"):
        fetch(server, tmp_path)
    assert everything_in(tmp_path) == set()
    assert fetch(server, tmp_path)[0].read_bytes() == CONTENT


def test_a_busy_server_is_asked_again(server: Server, tmp_path: Path) -> None:
    server.record(**{"a.bin": b"abc"})
    server.busy["files/a.bin"] = 2
    assert fetch(server, tmp_path)[0].read_bytes() == b"abc"
    assert [name for name, _ in server.requests] == ["record"] + ["files/a.bin"] * 3


def test_a_missing_file_is_not_asked_for_again(server: Server, tmp_path: Path) -> None:
    server.record(**{"a.bin": b"abc"})
    del server.files["files/a.bin"]
    with pytest.raises(DownloadError, match=r"a\.bin: the server answers 404 .*files/a\.bin"):
        fetch(server, tmp_path)
    assert [name for name, _ in server.requests] == ["record", "files/a.bin"]


def test_wrong_bytes_are_not_kept(server: Server, tmp_path: Path) -> None:
    server.record(**{"a.bin": CONTENT})
    server.files["files/a.bin"] = CONTENT[:-1] + b"?"
    with pytest.raises(DownloadError, match=r"a\.bin: what .* sent is not the file it should be \(its checksum"):
        fetch(server, tmp_path)
    assert everything_in(tmp_path) == set()


def test_a_file_shorter_than_announced_is_given_up(server: Server, tmp_path: Path) -> None:
    server.record(**{"a.bin": CONTENT})
    server.files["files/a.bin"] = CONTENT[:1000]
    with pytest.raises(DownloadError, match=r"of 300000 bytes are kept"):
        fetch(server, tmp_path)
    assert len(server.requests) < 10


def test_a_file_larger_than_announced_is_cut_off(server: Server, tmp_path: Path) -> None:
    server.record(**{"a.bin": b"abc"})
    server.files["files/a.bin"] = CONTENT * 10
    with pytest.raises(DownloadError, match="sends more than the file's 3 bytes"):
        fetch(server, tmp_path)
    assert everything_in(tmp_path) == set()


OUTSIDE = ["../evil", "/etc/evil", "a/../../evil", "a//b", "a/./b", "", "C:evil", "a\\..\\evil"]
UNUSABLE = ["nul\0", "tab\t", "a/ /b", "x.", "a" * 300]


@pytest.mark.parametrize("name", OUTSIDE + UNUSABLE)
def test_names_that_lead_elsewhere_are_refused(server: Server, tmp_path: Path, name: str) -> None:
    server.list_files([server.entry("ok", b""), {**server.entry("x", b"evil"), "key": name}])
    server.files["files/ok"] = server.files["files/x"] = b"evil"
    folder = tmp_path / "inside"
    with pytest.raises(DownloadError, match="refusing the file name"):
        fetch(server, folder)
    assert everything_in(tmp_path) == set(), "nothing at all is written"


def test_a_link_inside_the_folder_does_not_lead_out(server: Server, tmp_path: Path) -> None:
    (tmp_path / "outside").mkdir()
    (tmp_path / "inside").mkdir()
    os.symlink(tmp_path / "outside", tmp_path / "inside" / "sub")
    server.record(**{"sub/a": b"evil"})
    with pytest.raises(DownloadError, match="leads outside"):
        fetch(server, tmp_path / "inside")
    assert everything_in(tmp_path / "outside") == set()


@pytest.mark.parametrize(
    ("listing", "message"),
    [
        (b"<html>", "did not answer with a record"),
        (b"[]", "did not answer with a record"),
        (b'{"metadata": {}, "files": [{"key": "a"}]}', "did not answer with a record"),
        (b"[" * 100_000, "did not answer with a record"),
        (b" " * 10_000_001, "larger than 10000000 bytes"),
        (b'{"metadata": {"access_right": "restricted"}, "files": []}', r"is not open \(restricted\)"),
        (b'{"metadata": {}, "files": []}', "no file matches"),
    ],
)
def test_a_listing_that_is_none(server: Server, tmp_path: Path, listing: bytes, message: str) -> None:
    server.files["record"] = listing
    with pytest.raises(DownloadError, match=message):
        fetch(server, tmp_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"checksum": "md5:1234"}, "no usable checksum"),
        ({"checksum": "crc:" + "0" * 32}, "no usable checksum"),
        ({"size": -1}, "no usable checksum"),
        ({"links": {"self": "http://127.0.0.1:1/files/a"}}, "listed on another server"),
        ({"links": {"self": "file:///etc/passwd"}}, "listed on another server"),
        ({"size": 10**18}, r"GB are missing"),
    ],
)
def test_entries_that_cannot_be_trusted(
    server: Server, tmp_path: Path, change: dict[str, object], message: str
) -> None:
    server.list_files([{**server.entry("a", b"abc"), **change}])
    with pytest.raises(DownloadError, match=message):
        fetch(server, tmp_path)
    assert everything_in(tmp_path) == set()


def test_a_name_listed_twice_is_refused(server: Server, tmp_path: Path) -> None:
    server.list_files([server.entry("a", b"abc")] * 2)
    with pytest.raises(DownloadError, match="some of the same name"):
        fetch(server, tmp_path)


def test_nobody_listens(tmp_path: Path) -> None:
    with Server() as closed:
        url = closed.url
    with pytest.raises(DownloadError, match="cannot read the list of files"):
        download("andy", tmp_path, url=url, patience=0.0)
    with pytest.raises(DownloadError, match=r"(?s)CollaborativeHammering/0\.csv: .*0 of 968742 bytes"):
        download("human-robot-animations", tmp_path, url=url, patience=0.0)
    with pytest.raises(DownloadError, match="only http and https"):
        download("andy", tmp_path, url="file:///etc/passwd")


def test_an_unknown_set_is_an_option_error_that_lists_them(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="no public set 'h36m'; there are human-robot-animations, human-assembly"):
        download("h36m", tmp_path)


def test_the_bar_ends_at_the_total(server: Server, tmp_path: Path) -> None:
    server.record(**{"a.bin": CONTENT, "b": b"12345"})
    (tmp_path / "b").write_bytes(b"12345")
    with Progress(console=Console(file=io.StringIO())) as progress:
        download("andy", tmp_path, progress, url=server.url + "record")
        (task,) = progress.tasks
        assert task.completed == task.total == 300_005


def test_the_shipped_table_is_well_formed() -> None:
    sets = {name: each for name, each in public_sets().items() if each.model is None}
    assert list(sets) == ["human-robot-animations", "human-assembly-data", "handovers", "andy"]
    assert [None if s.files is None else len(s.files) for s in sets.values()] == [47, 14, 27, None]
    models = {name: each for name, each in public_sets().items() if each.model}
    assert set(models) == {"pose-landmarker", "rtmpose-m", "yolox-m"}
    for public in (*sets.values(), *models.values()):
        assert public.url.startswith("https://")
        assert public.model is None or "Apache" in public.licence
        for file in (*(public.files or ()), *filter(None, [public.model])):
            assert re.fullmatch("sha256:[0-9a-f]{64}", file.checksum)
            assert 0 < file.size < (200_000_000 if public.model else 10_000_000)


def test_the_shipped_checksums_are_those_of_the_real_files(server: Server, data_root: Path, tmp_path: Path) -> None:
    """The recordings kept for tests are the originals, compressed: serve them, download them."""
    source = data_root / "kth_handover_sample"
    if not source.is_dir():
        pytest.skip("no kth_handover_sample among the recordings")
    for path in source.rglob("*.csv.gz"):
        server.files[path.relative_to(source).as_posix().removesuffix(".gz")] = gzip.decompress(path.read_bytes())
    paths = download("handovers", tmp_path, url=server.url, patience=0.0)
    assert len(paths) == 27
    assert all(path.read_text().startswith("x,y,z,q0,q1,q2,q3\n") for path in paths)


# Models, which may come in an archive

NETWORK = np.random.default_rng(1).bytes(200_000)


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

    def remote(name: str, content: bytes) -> RemoteFile:
        return RemoteFile(name, f"sha256:{hashlib.sha256(content).hexdigest()}", len(content))

    archive = server.files["net.zip"] = archive_of(end2end=NETWORK)
    files = (remote("net.zip", archive),)
    public = PublicSet("net", "a network", "MIT", "home", server.url, files, remote("net.onnx", NETWORK))
    monkeypatch.setattr(remote_file, "public_sets", lambda: {"net": public})


@pytest.mark.usefixtures("known")
def test_a_model_comes_out_of_its_archive_and_is_fetched_once(server: Server, tmp_path: Path) -> None:
    (path,) = download("net", tmp_path, patience=0.0)
    assert (path.read_bytes(), everything_in(tmp_path)) == (NETWORK, {"net.onnx"})
    assert download("net", tmp_path, patience=0.0) == [path]
    assert server.requests == [("net.zip", None)]


@pytest.mark.usefixtures("known")
def test_another_file_of_the_same_size_is_refused(server: Server, tmp_path: Path) -> None:
    server.files["net.zip"] = server.files["net.zip"][:-1] + b"?"
    with pytest.raises(DownloadError, match="checksum"):
        download("net", tmp_path, patience=0.0)
    assert everything_in(tmp_path) == set()


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
