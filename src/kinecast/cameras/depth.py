"""One camera with depth: a pixel, the depth of the skin seen there, and the joint behind it.

The depth image lies over the colour image. Around a keypoint there is the limb, and beside it what is behind it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, UInt16

from kinecast.cameras.fusion.measurement import SKIN_STD, skin_depths
from kinecast.cameras.pinhole import PinholeCamera
from kinecast.live.detection import LEAST_CONFIDENCE, Detection
from kinecast.types import SkeletonFrame

NEAREST, FARTHEST = 0.1, 20.0  # depths that are believed [m]
HALF_LIMB = 0.02  # half of what is looked at around a keypoint [m]: within a wrist, which is 6 cm wide
LEAST_RADIUS, MOST_RADIUS = 2, 15  # the same, in pixels
LEAST_SHARE = 0.2  # of the pixels around a keypoint: fewer at one depth are noise at an edge
GAP = 0.08  # between two surfaces at least [m], beyond what noise makes
REACH = 1.2  # nothing of a person is so far from the middle of their depths [m]: arms are shorter
DISPARITY_STD = 0.08  # of a calibrated D400 in ordinary scenes [px]: its designer in librealsense, issue 3904


def stereo_noise(focal: float = 424.0, baseline: float = 0.050) -> float:
    """Standard deviation of a depth from two images of a focal length [px], by its square: s / (f · b) [1/m].

    Source: Intel, Tuning depth cameras for best performance.
    """
    return DISPARITY_STD / (focal * baseline)


@dataclass(frozen=True)
class DepthImage:
    """Depths by pixel of the colour image."""

    values: UInt16[np.ndarray, "h w"]  # in units; 0 where nothing was measured
    unit: float  # [m]
    focal: float  # of the colour image [px]
    noise: float  # see `stereo_noise`

    def at(self, pixels: Float[np.ndarray, "J 2"]) -> tuple[Float[np.ndarray, " J"], Float[np.ndarray, " J"]]:
        """(J,) depths at the keypoints of one person, NaN where none is believed, and their standard deviations [m].

        Depths around a keypoint are split where there is a gap, and the nearest part that is no speck is the limb: its
        median counts. One far from the person's others is of something else.
        """
        coarse = np.concatenate([self._patch(pixel, LEAST_RADIUS) for pixel in pixels])
        if not len(coarse):
            return np.full(len(pixels), np.nan), np.full(len(pixels), np.nan)
        radius = int(np.clip(round(self.focal * HALF_LIMB / np.median(coarse)), LEAST_RADIUS, MOST_RADIUS))
        depths, relief = np.array([self._surface(pixel, radius) for pixel in pixels]).T
        if np.isfinite(depths).any():
            depths = np.where(np.abs(depths - np.nanmedian(depths)) > REACH, np.nan, depths)
        return depths, np.hypot(self.noise * depths**2, relief)

    def added(self, seen: Detection) -> Detection:
        """The same person with the depths seen at their joints."""
        depth, depth_std = self.at(seen.pixels)
        return replace(seen, depth=depth, depth_std=depth_std)

    def _surface(self, pixel: Float[np.ndarray, " 2"], radius: int) -> tuple[float, float]:
        """Depth of the nearest surface at a pixel, and half the height of its own relief [m]."""
        values = np.sort(self._patch(pixel, radius))
        if len(values) < LEAST_SHARE * (2 * radius + 1) ** 2:
            return np.nan, np.nan
        parts = np.split(values, np.flatnonzero(np.diff(values) > GAP + 3 * self.noise * values[:-1] ** 2) + 1)
        part = next((part for part in parts if len(part) >= LEAST_SHARE * len(values)), values)
        low, middle, high = part[(np.array([0.16, 0.5, 0.84]) * (len(part) - 1)).astype(int)]
        return float(middle), float(high - low) / 2

    def _patch(self, pixel: Float[np.ndarray, " 2"], radius: int) -> Float[np.ndarray, " N"]:
        """Depths around a pixel that are believed [m]."""
        high, wide = self.values.shape
        if not (0 <= pixel[0] < wide and 0 <= pixel[1] < high):  # NaN is not
            return np.zeros(0)
        x, y = np.rint(pixel).astype(int)
        depths = self.values[max(y - radius, 0) : y + radius + 1, max(x - radius, 0) : x + radius + 1] * self.unit
        return depths[(depths >= NEAREST) & (depths <= FARTHEST)]


def lifted(seen: Detection, camera: PinholeCamera) -> SkeletonFrame:
    """A skeleton from one camera alone, in its z-up world: joints behind the skin, along the ray that they are seen on.

    Joints without a depth are not seen (NaN); the covariance is `PinholeCamera.covariance`.
    """
    skin = camera.back_project(seen.pixels, seen.depth)
    positions = skin + camera.rays(seen.pixels) * skin_depths(seen.joints)[:, None]
    positions[~(seen.confidence >= LEAST_CONFIDENCE)] = np.nan
    covariance = camera.covariance(positions, seen.pixel_std, np.hypot(seen.depth_std, SKIN_STD))
    std = np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 3)
    return SkeletonFrame(seen.stamp, seen.joints, positions, seen.person, std=std, covariance=covariance)
