"""People in the images of one camera, from one image to the next: who is where, and where to look for them."""

from __future__ import annotations

from itertools import count

import numpy as np
from jaxtyping import Float, UInt8

from kinecast.cameras.person_detector import PersonDetector, overlaps
from kinecast.cameras.pose_estimator import Keypoints, PoseEstimator

__all__ = ["MOST_PEOPLE", "PeopleTracker"]

MOST_PEOPLE = 4
"""In one image: each costs a run of the network."""
DETECT_EVERY = 10
"""Images from one look at the whole image to the next, while somebody is followed."""
LEAST_SEEN = 4
"""Joints by which somebody is followed: an arm and a shoulder."""
SAME = 0.3
"""Boxes that overlap by so much (intersection over union) are of one person."""
MARGIN = 1.25
"""A person's box around what was seen of them; the rest of the head and the hands are outside, and they move."""


class PeopleTracker:
    """Runs a pose estimator where people are.

    Without a detector it follows one person: in the whole image first, then around where they were.

    Args:
        estimator: for each person.
        detector: finds people in the whole image.
    """

    def __init__(self, estimator: PoseEstimator, detector: PersonDetector | None = None) -> None:
        self.estimator = estimator
        self._detector = detector
        self._boxes: dict[str, Float[np.ndarray, " 4"]] = {}
        self._names = count()
        self._since = 0

    def follow(self, image: UInt8[np.ndarray, "h w 3"]) -> dict[str, Keypoints]:
        """The keypoints of each person in the next image.

        Args:
            image: red, green, blue.

        Raises:
            ModelError: a network fails.
        """
        self._since += 1
        if not self._boxes or (self._detector is not None and self._since >= DETECT_EVERY):
            self._look(image)
        found = {name: self.estimator.estimate(image, box) for name, box in self._boxes.items()}
        found = {name: each for name, each in found.items() if each.seen.sum() >= LEAST_SEEN}
        self._boxes = {}
        for name, keypoints in found.items():  # the oldest first: a newer one in the same place is the same person
            box = _widened(keypoints.box)
            if not self._boxes or overlaps(box, np.stack(list(self._boxes.values()))).max() < 1 - SAME:
                self._boxes[name] = box
        return {name: found[name] for name in self._boxes}

    def _look(self, image: UInt8[np.ndarray, "h w 3"]) -> None:
        """Finds people in the whole image, and keeps the names of those who are known."""
        self._since = 0
        high, wide = image.shape[:2]
        found = np.array([[0.0, 0.0, wide, high]]) if self._detector is None else self._detector.find(image)
        for box in found:
            known = list(self._boxes)
            shares = overlaps(box, np.stack([self._boxes[name] for name in known])) if known else np.zeros(0)
            if known and shares.max() >= SAME:
                continue  # followed already
            if len(self._boxes) < MOST_PEOPLE:
                self._boxes[str(next(self._names))] = box


def _widened(box: Float[np.ndarray, " 4"]) -> Float[np.ndarray, " 4"]:
    middle, half = (box[:2] + box[2:]) / 2, (box[2:] - box[:2]) / 2 * MARGIN
    return np.concatenate([middle - half, middle + half])
