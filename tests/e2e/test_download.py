"""`kinecast download` against a server on loopback."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ..conftest import Server

Kinecast = Callable[..., Any]

MOTION = b"whatever the record lists"


def test_lists_the_sets_with_their_licences(kinecast: Kinecast) -> None:
    outcome = kinecast("download")
    assert outcome.code == 0
    sets = ("human-robot-animations", "human-assembly-data", "handovers", "andy")
    models = ("pose-landmarker", "rtmpose-m", "yolox-m")
    for name in (*sets, *models):
        assert f"{name}\n  " in outcome.out
    assert outcome.out.count("licence: ") == len(sets) + len(models)


def test_a_models_licence_is_printed_and_what_is_not_that_model_leaves_nothing(
    kinecast: Kinecast, server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    server.files["pose_landmarker_full.task"] = bytes(9_398_198)
    monkeypatch.setenv("KINECAST_MODELS", str(tmp_path / "cache"))
    outcome = kinecast("download", "pose-landmarker", "--url", server.url)
    assert "licence: Apache License 2.0, The MediaPipe Authors" in outcome.out
    assert outcome.code == 2
    assert outcome.err.startswith("kinecast: pose_landmarker_full.task: ")
    assert outcome.err.count("\n") == 1
    assert not list((tmp_path / "cache").rglob("*.task"))


def test_a_whole_record(kinecast: Kinecast, server: Server, tmp_path: Path) -> None:
    server.record(**{"walk.mvnx": MOTION})
    outcome = kinecast("download", "andy", "--url", server.url + "record", "--out", tmp_path / "recordings")
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out == f"1 file in {tmp_path / 'recordings' / 'andy'}\n"
    assert (tmp_path / "recordings" / "andy" / "walk.mvnx").read_bytes() == MOTION


def test_a_wrong_checksum_leaves_nothing(kinecast: Kinecast, server: Server, tmp_path: Path) -> None:
    server.record(**{"walk.mvnx": MOTION})
    server.files["files/walk.mvnx"] = MOTION[::-1]
    outcome = kinecast("download", "andy", "--url", server.url + "record", "--out", tmp_path / "recordings")
    assert outcome.code == 2
    assert outcome.err.startswith("kinecast: walk.mvnx: ")
    assert "checksum" in outcome.err
    assert outcome.err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_what_is_downloaded_can_be_used(kinecast: Kinecast, server: Server, data_root: Path, tmp_path: Path) -> None:
    name = "Task1/Human1/trial1.txt"
    server.files[name] = gzip.decompress((data_root / "human_assembly_data" / f"{name}.gz").read_bytes())
    out = tmp_path / "recordings"
    assert kinecast("download", "human-assembly-data", "--only", name, "--url", server.url, "--out", out).code == 0
    assert kinecast("info", out).out.startswith("Task1/Human1/trial1: lego, 925 frames")
