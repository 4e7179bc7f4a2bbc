"""Keypoints by small networks whose answer is known; files that are no such network; who is who from image to image."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from kinecast.body.skeleton import ARM_JOINTS, COCO_17, JOINTS
from kinecast.cameras.onnx_model import ImageModel
from kinecast.cameras.people_tracker import DETECT_EVERY, MOST_PEOPLE, PeopleTracker, PersonDetector
from kinecast.cameras.pose_estimator import PoseEstimator
from kinecast.errors import ModelError

PERSON = np.array(
    [(320, 90), (327, 83), (313, 83), (337, 88), (303, 88), (360, 150), (280, 150), (375, 215), (262, 218), (380, 280),
     (230, 260), (345, 290), (295, 290), (348, 370), (292, 372), (350, 440), (290, 442)], dtype=float,
)  # fmt: skip
"""COCO's 17 [px], of somebody in the middle of 640 x 480."""
BOX = np.array([220.0, 70.0, 390.0, 460.0])
WHOLE = np.array([0.0, 0.0, 640.0, 480.0])


def black() -> np.ndarray:
    return np.zeros((480, 640, 3), np.uint8)


@pytest.mark.parametrize(("heatmaps", "off"), [(False, 0.6), (True, 0.8)])
def test_keypoints_are_where_the_colours_are(
    blob_network: Callable[..., Path], blobs: Callable[..., np.ndarray], heatmaps: bool, off: float
) -> None:
    estimator = PoseEstimator(blob_network(17, heatmaps))
    assert estimator.joints == COCO_17.joints
    image = blobs(black(), PERSON)
    keypoints = estimator.estimate(image, BOX)
    assert keypoints.seen.all()
    pixel = 390 * 1.25 / 128  # of the network, in the image's
    np.testing.assert_allclose(keypoints.pixels, PERSON, atol=off * pixel)
    assert np.abs((keypoints.pixels - PERSON).mean(axis=0)).max() < 0.3 * pixel
    again = estimator.estimate(image, BOX + np.array([-60, -20, 10, 90]))  # whatever the box
    np.testing.assert_allclose(again.pixels, keypoints.pixels, atol=2 * off * pixel)


def test_what_is_hidden_is_not_seen_and_what_is_seen_is_as_sure_as_people_are(
    blob_network: Callable[..., Path], blobs: Callable[..., np.ndarray]
) -> None:
    estimator = PoseEstimator(blob_network(17))
    hidden = np.where(np.arange(17)[:, None] == 9, np.nan, PERSON)
    keypoints = estimator.estimate(blobs(black(), hidden), BOX)
    assert [joint for joint, seen in zip(estimator.joints, keypoints.seen, strict=True) if not seen] == ["left_wrist"]
    area = 0.53 * np.prod(np.ptp(keypoints.pixels[keypoints.seen], axis=0))
    wrist = estimator.joints.index("right_wrist")
    assert keypoints.pixel_std[wrist] == pytest.approx(0.062 * np.sqrt(area / 2))
    nobody = estimator.estimate(black(), WHOLE)
    assert not nobody.seen.any()
    assert np.isfinite(nobody.pixel_std).all()


@pytest.mark.parametrize(("keypoints", "extra"), [(26, {"neck", "pelvis", "left_heel"}), (133, {"left_hand"})])
def test_other_keypoints_have_their_names(keypoints: int, extra: set[str], tmp_path: Path) -> None:
    network(tmp_path / "pose.onnx", {"simcc_y": (1, keypoints, 128), "simcc_x": (1, keypoints, 96)}, (1, 3, 64, 48))
    estimator = PoseEstimator(tmp_path / "pose.onnx")
    assert set(ARM_JOINTS) | extra < set(estimator.joints) <= set(JOINTS)
    assert len(set(estimator.joints)) == len(estimator.joints)


def network(
    path: Path,
    outputs: dict[str, tuple[int, ...]],
    image: tuple[int | str, ...] = (1, 3, 64, 64),
    kind: int = TensorProto.FLOAT,
    value: float = 0.0,
) -> None:
    """Writes a network that always gives the same number."""
    shapes = [numpy_helper.from_array(np.array(shape), f"of_{name}") for name, shape in outputs.items()]
    number = numpy_helper.from_array(np.array([value], np.float32), "number")
    nodes = [helper.make_node("Expand", ["number", f"of_{name}"], [name]) for name in outputs]
    graph = helper.make_graph(
        nodes,
        "constant",
        [helper.make_tensor_value_info("image", kind, image)],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in outputs.items()],
        [*shapes, number],
    )
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)


SIMCC = {"simcc_x": (1, 17, 128), "simcc_y": (1, 17, 128)}


