"""Who is where in the images of one camera, from one image to the next: a person detector, and a pose in each box.

Source of what a detector takes and gives: mmdeploy's exports of RTMDet and YOLOX, which end in non-maximum suppression.
The image stands in the upper left of the network's, grey (114) elsewhere, blue before red; RTMDet takes it less
ImageNet's mean, YOLOX as it is.
"""

from __future__ import annotations

from itertools import count
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from kinecast.cameras.keypoints import overlaps
from kinecast.cameras.onnx_model import IMAGENET_MEAN, IMAGENET_STD, ImageModel
from kinecast.cameras.pose_estimator import PoseEstimator
from kinecast.errors import ModelError
from kinecast.live.detection import Detection

LEAST_SCORE = 0.5
SMALLEST = 16.0  # of a box, each side [px]
GREY = 114
PERSON = 0  # COCO's class
MOST_PEOPLE = 4  # in one image: each costs a run of the network
DETECT_EVERY = 10  # images from one look at the whole image to the next, while somebody is followed
LEAST_SEEN = 4  # joints by which somebody is followed: an arm and a shoulder
SAME = 0.3  # boxes that overlap by so much (intersection over union) are of one person
MARGIN = 1.25  # a person's box around what was seen of them: most of the head and the hands are outside, and they move


class PersonDetector:
    """Boxes around people, by RTMDet or YOLOX: `rtmdet` or `yolox` in the name of its ONNX file tells which."""

    def __init__(self, path: Path) -> None:
        name = path.name.lower()
        if ("yolox" in name) == ("rtmdet" in name):
            raise ModelError(f"{path}: a detector's name must say whether it is a yolox or an rtmdet")
        self._yolox = "yolox" in name
        self._model = ImageModel(path)
        shape = self._model.sample[0].shape
        if len(shape) != 3 or shape[0] != 1 or shape[2] != 5:
            raise ModelError(f"{path}: gives {shape}; expected boxes with scores after suppression")

    def find(self, image: UInt8[np.ndarray, "h w 3"]) -> Float[np.ndarray, "N 4"]:
        """(N, 4) left, top, right, bottom of people [px] in an RGB image, the surest first; may raise a ModelError."""
        high, wide = image.shape[:2]
        scale = max(high / self._model.height, wide / self._model.width)
        content = self._model.window(image, np.full(2, (scale - 1) / 2), scale, GREY)
        if not self._yolox:
            content = (content - IMAGENET_MEAN) / IMAGENET_STD
        outputs = self._model.run(content[..., ::-1])
        found = outputs[0][0].astype(np.float64)
        if len(outputs) > 1 and outputs[1].size == len(found):
            found = found[outputs[1].ravel() == PERSON]
        boxes, scores = np.clip(found[:, :4] * scale, 0.0, (wide, high, wide, high)), found[:, 4]
        large = (boxes[:, 2:] - boxes[:, :2] >= SMALLEST).all(axis=1)  # also drops what is NaN
        sure = np.flatnonzero(large & (scores >= LEAST_SCORE))
        return boxes[sure[np.argsort(-scores[sure], kind="stable")]]


class PeopleTracker:
    """Runs a pose estimator where people are.

    Without a detector it follows one person: in the whole image first, then around where they were.
    """

    def __init__(self, estimator: PoseEstimator, detector: PersonDetector | None = None) -> None:
        self.estimator = estimator
        self._detector = detector
        self._boxes: dict[str, Float[np.ndarray, " 4"]] = {}
        self._names = count()
        self._since = 0

    def update(self, image: UInt8[np.ndarray, "h w 3"]) -> dict[str, Detection]:
        """The joints of each person in the next RGB image; a ModelError where a network fails."""
        self._since += 1
        if not self._boxes or (self._detector is not None and self._since >= DETECT_EVERY):
            self._detect(image)
        found = {name: self.estimator.estimate(image, box) for name, box in self._boxes.items()}
        self._boxes = {}
        for name, person in found.items():  # the oldest first: a newer one in the same place is the same person
            seen = person.pixels[person.seen]
            if len(seen) >= LEAST_SEEN:
                low, high = seen.min(axis=0), seen.max(axis=0)
                middle, half = (low + high) / 2, (high - low) / 2 * MARGIN
                box = np.concatenate([middle - half, middle + half])
                if not (self._shared(box) >= 1 - SAME).any():
                    self._boxes[name] = box
        return {name: found[name] for name in self._boxes}

    def _detect(self, image: UInt8[np.ndarray, "h w 3"]) -> None:
        """Finds people in the whole image, and keeps the names of those who are known."""
        self._since = 0
        high, wide = image.shape[:2]
        for box in np.array([[0.0, 0.0, wide, high]]) if self._detector is None else self._detector.find(image):
            if len(self._boxes) < MOST_PEOPLE and not (self._shared(box) >= SAME).any():
                self._boxes[str(next(self._names))] = box

    def _shared(self, box: Float[np.ndarray, " 4"]) -> Float[np.ndarray, " N"]:
        return overlaps(box, np.array(list(self._boxes.values())).reshape(-1, 4))
