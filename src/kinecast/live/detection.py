"""One person in one camera's image: what a pose estimator gives, and what the fusion takes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

LEAST_CONFIDENCE = 0.3  # below it a joint is not taken as seen: the threshold from which mmpose draws one by default


@dataclass(frozen=True)
class Detection:
    """One person's joints in one image.

    A depth is of the surface seen there, along the optical axis, as a depth camera measures it: a joint's centre lies
    some centimetres deeper.
    """

    stamp: float  # when the image was taken [s], on the same clock for all images of this camera
    camera: str  # its name in the rig
    joints: tuple[str, ...]  # canonical names (kinecast.body.skeleton)
    pixels: Float[np.ndarray, "J 2"]  # [px]; NaN where a joint is not seen
    pixel_std: Float[np.ndarray, " J"]  # standard deviation of both coordinates [px]
    depth: Float[np.ndarray, " J"]  # [m]; NaN where there is none
    depth_std: Float[np.ndarray, " J"]  # [m]; NaN where there is none
    confidence: Float[np.ndarray, " J"]  # the estimator's own, 0..1
    person: str = "0"  # the camera's track of this person, if it keeps tracks: a hint, not an identity

    @property
    def seen(self) -> Bool[np.ndarray, " J"]:
        """(J,) True where there is a pixel."""
        return np.isfinite(self.pixels).all(axis=-1)


DetectionHandler = Callable[[float, Sequence[Detection], float], None]
"""Takes one image: its stamp [s], everybody in it, when it was acquired [s] on `time.monotonic`."""
