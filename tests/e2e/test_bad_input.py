"""Bad input: exit code 2, one line that names the file and the place, and nothing written."""

from __future__ import annotations

import json
import lzma
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.datasets import table
from kinecast.datasets.loading import load

Kinecast = Callable[..., Any]

LEGO = ("left_wrist", "right_wrist", "left_elbow", "right_elbow", "left_shoulder", "right_shoulder")
"""Columns of a LEGO file, three each: an easy format to get wrong by hand."""


@pytest.fixture(scope="session")
def numbers(tables: tuple[Path, Path]) -> np.ndarray:
    """(60, 18) the first person's arms as a LEGO file has them: x right, y down, z forward [m]."""
    (recording,) = load(tables[0])
    columns = [recording.joint(name)[:60, [0, 2, 1]] * [1, -1, 1] for name in LEGO]
    positions = np.concatenate(columns, axis=1)
    return positions[np.isfinite(positions).all(axis=1)]


def text_of(numbers: np.ndarray, separator: str = " ") -> list[str]:
    """Lines of numbers."""
    return [separator.join(f"{value:.6f}" for value in row) for row in numbers]


def refused(outcome: Any, *parts: object) -> None:
    """Exit code 2 and one line with these parts in this order."""
    assert outcome.code == 2
    assert outcome.out == ""
    assert outcome.err.startswith("kinecast: ")
    assert outcome.err.count("\n") == 1
    place = 0
    for part in map(str, parts):
        assert part in outcome.err[place:], (part, outcome.err)
        place = outcome.err.index(part, place) + len(part)


# Recordings


def damaged_number(numbers: np.ndarray) -> list[str]:
    """Lines, with a letter in the fourth column of the eleventh."""
    text = text_of(numbers)
    cells = text[10].split()
    return [*text[:10], " ".join([*cells[:3], "o.5", *cells[4:]]), *text[11:]]


def armless(numbers: np.ndarray) -> list[str]:
    """A table without the right elbow."""
    joints = [name for name in LEGO if name != "right_elbow"]
    return [
        "stamp,person,joint,x,y,z",
        *(f"{k / 30:.4f},0,{name},0,0,1" for k in range(len(numbers)) for name in joints),
    ]


BROKEN_RECORDINGS: dict[str, tuple[str, Callable[[np.ndarray], bytes | list[str]], tuple[str, ...]]] = {
    "an empty file": ("a.txt", lambda _: b"", ("empty file",)),
    "half an xz file": (
        "a.txt.xz",
        lambda numbers: lzma.compress("\n".join(text_of(numbers)).encode())[:1000],
        ("truncated or damaged",),
    ),
    "text in a number": ("a.txt", damaged_number, ("line 11", "column 4", "'o.5'")),
    "millimetres": ("a.txt", lambda numbers: text_of(1000 * numbers), ("elbow is", "millimetres")),
    "no right elbow": ("a.csv", armless, ("right_elbow",)),
    "no recording at all": ("a.md", lambda _: b"Dear reader,\n", ("formats tried",)),
}
"""What is wrong → file name, content, and what must be said of it; every format's are in tests/unit/datasets."""


@pytest.mark.parametrize("problem", BROKEN_RECORDINGS)
def test_broken_recordings_are_refused(kinecast: Kinecast, numbers: np.ndarray, tmp_path: Path, problem: str) -> None:
    name, write, parts = BROKEN_RECORDINGS[problem]
    content = write(numbers)
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / name).write_bytes(content if isinstance(content, bytes) else "\n".join(content).encode())
    commands = (
        ("info", tmp_path / "in" / name),
        ("train", tmp_path / "in", "--method", "zero_velocity", "--out", tmp_path / "model.npz"),
        ("predict", tmp_path / "in" / name, "--out", tmp_path / "predictions.csv"),
    )
    for command in commands[: 1 if name == "a.md" else 3]:
        refused(kinecast(*command), name, *parts)
    assert [path.name for path in tmp_path.iterdir()] == ["in"]
    assert [path.name for path in (tmp_path / "in").iterdir()] == [name]


def test_one_broken_file_among_good_ones_is_named(
    kinecast: Kinecast, tables: tuple[Path, Path], tmp_path: Path
) -> None:
    (tmp_path / "broken.parquet").write_bytes(tables[0].read_bytes()[:5000])
    refused(kinecast("info", tables[0], tmp_path / "broken.parquet", tables[1]), tmp_path / "broken.parquet", "damaged")


