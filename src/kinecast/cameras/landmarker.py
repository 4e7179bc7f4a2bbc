"""Everybody's landmarks in an image, by MediaPipe's PoseLandmarker: places in the image, and a shape in metres.

Source: BlazePose GHUM (Bazarevsky et al. 2020, arXiv:2006.10204; Grishchenko et al. 2022, arXiv:2206.11678) and the
PoseLandmarker task's documentation.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from kinecast.body.skeleton import MEDIAPIPE_33
from kinecast.cameras.keypoints import overlaps
from kinecast.errors import MissingExtraError, ModelError, OptionError

try:
    from mediapipe import Image, ImageFormat
    from mediapipe.tasks.python.core.base_options import BaseOptions
    from mediapipe.tasks.python.vision import PoseLandmarker, PoseLandmarkerOptions, RunningMode
except ModuleNotFoundError as error:
    raise MissingExtraError("a plain camera", "webcam") from error
except (ImportError, OSError) as error:  # its OpenCV needs libGL
    raise OptionError(f"mediapipe cannot be loaded: {error}") from None

JOINTS = MEDIAPIPE_33.joints
_TRUNK = [JOINTS.index(f"{side}_{joint}") for side in ("left", "right") for joint in ("shoulder", "hip")]
LARGEST_MODEL = 64 << 20  # [bytes]; the heavy one has 31 million
MOST_PEOPLE = 4
SAME = 0.2  # boxes that overlap by so much (intersection over union) in successive images are of one person
FORGOTTEN = 1.0  # after so long unseen [s] somebody who comes back is somebody else


@dataclass(frozen=True)
class Landmarks:
    """One person in an image; joints in the order of `JOINTS`."""

    pixels: Float[np.ndarray, "33 2"]  # [px]; may lie outside the image
    shape: Float[np.ndarray, "33 3"]  # from the middle of the hips [m]: x right, y down, z away from who looks at it
    confidence: Float[np.ndarray, " 33"]  # that it is seen, not hidden, 0..1


@contextmanager
def _quiet() -> Iterator[None]:
    """MediaPipe's own notes on standard error, forty lines that nobody can act on, go nowhere."""
    before = os.dup(2)
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(before, 2)
        os.close(before)


class Landmarker:
    """Finds up to so many people in the images of one camera, and keeps their names from image to image.

    A ModelError where there is no such file, or none that PoseLandmarker takes.
    """

    def __init__(self, path: Path, people: int = 1) -> None:
        try:
            if path.stat().st_size > LARGEST_MODEL:
                raise ValueError(f"larger than {LARGEST_MODEL} bytes")
            model = BaseOptions(model_asset_buffer=path.read_bytes())
            options = PoseLandmarkerOptions(base_options=model, running_mode=RunningMode.VIDEO, num_poses=people)
            with _quiet():
                self._network = PoseLandmarker.create_from_options(options)
                blank = Image(image_format=ImageFormat.SRGB, data=np.zeros((64, 64, 3), dtype=np.uint8))
                self._network.detect_for_video(blank, 0)  # the first run takes ten times as long
        except (OSError, ValueError, RuntimeError) as error:
            raise ModelError(f"{path}: is no PoseLandmarker model ({error})") from None
        self._names = count()
        self._known: dict[str, tuple[Float[np.ndarray, " 4"], float]] = {}  # box, and when it was seen [s]
        self._time = 0  # of the last image, as the network is told [ms]

    def close(self) -> None:
        """Frees the network."""
        with _quiet():
            self._network.close()

    def update(self, image: UInt8[np.ndarray, "h w 3"], stamp: float) -> dict[str, Landmarks]:
        """Who is in the next RGB image, taken at a stamp [s], by name; may raise a RuntimeError of MediaPipe."""
        self._time = max(self._time + 1, round(1000 * stamp))
        found = self._network.detect_for_video(Image(image_format=ImageFormat.SRGB, data=image), self._time)
        size = np.array([image.shape[1], image.shape[0]])
        people: dict[str, Landmarks] = {}
        for marks, shape in zip(found.pose_landmarks, found.pose_world_landmarks, strict=True):
            person = Landmarks(
                np.array([[each.x, each.y] for each in marks]) * size - 0.5,  # (0, 0): middle of the upper left pixel
                np.array([[each.x, each.y, each.z] for each in shape]),
                np.array([each.visibility or 0.0 for each in marks]),
            )
            people[self._name(person, stamp, set(people))] = person
        self._known = {name: known for name, known in self._known.items() if stamp - known[1] <= FORGOTTEN}
        return people

    def _name(self, person: Landmarks, stamp: float, taken: set[str]) -> str:
        """Of whose trunk was last where this person's is, or a new one."""
        trunk = person.pixels[_TRUNK]
        box = np.concatenate([trunk.min(axis=0) - 1, trunk.max(axis=0) + 1])
        free = [name for name in self._known if name not in taken]
        shared = overlaps(box, np.array([self._known[name][0] for name in free]).reshape(-1, 4))
        name = free[int(shared.argmax())] if len(free) and shared.max() >= SAME else str(next(self._names))
        self._known[name] = box, stamp
        return name
