"""Pictures and films of predictions: geometry of the page, odd inputs, sizes."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from PIL import Image

from kinecast.evaluation import pictures
from kinecast.evaluation.pictures import TRUTH, Moment, animate_predictions, draw_prediction, perspective
from kinecast.evaluation.scenery import OBSTACLE, Camera, draw_obstacles
from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Box, Capsule, ConstantVelocity, HalfSpace, MovingObstacle, Sphere

UP = np.array([0.0, 0.0, 1.0])
TABLE = HalfSpace(np.array([0.0, 0.0, 0.9]), UP)


def moment(samples: int = 20, steps: int = 3) -> Moment:
    """Someone at (1, 2) facing +x who moves both hands forward."""
    left = np.array([[0.0, 0.2, 1.4], [0.05, 0.25, 1.15], [0.3, 0.2, 1.1]])
    pose = np.concatenate([left, left * (1, -1, 1)]) + np.array([1.0, 2.0, 0.0])
    forward = 0.04 * np.array([0, 0.5, 1, 0, 0.5, 1])[:, None] * (1.0, 0.0, 0.0)
    observed = np.stack([pose - forward, pose])
    mean = np.stack([pose + (k + 1) * forward for k in range(steps)])
    noise = 0.05 * np.random.default_rng(0).standard_normal((samples, steps, 6, 3))
    return Moment(observed, mean + noise, mean, mean + 0.01, 1 / 30)


def share_of(path: Path, colour: str) -> float:
    """Share of pixels that have nearly this colour."""
    with Image.open(path) as picture:
        pixels = np.asarray(picture.convert("RGB")).astype(int)
    wanted = [int(to_hex(colour)[i : i + 2], 16) for i in (1, 3, 5)]
    return float(np.mean(np.abs(pixels - wanted).max(axis=-1) < 12))


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A picture of `moment`."""
    path = tmp_path_factory.mktemp("pictures") / "plain.png"
    draw_prediction(path, moment())
    return path


def test_the_picture_shows_the_person_and_the_table(tmp_path: Path, plain: Path) -> None:
    full = tmp_path / "full.png"
    draw_prediction(full, moment(), Scene((TABLE,)), "a title")
    draw_prediction(tmp_path / "again.png", moment())
    assert plain.read_bytes() == (tmp_path / "again.png").read_bytes()
    with Image.open(full) as picture:
        assert picture.size == (1664, 944)
    assert share_of(plain, OBSTACLE) < 1e-3 < 0.02 < share_of(full, OBSTACLE)


def odd_moments() -> dict[str, Moment]:
    usual = moment()
    holed = usual.truth.copy()
    holed[1], holed[-1, 2, 0] = np.nan, np.nan
    unseen = usual.observed.copy()
    unseen[0, :3] = np.nan
    unknown = np.full_like(usual.truth, np.nan)
    few = {"samples": usual.samples[:1], "observed": usual.observed[-1:]}
    return {
        "no truth or samples": dataclasses.replace(usual, truth=unknown, samples=usual.samples[:0]),
        "truth with holes": dataclasses.replace(usual, truth=holed),
        "one sample, one frame": dataclasses.replace(usual, **few),
        "one step": dataclasses.replace(usual, samples=usual.samples[:, :1], mean=usual.mean[:1], truth=unknown[:1]),
        "an arm unseen": dataclasses.replace(usual, observed=unseen),
        "no width": dataclasses.replace(usual, observed=np.ones((2, 6, 3))),
    }


@pytest.mark.parametrize("name", odd_moments())
def test_odd_moments_are_drawn(name: str, tmp_path: Path) -> None:
    draw_prediction(tmp_path / "a.png", odd_moments()[name], title="<b> $x$ \n 漢 " + 300 * "x")
    assert (tmp_path / "a.png").stat().st_size > 10_000


def test_what_happened_is_seen(tmp_path: Path, plain: Path) -> None:
    draw_prediction(tmp_path / "without.png", dataclasses.replace(moment(), truth=np.full((3, 6, 3), np.nan)))
    legend = 2e-4
    assert share_of(tmp_path / "without.png", TRUTH) < legend < 1e-3 < share_of(plain, TRUTH)


def film(count: int = 4, steps: int = 3) -> list[Moment]:
    """Successive moments of someone who moves forward."""
    first = moment(steps=steps)
    shifts = [np.array([0.02 * k, 0.0, 0.0]) for k in range(count)]
    return [
        dataclasses.replace(
            first,
            observed=first.observed + shift,
            samples=first.samples + shift,
            mean=first.mean + shift,
            truth=first.truth + shift,
            stamp=k * first.dt,
        )
        for k, shift in enumerate(shifts)
    ]