@pytest.mark.parametrize(
    ("outputs", "image", "kind", "words"),
    [
        ({"boxes": (1, 17, 6)}, (1, 3, 64, 64), TensorProto.FLOAT, "expected simcc_x and simcc_y, or heatmaps"),
        ({"simcc_x": (1, 17, 100), "simcc_y": (1, 17, 128)}, (1, 3, 64, 64), TensorProto.FLOAT, "expected simcc_x"),
        ({"simcc_x": (1, 17, 128), "simcc_y": (1, 18, 128)}, (1, 3, 64, 64), TensorProto.FLOAT, "expected simcc_x"),
        ({"simcc_x": (1, 21, 128), "simcc_y": (1, 21, 128)}, (1, 3, 64, 64), TensorProto.FLOAT, "21 keypoints; known"),
        ({"maps": (1, 17, 1000, 1000)}, (1, 3, 64, 64), TensorProto.FLOAT, "more than 16777216 numbers"),
        (SIMCC, (1, 3, "high", 64), TensorProto.FLOAT, "64 x high pixels; both must be fixed, 16..2048"),
        (SIMCC, (1, 3, 64, 100_000), TensorProto.FLOAT, "100000 x 64 pixels"),
        (SIMCC, (1, 1, 64, 64), TensorProto.FLOAT, "expected one image of 3 channels"),
        (SIMCC, (4, 3, 64, 64), TensorProto.FLOAT, "expected one image of 3 channels"),
        (SIMCC, (64, 64, 3), TensorProto.FLOAT, "expected one float image"),
        (SIMCC, (1, 3, 64, 64), TensorProto.UINT8, "image tensor(uint8) [1, 3, 64, 64]; expected one float image"),
    ],
)
def test_another_network_is_refused_when_it_is_loaded(
    outputs: dict[str, tuple[int, ...]], image: tuple[int | str, ...], kind: int, words: str, tmp_path: Path
) -> None:
    path = tmp_path / "model.onnx"
    network(path, outputs, image, kind)
    with pytest.raises(ModelError) as caught:
        PoseEstimator(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_no_network_is_refused_and_no_other_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "model.onnx"
    with pytest.raises(ModelError, match="No such file"):
        ImageModel(path)
    with pytest.raises(ModelError, match="Is a directory"):
        ImageModel(tmp_path)
    network(path, SIMCC)
    good = path.read_bytes()
    for content in (b"", b"\x00" * 100, os.urandom(5000), good[: len(good) // 2], b"onnx: see attached"):
        path.write_bytes(content)
        with pytest.raises(ModelError, match="onnxruntime cannot load it"):
            ImageModel(path)
    (tmp_path / "weights.bin").write_bytes(bytes(4))
    model = onnx.load_from_string(good)
    number = next(each for each in model.graph.initializer if each.name == "number")
    number.ClearField("raw_data")
    number.data_location = TensorProto.EXTERNAL
    number.external_data.add(key="location", value="weights.bin")
    path.write_bytes(model.SerializeToString())
    with pytest.raises(ModelError, match="onnxruntime cannot load it"):
        ImageModel(path)


# Where people are


def bright_detector(path: Path) -> Path:
    """Writes a YOLOX of 128 x 128 px that finds a person of 40 x 80 px wherever a cell of 8 px is bright."""
    y, x = 8 * np.indices((16, 16)).reshape(2, -1) + 4
    boxes = np.stack([x - 20, y - 40, x + 20, y + 40], axis=1)[None].astype(np.float32)
    nodes = [
        helper.make_node("AveragePool", ["image"], ["pooled"], kernel_shape=[8, 8], strides=[8, 8]),
        helper.make_node("ReduceMean", ["pooled"], ["bright"], axes=[1]),
        helper.make_node("Reshape", ["bright", "flat"], ["cells"]),
        helper.make_node("Mul", ["cells", "unit"], ["scores"]),
        helper.make_node("Concat", ["boxes", "scores"], ["dets"], axis=2),
    ]
    constants = {"flat": np.array([1, 256, 1]), "unit": np.array(1 / 255, np.float32), "boxes": boxes}
    return written(path, nodes, constants, (1, 3, 128, 128), {"dets": (1, 256, 5)})


def blue_detector(path: Path) -> Path:
    """Writes an RTMDet of 64 x 64 px with two boxes, whose scores are what is blue on the left and on the right."""
    boxes = np.array([[[0, 0, 30, 40], [34, 0, 64, 40]]], np.float32)
    nodes = [
        helper.make_node("Slice", ["image", "zero", "one", "channel"], ["blue"]),
        helper.make_node("AveragePool", ["blue"], ["halves"], kernel_shape=[48, 32], strides=[48, 32]),
        helper.make_node("Reshape", ["halves", "column"], ["scores"]),
        helper.make_node("Concat", ["boxes", "scores"], ["dets"], axis=2),
        helper.make_node("Identity", ["classes"], ["labels"]),
    ]
    constants = {
        "zero": np.array([0]), "one": np.array([1]), "channel": np.array([1]), "column": np.array([1, 2, 1]),
        "boxes": boxes, "classes": np.array([[0.0, 0.0]], np.float32),
    }  # fmt: skip
    return written(path, nodes, constants, (1, 3, 64, 64), {"dets": (1, 2, 5), "labels": (1, 2)})


def written(
    path: Path,
    nodes: list[onnx.NodeProto],
    constants: dict[str, np.ndarray],
    image: tuple[int, ...],
    outputs: dict[str, tuple[int, ...]],
) -> Path:
    graph = helper.make_graph(
        nodes,
        "detector",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, image)],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in outputs.items()],
        [numpy_helper.from_array(value, name) for name, value in constants.items()],
    )
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
    return path