def test_missing_paths_are_named(kinecast: Kinecast, tables: tuple[Path, Path], tmp_path: Path) -> None:
    missing = tmp_path / "missing.parquet"
    out = ("--out", tmp_path / "results")
    refused(kinecast("info", missing), missing, "no such file")
    refused(kinecast("evaluate", "--train", missing, "--test", tables[0], *out), missing, "no such file")
    refused(kinecast("evaluate", "--train", tables[0], "--test", missing, *out), missing, "no such file")
    refused(kinecast("info"), "no recording given")
    refused(kinecast("evaluate", "--train", tables[0], "--test", *out), "--test: no recording given")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_of_several_recordings_is_too_much_for_predict(
    kinecast: Kinecast, tables: tuple[Path, Path], model: Path, tmp_path: Path
) -> None:
    outcome = kinecast("predict", tables[0].parent, "--model", model, "--out", tmp_path / "a.csv")
    refused(outcome, tables[0].parent, "2 recordings (synthetic/pick_and_place/0-0", "takes one")
    assert list(tmp_path.iterdir()) == []


def test_testing_on_what_was_trained_on_is_refused(
    kinecast: Kinecast, tables: tuple[Path, Path], tmp_path: Path
) -> None:
    """Also under another name and in another format."""
    copy = tmp_path / "copy.csv"
    table.write(copy, load(tables[0]))
    for train in (tables[0], copy):
        outcome = kinecast("evaluate", "--train", train, "--test", tables[0], "--out", tmp_path / "results")
        refused(outcome, "every training recording is also a test recording", "synthetic/pick_and_place/0-0")
    assert list(tmp_path.iterdir()) == [copy]


# Options


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (("--rate", 0), ("rate is 0.0 Hz", "1 to 1000 Hz")),
        (("--rate", "nan"), ("rate is nan Hz",)),
        (("--horizon", 1000), ("horizon is 1000.0 s", "to 10 s")),
        (("--horizon", 10, "--rate", 1000), ("horizon is 10.0 s", "0.3 s at 1000 Hz", "300 frames")),
        (("--horizon", -0.5), ("horizon is -0.5 s",)),
        (("--horizon", 4.9), ("no window of 5.1 s",)),
        (("--window", 0.01), ("window is 0.01 s", "2 to 300 frames")),
        (("--stride", 0), ("stride is 0 frames",)),
        (("--samples", 0), ("samples 0",)),
        (("--samples", 10**9), ("samples 1000000000", "100000")),
        (("--repeats", -1), ("repeats -1",)),
        (("--seed", -1), ("seed is -1",)),
        (("--methods", "ridge,magic"), ("unknown method magic", "zero_velocity")),
        (("--methods", " , "), ("unknown method (none)",)),
        (("--label", "Zz"), ("'Zz' does not occur", "Ca, Id, Pi, Pl, Re")),
        (("--format", "c3d"), ("'c3d'", "vicon")),
        (("--scene", "nowhere.yaml"), ("nowhere.yaml", "no such file")),
        (("--model", "some.npz"), ("either --train", "or --model")),
    ],
)
def test_options_out_of_range_are_refused(
    kinecast: Kinecast,
    tables: tuple[Path, Path],
    tmp_path: Path,
    options: tuple[object, ...],
    parts: tuple[str, ...],
) -> None:
    common = ("evaluate", "--train", tables[0], "--test", tables[1], "--out", tmp_path / "results")
    methods = () if "--methods" in options else ("--methods", "zero_velocity")
    refused(kinecast(*common, *methods, *options), *parts)
    assert list(tmp_path.iterdir()) == []


def test_a_wrong_command_line_is_refused(kinecast: Kinecast, tables: tuple[Path, Path], tmp_path: Path) -> None:
    out = ("--out", tmp_path / "results")
    for arguments in (
        (),
        ("guess",),
        ("evaluate", "--test", tables[0]),
        ("evaluate", "--train", tables[0], "--test", tables[1], *out, "--stride", "five"),
        ("evaluate", "--train", tables[0], "--test", tables[1], *out, "--speed", "5"),
    ):
        outcome = kinecast(*arguments)
        assert outcome.code == 2
        assert outcome.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", ("expected entries", "None")),
        ("table: {hight: 0.9}", ("table", "'hight'", "height")),
        ("table: {height: 900}", ("table.height", "900", "metres")),
        ("table: {height: 0.9\nboxes: [", ("line", "not valid YAML")),
        ("boxes:\n  - {center: [0, 0, 1], size: [1, 1, -1]}", ("boxes[0]", "size")),
    ],
)
def test_broken_scenes_are_refused(
    kinecast: Kinecast, tables: tuple[Path, Path], model: Path, tmp_path: Path, text: str, parts: tuple[str, ...]
) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text(text)
    for command in (
        ("train", tables[0], "--out", tmp_path / "model.npz"),
        ("evaluate", "--model", model, "--test", tables[1], "--out", tmp_path / "results"),
        ("predict", tables[1], "--model", model, "--out", tmp_path / "a.parquet"),
    ):
        refused(kinecast(*command, "--scene", scene), scene, *parts)
    assert list(tmp_path.iterdir()) == [scene]


