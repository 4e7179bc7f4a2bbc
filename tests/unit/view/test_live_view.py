"""The view of live predictions: what it takes, draws and counts."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.cameras.overlay import Picture
from kinecast.cameras.pinhole import Intrinsics, PinholeCamera, level_pose
from kinecast.errors import OptionError
from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Box, Capsule, HalfSpace, Sphere
from kinecast.geometry.transforms import transform
from kinecast.live.publication import Publication
from kinecast.live.sinks import Sink
from kinecast.predictor import Predictor, PredictorOptions
from kinecast.types import SkeletonFrame
from kinecast.view.live_view import MOST_SHOWN, LiveView

REST = np.array([[0, 0.2, 1.4], [0, 0.25, 1.1], [0.2, 0.2, 1.0], [0, -0.2, 1.4], [0, -0.25, 1.1], [0.2, -0.2, 1.0]])
MODEL = Path(__file__).resolve().parents[3] / "src" / "kinecast" / "data" / "models" / "zero_velocity.npz"
SCENE = Scene(
    (
        Box(np.zeros(3), np.ones(3)), Sphere(np.ones(3), 0.2), Capsule(np.zeros(3), np.ones(3), 0.1),
        HalfSpace(np.zeros(3), np.array([0.0, 0.0, 1.0])),
    ),
    {"shelf": Sphere(np.ones(3), 0.1)},
)  # fmt: skip


@pytest.fixture(scope="module")
def predictor() -> Predictor:
    return Predictor.load(MODEL, options=PredictorOptions(samples=20))


@pytest.fixture
def view() -> Iterator[LiveView]:
    opened = LiveView("127.0.0.1", 0, SCENE)
    yield opened
    opened.close()


def publication(predictor: Predictor, number: int, arms: np.ndarray = REST, person: str = "0") -> Publication:
    frame = SkeletonFrame(float(number), ARM_JOINTS, arms, person)
    return Publication.of(number, "camera", frame, predictor.observe(frame), 0.9, time.monotonic())


def settled(view: LiveView, count: int) -> None:
    """Waits until so many publications are accounted for."""
    end = time.monotonic() + 240.0
    while view.counters.published + view.counters.dropped < count and time.monotonic() < end:
        time.sleep(0.01)
    assert view.counters.published + view.counters.dropped == count


def test_every_publication_is_drawn_or_counted(view: LiveView, predictor: Predictor) -> None:
    assert isinstance(view, Sink)
    for number in range(1, 30):
        view.publish(publication(predictor, number))
    settled(view, 29)
    assert view.counters.published >= 1
    assert view.counters.failure is None
    assert "<b>0</b> · camera" in view.words.content


def test_what_is_not_known_and_more_people_than_are_drawn_are_no_trouble(
    view: LiveView, predictor: Predictor, caplog: pytest.LogCaptureFixture
) -> None:
    view.publish(publication(predictor, 1, np.full((6, 3), np.nan)))
    for number in range(3 * MOST_SHOWN):
        view.publish(publication(predictor, number + 2, person=f"<b>{number}</b>"))
    settled(view, 3 * MOST_SHOWN + 1)
    assert "could not be drawn" not in caplog.text
    assert "<b><b>" not in view.words.content
    assert "&lt;b&gt;" in view.words.content
    assert len(view._shown) <= MOST_SHOWN


def test_who_is_seen_no_more_is_drawn_no_more(view: LiveView, predictor: Predictor) -> None:
    view.publish(publication(predictor, 1))
    settled(view, 1)
    view._refresh({}, time.monotonic() + 10.0)
    assert view._shown == {}
    assert "Nobody" in view.words.content


def test_what_cannot_be_drawn_is_counted_and_the_next_is_drawn(
    view: LiveView, predictor: Predictor, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with monkeypatch.context() as broken:
        broken.setattr(view, "_aim", None)
        view.publish(publication(predictor, 1))
        settled(view, 1)
    assert (view.counters.published, view.counters.dropped, view.counters.failure) == (0, 1, None)
    assert caplog.text.count("could not be drawn") == 1
    view.publish(publication(predictor, 2))
    settled(view, 2)
    assert (view.counters.published, view.counters.dropped) == (1, 1)


def test_a_cameras_picture_is_shown_beside_with_what_is_predicted(view: LiveView, predictor: Predictor) -> None:
    intrinsics = Intrinsics(320, 240, 250.0, 250.0, 159.5, 119.5)
    camera = PinholeCamera("camera", intrinsics, level_pose(1.2) @ transform(np.eye(3), np.array([0.0, 0.0, -2.0])))
    grey = np.full((240, 320, 3), 128, dtype=np.uint8)
    view.publish(publication(predictor, 1))
    settled(view, 1)
    end = time.monotonic() + 240.0
    while "camera" not in view.images and time.monotonic() < end:
        view.take(Picture("camera", 1.0, grey, camera, 30.0))
        time.sleep(0.01)
    shown = view.images["camera"].image
    assert shown.shape == grey.shape
    assert (shown[60:] != 128).any()
    assert view.counters.failure is None


def test_it_listens_on_this_machine_and_a_taken_port_is_named(view: LiveView) -> None:
    assert view.address.startswith("http://127.0.0.1:")
    with pytest.raises(OptionError, match="the view: nothing can listen there"):
        LiveView("127.0.0.1", int(view.address.rpartition(":")[2]))