def test_a_film_of_successive_predictions(tmp_path: Path) -> None:
    animate_predictions(tmp_path / "a.gif", film(), Scene((TABLE,)), "a title")
    with Image.open(tmp_path / "a.gif") as played:
        assert played.n_frames == 4
        assert played.info["loop"] == 0
        times, shown = [], []
        for frame in range(played.n_frames):
            played.seek(frame)
            times.append(played.info["duration"])
            shown.append(np.asarray(played.convert("RGB")).astype(int))
    assert times == [50, 50, 50, 1000]  # one and a half times slower than 1/30 s, with a rest
    for before, after in itertools.pairwise(shown):  # the person moves, the table stays: the camera stands still
        assert 0.001 < np.mean(np.abs(after - before).max(axis=-1) > 12) < 0.2


def test_odd_moments_are_filmed(tmp_path: Path) -> None:
    animate_predictions(tmp_path / "a.gif", [*odd_moments().values()])
    with Image.open(tmp_path / "a.gif") as played:
        assert played.n_frames == 6


def test_a_film_too_large_is_made_smaller(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    animate_predictions(tmp_path / "large.gif", film(2, steps=1))
    monkeypatch.setattr(pictures, "LARGEST", (tmp_path / "large.gif").stat().st_size - 1)
    animate_predictions(tmp_path / "small.gif", film(2, steps=1))
    with Image.open(tmp_path / "small.gif") as small, Image.open(tmp_path / "large.gif") as large:
        assert small.width < large.width


def test_the_persons_left_is_on_the_readers_right() -> None:
    now = moment().now
    camera = perspective(moment())
    page = camera.page(now)
    assert page[0, 0] > page[3, 0]
    assert page[0, 1] > page[1, 1]  # shoulders above elbows
    nearer = camera.depth(now)
    assert nearer[2] > nearer[0]  # hands nearer to the viewer, who is in front


def test_what_is_nearer_is_larger_only_in_perspective() -> None:
    flat = Camera(np.zeros(3), np.eye(3))
    near = dataclasses.replace(flat, distance=2.0)
    stick = np.array([[-0.1, 0.0, 1.0], [0.1, 0.0, 1.0]])
    assert np.ptp(flat.page(stick)[:, 0]) == pytest.approx(0.2)
    assert np.ptp(near.page(stick)[:, 0]) == pytest.approx(0.4)
    np.testing.assert_allclose(near.page(np.zeros(3)), 0.0)
    np.testing.assert_allclose(near.towards(np.array([0.0, 0.0, -5.0])), UP)
    assert np.isfinite(near.page(np.array([1.0, 1.0, 2.0]))).all()  # at the viewer's own place


def outlines(*obstacles: object, start: float = 0.0, end: float = 0.0) -> list[np.ndarray]:
    """Corners of everything drawn for a scene seen from above, around the origin."""
    axes = Figure().add_subplot()
    camera = Camera(np.zeros(3), np.eye(3))
    draw_obstacles(axes, camera, Scene(tuple(obstacles)), start, end, np.zeros((1, 3)))
    return [patch.get_xy() for patch in axes.patches]


def test_obstacles_are_drawn_as_large_as_they_are() -> None:
    (box,) = outlines(Box(np.array([1.0, 0.0, 0.0]), np.array([0.4, 0.2, 0.6])))
    np.testing.assert_allclose([box.min(axis=0), box.max(axis=0)], [[0.8, -0.1], [1.2, 0.1]])
    (ball,) = outlines(Sphere(np.array([0.0, 1.0, 0.0]), 0.3))
    np.testing.assert_allclose(np.linalg.norm(ball - (0.0, 1.0), axis=-1), 0.3, rtol=0.02)
    (tube,) = outlines(Capsule(np.array([-1.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]), 0.1))
    np.testing.assert_allclose(np.ptp(tube, axis=0), [2.2, 0.2], rtol=0.02)


def test_planes_are_patches_and_far_ones_are_left_out() -> None:
    (patch,) = outlines(HalfSpace(-0.1 * UP, UP))
    assert np.ptp(patch, axis=0) == pytest.approx([1.7, 1.7])
    assert outlines(HalfSpace(-2.0 * UP, UP)) == []


def test_a_moved_obstacle_leaves_its_outline() -> None:
    box = Box(np.zeros(3), np.full(3, 0.2))
    moving = MovingObstacle(box, ConstantVelocity(np.array([1.0, 0.0, 0.0])))
    ghost, solid = outlines(moving, start=0.0, end=0.5)
    np.testing.assert_allclose(ghost.mean(axis=0), [0.0, 0.0], atol=0.06)
    np.testing.assert_allclose([solid[:, 0].min(), solid[:, 0].max()], [0.4, 0.6])


def test_what_stands_on_a_table_is_drawn_over_it() -> None:
    table = Box(np.array([0.0, 0.0, 0.88]), np.array([1.0, 1.0, 0.04]))
    bin_ = Box(np.array([0.0, 0.0, 1.0]), np.array([0.2, 0.2, 0.2]))
    under, over = outlines(bin_, table)
    assert np.ptp(under[:, 0]) > np.ptp(over[:, 0])