def test_a_scene_in_another_frame_is_suspected(kinecast: Kinecast, tables: tuple[Path, Path], tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text("table: {height: 3.0}")
    outcome = kinecast("train", tables[0], "--scene", scene, "--out", tmp_path / "model.npz")
    refused(outcome, "training windows end inside an obstacle", "frame?")


# Models


class Bomb:
    """Makes a folder when unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[[str], None], tuple[str]]:
        return os.mkdir, (str(self.path),)


def changed(model: Path, **entries: object) -> dict[str, Any]:
    """Arrays of a model with entries of its card changed."""
    with np.load(model) as file:
        arrays = dict(file)
    card = json.loads(arrays["card"].tobytes()) | entries
    return {**arrays, "card": np.frombuffer(json.dumps(card).encode(), np.uint8)}


BROKEN_MODELS: dict[str, tuple[Callable[[Path], bytes | dict[str, Any]], tuple[str, ...]]] = {
    "an empty file": (lambda _: b"", ("not a readable model",)),
    "no npz": (lambda _: b"model", ("not a readable model",)),
    "half a model": (lambda model: model.read_bytes()[:3000], ("not a readable model",)),
    "a foreign npz": (lambda _: {"a": np.ones(3)}, ("not a kinecast model",)),
    "a pickle": (
        lambda model: {"card": np.array([Bomb(model.parent / "exploded")], dtype=object)},
        ("not a readable model", "pickle"),
    ),
    "another skeleton": (lambda model: changed(model, joints=["left_hip", *ARM_JOINTS[1:]]), ("left_hip", "predicts")),
    "another version": (lambda model: changed(model, version=99), ("version 99",)),
    "an unknown method": (lambda model: changed(model, method="magic"), ("'magic'",)),
    "arrays of another size": (lambda model: changed(model, frames=4), ("arrays do not fit",)),
    "no finite numbers": (lambda model: {**changed(model), "extra": np.array([np.nan])}, ("extra", "finite numbers")),
}
"""What is wrong → content made from a good model, and what must be said of it."""


@pytest.mark.parametrize("problem", ["no file", *BROKEN_MODELS])
def test_broken_models_are_refused(
    kinecast: Kinecast, tables: tuple[Path, Path], model: Path, tmp_path: Path, problem: str
) -> None:
    path = tmp_path / "model.npz"
    make, parts = BROKEN_MODELS.get(problem, (None, ("No such file",)))
    if make is not None:
        content = make(model)
        path.write_bytes(content) if isinstance(content, bytes) else np.savez(path, **content)
    there = list(tmp_path.iterdir())
    outcome = kinecast("evaluate", "--model", path, "--test", tables[1], "--out", tmp_path / "results")
    refused(outcome, path, *parts)
    refused(kinecast("predict", tables[1], "--model", path, "--out", tmp_path / "a.csv"), path, *parts)
    assert list(tmp_path.iterdir()) == there
    assert not (model.parent / "exploded").exists()


def test_a_model_for_another_rate_is_refused(
    kinecast: Kinecast, tables: tuple[Path, Path], model: Path, tmp_path: Path
) -> None:
    common = ("evaluate", "--test", tables[1], "--out", tmp_path / "results")
    outcome = kinecast(*common, "--model", model, "--rate", 15)
    refused(outcome, model, "6 frames seen and 15 predicted at 30 Hz, not 3 frames seen and 8 predicted at 15 Hz")
    slow = tmp_path / "slow.npz"
    kinecast("train", tables[0], "--method", "zero_velocity", "--rate", 15, "--out", slow)
    refused(kinecast(*common, "--model", model, slow), slow, "3 frames seen and 8 predicted at 15 Hz, not 6")
    refused(kinecast(*common, "--model", model, "--methods", "ridge"), "--methods goes with --train")
    assert list(tmp_path.iterdir()) == [slow]


# Where results go


def test_places_where_nothing_can_be_written_are_refused_first(
    kinecast: Kinecast, tables: tuple[Path, Path], model: Path, tmp_path: Path
) -> None:
    taken = tmp_path / "taken"
    taken.touch()
    evaluate = ("evaluate", "--model", model, "--test", tables[1], "--out")
    train, predict = ("train", tables[0], "--out"), ("predict", tables[1], "--model", model, "--out")
    for command, out, part in (
        (train, tmp_path / "model.txt", "must end in .npz"),
        (train, tmp_path / "nowhere" / "model.npz", "there is no folder"),
        (train, taken / "model.npz", "there is no folder"),
        (predict, tmp_path / "a.xlsx", "must end in .parquet or .csv"),
        (predict, tmp_path / "nowhere" / "a.csv", "there is no folder"),
        (evaluate, taken, "is a file, not a folder"),
        (evaluate, taken / "results", "is a file, not a folder"),
        (("download", "handovers", "--out"), taken, "is a file, not a folder"),
    ):
        refused(kinecast(*command, out), f"--out {out}", part)
    assert list(tmp_path.iterdir()) == [taken]


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs a folder that even root cannot write in")
def test_folders_that_are_not_writable_are_refused_first(
    kinecast: Kinecast, tables: tuple[Path, Path], model: Path
) -> None:
    outcome = kinecast("evaluate", "--model", model, "--test", tables[1], "--out", "/proc/results")
    refused(outcome, "--out /proc/results", "nothing can be written in /proc")
    outcome = kinecast("train", tables[0], "--method", "zero_velocity", "--out", "/proc/model.npz")
    refused(outcome, "--out /proc/model.npz", "nothing can be written in /proc")


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (OSError(28, "No space left on device"), "kinecast: [Errno 28] No space left on device\n"),
        (MemoryError(), "kinecast: out of memory: "),
        (KeyboardInterrupt(), None),
    ],
)
def test_trouble_while_writing_leaves_nothing(
    kinecast: Kinecast,
    tables: tuple[Path, Path],
    model: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    error: BaseException,
    message: str | None,
) -> None:
    from kinecast.evaluation import report

    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(report, "draw_prediction", fail)
    out = tmp_path / "new" / "results"
    command = ("evaluate", "--model", model, "--test", tables[1], "--stride", 100, "--samples", 20, "--repeats", 0)
    if message is None:  # then it is the process's (test_ctrl_c.py)
        with pytest.raises(KeyboardInterrupt):
            kinecast(*command, "--out", out)
    else:
        outcome = kinecast(*command, "--out", out)
        assert outcome.code == 2
        # A note that something is compiled may come first, on a machine where it has not been.
        assert outcome.err.splitlines(keepends=True)[-1].startswith(message)
    assert list(tmp_path.iterdir()) == []


def test_a_failed_download_leaves_no_folder(kinecast: Kinecast, tmp_path: Path) -> None:
    refused(kinecast("download", "everything", "--out", tmp_path / "new"), "no public set 'everything'")
    outcome = kinecast("download", "handovers", "--only", "*.exe", "--out", tmp_path / "new")
    refused(outcome, "handovers: no file matches '*.exe'")
    assert list(tmp_path.iterdir()) == []


# In a process of their own


def test_a_two_gigabyte_file_needs_little_memory(numbers: np.ndarray, model: Path, tmp_path: Path) -> None:
    """As recording, as model and as scene; nothing of it is on the disk."""
    head = {
        "a.txt": "\n".join(text_of(numbers)).encode(),
        "a.parquet": b"PAR1",
        "a.npz": model.read_bytes(),
        "a.yaml": b"table: {height: 0.9}\n",
    }
    for name, content in head.items():
        with (tmp_path / name).open("wb") as file:
            file.write(content)
            file.truncate(2 * 10**9)
    (tmp_path / "fine.txt").write_bytes(head["a.txt"])
    script = """
import resource
from kinecast.cli.commands import run
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024)
for command in (
    "info a.txt", "info a.parquet", "evaluate --test fine.txt --model a.npz --out out",
    "train fine.txt --scene a.yaml --out b.npz",
):
    try:
        run(command.split())
    except SystemExit as exit_:
        print(exit_.code)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024)
"""
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=True)
    before, *codes, after = done.stdout.split()
    assert codes == ["2"] * 4
    assert [line.split()[1].rstrip(":") for line in done.stderr.splitlines()] == list(head)
    assert int(after) - int(before) < 200  # megabytes
    assert sorted(path.name for path in tmp_path.iterdir()) == [*sorted(head), "fine.txt"]


def test_the_installed_command_ends_with_the_same_codes(numbers: np.ndarray, tmp_path: Path) -> None:
    path = tmp_path / "arms.txt"
    path.write_text("\n".join(text_of(1000 * numbers)))
    command = Path(sys.executable).with_name("kinecast")
    done = subprocess.run([command, "info", path], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(f"kinecast: {path}: left_shoulder to left_elbow is ")
    assert done.stderr.endswith("; the file seems to be in millimetres\n")
