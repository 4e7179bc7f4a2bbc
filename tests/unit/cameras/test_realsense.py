"""Depths of keypoints, and a rendered person through librealsense's software device, a recording and the source."""

from __future__ import annotations

import json
import logging
import re
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import cv2
import numpy as np
import pytest

from kinecast.body.skeleton import ARM_JOINTS, COCO_17
from kinecast.cameras import realsense
from kinecast.cameras.depth import DepthImage, lifted, stereo_noise
from kinecast.cameras.fused_source import FusedSource
from kinecast.cameras.fusion.measurement import skin_depths
from kinecast.cameras.pinhole import Intrinsics, PinholeCamera, level_pose
from kinecast.cameras.realsense import (
    RealSenseOptions,
    RealSenseSource,
    RealSenseStream,
    intrinsics_of,
    rs,
)
from kinecast.cameras.rig import Rig
from kinecast.cli import main
from kinecast.cli.commands import run
from kinecast.errors import ModelError, OptionError
from kinecast.geometry.transforms import apply, inverse
from kinecast.live.detection import Detection
from kinecast.live.mailbox import Mailbox
from kinecast.live.settings import read_settings
from kinecast.types import SkeletonFrame

MODEL = Path(__file__).resolve().parents[3] / "src" / "kinecast" / "data" / "models" / "zero_velocity.npz"
BODY = np.array(
    [(0.0, 2.4, 1.62), (0.03, 2.4, 1.65), (-0.03, 2.4, 1.65), (0.08, 2.5, 1.62), (-0.08, 2.5, 1.62), (0.19, 2.5, 1.40),
     (-0.19, 2.5, 1.40), (0.26, 2.45, 1.12), (-0.28, 2.5, 1.12), (0.22, 2.2, 1.00), (-0.45, 2.4, 1.25),
     (0.1, 2.5, 0.92), (-0.1, 2.5, 0.92), (0.11, 2.5, 0.5), (-0.11, 2.5, 0.5), (0.11, 2.55, 0.1), (-0.11, 2.55, 0.1)]
)  # fmt: skip
"""COCO's 17 in the world [m], of somebody 2.4 m in front of a camera at the origin, who faces it."""
BONES = ((5, 7), (7, 9), (6, 8), (8, 10), (5, 6), (5, 11), (6, 12), (11, 12), (11, 13), (13, 15), (12, 14), (14, 16),
         (0, 5), (0, 6), (3, 4))  # fmt: skip
SKIN = skin_depths(COCO_17.joints)
WALL = 3.6
LONG = 120.0
"""Longest wait for anything [s]."""
SIZE = (640, 480)
HEIGHT, TILT = 1.3, 4.0
COLOUR = Intrinsics(*SIZE, 430.0, 430.0, 322.0, 238.0)
DEPTH = Intrinsics(*SIZE, 385.0, 385.0, 319.0, 241.0)
BETWEEN = 0.015
"""The colour camera is so far to the right of the depth camera [m]."""


def drawn_depth(points: np.ndarray, intrinsics: Intrinsics, unit: float = 0.001) -> np.ndarray:
    """(h, w) a wall, and in front of it the skin of a person's limbs: (17, 3) joints in the camera's axes."""
    image = np.full((intrinsics.height, intrinsics.width), round(WALL / unit), np.uint16)
    share = np.linspace(0, 1, 25)[:, None]
    limbs = [
        np.hstack([points[a] * (1 - share) + points[b] * share, SKIN[a] * (1 - share) + SKIN[b] * share])
        for a, b in BONES
    ]
    for x, y, z, skin in sorted(np.vstack([*limbs, np.column_stack([points, SKIN])]), key=lambda each: -each[2]):
        place = (16 * intrinsics.pixels(np.array([x / z, y / z]))).round().astype(int).tolist()
        radius = round(16 * intrinsics.fx * max(skin, 0.02) / z)
        cv2.circle(image, place, radius, round((z - skin) / unit), cv2.FILLED, shift=4)
    return image


def image_of(depth: np.ndarray, focal: float = COLOUR.fx) -> DepthImage:
    return DepthImage(depth, 0.001, focal, stereo_noise())


# Depths


def test_depth_noise_is_that_of_a_calibrated_d435() -> None:
    np.testing.assert_allclose(stereo_noise() * np.array([1.0, 4.0]), [0.0038, 0.0151], atol=1e-4)


