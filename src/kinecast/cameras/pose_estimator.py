"""Keypoints of one person in a box of an image, by a network of the RTMPose kind.

Source of what goes in and comes out: RTMPose (Jiang et al. 2023) as mmpose trains and exports it: crops of 1.25 times
the box in the network's own ratio, RGB less ImageNet's mean, and for each keypoint either two vectors over x and y
(SimCC, Li et al. 2022) or a heatmap, as HRNet and ViTPose give.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from kinecast.body.skeleton import COCO_17
from kinecast.cameras.keypoints import detection
from kinecast.cameras.onnx_model import IMAGENET_MEAN, IMAGENET_STD, ImageModel
from kinecast.errors import ModelError
from kinecast.live.detection import Detection

PADDING = 1.25
FINEST = 8  # most SimCC bins in a pixel; RTMPose has 2

_FEET = ("left_foot", None, "left_heel", "right_foot", None, "right_heel")
_NAMES: dict[int, tuple[str | None, ...]] = {
    17: COCO_17.joints,
    # Halpe: its head is the top of the head, which is none of our joints; big and small toes, heels
    26: (*COCO_17.joints, None, "neck", "pelvis", "left_foot", "right_foot", None, None, "left_heel", "right_heel"),
    # COCO-WholeBody: 68 points of the face, 21 of each hand, of which the middle finger's knuckle is the hand
    133: (*COCO_17.joints, *_FEET, *(None,) * 68, *((None,) * 9 + ("left_hand",) + (None,) * 11),
          *((None,) * 9 + ("right_hand",) + (None,) * 11)),
}  # fmt: skip
"""Joint of each keypoint, by how many there are; of None nothing is made."""


class PoseEstimator:
    """A network for 17 (COCO), 26 (Halpe) or 133 (COCO-WholeBody) keypoints, in an ONNX file, else a ModelError.

    Its joints are the canonical names of the keypoints that have one.
    """

    def __init__(self, path: Path) -> None:
        self.model = ImageModel(path)
        count = self._check()
        if count not in _NAMES:
            known = ", ".join(map(str, _NAMES))
            raise ModelError(f"{path}: {count} keypoints; known are {known} (COCO, Halpe, COCO-WholeBody)")
        self._columns = [column for column, joint in enumerate(_NAMES[count]) if joint is not None]
        self.joints = tuple(joint for joint in _NAMES[count] if joint is not None)

    def estimate(self, image: UInt8[np.ndarray, "h w 3"], box: Float[np.ndarray, " 4"]) -> Detection:
        """The joints of whoever is in a box (left, top, right, bottom) [px] of an RGB image; or a ModelError."""
        middle, size = (box[:2] + box[2:]) / 2, np.maximum(box[2:] - box[:2], 1.0) * PADDING
        inside = np.array([self.model.width, self.model.height])
        scale = float((size / inside).max())
        corner = middle - scale * inside / 2
        outputs = self.model.run((self.model.window(image, corner, scale) - IMAGENET_MEAN) / IMAGENET_STD)
        places, confidence = self._peaks(outputs)
        found = detection(self.joints, corner + scale * places[self._columns], confidence[self._columns])
        return replace(found, pixel_std=np.maximum(found.pixel_std, scale / 2))

    def _peaks(self, outputs: list[np.ndarray]) -> tuple[Float[np.ndarray, "K 2"], Float[np.ndarray, " K"]]:
        """Where each keypoint is in the crop [px], and the height of its peak, 0..1."""
        if len(outputs) == 1:  # heatmaps: the peak is moved a quarter towards the higher neighbour
            maps = outputs[0][0]
            _, height, width = maps.shape
            flat, k = maps.reshape(len(maps), -1), np.arange(len(maps))
            y, x = np.divmod(flat.argmax(axis=1), width)
            around = np.pad(maps, ((0, 0), (1, 1), (1, 1)), mode="edge")
            step_x = np.sign(around[k, y + 1, x + 2] - around[k, y + 1, x]) * ((x > 0) & (x < width - 1))
            step_y = np.sign(around[k, y + 2, x + 1] - around[k, y, x + 1]) * ((y > 0) & (y < height - 1))
            places = np.stack([x + 0.25 * step_x, y + 0.25 * step_y], axis=1)
            places, heights = places * (self.model.width / width, self.model.height / height), flat.max(axis=1)
        else:
            both = [outputs[place][0] for place in self._order]
            places = np.stack([each.argmax(axis=1) for each in both], axis=1) / self._bins
            heights = np.minimum(both[0].max(axis=1), both[1].max(axis=1))
        return places.astype(np.float64), np.clip(np.nan_to_num(heights.astype(np.float64)), 0.0, 1.0)

    def _check(self) -> int:
        """How many keypoints the network gives."""
        shapes = [each.shape for each in self.model.sample]
        if len(shapes) == 1 and len(shapes[0]) == 4 and shapes[0][0] == 1:
            return shapes[0][1]
        if len(shapes) == 2 and all(len(shape) == 3 and shape[0] == 1 for shape in shapes):
            self._order = (1, 0) if self.model.outputs[0].endswith("_y") else (0, 1)
            (_, count, wide), (_, same, high) = (shapes[place] for place in self._order)
            self._bins = wide / self.model.width
            fits = self._bins == high / self.model.height and self._bins in range(1, FINEST + 1)
            if fits and count == same:
                return count
        found = ", ".join(f"{name} {shape}" for name, shape in zip(self.model.outputs, shapes, strict=True))
        raise ModelError(f"{self.model.path}: gives {found[:200]}; expected simcc_x and simcc_y, or heatmaps")
