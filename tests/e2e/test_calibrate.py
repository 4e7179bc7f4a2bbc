"""`kinecast calibrate`: rendered pictures of a board by cameras whose places are known."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from kinecast.cameras.calibration import CharucoBoard
from kinecast.cameras.pinhole import Intrinsics, PinholeCamera
from kinecast.cameras.rig import Rig
from kinecast.geometry.transforms import apply, from_rotation_vector, inverse, rotation_vector, transform

BOARD = CharucoBoard(6, 4, 0.080)
LENS = Intrinsics(960, 540, 700.0, 704.0, 471.0, 275.0, (0.06, -0.12, 0.0002, -0.0001, 0.0))
FINE = 3
"""Rays for each pixel, along each side."""
LEVEL = np.array([[1.0, 0, 0, 0], [0, -1.0, 0, BOARD.height], [0, 0, -1.0, 0.75], [0, 0, 0, 1.0]])
"""T_world_board of the board that lies on a table, face up."""


def camera(name: str, azimuth: float) -> PinholeCamera:
    """One 1.4 m from the middle of the table, 0.9 m above it."""
    a = np.radians(azimuth)
    middle = np.array([BOARD.columns * BOARD.square / 2, BOARD.height / 2, 0.75])
    place = middle + np.array([1.1 * np.cos(a), 1.1 * np.sin(a), 0.9])
    forward = (middle - place) / np.linalg.norm(middle - place)
    right = np.cross(forward, [0, 0, 1]) / np.linalg.norm(np.cross(forward, [0, 0, 1]))
    return PinholeCamera(name, LENS, transform(np.stack([right, np.cross(forward, right), forward], axis=1), place))


CAMERAS = [camera("left", 200.0), camera("middle", 260.0), camera("right", 320.0)]


def picture(of: PinholeCamera, T_world_board: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The board as the camera sees it, distorted and noisy: a ray for each ninth of a pixel."""
    face = BOARD.pattern.generateImage((BOARD.columns * 80, BOARD.rows * 80), marginSize=0)
    i = of.intrinsics
    edge = np.array([[x, y, 0.0] for x in (0, BOARD.columns) for y in (0, BOARD.rows)]) * BOARD.square
    around = of.project(apply(T_world_board, edge))[0]
    left, top = np.clip(np.floor(around.min(axis=0) - 20), 0, None).astype(int)
    width, height = np.ceil(around.max(axis=0) + 20).astype(int) - (left, top)
    # Where a ray meets the board is exact at every fourth pixel, and linear between.
    u, v = np.meshgrid(np.arange(left, left + width + 8, 4), np.arange(top, top + height + 8, 4))
    directions = i.directions(np.stack([u, v], axis=-1).reshape(-1, 2).astype(float)).reshape(*u.shape, 2)
    T = inverse(T_world_board) @ of.T_world_camera
    rays = directions @ T[:3, :2].T + T[:3, 2]
    reach = -T[2, 3] / rays[..., 2]
    where = (T[:2, 3] + rays[..., :2] * reach[..., None]) * 80 / BOARD.square - 0.5
    x, y = np.meshgrid(*(((np.arange(n * FINE) + 0.5) / FINE - 0.5).astype(np.float32) / 4 for n in (width, height)))
    where = cv2.remap(where.astype(np.float32), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    fine = cv2.remap(face, where, None, cv2.INTER_LINEAR, borderValue=150)
    seen = np.full((i.height, i.width), 150, np.float32)
    part = cv2.resize(fine, (int(width), int(height)), interpolation=cv2.INTER_AREA)
    seen[top : top + height, left : left + width] = part[: i.height - top, : i.width - left]
    noise = 2.0 * rng.standard_normal(seen.shape, np.float32)
    return np.clip(0.8 * seen + 20 + noise, 0, 255).astype(np.uint8)


def written(path: Path, image: np.ndarray) -> None:
    cv2.imwrite(str(path), image, [cv2.IMWRITE_PNG_COMPRESSION, 0])  # noise takes long to compress


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """For each camera ten pictures of its own for the lens, and eleven of a board that all see; in one it moved."""
    root, rng, noise = tmp_path_factory.mktemp("pictures"), np.random.default_rng(3), np.random.default_rng(1)
    for each in CAMERAS:
        (root / each.name).mkdir()
    for k in range(11):
        T = LEVEL.copy()
        if k:
            middle = transform(np.eye(3), np.array([-BOARD.columns * BOARD.square / 2, -BOARD.height / 2, 0.0]))
            turn = from_rotation_vector(rng.uniform(-0.45, 0.45, 3))
            shift = np.array([0.24, -0.16, 0.0]) + rng.uniform(-0.18, 0.18, 3)
            T = LEVEL @ transform(turn, shift * (1, -1, 1)) @ middle
        for each in CAMERAS:
            moved = T if (each.name, k) != ("right", 7) else T @ transform(np.eye(3), np.array([0.05, 0.0, 0.0]))
            written(root / each.name / f"{k:02d}.png", picture(each, moved, noise))
    for each in CAMERAS:
        for k in range(10):
            at = np.array([(-0.35, 0, 0.35)[k % 3], (-0.18, 0, 0.18)[k // 3 % 3], 1.0]) * rng.uniform(0.55, 0.75)
            turn = rng.uniform(0.25, 0.6) * np.array([np.cos(2.4 * k), np.sin(2.4 * k), 0.0])
            T = each.T_world_camera @ transform(from_rotation_vector(turn), at) @ middle
            written(root / each.name / f"{each.name}_{k}.png", picture(each, T, noise))
    return root


def off(found: np.ndarray, wanted: np.ndarray) -> tuple[float, float]:
    """Distance [m] and angle [rad] between two places."""
    between = inverse(found) @ wanted
    return float(np.linalg.norm(between[:3, 3])), float(np.linalg.norm(rotation_vector(between[:3, :3])))


def test_cameras_are_found_where_they_stand(kinecast: Callable[..., Any], pictures: Path, tmp_path: Path) -> None:
    out, folders = tmp_path / "rig.yaml", [f"{each.name}={pictures / each.name}" for each in CAMERAS]
    options = ("--squares", "6x4", "--square", "0.08", "--height", "0.75")
    done = kinecast("calibrate", *folders, *options, "--out", out)
    assert done.code == 0, done.err
    rig = Rig.load(out)
    for each in CAMERAS:
        found = rig.cameras[each.name]
        distance, angle = off(found.T_world_camera, each.T_world_camera)
        assert distance < 0.008, each.name
        assert angle < 0.005, each.name
        assert abs(found.intrinsics.fx / LENS.fx - 1) < 0.01
    for line in done.out.splitlines()[1:4]:
        assert float(line.split()[3]) < 0.5  # pixels, for the lens
        assert float(line.split()[5]) < 0.5  # and for the place
    used = [int(line.split()[2]) for line in done.out.splitlines()[1:4]]
    assert 60 <= sum(used) <= 62  # of 63: what does not fit together is left out
    # With lenses that are known, to the millimetre.
    given = tmp_path / "given.yaml"
    given.write_text(Rig({each.name: each for each in CAMERAS}).to_yaml())
    done = kinecast("calibrate", *folders, *options, "--out", out, "--intrinsics", given, "--origin", "00.png")
    assert done.code == 0, done.err
    for each in CAMERAS:
        distance, angle = off(Rig.load(out).cameras[each.name].T_world_camera, each.T_world_camera)
        assert distance < 0.002, each.name
        assert angle < 0.002, each.name


def test_a_board_is_printed_at_its_size(kinecast: Callable[..., Any], tmp_path: Path) -> None:
    path = tmp_path / "board.png"
    assert kinecast("calibrate", "--board", path, "--squares", "6x4", "--square", "0.08").code == 0
    content = path.read_bytes()
    dots = int.from_bytes(content[content.index(b"pHYs") + 4 :][:4])
    page = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert page is not None
    corners = BOARD.corners(page)
    assert corners is not None
    assert len(corners.points) == 15
    scale = np.ptp(corners.pixels, axis=0) / np.ptp(corners.points[:, :2], axis=0)
    np.testing.assert_allclose(scale, dots, rtol=2e-3)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "at least one camera is needed"),
        (("left",), "left: expected NAME=FOLDER"),
        (("left=nowhere",), "nowhere: no such folder"),
        (("left={p}/left", "left={p}/left"), "left: is there twice"),
        (("left={p}/left", "--squares", "six"), "--squares six: expected two numbers"),
        (("left={p}/left", "--squares", "2x4"), "3 to 20 a side"),
        (("left={p}/left", "--square", "70"), "squares of 70 m are outside"),
        (("left={p}/left", "--squares", "7x5"), "is seen in none of 21 pictures"),
        (("left={p}/left", "--squares", "6x4", "--origin", "99"), "99: the board is not seen in this picture"),
        (("left={p}",), "0 pictures (.png"),
        (("left={p}/left", "--out", "rig.txt"), "must end in .yaml or .yml"),
        (("left={p}/few", "--squares", "6x4"), "left: the board is seen in 1 pictures, at least 6"),
        (("left={p}/left", "other={p}/other", "--squares", "6x4"), "no picture of the board at a moment that left saw"),
        (("left={p}/broken", "--squares", "6x4"), "00.png: no picture can be read from it"),
    ],
)
def test_what_is_wrong_is_said(
    arguments: tuple[str, ...], words: str, kinecast: Callable[..., Any], pictures: Path, tmp_path: Path
) -> None:
    level = (pictures / "left" / "00.png").read_bytes()
    for folder in ("few", "other", "broken"):
        (pictures / folder).mkdir(exist_ok=True)
    (pictures / "few" / "00.png").write_bytes(level)
    (pictures / "broken" / "00.png").write_bytes(level[:1000])
    for path in (pictures / "right").glob("*.png"):
        (pictures / "other" / f"x{path.name}").write_bytes(path.read_bytes())
    out = () if "--out" in arguments else ("--out", tmp_path / "rig.yaml")
    done = kinecast("calibrate", *(argument.format(p=pictures) for argument in arguments), *out)
    assert done.code == 2
    assert words in " ".join(done.err.split())
    assert not (tmp_path / "rig.yaml").exists()
