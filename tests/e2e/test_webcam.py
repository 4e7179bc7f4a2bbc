"""`kinecast live --source camera:` with the real network: a photograph that moves, and what can go wrong."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.cameras.pinhole import Intrinsics, PinholeCamera, level_pose
from kinecast.live import mcap_file

Kinecast = Callable[..., Any]
ZERO_VELOCITY = Path(__file__).resolve().parents[2] / "src" / "kinecast" / "data" / "models" / "zero_velocity.npz"
SIZE, RATE, PICTURES = 480, 30.0, 48
FOCAL = SIZE / 2 / np.tan(np.radians(60.0) / 2)
CAMERA = PinholeCamera("c", Intrinsics(SIZE, SIZE, FOCAL, FOCAL, (SIZE - 1) / 2, (SIZE - 1) / 2), level_pose(1.4))


def view_of(stamp: float) -> np.ndarray:
    """(2, 3) from pixels of the photograph to pixels of the video: panned by 30 px in 2 s, scaled by 5 %."""
    scale = 1.05 * (1 + 0.05 * np.sin(2 * np.pi * stamp / 5))
    shift = 30 * np.sin(2 * np.pi * stamp / 2)
    return np.array([[scale, 0, SIZE / 2 + 10 + shift - 256 * scale], [0, scale, SIZE + 30 - 512 * scale]])


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A video of scikit-image's photographer (CC0), whose two arms are seen."""
    from skimage import data

    photograph, rng = np.repeat(data.camera()[..., None], 3, axis=2), np.random.default_rng(0)
    path = tmp_path_factory.mktemp("videos") / "take.mp4"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), RATE, (SIZE, SIZE))
    for k in range(PICTURES):
        picture = cv2.warpAffine(photograph, view_of(k / RATE), (SIZE, SIZE), borderMode=cv2.BORDER_REPLICATE)
        writer.write(np.clip(picture + rng.normal(0, 3, picture.shape), 0, 255).astype(np.uint8))
    writer.release()
    return path


@pytest.fixture
def live(kinecast: Kinecast, model_root: Path, monkeypatch: pytest.MonkeyPatch) -> Kinecast:
    """live("--source", …) → Outcome, with the real network."""
    monkeypatch.setenv("KINECAST_MODELS", str(model_root))
    return lambda *options: kinecast("live", "--model", ZERO_VELOCITY, "--samples", 50, *options)


def test_a_moving_photograph_is_predicted_recorded_and_drawn(live: Kinecast, take: Path, tmp_path: Path) -> None:
    for attempt, speed in enumerate((0.5, 0.1, 0.02)):  # a busy machine skips pictures: then it plays slower
        out = tmp_path / str(attempt)
        out.mkdir()
        source = f"camera:{take}?fov=60&height=1.4&body=1.75&speed={speed}"
        sinks = ("--sink", f"mcap:{out / 'live.mcap'}", "--sink", f"jsonl:{out / 'live.jsonl'}")
        outcome = live("--source", source, *sinks, "--record", out / "film.mp4")
        assert outcome.code == 0, outcome.err
        assert sorted(path.name for path in out.iterdir()) == ["film.mp4", "live.jsonl", "live.mcap"]
        lines = [json.loads(line) for line in (out / "live.jsonl").read_text().splitlines()]
        assert {line["person"] for line in lines} <= {"0"}
        if len(lines) >= 15:
            break
    assert len(lines) >= 15
    _check_wrists(lines)
    recordings = mcap_file.load(out / "live.mcap")
    assert sum(len(each.stamps) for each in recordings) == len(lines)
    _check_film(out / "film.mp4", take)


def _check_wrists(lines: list[dict[str, Any]]) -> None:
    """They follow a point of the photograph within 12 px, 2.5 % of the picture, and its motion by 60 to 140 %."""
    stamps = np.array([line["stamp"] for line in lines])
    assert set(np.round(stamps * RATE, 2) % 1) <= {0.0}  # the video's own time
    observed = np.array([line["observed"] for line in lines], dtype=np.float64)
    views = np.array([view_of(stamp) for stamp in stamps])
    for joint in ("left_wrist", "right_wrist"):
        points = observed[:, ARM_JOINTS.index(joint)]
        settled = np.isfinite(points).all(axis=1) & (stamps > 0.3)
        assert settled.mean() > 0.6
        settled &= np.diff(stamps, prepend=-1.0) < 1.5 / RATE  # where none was skipped: it smooths more then
        assert settled.sum() >= 8
        pixels = CAMERA.project(points[settled])[0]
        of_photograph = (pixels - views[settled, :, 2]) / views[settled, :1, 0]
        expected = np.median(of_photograph, axis=0) * views[settled, :1, 0] + views[settled, :, 2]
        assert np.sqrt(((pixels - expected) ** 2).mean(axis=0)).max() < 12.0
        slope = np.polyfit(expected[:, 0], pixels[:, 0], 1)[0]
        assert 0.6 < slope < 1.4
        assert 0.4 < points[settled, 1].mean() < 2.0  # how far away a man of 1.75 m is who fills the picture


