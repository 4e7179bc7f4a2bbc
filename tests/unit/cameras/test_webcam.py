"""The plain camera as a source, with the real network: two people, a rig's camera, a cable that is pulled."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2
import numpy as np
import pytest

from kinecast.cameras.landmarker import JOINTS, Landmarker
from kinecast.cameras.overlay import Picture
from kinecast.cameras.pinhole import Intrinsics, PinholeCamera, level_pose
from kinecast.cameras.rig import Rig
from kinecast.cameras.webcam import WebcamOptions, WebcamSource
from kinecast.errors import ModelError, OptionError
from kinecast.live.detection import Detection
from kinecast.live.mailbox import Mailbox
from kinecast.live.settings import read_settings

LONG = 120.0


@pytest.fixture(scope="module")
def photograph() -> np.ndarray:
    """(480, 480, 3) scikit-image's photographer (CC0)."""
    from skimage import data

    return np.repeat(data.camera()[16:496, 16:496, None], 3, axis=2)


@pytest.fixture
def model(model_root: Path) -> Path:
    return model_root / "pose_landmarker_full.task"


def wait_until(done: Callable[[], bool]) -> None:
    end = time.monotonic() + LONG
    while not done() and time.monotonic() < end:
        time.sleep(0.01)
    assert done()


def test_it_needs_nothing_of_other_cameras() -> None:
    hidden = "import sys; sys.modules.update(onnxruntime=None, pyrealsense2=None)"
    subprocess.run((sys.executable, "-c", f"{hidden}; import kinecast.cameras.webcam"), check=True, timeout=LONG)


def test_two_people_keep_their_names(model: Path) -> None:
    from skimage import data

    landmarker = Landmarker(model, people=2)
    astronaut = data.astronaut()  # public domain
    pair = np.hstack([astronaut, np.full((512, 200, 3), 127, dtype=np.uint8), astronaut])
    places: dict[str, list[float]] = {}
    for k in range(6):
        for name, person in landmarker.update(np.roll(pair, 4 * k, axis=1).copy(), k / 30).items():
            places.setdefault(name, []).append(person.pixels[JOINTS.index("nose"), 0])
    landmarker.close()
    assert {name: len(xs) for name, xs in places.items()} == {"0": 6, "1": 6}
    assert all(np.ptp(xs) < 60 for xs in places.values())  # nobody jumps to the other
    assert abs(places["0"][0] - places["1"][0]) == pytest.approx(712, abs=30)


def test_what_is_no_model_and_too_many_people_are_refused(model: Path, tmp_path: Path) -> None:
    (tmp_path / "bad.task").write_bytes(b"PK" + bytes(100))
    for path in (tmp_path / "bad.task", tmp_path / "none.task", tmp_path):
        with pytest.raises(ModelError, match="is no PoseLandmarker model"):
            Landmarker(path)
    with pytest.raises(OptionError, match=r"people '5', expected a whole number in 1\.\.4"):
        read_settings(WebcamOptions, f"model={model}&people=5", "camera:0")


def test_a_camera_of_a_rig_gives_pixels_and_no_depth(photograph: np.ndarray, model: Path, tmp_path: Path) -> None:
    for k in range(4):
        cv2.imwrite(str(tmp_path / f"{k}.png"), photograph)
    seen: list[Detection] = []
    pictures: list[Picture] = []
    mailbox = Mailbox()
    feed = mailbox.feed("camera")

    def handle(_stamp: float, people: list[Detection], _acquired: float) -> None:
        seen.extend(people)

    source = WebcamSource("front", feed, str(tmp_path), WebcamOptions(model, speed=0.2), [pictures.append], handle)
    source.start()
    wait_until(lambda: feed.ended)
    source.close()
    assert len(pictures) >= 2
    assert seen
    assert {(each.camera, each.person) for each in seen} == {("front", "0")}
    assert np.isnan(seen[-1].depth).all()
    wrist = JOINTS.index("right_wrist")
    assert np.linalg.norm(seen[-1].pixels[wrist] - (245, 205)) < 40  # at the camera's tripod head
    assert 2 < seen[-1].pixel_std[wrist] < 20
    assert feed.received == feed.superseded  # pictures that nobody had time for, and no skeleton


class Camera(BaseHTTPRequestHandler):
    """An IP camera whose cable is pulled after twelve pictures."""

    picture = b""

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=next")
        self.end_headers()
        for _ in range(12):
            head = f"--next\r\nContent-Type: image/jpeg\r\nContent-Length: {len(self.picture)}\r\n\r\n"
            self.wfile.write(head.encode() + self.picture + b"\r\n")
            time.sleep(0.03)
        self.close_connection = True

    def log_message(self, *_: object) -> None:
        """Silence."""


@pytest.fixture
def address(photograph: np.ndarray) -> Iterator[str]:
    Camera.picture = cv2.imencode(".jpg", photograph)[1].tobytes()
    with ThreadingHTTPServer(("127.0.0.1", 0), Camera) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/camera.mjpg"
        server.shutdown()
        thread.join()


def test_a_camera_that_is_unplugged_is_opened_anew(
    address: str, model: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("kinecast.cameras.webcam.RETRY", 0.05)
    mailbox = Mailbox()
    feed = mailbox.feed(f"camera:{address}")
    source = WebcamSource(feed.name, feed, address, WebcamOptions(model))
    source.start()
    wait_until(lambda: feed.refused >= 2)  # it went away twice
    source.close()
    assert "gives no picture any more" in caplog.text
    assert feed.received > 0
    arrival = mailbox.take(0.0)
    assert arrival is not None
    assert abs(arrival.frame.stamp - time.time()) < LONG


def test_a_lens_file_is_of_one_camera_and_of_the_pictures_size(model: Path, tmp_path: Path) -> None:
    lens = Intrinsics(640, 480, 500.0, 501.0, 320.0, 241.0, (0.1, -0.2, 0.0, 0.0))
    cameras = {name: PinholeCamera(name, lens, level_pose()) for name in ("left", "right")}
    (tmp_path / "one.yaml").write_text(Rig({"left": cameras["left"]}).to_yaml())
    (tmp_path / "two.yaml").write_text(Rig(cameras).to_yaml())
    options = WebcamOptions(model, lens=tmp_path / "one.yaml")
    assert options.intrinsics((640, 480)) == lens
    assert options.scale.focal_std == 0.0
    for file, size in (("one.yaml", (1280, 720)), ("two.yaml", (640, 480))):
        with pytest.raises(OptionError, match="expected one camera of"):
            WebcamOptions(model, lens=tmp_path / file).intrinsics(size)
    found = WebcamOptions(model, fov=90.0).intrinsics((640, 480))
    assert (found.fx, found.cx) == (pytest.approx(320.0), 319.5)