def test_the_limb_counts_and_not_what_is_behind_nor_a_hole_nor_a_speck() -> None:
    rng = np.random.default_rng(0)
    depth = np.full((200, 200), 3500.0)
    depth[:, 90:100] = 2000.0  # a wrist, 10 px wide
    depth[50:, 93:96] = 0.0  # with a hole along it
    depth[100, 100] = 700.0  # and a speck in the air
    noisy = np.where(depth > 0, depth + rng.normal(0, 15, depth.shape), 0).astype(np.uint16)
    image = image_of(noisy)
    pixels = np.array(
        [(95.0, 30.0), (95.0, 120.0), (99.0, 70.0), (89.0, 70.0), (99.0, 100.0), (np.nan, 3.0), (5e6, 1.0)]
    )
    depths, std = image.at(pixels)
    np.testing.assert_allclose(depths[:5], 2.0, atol=0.02)
    assert np.isnan(depths[5:]).all()
    assert ((std[:5] >= 0.0037 * 1.95**2) & (std[:5] < 0.035)).all()
    nothing, _ = image_of(np.zeros((50, 50), np.uint16)).at(np.full((3, 2), 25.0))
    assert np.isnan(nothing).all()


def test_what_is_far_from_the_others_is_not_theirs() -> None:
    depth = np.full((100, 100), 2000, np.uint16)
    depth[:, 80:] = 3500
    depths, _ = image_of(depth).at(np.array([(10.0, 50.0), (30.0, 50.0), (50.0, 50.0), (95.0, 50.0)]))
    np.testing.assert_allclose(depths[:3], 2.0)
    assert np.isnan(depths[3])


def test_a_rendered_person_is_lifted_into_the_world() -> None:
    camera = PinholeCamera("front", COLOUR, level_pose(HEIGHT, np.radians(TILT)))
    local = apply(inverse(camera.T_world_camera), BODY)
    pixels, _ = camera.project(BODY)
    depth, depth_std = image_of(drawn_depth(local, COLOUR)).at(pixels)
    confidence = np.where(np.arange(17) == 10, 0.2, 1.0)
    view = Detection(1.0, "front", COCO_17.joints, pixels, np.full(17, 3.0), depth, depth_std, confidence, "7")
    frame = lifted(view, camera)
    assert (frame.stamp, frame.person, frame.frame_id) == (1.0, "7", "world")
    assert np.flatnonzero(~frame.valid).tolist() == [10]  # the network was not sure
    arms = [5, 6, 7, 8, 9]
    np.testing.assert_allclose(frame.positions[arms], BODY[arms], atol=0.055)  # the forearm hides part of the elbow
    assert np.median(np.linalg.norm(frame.positions[arms] - BODY[arms], axis=1)) < 0.02
    assert frame.std is not None
    assert frame.covariance is not None
    along = camera.rays(pixels)[arms]
    deep = np.sqrt(np.einsum("ji,jik,jk->j", along, frame.covariance[arms], along))
    np.testing.assert_allclose(deep, np.hypot(depth_std, 0.015)[arms], rtol=0.15)
    assert ((frame.std[arms] > 0.01) & (frame.std[arms] < 0.05)).all()


def test_a_camera_that_looks_down_stands_upright() -> None:
    T = level_pose(2.0, np.radians(30))
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(apply(T, np.array([0.0, 0.0, 4.0])), [0, 4 * np.cos(np.pi / 6), 0.0], atol=1e-12)
    np.testing.assert_allclose(apply(level_pose(), np.array([1.0, 2.0, 3.0])), [1, 3, -2])


# librealsense


def rs_intrinsics(of: Intrinsics, model: Any = None, coefficients: Sequence[float] = (0.0,) * 5) -> Any:
    found = rs.intrinsics()
    found.width, found.height = of.width, of.height
    found.fx, found.fy, found.ppx, found.ppy = of.fx, of.fy, of.cx, of.cy
    found.model, found.coeffs = model or rs.distortion.none, list(coefficients)
    return found


@pytest.mark.parametrize("name", ["brown_conrady", "inverse_brown_conrady"])
def test_distortion_is_opencvs(name: str) -> None:
    found = rs_intrinsics(COLOUR, getattr(rs.distortion, name), (-0.055, 0.065, -0.0006, 0.0004, -0.021))
    intrinsics = intrinsics_of(found)
    pixels = np.array([(320.0, 240.0), (10.0, 20.0), (600.0, 50.0), (80.0, 460.0), (639.0, 479.0)])
    wanted = [rs.rs2_deproject_pixel_to_point(found, list(pixel), 1.0)[:2] for pixel in pixels]
    np.testing.assert_allclose(intrinsics.directions(pixels), wanted, atol=1.0 / COLOUR.fx)
    np.testing.assert_allclose(intrinsics.directions(pixels)[1:] / wanted[1:], 1.0, atol=3e-3)


