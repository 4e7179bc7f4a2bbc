"""What is predicted, drawn in the camera's picture: skeleton, arms as a fading fan, tubes, status in words."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float, UInt8

from kinecast.cameras.pinhole import PinholeCamera
from kinecast.errors import MissingExtraError
from kinecast.live.publication import Publication, colour_of
from kinecast.types import LIMBS, Status

try:
    import cv2
except ImportError as error:  # pragma: no cover - the tests install it
    raise MissingExtraError("pictures of a camera", "webcam") from error

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
    tubes, colour = publication.tubes, [255 * part for part in colour_of(publication.prediction.status)]
    for share in SHOWN if len(tubes.times) else ():
        step = max(round(share * len(tubes.times)) - 1, 0)
        layer = image.copy()
        for start, end, radius in zip(tubes.start[step], tubes.end[step], tubes.radius[step], strict=True):
            outline = _capsule(camera, np.stack([start, end]), float(radius))
            if outline is not None:
                cv2.fillConvexPoly(layer, outline, colour, cv2.LINE_AA, 4)
        cv2.addWeighted(layer, TUBE, image, 1 - TUBE, 0, image)


def _capsule(camera: PinholeCamera, ends: Float[np.ndarray, "2 3"], radius: float) -> np.ndarray | None:
    """Hull of a capsule's two circles in the image, in parts of a pixel; None where it is not before the camera."""
    pixels, depth = camera.project(ends)
    if not (np.isfinite(pixels).all() and np.isfinite(radius) and (depth > 2 * radius).all()):
        return None
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    size = camera.intrinsics.fx * radius / depth
    points = (pixels[:, None] + size[:, None, None] * circle).reshape(-1, 2)
    return cv2.convexHull(_fine(points))


def _draw_fan(image: np.ndarray, camera: PinholeCamera, publication: Publication) -> None:
    """The expected arms, later ones below, thinner and fainter."""
    mean = publication.prediction.mean
    later = np.array_split(np.arange(len(mean))[::-1], FADES)
    for layers, steps in enumerate(later, 1):
        layer = image.copy()
        for step in steps:
            share = step / max(len(mean) - 1, 1)
            colour = (1 - share) * SOON + share * LATE
            _lines(layer, camera.project(mean[step])[0], LIMBS, colour, 3 if share < 0.5 else 2)
        cv2.addWeighted(layer, FAN * layers / FADES, image, 1 - FAN * layers / FADES, 0, image)


def _draw_body(image: np.ndarray, camera: PinholeCamera, publication: Publication) -> None:
    frame = publication.frame
    pixels = camera.project(frame.positions)[0]
    place = {joint: row for row, joint in enumerate(frame.joints)}
    bones = [(place[a], place[b]) for a, b in BONES if a in place and b in place]
    for colour, width in ((EDGE, 4), (BODY, 2)):
        _lines(image, pixels, bones, colour, width)
    for pixel in pixels[np.isfinite(pixels).all(axis=1)]:
        cv2.circle(image, _fine(pixel).tolist(), 4 * FINE, BODY.tolist(), cv2.FILLED, cv2.LINE_AA, 4)


def _lines(
    image: np.ndarray, pixels: np.ndarray, pairs: Sequence[tuple[int, int]], colour: np.ndarray, width: int
) -> None:
    for a, b in pairs:
        if np.isfinite(pixels[[a, b]]).all():
            cv2.line(
                image, _fine(pixels[a]).tolist(), _fine(pixels[b]).tolist(), colour.tolist(), width, cv2.LINE_AA, 4
            )


def _write(image: np.ndarray, publications: Sequence[Publication]) -> None:
    """One line for each person, at the top."""
    lines = [
        (f"{each.prediction.person}: {each.prediction.status.name}", each.prediction.status) for each in publications
    ]
    for row, (text, status) in enumerate(lines or [("nobody is seen", Status.OCCLUDED)]):
        colour = tuple(255 * part for part in colour_of(status))
        (wide, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.6, 1)
        cv2.rectangle(image, (4, 6 + 24 * row), (16 + wide, 30 + 24 * row), EDGE.tolist(), cv2.FILLED)
        cv2.putText(image, text, (10, 24 + 24 * row), cv2.FONT_HERSHEY_SIMPLEX, 0.6, colour, 1, cv2.LINE_AA)


def _fine(pixels: np.ndarray) -> np.ndarray:
    """Sixteenths of a pixel, within what OpenCV takes."""
    return np.rint(np.clip(pixels, -4000, 8000) * FINE).astype(np.int32)
