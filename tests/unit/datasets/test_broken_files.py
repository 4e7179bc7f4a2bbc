"""Files with random damage: every format either loads them or says DatasetError, and nothing else."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kinecast.body.skeleton import ARM_JOINTS, HA4M_UPPER_23, KTH_13, LEGO_6
from kinecast.datasets import table
from kinecast.datasets.loading import load
from kinecast.datasets.recording import Recording
from kinecast.errors import DatasetError

DAMAGES = 40


@pytest.fixture
def files(
    tmp_path: Path,
    motion: Callable[..., np.ndarray],
    vicon_text: Callable[..., str],
    mvnx_text: Callable[..., str],
    write_ha4m: Callable[..., np.ndarray],
) -> dict[str, tuple[Path, Path]]:
    """For each format, the path to load and the file to damage."""
    recording = Recording("made", ARM_JOINTS, np.arange(8) / 30.0, motion(ARM_JOINTS, 8), 30.0, labels=("a", "b") * 4)
    for suffix in ("parquet", "csv"):
        table.write(tmp_path / f"table.{suffix}", [recording])
    (tmp_path / "vicon").write_text(vicon_text(), encoding="utf-8")
    (tmp_path / "suit.mvnx").write_text(mvnx_text())
    labels = "t_video,current_action_Annotator1,current_action_Annotator2\n0.0,Re,Pi\n0.25,Re,Re\n"
    (tmp_path / "labelled").mkdir()
    (tmp_path / "labelled" / "suit.mvnx").write_text(mvnx_text())
    (tmp_path / "labelled" / "suit.labels.csv").write_text(labels)
    np.savetxt(tmp_path / "lego.txt", motion(LEGO_6.joints, 8).reshape(8, 18), fmt="%.6f")
    (tmp_path / "UpSkel").mkdir()
    np.save(tmp_path / "UpSkel" / "clip.npy", motion(HA4M_UPPER_23.joints, 8).transpose(2, 1, 0).reshape(69, 8))
    (tmp_path / "GroundTruth").mkdir()
    (tmp_path / "GroundTruth" / "clip.txt").write_text("0\n" * 8)
    write_ha4m(tmp_path / "IDU001V001")
    (tmp_path / "IDU001V001" / "Labels.txt").write_text("10 0 0\n11 1 1\n")
    frame = min((tmp_path / "IDU001V001").glob("Skeletons/*/*"))
    (tmp_path / "handover").mkdir()
    for segment, points in zip(KTH_13.aliases, motion(KTH_13.joints, 8).transpose(1, 0, 2), strict=True):
        file = tmp_path / "handover" / f"giver_{segment}_pose_saved.csv"
        np.savetxt(
            file, np.column_stack([points, np.ones((8, 4))]), delimiter=",", header="x,y,z,q0,q1,q2,q3", comments=""
        )
    arms = "".join(
        f"JOINT {side}{part}\n{{\nOFFSET 0 -30 0\nCHANNELS 3 Zrotation Xrotation Yrotation\n{end}"
        for side in ("Left", "Right")
        for part, end in (("Arm", ""), ("ForeArm", ""), ("Hand", "End Site\n{\nOFFSET 0 -5 0\n}\n}\n}\n}\n"))
    )
    values = "\n".join(" ".join(f"{10 * row + column}" for column in range(21)) for row in range(4))
    (tmp_path / "walk.bvh").write_text(
        "HIERARCHY\nROOT Hips\n{\nOFFSET 0 0 0\nCHANNELS 3 Xposition Yposition Zposition\n"
        f"{arms}}}\nMOTION\nFrames: 4\nFrame Time: 0.1\n{values}\n"
    )
    same = {
        "parquet": tmp_path / "table.parquet",
        "csv": tmp_path / "table.csv",
        "vicon": tmp_path / "vicon",
        "mvnx": tmp_path / "suit.mvnx",
        "lego": tmp_path / "lego.txt",
        "ha4m-features": tmp_path / "UpSkel" / "clip.npy",
        "bvh": tmp_path / "walk.bvh",
    }
    return {name: (path, path) for name, path in same.items()} | {
        "andy": (tmp_path / "labelled" / "suit.mvnx", tmp_path / "labelled" / "suit.labels.csv"),
        "ha4m-features labels": (same["ha4m-features"], tmp_path / "GroundTruth" / "clip.txt"),
        "ha4m": (tmp_path / "IDU001V001", frame),
        "ha4m labels": (tmp_path / "IDU001V001", tmp_path / "IDU001V001" / "Labels.txt"),
        "kth-handover": (tmp_path / "handover", tmp_path / "handover" / "giver_LHand_pose_saved.csv"),
    }


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """The content cut, or with some bytes overwritten, removed or doubled."""
    start, end = sorted(rng.integers(0, len(content) + 1, 2).tolist())
    piece = slice(start, min(end, start + 40))
    match int(rng.integers(5)):
        case 0:
            return content[:start]
        case 1:
            return content[: piece.start] + rng.bytes(piece.stop - piece.start) + content[piece.stop :]
        case 2:
            return content[: piece.start] + content[piece.stop :]
        case 3:
            return content[: piece.stop] + content[piece.start :]
        case _:
            words = (
                b"nan",
                b"inf",
                b"-1",
                b"1e400",
                b"0",
                b"{",
                b"\n",
                b",",
                b"\x00",
                b'"',
                b"<!DOCTYPE a [",
                b"9" * 30,
            )
            return content[:start] + words[int(rng.integers(len(words)))] + content[start:]


FORMATS = (
    "parquet", "csv", "vicon", "mvnx", "lego", "ha4m-features", "bvh", "andy", "ha4m-features labels", "ha4m",
    "ha4m labels", "kth-handover",
)  # fmt: skip


@pytest.mark.parametrize("name", FORMATS)
def test_random_damage_is_a_dataset_error_or_harmless(files: dict[str, tuple[Path, Path]], name: str) -> None:
    path, file = files[name]
    content = file.read_bytes()
    rng = np.random.default_rng(FORMATS.index(name))
    refused = 0
    for _ in range(DAMAGES):
        file.write_bytes(damaged(content, rng))
        try:
            recordings = load(path)
        except DatasetError:
            refused += 1
        else:
            assert all(np.isfinite(recording.stamps).all() for recording in recordings)
    assert refused > 0