def test_yolox_finds_boxes_the_surest_first(tmp_path: Path) -> None:
    detector = PersonDetector(bright_detector(tmp_path / "yolox_tiny.onnx"))
    image = black()
    image[200:240, 120:160] = 255  # of the network's pixels 5, cells at (3, 5)
    image[320:360, 480:520] = 240  # cells at (12, 8)
    image[0:40, 0:40] = 100  # too dim
    boxes = detector.find(image)
    np.testing.assert_allclose(boxes, [[40, 20, 240, 420], [400, 140, 600, 480]], atol=1)
    assert not len(detector.find(black()))


def test_rtmdet_takes_blue_first_less_the_mean(tmp_path: Path) -> None:
    detector = PersonDetector(blue_detector(tmp_path / "rtmdet_nano.onnx"))
    image = black()
    image[:, :320, 2] = 103.53 + 0.6 * 57.375
    image[:, 320:, :2] = 255  # red and green are not looked at
    np.testing.assert_allclose(detector.find(image), [[0, 0, 300, 400]])


@pytest.mark.parametrize(
    ("name", "outputs", "words"),
    [
        ("person.onnx", {"dets": (1, 5, 5)}, "must say whether it is a yolox or an rtmdet"),
        ("yolox.onnx", {"dets": (1, 5, 4)}, "gives (1, 5, 4); expected boxes with scores"),
        ("rtmdet.onnx", {"cells": (1, 84, 85)}, "gives (1, 84, 85); expected boxes with scores"),
    ],
)
def test_another_detector_is_refused(
    name: str, outputs: dict[str, tuple[int, ...]], words: str, tmp_path: Path
) -> None:
    network(tmp_path / name, outputs)
    with pytest.raises(ModelError) as caught:
        PersonDetector(tmp_path / name)
    assert words in str(caught.value)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e30])
def test_numbers_that_are_none_find_nobody_and_raise_nothing(value: float, tmp_path: Path) -> None:
    network(tmp_path / "yolox.onnx", {"dets": (1, 3, 5)}, value=value)
    network(tmp_path / "pose.onnx", SIMCC, value=value)
    people = PeopleTracker(PoseEstimator(tmp_path / "pose.onnx"), PersonDetector(tmp_path / "yolox.onnx"))
    assert people.update(black()) == {}


def test_one_person_is_followed_without_a_detector_lost_and_found(
    blob_network: Callable[..., Path], blobs: Callable[..., np.ndarray]
) -> None:
    tracker = PeopleTracker(PoseEstimator(blob_network(17)))
    for step in range(12):
        moved = PERSON + np.array([9.0 * step, 0.0])
        found = tracker.update(blobs(black(), moved, 10.0))
        assert list(found) == ["0"]
        np.testing.assert_allclose(found["0"].pixels[5:], moved[5:], atol=5 if step else 10)
    assert tracker.update(black()) == {}
    assert list(tracker.update(blobs(black(), PERSON - np.array([120.0, 0.0]), 10.0))) == ["1"]


def test_several_are_followed_with_a_detector(
    blob_network: Callable[..., Path], blobs: Callable[..., np.ndarray], tmp_path: Path
) -> None:
    """Two with the same colours: each box shows one of them."""
    detector = PersonDetector(bright_detector(tmp_path / "yolox.onnx"))
    tracker = PeopleTracker(PoseEstimator(blob_network(17)), detector)

    def seen(*offsets: int) -> dict[str, float]:
        image = black()
        for offset in offsets:
            blobs(image, PERSON * 0.8 + np.array([offset, 20.0]), 5.0)
            image[200:256, 236 + offset : 276 + offset] = 255  # a bright shirt, for the detector
            blobs(image, PERSON * 0.8 + np.array([offset, 20.0]), 5.0)
        return {name: np.nanmean(each.pixels[:, 0]) for name, each in tracker.update(image).items()}

    first = seen(-150, 150)
    assert len(first) == 2
    left = min(first, key=lambda name: first[name])
    for step in range(1, 6):
        now = seen(-150 + 4 * step, 150 - 4 * step)
        assert set(now) == set(first)
        assert now[left] == pytest.approx(first[left] + 4 * step, abs=4)
    for _ in range(DETECT_EVERY):
        alone = seen(-130)
    assert list(alone) == [left]
    for _ in range(DETECT_EVERY):
        both = seen(-130, 130)
    assert len(both) == 2
    assert set(both).isdisjoint(set(first) - {left})  # a new name for who comes back
    assert len(both) <= MOST_PEOPLE
