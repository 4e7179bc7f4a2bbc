"""A pinhole camera with OpenCV's distortion: points to pixels, pixels and depths to points, and how sure they are.

A camera's own axes are x right, y down, z forward; `depth` is along z, as depth cameras give it, not along the ray.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from kinecast.errors import OptionError
from kinecast.geometry.transforms import apply, inverse, transform

Numbers = Float[np.ndarray, "*b"]
Pairs = Float[np.ndarray, "*b 2"]
Points = Float[np.ndarray, "*b 3"]
NEAREST = 1e-3  # points nearer to the camera's plane [m], or behind it, have no pixel
MOST_STEPS, CONVERGED = 20, 1e-9  # Newton steps; the last one in x/z: a millionth of a pixel


@dataclass(frozen=True)
class Intrinsics:
    """How a camera maps directions to pixels; pixel (0, 0) is the middle of the upper left one, as in OpenCV."""

    width: int  # [px]
    height: int
    fx: float  # focal lengths [px]
    fy: float
    cx: float  # principal point [px]
    cy: float
    distortion: tuple[float, ...] = ()  # none, or OpenCV's k1, k2, p1, p2[, k3[, k4, k5, k6]]

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise OptionError(f"an image of {self.width} x {self.height} pixels is none")
        if not (0 < self.fx < np.inf and 0 < self.fy < np.inf):
            raise OptionError(f"focal lengths {self.fx:g}, {self.fy:g} px must be above 0")
        if len(self.distortion) not in (0, 4, 5, 8):
            raise OptionError(f"{len(self.distortion)} distortion coefficients: OpenCV's 4, 5 or 8, or none, are taken")
        if not np.isfinite((self.cx, self.cy, *self.distortion)).all():
            raise OptionError("principal point and distortion must be finite")

    def pixels(self, directions: Pairs) -> Pairs:
        """(…, 2) pixels of directions x/z, y/z (…, 2)."""
        return self._distorted(directions) * (self.fx, self.fy) + (self.cx, self.cy)

    def directions(self, pixels: Pairs) -> Pairs:
        """(…, 2) directions x/z, y/z that are seen at pixels (…, 2): Newton's method on `pixels`.

        NaN where a pixel is NaN, or where no direction leads to it.
        """
        seen = (np.asarray(pixels, dtype=np.float64) - (self.cx, self.cy)) / (self.fx, self.fy)
        found = seen.copy()
        with np.errstate(all="ignore"):  # what diverges is NaN in the end
            for _ in range(MOST_STEPS if any(self.distortion) else 0):
                (a, b), (c, d) = np.moveaxis(self._slope(found), (-2, -1), (0, 1))
                x, y = np.moveaxis(seen - self._distorted(found), -1, 0)
                step = np.stack([d * x - b * y, a * y - c * x], axis=-1) / (a * d - b * c)[..., None]
                found += step
                if not (np.abs(step) > CONVERGED).any():
                    break
            found[~(np.abs(self._distorted(found) - seen) < 1e3 * CONVERGED).all(axis=-1)] = np.nan
        return found

    def jacobian(self, directions: Pairs) -> Float[np.ndarray, "*b 2 2"]:
        """(…, 2, 2) ∂pixel/∂direction."""
        return self._slope(directions) * np.array([[self.fx], [self.fy]])

    def _distorted(self, directions: np.ndarray) -> np.ndarray:
        """Directions times (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶), and what p1 and p2 add."""
        k1, k2, p1, p2, k3, k4, k5, k6 = (*self.distortion, *(0.0,) * (8 - len(self.distortion)))
        x, y = np.moveaxis(directions, -1, 0)
        r2 = x * x + y * y
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return np.stack([u, v], axis=-1)

    def _slope(self, directions: np.ndarray) -> np.ndarray:
        """(…, 2, 2) ∂distorted/∂direction, exact: by imaginary steps too small to be squared."""
        tiny = 1e-30
        return np.stack([self._distorted(directions + 1j * tiny * axis).imag / tiny for axis in np.eye(2)], axis=-1)


@dataclass(frozen=True)
class PinholeCamera:
    """A camera at its place in the world."""

    name: str
    intrinsics: Intrinsics
    T_world_camera: Float[np.ndarray, "4 4"]  # p_world = T_world_camera · p_camera [m]

    @cached_property
    def T_camera_world(self) -> Float[np.ndarray, "4 4"]:  # noqa: N802 - as in conventions.md
        """(4, 4) p_camera = T_camera_world · p_world."""
        return inverse(self.T_world_camera)

    def project(self, points: Points) -> tuple[Pairs, Numbers]:
        """(…, 2) pixels, also outside the image, NaN behind the camera, and (…) depths [m] of points (…, 3) [m]."""
        local = apply(self.T_camera_world, points)
        depth = local[..., 2]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            pixels = self.intrinsics.pixels(local[..., :2] / depth[..., None])
        return np.where((depth > NEAREST)[..., None], pixels, np.nan), depth

    def back_project(self, pixels: Pairs, depth: Numbers) -> Points:
        """(…, 3) points in the world [m] seen at pixels (…, 2) at depths (…) [m]."""
        return apply(self.T_world_camera, _homogeneous(self.intrinsics.directions(pixels)) * depth[..., None])

    def rays(self, pixels: Pairs) -> Points:
        """(…, 3) unit vectors in the world from the camera (`T_world_camera[:3, 3]`) towards what is at pixels."""
        ahead = _homogeneous(self.intrinsics.directions(pixels)) @ self.T_world_camera[:3, :3].T
        return ahead / np.linalg.norm(ahead, axis=-1, keepdims=True)

    def covariance(self, points: Points, pixel_std: Numbers, depth_std: Numbers) -> Float[np.ndarray, "*b 3 3"]:
        """(…, 3, 3) covariance J diag(σ_px², σ_px², σ_depth²) Jᵀ [m²] of points (…, 3) [m] that `back_project` gave.

        NaN where a point is NaN or behind the camera. Standard deviations (…) are of both pixel coordinates [px] and of
        the depth [m].
        """
        local = apply(self.T_camera_world, points)
        z = np.where(local[..., 2] > NEAREST, local[..., 2], np.nan)[..., None]
        directions = np.where(np.isfinite(z), local[..., :2] / z, 0.0)
        J = np.zeros((*points.shape, 3))  # ∂point/∂(u, v, depth)
        J[..., :2, :2] = z[..., None] * np.linalg.inv(self.intrinsics.jacobian(directions))
        J[..., 2] = _homogeneous(directions)
        std = np.stack([pixel_std, pixel_std, depth_std], axis=-1)
        root = self.T_world_camera[:3, :3] @ (J * std[..., None, :])
        return root @ np.swapaxes(root, -1, -2)


def level_pose(height: float = 0.0, tilt: float = 0.0) -> Float[np.ndarray, "4 4"]:
    """(4, 4) T_world_camera, upright, x to its right and y ahead, so high above the origin [m]; tilt [rad] is down."""
    s, c = np.sin(tilt), np.cos(tilt)
    return transform(np.array([[1.0, 0.0, 0.0], [0.0, -s, c], [0.0, -c, -s]]), np.array([0.0, 0.0, height]))


def _homogeneous(directions: Pairs) -> Points:
    return np.concatenate([directions, np.ones((*directions.shape[:-1], 1))], axis=-1)
