"""Pictures of files, folders and a camera on the network that goes away and comes back."""

from __future__ import annotations

import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2
import numpy as np
import pytest

from kinecast.cameras.video import VideoStream
from kinecast.errors import OptionError

PICTURE = np.full((48, 64, 3), (10, 20, 200), dtype=np.uint8)


def write_video(path: Path, count: int, rate: float = 25.0) -> None:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate, (64, 48))
    for shade in range(count):
        writer.write(np.full_like(PICTURE, shade))
    writer.release()


def all_of(stream: VideoStream) -> list[tuple[float, np.ndarray]]:
    return list(stream.pictures(threading.Event()))


def test_a_video_keeps_its_own_time(tmp_path: Path) -> None:
    write_video(tmp_path / "take.mp4", 12)
    stream = VideoStream(str(tmp_path / "take.mp4"))
    assert (stream.size, stream.rate, stream.live) == ((64, 48), 25.0, False)
    for _ in range(2):  # from the beginning again
        pictures = all_of(stream)
        np.testing.assert_allclose([stamp for stamp, _ in pictures], np.arange(12) / 25, atol=1e-3)
    assert stream.lost == 0


def test_a_folder_is_read_in_the_order_of_names_and_in_rgb(tmp_path: Path) -> None:
    for name in ("b.png", "a.png", "d.jpg"):
        cv2.imwrite(str(tmp_path / name), PICTURE[..., ::-1])
    (tmp_path / "c.png").write_bytes(b"no picture")
    cv2.imwrite(str(tmp_path / "e.png"), np.zeros((10, 10, 3), dtype=np.uint8))
    (tmp_path / "notes.txt").touch()
    stream = VideoStream(str(tmp_path), rate=10.0)
    pictures = all_of(stream)
    assert [stamp for stamp, _ in pictures] == [0.0, 0.1, 0.3]
    np.testing.assert_array_equal(pictures[0][1], PICTURE)
    assert stream.lost == 2


@pytest.mark.parametrize(
    ("make", "why"),
    [
        (lambda _: None, "no such file or folder"),
        (lambda path: path.mkdir(), "holds no picture that can be read"),
        (lambda path: path.write_bytes(b"\x00\x00\x00\x18ftypmp42" + bytes(1000)), "no video with a picture"),
        (lambda path: path.touch(), "no video with a picture"),
    ],
)
def test_what_gives_no_picture_is_named(make: object, why: str, tmp_path: Path) -> None:
    make(tmp_path / "take.mp4")
    with pytest.raises(OptionError, match=f"take.mp4: .*{why}"):
        VideoStream(str(tmp_path / "take.mp4"))


def test_no_camera_is_named() -> None:
    with pytest.raises(OptionError, match="camera:73: no camera 73 is there"):
        VideoStream("73")


def test_a_video_that_breaks_off_gives_what_it_has_and_counts_the_rest(tmp_path: Path) -> None:
    writer = cv2.VideoWriter(str(tmp_path / "take.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (64, 48))
    rng = np.random.default_rng(0)
    for _ in range(40):
        writer.write(rng.integers(0, 255, PICTURE.shape, dtype=np.uint8))
    writer.release()
    content = (tmp_path / "take.avi").read_bytes()
    (tmp_path / "cut.avi").write_bytes(content[: len(content) // 2])
    stream = VideoStream(str(tmp_path / "cut.avi"))
    pictures = all_of(stream)
    assert 10 < len(pictures) < 30
    assert len(pictures) + stream.lost == pytest.approx(40, abs=2)


class Camera(BaseHTTPRequestHandler):
    """An IP camera: five JPEG pictures, then the cable is pulled."""

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=next")
        self.end_headers()
        content = cv2.imencode(".jpg", PICTURE[..., ::-1])[1].tobytes()
        for _ in range(40):
            head = f"--next\r\nContent-Type: image/jpeg\r\nContent-Length: {len(content)}\r\n\r\n"
            self.wfile.write(head.encode() + content + b"\r\n")
            time.sleep(0.005)
        self.close_connection = True

    def log_message(self, *_: object) -> None:
        """Silence."""


def test_a_camera_that_goes_away_raises_and_can_be_opened_anew() -> None:
    with ThreadingHTTPServer(("127.0.0.1", 0), Camera) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            stream = VideoStream(f"http://127.0.0.1:{server.server_port}/camera.mjpg")
            assert stream.live
            for _ in range(2):
                stamps: list[float] = []
                with pytest.raises(RuntimeError, match="gives no picture any more"):
                    stamps.extend(
                        stamp for stamp, picture in stream.pictures(threading.Event()) if picture[0, 0, 2] > 190
                    )
                assert len(stamps) > 5
                assert abs(stamps[0] - time.time()) < 60
        finally:
            server.shutdown()
            thread.join()