def video_stream(kind: Any, number: int, intrinsics: Intrinsics, form: Any, width: int) -> Any:
    stream = rs.video_stream()
    stream.type, stream.index, stream.uid, stream.fps, stream.fmt, stream.bpp = kind, 0, number, 30, form, width
    stream.width, stream.height, stream.intrinsics = *SIZE, rs_intrinsics(intrinsics)
    return stream


def shift(x: float) -> Any:
    extrinsics = rs.extrinsics()
    extrinsics.rotation, extrinsics.translation = np.eye(3).ravel().tolist(), [x, 0.0, 0.0]
    return extrinsics


def record(path: Path, pictures: Sequence[tuple[np.ndarray, np.ndarray]]) -> None:
    """Writes what a software device shows, as librealsense records it."""
    device = rs.software_device()
    device.register_info(rs.camera_info.serial_number, "0")
    device.register_info(rs.camera_info.name, "rendered")
    sensors = [device.add_sensor(name) for name in ("Stereo Module", "RGB Camera")]
    profiles = [
        sensors[0].add_video_stream(video_stream(rs.stream.depth, 0, DEPTH, rs.format.z16, 2), True),
        sensors[1].add_video_stream(video_stream(rs.stream.color, 1, COLOUR, rs.format.rgb8, 3), True),
    ]
    sensors[0].add_read_only_option(rs.option.depth_units, 0.001)
    sensors[0].add_read_only_option(rs.option.stereo_baseline, 50.0)
    profiles[0].register_extrinsics_to(profiles[1], shift(-BETWEEN))
    profiles[1].register_extrinsics_to(profiles[0], shift(BETWEEN))
    recorder = rs.recorder(str(path), device)
    recorded = recorder.query_sensors()
    for each in recorded:
        each.open(each.get_stream_profiles())
        each.start(lambda _: None)
    for number, (colour, depth) in enumerate(pictures, 1):
        for sensor, profile, pixels, width in zip(sensors, profiles, (depth, colour), (2, 3), strict=True):
            frame = rs.software_video_frame()
            frame.pixels, frame.stride, frame.bpp = pixels, SIZE[0] * width, width
            frame.timestamp, frame.domain = 1.7e12 + 1000 * number / 30, rs.timestamp_domain.system_time
            frame.frame_number, frame.profile = number, profile.as_video_stream_profile()
            frame.depth_units = 0.001
            sensor.on_video_frame(frame)
        threading.Event().wait(1 / 30)
    recorder.pause()
    for each in recorded:
        each.stop()
        each.close()


@pytest.fixture(scope="module")
def recording(blobs: Callable[..., np.ndarray], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray]:
    """A recording of 30 pictures, and (30, 17, 3) where the joints are in the world [m]."""
    camera = PinholeCamera("colour", COLOUR, level_pose(HEIGHT, np.radians(TILT)))
    bodies = BODY + 0.006 * np.arange(30)[:, None, None] * np.array([1.0, 0.0, 0.0])
    pictures = []
    for body in bodies:
        pixels, _ = camera.project(body)
        local = apply(inverse(camera.T_world_camera), body)
        image = np.full((SIZE[1], SIZE[0], 3), 20, np.uint8)
        pictures.append((blobs(image, pixels, 7.0), drawn_depth(local + np.array([BETWEEN, 0.0, 0.0]), DEPTH)))
    path = tmp_path_factory.mktemp("realsense") / "person.db3"
    record(path, pictures)
    return path, bodies


class PatientPipeline:
    """librealsense's, that waits for whoever takes the frames of a recording: none is lost on a busy machine."""

    def __init__(self) -> None:
        self._pipeline = PIPELINE()

    def start(self, config: Any) -> Any:
        profile = self._pipeline.start(config)
        profile.get_device().as_playback().set_real_time(False)
        return profile

    def __getattr__(self, name: str) -> Any:
        return getattr(self._pipeline, name)


PIPELINE = rs.pipeline


