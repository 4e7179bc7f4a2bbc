"""What is drawn in a camera's picture, and the film of it."""

from __future__ import annotations

import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.cameras.movie import Movie
from kinecast.cameras.overlay import Picture, drawn
from kinecast.cameras.pinhole import Intrinsics, PinholeCamera, level_pose
from kinecast.live.publication import Publication, colour_of
from kinecast.live.sinks import Sink
from kinecast.predictor import Predictor, PredictorOptions
from kinecast.types import SkeletonFrame

MODEL = Path(__file__).resolve().parents[3] / "src" / "kinecast" / "data" / "models" / "zero_velocity.npz"
ARMS = np.array([[-0.2, 2, 1.4], [-0.25, 2, 1.1], [-0.2, 1.8, 1.0], [0.2, 2, 1.4], [0.25, 2, 1.1], [0.2, 1.8, 1.0]])
CAMERA = PinholeCamera("c", Intrinsics(320, 240, 250.0, 250.0, 159.5, 119.5), level_pose(1.2))
GREY = np.full((240, 320, 3), 128, dtype=np.uint8)


@pytest.fixture(scope="module")
def published() -> Publication:
    predictor = Predictor.load(MODEL, options=PredictorOptions(samples=50, horizon=0.5))
    for k in range(12):
        frame = SkeletonFrame(k / 30, ARM_JOINTS, ARMS, "ada")
        prediction = predictor.observe(frame)
    return Publication.of(1, "camera:0", frame, prediction, 0.95, time.monotonic())


def test_tubes_lie_over_the_arms_and_nothing_is_drawn_far_away(published: Publication) -> None:
    image = drawn(Picture("camera:0", 0.4, GREY, CAMERA, 20.0), [published])
    changed = (image != GREY).any(axis=2)
    for limb in ((0, 1), (1, 2), (3, 4), (4, 5)):
        x, y = CAMERA.project(ARMS[list(limb)].mean(axis=0))[0].round().astype(int)
        assert changed[y - 3 : y + 4, x - 3 : x + 4].all()
        beside = image[y, x - 12] - 128.0  # the tube: towards the status' colour
        assert beside @ (np.array(colour_of(published.prediction.status)) * 255 - 128) > 500
    assert not changed[200:].any()
    np.testing.assert_array_equal(GREY, 128)


def test_what_is_unknown_or_behind_the_camera_is_left_out(published: Publication) -> None:
    behind = PinholeCamera("c", CAMERA.intrinsics, level_pose(1.2) @ np.diag([-1.0, 1.0, -1.0, 1.0]))
    image = drawn(Picture("camera:0", 0.4, GREY, behind, 20.0), [published])
    assert not (image[40:] != 128).any()
    assert (drawn(Picture("camera:0", 0.4, GREY, CAMERA, 20.0), [])[:40] != 128).any()  # says that nobody is seen


def test_a_film_keeps_the_pictures_times_and_is_whole_at_the_end(published: Publication, tmp_path: Path) -> None:
    movie = Movie(tmp_path / "film.mp4")
    assert isinstance(movie, Sink)
    movie.publish(published)
    for k in (0, 1, 2, 6, 7):  # four are missing
        movie.take(Picture("camera:0", published.frame.stamp + k / 20, GREY, CAMERA, 20.0))
    assert not (tmp_path / "film.mp4").exists()
    movie.close()
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]
    film = cv2.VideoCapture(str(tmp_path / "film.mp4"))
    pictures = []
    while (read := film.read())[0]:
        pictures.append(read[1])
    assert len(pictures) == 8
    arm = slice(90, 110), slice(120, 140)
    assert abs(pictures[0][arm].astype(int) - 128).mean() > 5 > abs(pictures[7][arm].astype(int) - 128).mean()
    assert (movie.counters.published, movie.counters.dropped) == (5, 0)


def test_a_film_without_a_picture_leaves_no_file(tmp_path: Path) -> None:
    Movie(tmp_path / "film.mp4").close()
    assert list(tmp_path.iterdir()) == []