def _check_film(film: Path, take: Path) -> None:
    """As long as the video, with the skeleton's white in it."""
    captures = cv2.VideoCapture(str(film)), cv2.VideoCapture(str(take))
    counts = [int(each.get(cv2.CAP_PROP_FRAME_COUNT)) for each in captures]
    assert PICTURES - 15 <= counts[0] <= counts[1] == PICTURES
    for capture in captures:
        capture.set(cv2.CAP_PROP_POS_FRAMES, counts[0] - 1)
    drawn, plain = (capture.read()[1].astype(int) for capture in captures)
    assert (np.abs(drawn - plain).max(axis=2) > 60).mean() > 0.005


def test_what_shows_nobody_says_so(live: Kinecast, tmp_path: Path) -> None:
    for k in range(5):
        cv2.imwrite(str(tmp_path / f"{k}.png"), np.full((120, 160, 3), 90, dtype=np.uint8))
    (tmp_path / "bad.png").write_bytes(b"no picture")
    out = tmp_path / "out"
    out.mkdir()
    outcome = live("--source", f"camera:{tmp_path}", "--sink", f"jsonl:{out / 'a.jsonl'}", "--record", out / "a.mp4")
    assert outcome.code == 0
    said = outcome.out + outcome.err
    assert "nobody was seen in" in said
    assert (out / "a.jsonl").read_text() == ""
    assert (out / "a.mp4").is_file()


@pytest.mark.parametrize(
    ("source", "why"),
    [
        ("camera:73", "no camera 73 is there, or another program uses it"),
        ("camera:{}/gone.mp4", "no such file or folder"),
        ("camera:{}/corrupt.mp4", "is no video with a picture that can be read"),
        ("camera:0?tilt=100", "tilt '100', expected -90..90"),
        ("camera:0?feet=floor", "feet=floor needs the camera's height="),
        ("camera:0?body=1.8&feet=floor&height=2", "give one"),
        ("camera:0?size=big", "expected a size such as 640x480"),
        ("camera:0?colour=red", "colour unknown; allowed are model, people"),
        ("camera:0?camera=left", "a camera needs --rig"),
        ("camera:{}/corrupt.mp4?model={}/corrupt.mp4", "is no video"),
    ],
)
def test_what_is_wrong_is_one_line_and_leaves_nothing(live: Kinecast, source: str, why: str, tmp_path: Path) -> None:
    (tmp_path / "corrupt.mp4").write_bytes(b"\x00\x00\x00\x18ftypmp42" + bytes(2000))
    sink, film = f"jsonl:{tmp_path / 'a.jsonl'}", tmp_path / "a.mp4"
    outcome = live("--source", source.replace("{}", str(tmp_path)), "--sink", sink, "--record", film)
    assert outcome.code == 2
    assert why in outcome.err
    assert outcome.err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["corrupt.mp4"]


def test_a_missing_model_says_the_command_and_a_bad_one_is_named(
    kinecast: Kinecast, take: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("KINECAST_MODELS", str(tmp_path))
    options = ("--model", ZERO_VELOCITY, "--sink", f"jsonl:{tmp_path / 'a.jsonl'}")
    outcome = kinecast("live", "--source", f"camera:{take}", *options)
    assert outcome.code == 2
    assert outcome.err.endswith("fetch it once with: kinecast download pose-landmarker\n")
    (tmp_path / "pose_landmarker_full.task").write_bytes(b"PK\x05\x06" + bytes(18))
    outcome = kinecast("live", "--source", f"camera:{take}", *options)
    assert outcome.code == 2
    assert "pose_landmarker_full.task: is no PoseLandmarker model" in outcome.err
    assert outcome.err.count("\n") == 1
    assert not (tmp_path / "a.jsonl").exists()


@pytest.mark.parametrize("display", ["", ":0"])
def test_a_camera_alone_opens_the_view_and_a_browser_where_there_is_a_screen(
    display: str, live: Kinecast, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[str] = []
    monkeypatch.setattr("webbrowser.open", shown.append)
    monkeypatch.setattr("kinecast.cli.endpoint._DEFAULT_PORTS", {"view": 0})
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setenv("DISPLAY", display)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    cv2.imwrite(str(tmp_path / "0.png"), np.full((120, 160, 3), 90, dtype=np.uint8))
    outcome = live("--source", f"camera:{tmp_path}")
    assert outcome.code == 0
    address = outcome.out.split("sink: ")[1].split()[0]
    assert shown == ([address] if display else [])


def test_a_film_is_of_one_camera(kinecast: Kinecast, tables: tuple[Path, Path], tmp_path: Path) -> None:
    outcome = kinecast("live", "--source", tables[0], "--record", tmp_path / "a.mp4")
    assert (outcome.code, outcome.err.count("\n")) == (2, 1)
    assert "records one --source camera:, and there are 0" in outcome.err