def played(source: RealSenseSource, mailbox: Mailbox, monkeypatch: pytest.MonkeyPatch) -> list[SkeletonFrame]:
    """All frames that come before the recording ends."""
    monkeypatch.setattr(rs, "pipeline", PatientPipeline)
    source.start()
    frames = []
    deadline = time.monotonic() + LONG
    while not mailbox.finished:
        assert time.monotonic() < deadline
        if arrival := mailbox.take(1.0):
            frames.append(arrival.frame)
    source.close()
    return frames


def test_a_recorded_person_comes_out_where_they_were(
    recording: tuple[Path, np.ndarray], blob_network: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, bodies = recording
    mailbox = Mailbox()
    feed = mailbox.feed("camera")
    options = RealSenseOptions(blob_network(17, width=144, height=192), tilt=TILT, height=HEIGHT)
    source = RealSenseSource("camera", feed, str(path), options)
    assert source.intrinsics == COLOUR
    frames = played(source, mailbox, monkeypatch)
    assert feed.refused == 0
    assert feed.received >= len(frames) > 5
    errors = []
    for frame in frames[1:]:  # the first is found in the whole image
        number = round((frame.stamp - 1.7e9) * 30) - 1
        assert (frame.person, frame.joints) == ("0", COCO_17.joints)
        errors.append(np.linalg.norm(frame.positions - bodies[number], axis=1)[5:11])
    assert np.nanmedian(errors) < 0.03
    assert np.nanquantile(errors, 0.9) < 0.08
    assert np.isfinite(errors).mean() > 0.9


def test_a_camera_of_a_rig_is_fused(
    recording: tuple[Path, np.ndarray], blob_network: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, bodies = recording
    mailbox = Mailbox()
    rig = Rig({"front": PinholeCamera("front", COLOUR, level_pose(HEIGHT, np.radians(TILT)))}, "cell")
    fused = FusedSource(rig, mailbox.feed("fusion"))
    feed = mailbox.feed("camera")
    options = RealSenseOptions(blob_network(17, width=144, height=192))
    source = RealSenseSource("camera", feed, str(path), options, fused.handler("front", feed))
    fused.start()
    frames = played(source, mailbox, monkeypatch)
    fused.close()
    assert feed.refused == 0
    assert len(frames) > 3
    arms = frames[-1].positions[[frames[-1].joints.index(joint) for joint in ARM_JOINTS]]
    np.testing.assert_allclose(arms[:, 1:], bodies[-1][[5, 7, 9, 6, 8, 10], 1:], atol=0.08)
    assert {frame.frame_id for frame in frames} == {"cell"}


def test_the_command_predicts_from_it(
    recording: tuple[Path, np.ndarray],
    blob_network: Callable[..., Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    source = f"realsense:{recording[0]}?model={blob_network(17, width=144, height=192)}&tilt={TILT}&height={HEIGHT}"
    monkeypatch.chdir(tmp_path)
    run(["live", "--source", source, "--model", str(MODEL), "--samples", "20", "--sink", "jsonl:out.jsonl"])
    assert re.search(rf"^realsense:{recording[0]}\s+ended\s+[1-9]", capsys.readouterr().out, re.MULTILINE)
    last = json.loads((tmp_path / "out.jsonl").read_text().splitlines()[-1])
    np.testing.assert_allclose(np.array(last["observed"])[:, 1:], BODY[[5, 7, 9, 6, 8, 10], 1:], atol=0.08)


def test_a_camera_of_another_size_than_the_rigs_is_refused(
    recording: tuple[Path, np.ndarray],
    blob_network: Callable[..., Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    half = Intrinsics(320, 240, 215.0, 215.0, 160.0, 120.0)
    rig = tmp_path / "rig.yaml"
    rig.write_text(Rig({"front": PinholeCamera("front", half, level_pose())}).to_yaml())
    source = f"realsense:{recording[0]}?model={blob_network(17)}&camera=front"
    arguments = ["live", "--source", source, "--rig", str(rig), "--model", str(MODEL), "--sink", "ws://:0"]
    monkeypatch.setattr(sys, "argv", ["kinecast", *arguments])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2
    assert "its images have 640x480 pixels, and the rig's camera 320x240" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("realsense:", "fetch it once with: kinecast download rtmpose-m"),
        ("realsense:?model=none.onnx", "none.onnx: No such file or directory"),
        ("realsense:?model=none.onnx&camera=left", "a camera needs --rig"),
        (
            "realsense:?model=none.onnx&fps=3",
            "fps unknown; allowed are model, detector, size, rate, tilt, height, camera",
        ),
    ],
)
def test_the_command_refuses_what_cannot_be(
    source: str, words: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    arguments = ["live", "--source", source, "--model", str(MODEL), "--sink", f"jsonl:{tmp_path / 'out.jsonl'}"]
    monkeypatch.setenv("KINECAST_MODELS", str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["kinecast", *arguments])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2
    assert words in " ".join(capsys.readouterr().err.split())
    assert not list(tmp_path.iterdir())


def test_a_source_can_be_closed_at_any_time(
    recording: tuple[Path, np.ndarray], blob_network: Callable[..., Path]
) -> None:
    mailbox = Mailbox()
    source = RealSenseSource("camera", mailbox.feed("camera"), str(recording[0]), RealSenseOptions(blob_network(17)))
    source.close()
    source = RealSenseSource("camera", mailbox.feed("camera"), str(recording[0]), RealSenseOptions(blob_network(17)))
    source.start()
    assert mailbox.take(LONG) is not None
    source.close()
    assert not any(thread.name == "camera" for thread in threading.enumerate())


def test_a_failure_is_counted_and_ends_nothing_else(
    recording: tuple[Path, np.ndarray],
    blob_network: Callable[..., Path],
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    mailbox = Mailbox()
    feed = mailbox.feed("camera")
    source = RealSenseSource("camera", feed, str(recording[0]), RealSenseOptions(blob_network(17)))

    def torn(*_: object) -> None:
        raise ModelError("the network fails")

    monkeypatch.setattr(source, "_people", type("People", (), {"update": torn})())
    with caplog.at_level(logging.WARNING):
        assert played(source, mailbox, monkeypatch) == []
    assert (feed.refused, feed.ended) == (1, True)
    assert "camera: ModelError: the network fails" in caplog.text


def test_a_camera_that_fails_is_opened_anew(
    recording: tuple[Path, np.ndarray], blob_network: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A recording in place of a camera, unplugged twice."""
    mailbox = Mailbox()
    feed = mailbox.feed("camera")
    source = RealSenseSource("camera", feed, str(recording[0]), RealSenseOptions(blob_network(17)))
    stream, plugged = source.stream, iter((False, False, True))

    def frames(stop: threading.Event) -> Iterator[Any]:
        if not next(plugged):
            raise RuntimeError("no picture for 5 s")
        return RealSenseStream.frames(stream, stop)

    monkeypatch.setattr(stream, "frames", frames)
    monkeypatch.setattr(stream, "recorded", False)
    monkeypatch.setattr(realsense, "RETRY", 0.01)
    source.start()
    assert mailbox.take(LONG) is not None
    assert feed.refused == 2
    source.close()


def test_a_camera_or_recording_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="012345: librealsense finds no colour and depth"):
        RealSenseStream("012345")
    with pytest.raises(OptionError, match=r"none\.bag: no such file"):
        RealSenseStream(str(tmp_path / "none.bag"))
    for ending in ("bag", "db3"):
        junk = tmp_path / f"junk.{ending}"
        junk.write_bytes(b"#ROSBAG V2.0\n" + bytes(500))
        with pytest.raises(OptionError, match="librealsense finds no colour and depth"):
            RealSenseStream(str(junk))


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"model": "m", "size": "big"}, "size 'big', expected a size such as 640x480"),
        ({"model": "m", "rate": "0"}, "rate '0', expected a whole number in 1..300"),
        ({"model": "m", "rate": "29.7"}, "rate '29.7', expected a whole number in 1..300"),
        ({"model": "m", "tilt": "nan"}, "tilt 'nan', expected -90..90"),
        ({"model": "m", "height": "high"}, "height 'high', expected -10..10"),
    ],
)
def test_settings_that_cannot_be_are_refused(settings: dict[str, str], words: str) -> None:
    with pytest.raises(OptionError) as caught:
        read_settings(RealSenseOptions, urlencode(settings), "realsense:")
    assert words in str(caught.value)


def test_settings_are_read() -> None:
    names = ("model", "detector", "size", "rate", "tilt", "height")
    settings = dict(zip(names, ("a.onnx", "yolox.onnx", "640x360", "15", "20", "2"), strict=True))
    wanted = RealSenseOptions(Path("a.onnx"), Path("yolox.onnx"), "640x360", 15, 20.0, 2.0)
    assert read_settings(RealSenseOptions, urlencode(settings), "realsense:") == wanted
