"""What is predicted, drawn in the camera's picture: skeleton, arms as a fading fan, tubes, status in words."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float, UInt8

from kinecast.cameras.opencv import cv2
from kinecast.cameras.pinhole import PinholeCamera
from kinecast.live.publication import Publication, colour_of
from kinecast.types import LIMBS, Status

_SIDE = ("shoulder", "elbow", "wrist"), ("shoulder", "hip", "knee", "ankle")
BONES = (
    *((f"{side}_{a}", f"{side}_{b}") for side in ("left", "right") for chain in _SIDE for a, b in pairwise(chain)),
    ("left_shoulder", "right_shoulder"),
    ("left_hip", "right_hip"),
)
BODY, EDGE, SOON, LATE = np.array(
    [[255.0, 255.0, 255.0], [40.0, 40.0, 40.0], [255.0, 214.0, 10.0], [230.0, 57.0, 70.0]]
)
TUBE, FAN, FADES = 0.25, 0.9, 3  # opacity of the tubes, of the fan's first arms, and in how many steps it fades
SHOWN = (0.5, 1.0)  # share of the horizon at which tubes are drawn: two of them tell more than fifteen
FINE = 16  # parts of a pixel that OpenCV's `shift` of 4 makes


@dataclass(frozen=True)
class Picture:
    """One picture of a camera."""

    source: str  # as publications of it say
    stamp: float  # [s], on the clock of its frames
    image: UInt8[np.ndarray, "h w 3"]  # RGB
    camera: PinholeCamera
    rate: float  # pictures in a second, as far as the camera says


Watcher = Callable[[Picture], None]
"""Takes every picture that was looked at, in the source's thread; neither waits nor raises."""


def drawn(picture: Picture, publications: Sequence[Publication]) -> UInt8[np.ndarray, "h w 3"]:
    """The picture with what was published of it."""
    image = picture.image.copy()
    for each in publications:
        _draw_tubes(image, picture.camera, each)
        _draw_fan(image, picture.camera, each)
        _draw_body(image, picture.camera, each)
    _write(image, publications)
    return image


def _draw_tubes(image: np.ndarray, camera: PinholeCamera, publication: Publication) -> None:
    """Each as a line as thick as it is in its middle; one that reaches the camera is left out."""
    tubes, colour = publication.tubes, 255 * np.array(colour_of(publication.prediction.status))
    for share in SHOWN if len(tubes.times) else ():
        step = max(round(share * len(tubes.times)) - 1, 0)
        layer = image.copy()
        pixels, depth = camera.project(np.stack([tubes.start[step], tubes.end[step]], axis=1))  # (L, 2, 2), (L, 2)
        for ends, away, radius in zip(pixels, depth, tubes.radius[step], strict=True):
            if (away > 2 * radius).all():
                _line(layer, ends, colour, max(round(2 * camera.intrinsics.fx * radius / away.mean()), 1))
        cv2.addWeighted(layer, TUBE, image, 1 - TUBE, 0, image)


def _draw_fan(image: np.ndarray, camera: PinholeCamera, publication: Publication) -> None:
    """The expected arms, later ones below, thinner and fainter."""
    mean = publication.prediction.mean
    later = np.array_split(np.arange(len(mean))[::-1], FADES)
    for layers, steps in enumerate(later, 1):
        layer = image.copy()
        for step in steps:
            share = step / max(len(mean) - 1, 1)
            for ends in camera.project(mean[step])[0][np.array(LIMBS)]:
                _line(layer, ends, (1 - share) * SOON + share * LATE, 3 if share < 0.5 else 2)
        cv2.addWeighted(layer, FAN * layers / FADES, image, 1 - FAN * layers / FADES, 0, image)


def _draw_body(image: np.ndarray, camera: PinholeCamera, publication: Publication) -> None:
    frame = publication.frame
    pixels = camera.project(frame.positions)[0]
    place = dict(zip(frame.joints, pixels, strict=False))
    for colour, width in ((EDGE, 4), (BODY, 2)):
        for a, b in BONES:
            if a in place and b in place:
                _line(image, np.stack([place[a], place[b]]), colour, width)
    for pixel in pixels[np.isfinite(pixels).all(axis=1)]:
        cv2.circle(image, _fine(pixel), 4 * FINE, BODY.tolist(), cv2.FILLED, cv2.LINE_AA, 4)


def _line(image: np.ndarray, ends: Float[np.ndarray, "2 2"], colour: np.ndarray, width: int) -> None:
    """Nothing where an end is not known."""
    if np.isfinite(ends).all():
        cv2.line(image, _fine(ends[0]), _fine(ends[1]), colour.tolist(), width, cv2.LINE_AA, 4)


def _write(image: np.ndarray, publications: Sequence[Publication]) -> None:
    """One line for each person, at the top."""
    said = [each.prediction for each in publications]
    lines = [(f"{each.person}: {each.status.name}", each.status) for each in said]
    for row, (text, status) in enumerate(lines or [("nobody is seen", Status.OCCLUDED)]):
        colour = tuple(255 * part for part in colour_of(status))
        (wide, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.6, 1)
        cv2.rectangle(image, (4, 6 + 24 * row), (16 + wide, 30 + 24 * row), EDGE.tolist(), cv2.FILLED)
        cv2.putText(image, text, (10, 24 + 24 * row), cv2.FONT_HERSHEY_SIMPLEX, 0.6, colour, 1, cv2.LINE_AA)


def _fine(pixel: np.ndarray) -> list[int]:
    """Sixteenths of a pixel, within what OpenCV takes."""
    return np.rint(np.clip(pixel, -4000, 8000) * FINE).astype(int).tolist()
