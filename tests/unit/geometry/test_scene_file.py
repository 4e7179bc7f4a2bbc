"""Scene files: what they mean, and that nothing wrong passes silently."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from kinecast.errors import DatasetError
from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Box, Capsule, HalfSpace, MovingObstacle, Sphere

from .conftest import distances


def test_the_shipped_example_holds_every_kind_of_entry() -> None:
    example = files("kinecast") / "data" / "example_scene.yaml"
    scene = Scene.from_yaml(example.read_text(encoding="utf-8"), "example")
    kinds = [type(o.shape if isinstance(o, MovingObstacle) else o) for o in scene.obstacles]
    assert kinds == [Box, HalfSpace, Box, Box, Box, Sphere, Capsule]
    assert {name: type(goal) for name, goal in scene.goals.items()} == {"red_cube": Sphere, "tray": Box}
    above_and_below = np.array([[[0.5, 0.0, 0.95], [0.5, 0.0, 0.85]]])
    np.testing.assert_allclose(distances(scene, above_and_below, np.zeros(1)), [[0.05, 0.01]], atol=1e-12)


@pytest.mark.parametrize(
    ("text", "point", "distance"),
    [
        ("table: {height: 0.75}", [9.0, 9.0, 1.0], 0.25),
        ("table: {height: 0.75, center: [0, 0], extent: [2, 2]}", [0.0, 0.0, 0.5], 0.21),  # under a 4 cm slab
        ("table: {height: 0.75, center: [0, 0], extent: [2, 2], thickness: 0.1}", [0.0, 0.0, 0.5], 0.15),
        ("table: {point: [0, 0, 1], normal: [0, 0, 2]}", [0.0, 0.0, 3.0], 2.0),
        ("planes: [{point: [2, 0, 0], normal: [-1, 0, 0]}]", [0.0, 0.0, 0.0], 2.0),
        ("boxes: [{center: [0, 0, 0], size: [2, 2, 2], yaw_degrees: 45}]", [2.0, 0.0, 0.0], 2 - np.sqrt(2)),
        ("boxes: [{center: [0, 0, 0], size: [2, 4, 2], quaternion: [1, 0, 0, 1]}]", [3.0, 0.0, 0.0], 1.0),
        ("spheres: [{center: [1, 0, 0], radius: 0.5}]", [0.0, 0.0, 0.0], 0.5),
        ("capsules: [{start: [0, 0, 0], end: [0, 0, 1], radius: 0.5}]", [2.0, 0.0, 0.5], 1.5),
    ],
)
def test_entries(text: str, point: list[float], distance: float) -> None:
    found = distances(Scene.from_yaml(text), np.array([[point]]), np.zeros(1))
    assert found[0, 0] == pytest.approx(distance, abs=1e-12)


@pytest.mark.parametrize(
    "motion",
    [
        "boxes: [{center: [0, 0, 0], size: [1, 1, 1], velocity: [0, 0.5, 0]}]",
        "boxes: [{size: [1, 1, 1], waypoints: [{time: 0, position: [0, 0, 0]}, {time: 4, position: [0, 2, 0]}]}]",
    ],
)
def test_boxes_move(motion: str) -> None:
    origin = np.zeros((2, 1, 3))
    found = distances(Scene.from_yaml(motion), origin, np.array([0.0, 4.0]))
    np.testing.assert_allclose(found[:, 0], [-0.5, 1.5])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"s\.yaml: expected entries `key: value`, found None"),
        ("- 1", r"s\.yaml: expected entries"),
        ("tabel: {height: 1}", r"s\.yaml: unknown entry 'tabel'; allowed: table, planes, boxes, spheres"),
        (
            "table: {height: 750}",
            r"s\.yaml, table\.height: 750 m is outside -100\.\.100; lengths are in metres",
        ),
        ("table: {height: high}", r"table\.height: expected a number m, found 'high'"),
        ("table: {height: true}", r"table\.height: expected a number m, found True"),
        ("table: {height: .nan}", r"table\.height: nan m is outside"),
        ("table: {height: 1, thickness: 0.1}", r"table: unknown entry 'thickness'; allowed: height"),
        ("table: {height: 1, extent: [1, 1]}", r"table: `center` is missing; found: height, extent"),
        ("table: {height: 1, center: [0, 0], extent: [1]}", r"table\.extent: expected a list of 2 numbers m"),
        ("table: {height: 1, center: [0, 0], extent: [1, -1]}", r"table: box size"),
        ("boxes: {center: [0, 0, 0]}", r"boxes: expected a list of entries"),
        ("boxes: [5]", r"boxes\[0\]: expected entries `key: value`, found 5"),
        (
            "boxes: [{center: [0, 0, x], size: [1, 1, 1]}]",
            r"boxes\[0\]\.center\[2\]: expected a number m, found 'x'",
        ),
        ("boxes: [{center: [0, 0, 0], sise: [1, 1, 1]}]", r"boxes\[0\]: unknown entry 'sise'"),
        (
            "boxes: [{center: [0, 0, 0], size: [1, 1, 1], waypoints: []}]",
            r"boxes\[0\]\.center: `center` and `waypoints` exclude each other",
        ),
        ("boxes: [{size: [1, 1, 1], waypoints: []}]", r"boxes\[0\]: waypoints"),
        (
            "boxes: [{size: [1, 1, 1], waypoints: [{time: 1, position: [0, 0, 0]}, {time: 0, position: [0, 0, 0]}]}]",
            r"boxes\[0\]: waypoints: times must increase",
        ),
        (
            "boxes: [{center: [0, 0, 0], size: [1, 1, 1], yaw_degrees: 1, quaternion: [1, 0, 0, 0]}]",
            r"exclude each other",
        ),
        (
            "boxes: [{center: [0, 0, 0], size: [1, 1, 1], quaternion: [0, 0, 0, 0]}]",
            r"boxes\[0\]: a quaternion of length zero",
        ),
        (
            "spheres: [{center: [0, 0, 0], radius: -1}]",
            r"spheres\[0\]: sphere radius -1\.0 m must be above 0",
        ),
        ("planes: [{point: [0, 0, 0], normal: [0, 0, 0]}]", r"planes\[0\]: half-space normal"),
        ("goals: [1]", r"goals: expected entries `name: \.\.\.`"),
        ("goals: {1: {center: [0, 0, 0], radius: 1}}", r"goals: a name must be text, found 1"),
        ("goals: {cup: {center: [0, 0, 0]}}", r"goals\.cup: `size` is missing"),
        (
            "goals: {cup: {center: [0, 0, 0], radius: 1, velocity: [1, 0, 0]}}",
            r"goals\.cup: unknown entry 'velocity'",
        ),
        ("boxes: []\nspheres: []\nboxes: []", r"s\.yaml, line 3: `boxes` is given twice"),
        ("table: {height: 1\n", r"s\.yaml, line 2: not valid YAML"),
        (
            "table: !!python/object/apply:os.system ['true']",
            r"not valid YAML: could not determine a constructor",
        ),
        ("a: &x [1]\nb: *x", r"line 2: aliases"),
        ("a: " + "[" * 5000, r"line 1: nested deeper than 8 levels"),
        ("a: " + "9" * 5000, r"line 1: a whole number of 5000 digits"),
        ("table: {height: 0x" + "F" * 5000 + "}", r"line 1: a whole number of 5002 digits"),
        ("table: {height: 1}\n---\ntable: {height: 2}", r"not valid YAML: but found another document"),
    ],
)
def test_a_wrong_scene_is_an_error_that_names_the_place(text: str, message: str) -> None:
    with pytest.raises(DatasetError, match=message):
        Scene.from_yaml(text, "s.yaml")


def test_too_many_entries_are_refused() -> None:
    ball = "{center: [0, 0, 0], radius: 1}"
    with pytest.raises(DatasetError, match="1001 entries, at most 1000"):
        Scene.from_yaml("spheres: [" + ", ".join([ball] * 1001) + "]")


def test_files_that_are_not_there_or_not_text(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"none\.yaml: no such file"):
        Scene.load(tmp_path / "none.yaml")
    with pytest.raises(DatasetError, match="no such file"):
        Scene.load(tmp_path)
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"table: \xff\xfe")
    with pytest.raises(DatasetError, match="byte 7 is not UTF-8"):
        Scene.load(binary)
    huge = tmp_path / "huge.yaml"
    with huge.open("wb") as file:
        file.truncate(2_000_000_000)  # sparse: read no more than the limit
    with pytest.raises(DatasetError, match="at most 1000000 bytes"):
        Scene.load(huge)


def test_load_reads_a_file_with_a_byte_order_mark(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_bytes(b"\xef\xbb\xbftable: {height: 0.7}\n")
    assert len(Scene.load(path).obstacles) == 1
