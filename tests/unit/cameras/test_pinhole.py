"""Cameras against OpenCV's own projection and against finite differences; rig files that are good and bad."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from kinecast.cameras.pinhole import Intrinsics, PinholeCamera
from kinecast.cameras.rig import Rig
from kinecast.errors import DatasetError, OptionError
from kinecast.geometry.transforms import from_rotation_vector, inverse, rotation_vector, transform

PLAIN = (1280, 720, 910.0, 905.0, 642.0, 355.0)
DISTORTIONS = (
    (),
    (0.12, -0.24, 0.001, -0.0006),
    (0.15, -0.5, 0.0007, -0.0008, 0.45),  # an Azure Kinect's and a D415's colour cameras are of this size
    (0.6, -2.7, 0.0005, -0.0001, 1.5, 0.48, -2.5, 1.45),
)


def camera(distortion: tuple[float, ...]) -> PinholeCamera:
    pose = transform(from_rotation_vector(np.array([1.9, 0.4, -0.3])), np.array([0.4, -2.1, 1.7]))
    return PinholeCamera("left", Intrinsics(*PLAIN, distortion), pose)


def points(of: PinholeCamera) -> np.ndarray:
    """Points that the camera sees, in the world."""
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.5, 5.0, 200)
    local = np.column_stack([rng.uniform(-0.6, 0.6, 200) * depth, rng.uniform(-0.35, 0.35, 200) * depth, depth])
    return local @ of.T_world_camera[:3, :3].T + of.T_world_camera[:3, 3]


@pytest.mark.parametrize("distortion", DISTORTIONS)
def test_it_projects_as_opencv_does_and_back(distortion: tuple[float, ...]) -> None:
    each = camera(distortion)
    world = points(each)
    pixels, depth = each.project(world)
    T = inverse(each.T_world_camera)
    _, _, fx, fy, cx, cy = PLAIN
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    wanted, _ = cv2.projectPoints(world, rotation_vector(T[:3, :3]), T[:3, 3], matrix, np.array(distortion))
    np.testing.assert_allclose(pixels, wanted[:, 0], atol=1e-8)
    np.testing.assert_allclose(each.back_project(pixels, depth), world, atol=1e-6)
    along = each.rays(pixels)
    away = world - each.T_world_camera[:3, 3]
    np.testing.assert_allclose(along, away / np.linalg.norm(away, axis=1, keepdims=True), atol=1e-6)


@pytest.mark.parametrize("distortion", DISTORTIONS)
def test_its_jacobian_is_the_slope_of_its_pixels(distortion: tuple[float, ...]) -> None:
    lens, step = camera(distortion).intrinsics, 1e-6
    directions = np.random.default_rng(0).uniform((-0.6, -0.35), (0.6, 0.35), (200, 2))
    columns = [(lens.pixels(directions + d) - lens.pixels(directions - d)) / (2 * step) for d in np.eye(2) * step]
    np.testing.assert_allclose(lens.jacobian(directions), np.stack(columns, axis=-1), rtol=1e-5, atol=1e-3)


def test_its_covariance_is_that_of_many_back_projections() -> None:
    each = camera(DISTORTIONS[2])
    rng, count = np.random.default_rng(1), 100_000
    world = points(each)[:1]
    pixel, depth = each.project(world)
    noisy = each.back_project(pixel + rng.normal(0, 3.0, (count, 2)), depth + rng.normal(0, 0.02, count))
    covariance = each.covariance(world, np.array([3.0]), np.array([0.02]))[0]
    spread = np.sqrt(np.diag(covariance))
    assert np.abs(np.cov(noisy.T) - covariance).max() < 6 * spread.max() ** 2 * np.sqrt(2 / count)


def test_what_is_behind_it_or_unknown_is_nan() -> None:
    each = camera(DISTORTIONS[2])
    behind = each.T_world_camera[:3, 3] - 2 * each.T_world_camera[:3, 2]
    world = np.stack([behind, np.full(3, np.nan), each.T_world_camera[:3, 3]])
    assert np.isnan(each.project(world)[0]).all()
    assert np.isnan(each.covariance(world, np.ones(3), np.ones(3))).all()
    assert np.isnan(each.back_project(np.full((1, 2), np.nan), np.ones(1))).all()
    assert np.isnan(each.intrinsics.directions(np.array([[1e7, -1e7]]))).all(), "no direction leads there"


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"width": 0}, "0 x 720"),
        ({"fx": 0.0}, "focal lengths 0"),
        ({"fy": float("nan")}, "focal"),
        ({"distortion": (0.1,)}, "1 distortion coefficients"),
        ({"cx": float("inf")}, "finite"),
    ],
)
def test_intrinsics_that_are_none_are_refused(changed: dict[str, object], words: str) -> None:
    names = ("width", "height", "fx", "fy", "cx", "cy")
    with pytest.raises(OptionError, match=words):
        Intrinsics(**{**dict(zip(names, PLAIN, strict=True)), **changed})  # type: ignore[arg-type]


GOOD = """
frame_id: cell
cameras:
  left:
    size: [1280, 720]
    focal: [910, 905]
    center: [642, 355]
    distortion: [0.15, -0.5, 0.0007, -0.0008, 0.45]
    position: [0.4, -2.1, 1.7]
    quaternion: [0.5, -0.5, 0.5, -0.5]
  right:
    size: [640, 480]
    focal: [600.5, 600.5]
    center: [320, 240]
    position: [-2, 0, 1.5]
    quaternion: [1, 0, 0, 0]
