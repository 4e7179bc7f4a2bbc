"""Boxes around people, by a network of the RTMDet or YOLOX kind.

Source of what goes in and comes out: mmdeploy's exports of RTMDet and YOLOX, which end in non-maximum suppression, and
YOLOX's own (Ge et al. 2021), which do not. The image stands in the upper left of the network's, grey (114) elsewhere,
blue before red; RTMDet takes it less ImageNet's mean, YOLOX as it is.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from kinecast.cameras.onnx_model import ImageModel
from kinecast.cameras.pose_estimator import MEAN, SCALE
from kinecast.errors import MissingExtraError, ModelError

try:
    import cv2
except ImportError as error:  # pragma: no cover - the tests install it
    raise MissingExtraError("cameras", "camera") from error

__all__ = ["PersonDetector", "overlaps"]

LEAST_SCORE = 0.5
MOST_OVERLAP = 0.45
"""Of two boxes, intersection over union; the weaker one is dropped beyond it, as YOLOX does."""
MOST_BOXES = 100
"""That are compared."""
SMALLEST = 16.0
"""Of a box, each side [px]."""
GREY = 114
STRIDES = (8, 16, 32)
PERSON = 0
"""COCO's class."""


class PersonDetector:
    """RTMDet or YOLOX.

    Args:
        path: its ONNX file. `yolox` or `rtmdet` in its name tells which.

    Raises:
        ModelError: it is no such network.
    """

    def __init__(self, path: Path) -> None:
        name = path.name.lower()
        if ("yolox" in name) == ("rtmdet" in name):
            raise ModelError(f"{path}: a detector's name must say whether it is a yolox or an rtmdet")
        self._raw = "yolox" in name
        self._model = ImageModel(path)
        shape = self._model.sample[0].shape
        self._grid, self._stride = self._cells()
        plain = len(shape) == 3 and shape[1] == len(self._grid) and shape[2] >= 6 and self._raw
        if not plain and not (len(shape) == 3 and shape[0] == 1 and shape[2] == 5):
            raise ModelError(f"{path}: gives {shape}; expected boxes with scores after suppression, or YOLOX's cells")
        self._plain = plain

    def find(self, image: UInt8[np.ndarray, "h w 3"]) -> Float[np.ndarray, "N 4"]:
        """(N, 4) left, top, right, bottom of people [px], the surest first.

        Args:
            image: red, green, blue.

        Raises:
            ModelError: the network fails.
        """
        high, wide = image.shape[:2]
        scale = min(self._model.height / high, self._model.width / wide)
        inside = cv2.resize(image, (max(int(wide * scale), 1), max(int(high * scale), 1)))
        content = np.full((self._model.height, self._model.width, 3), GREY, dtype=np.float32)
        content[: inside.shape[0], : inside.shape[1]] = inside
        if not self._raw:
            content = (content - MEAN) / SCALE
        outputs = self._model.run(content[..., ::-1])
        boxes, scores = self._cell_boxes(outputs[0][0]) if self._plain else self._boxes(outputs)
        boxes = np.clip(boxes / scale, 0.0, (wide, high, wide, high))
        large = (boxes[:, 2:] - boxes[:, :2] >= SMALLEST).all(axis=1)  # also drops what is NaN
        sure = np.flatnonzero(large & (scores >= LEAST_SCORE))
        return _apart(boxes[sure[np.argsort(-scores[sure], kind="stable")]][:MOST_BOXES])

    def _boxes(self, outputs: list[np.ndarray]) -> tuple[Float[np.ndarray, "N 4"], Float[np.ndarray, " N"]]:
        """Boxes in the network's pixels and scores of people, after suppression."""
        found = outputs[0][0].astype(np.float64)
        if len(outputs) > 1 and outputs[1].size == len(found):
            found = found[outputs[1].ravel() == PERSON]
        return found[:, :4], found[:, 4]

    def _cell_boxes(self, cells: Float[np.ndarray, "M C"]) -> tuple[Float[np.ndarray, "N 4"], Float[np.ndarray, " N"]]:
        """Boxes in the network's pixels and scores of people, from YOLOX's cells."""
        scores = cells[:, 4].astype(np.float64) * cells[:, 5 + PERSON]
        few = np.argsort(-scores, kind="stable")[:MOST_BOXES]
        cell, stride = cells[few].astype(np.float64), self._stride[few, None]
        middle = (cell[:, :2] + self._grid[few]) * stride
        half = np.exp(np.clip(cell[:, 2:4], -20.0, 20.0)) * stride / 2
        return np.hstack([middle - half, middle + half]), scores[few]

    def _cells(self) -> tuple[Float[np.ndarray, "N 2"], Float[np.ndarray, " N"]]:
        """(N, 2) column and row of each of YOLOX's cells, and (N,) its size [px]."""
        grids, strides = [], []
        for stride in STRIDES:
            rows, columns = np.indices((self._model.height // stride, self._model.width // stride))
            grids.append(np.stack([columns.ravel(), rows.ravel()], axis=1))
            strides.append(np.full(rows.size, float(stride)))
        return np.concatenate(grids).astype(np.float64), np.concatenate(strides)


def overlaps(box: Float[np.ndarray, " 4"], others: Float[np.ndarray, "N 4"]) -> Float[np.ndarray, " N"]:
    """(N,) intersection over union of a box with others."""
    sides = np.minimum(box[2:], others[:, 2:]) - np.maximum(box[:2], others[:, :2])
    common = np.maximum(sides, 0.0).prod(axis=1)
    union = (box[2:] - box[:2]).prod() + (others[:, 2:] - others[:, :2]).prod(axis=1) - common
    return common / np.maximum(union, 1e-9)


def _apart(boxes: Float[np.ndarray, "N 4"]) -> Float[np.ndarray, "M 4"]:
    """Those that no surer one overlaps too much; the surest come first."""
    kept: list[int] = []
    for place, box in enumerate(boxes):
        if not (overlaps(box, boxes[kept]) > MOST_OVERLAP).any():
            kept.append(place)
    return boxes[kept]
