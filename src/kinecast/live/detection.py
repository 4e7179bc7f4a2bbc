"""One person in one camera's image: what a pose estimator gives, and what the fusion takes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

LEAST_CONFIDENCE = 0.3
"""Below it a joint is not taken as seen: the threshold from which mmpose draws one by default."""


@dataclass(frozen=True)
class Detection:
    """One person's joints in one image.

    Attributes:
        stamp: when the image was taken [s], on the same clock for all images of this camera.
        camera: its name in the rig.
        joints: canonical joint names (kinecast.body.skeleton).
        pixels: (J, 2) where each joint is seen [px]; NaN where it is not.
        pixel_std: (J,) standard deviation of both pixel coordinates [px].
        depth: (J,) distance along the optical axis [m] of the surface seen there, as a depth camera measures it: a
            joint's centre lies some centimetres deeper. NaN where there is none.
        depth_std: (J,) standard deviation of the depth [m]; NaN where there is none.
        confidence: (J,) the estimator's own, 0..1.
        person: the camera's track of this person, if it keeps tracks: a hint, not an identity.
    """

    stamp: float
    camera: str
    joints: tuple[str, ...]
    pixels: Float[np.ndarray, "J 2"]
    pixel_std: Float[np.ndarray, " J"]
    depth: Float[np.ndarray, " J"]
    depth_std: Float[np.ndarray, " J"]
    confidence: Float[np.ndarray, " J"]
    person: str = "0"

    @property
    def seen(self) -> Bool[np.ndarray, " J"]:
        """(J,) True where there is a pixel."""
        return np.isfinite(self.pixels).all(axis=-1)


DetectionHandler = Callable[[float, Sequence[Detection], float], None]
"""Takes one image: its stamp [s], everybody in it, when it was acquired [s] on `time.monotonic`."""