"""


def test_a_rig_is_read_and_written(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(GOOD)
    rig = Rig.load(path)
    assert (rig.frame_id, list(rig.cameras)) == ("cell", ["left", "right"])
    assert rig.cameras["left"].intrinsics.distortion[1] == -0.5
    pose = rig.cameras["left"].T_world_camera
    np.testing.assert_allclose(pose[:3, :3], [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], atol=1e-12)  # looks along x, upright
    again = Rig.from_yaml(rig.to_yaml())
    for name, each in rig.cameras.items():
        assert again.cameras[name].intrinsics == each.intrinsics
        np.testing.assert_allclose(again.cameras[name].T_world_camera, each.T_world_camera, atol=1e-6)


@pytest.mark.parametrize(
    ("found", "put", "words"),
    [
        ("focal: [910, 905]", "focal: [910]", "cameras.left.focal: expected a list of 2 numbers px"),
        ("focal: [910, 905]", "focal: [-910, 905]", "cameras.left: focal lengths"),
        ("focal: [910, 905]", "foc: [910, 905]", "cameras.left: unknown entry 'foc'"),
        ("size: [1280, 720]", "size: [1280.5, 720]", "whole number"),
        ("distortion: [0.15, -0.5, 0.0007, -0.0008, 0.45]", "distortion: [0.1, 0.2]", "2 distortion coefficients"),
        ("distortion: [0.15, -0.5, 0.0007, -0.0008, 0.45]", "distortion: 0.1", "list of numbers"),
        ("position: [0.4, -2.1, 1.7]", "position: [400, -2100, 1700]", "lengths are in metres"),
        ("quaternion: [1, 0, 0, 0]", "quaternion: [0, 0, 0, 0]", "cameras.right: a quaternion of length zero"),
        ("  right:", "  left:", "`left` is given twice"),
        ("frame_id: cell", "frame_id: [1]", "frame_id: expected a name"),
        ("frame_id: cell", "frame: cell", "unknown entry 'frame'"),
    ],
)
def test_a_rig_that_is_wrong_is_named_with_its_place(found: str, put: str, words: str) -> None:
    assert found in GOOD
    with pytest.raises(DatasetError) as error:
        Rig.from_yaml(GOOD.replace(found, put), "rig.yaml")
    assert words in str(error.value)
    assert str(error.value).startswith("rig.yaml")


def test_a_rig_without_cameras_is_none() -> None:
    with pytest.raises(DatasetError, match="0 cameras"):
        Rig.from_yaml("cameras: {}")
