"""Skeletons from one camera with depth: a pixel, the depth of the skin seen there, and the flesh behind it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from kinecast.cameras.camera import PinholeCamera
from kinecast.cameras.depth import DepthImage
from kinecast.cameras.fusion.sighting import FLESH_STD, flesh_of
from kinecast.cameras.pose_estimator import Keypoints
from kinecast.geometry.transforms import transform
from kinecast.live.detection import LEAST_CONFIDENCE, View
from kinecast.types import SkeletonFrame

__all__ = ["lifted", "standing", "view_of"]


def view_of(
    stamp: float, camera: str, person: str, joints: tuple[str, ...], keypoints: Keypoints, depths: DepthImage
) -> View:
    """What one image with depth says of one person; joints that are not sure have no pixel."""
    pixels = np.where(keypoints.seen[:, None], keypoints.pixels, np.nan)
    depth, depth_std = depths.at(pixels)
    return View(stamp, camera, joints, pixels, keypoints.pixel_std, depth, depth_std, keypoints.confidence, person)


def lifted(view: View, camera: PinholeCamera, frame_id: str = "world") -> SkeletonFrame:
    """A skeleton from one view alone: (J, 3) joints behind the skin, along the ray that they are seen on.

    Args:
        view: of that camera; joints without a depth are not seen (NaN).
        camera: at its place in a z-up world.
        frame_id: name of that world.

    Returns:
        The frame with Σ = J⁻¹ diag(σ_px², σ_px², σ_d²) J⁻ᵀ of each joint (`PinholeCamera.covariance`), and √(tr Σ / 3).
    """
    skin = camera.back_project(view.pixels, view.depth)
    positions = skin + camera.rays(view.pixels) * flesh_of(view.joints)[:, None]
    positions[~(view.confidence >= LEAST_CONFIDENCE)] = np.nan
    covariance = camera.covariance(positions, view.pixel_std, np.hypot(view.depth_std, FLESH_STD))
    std = np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 3)
    return SkeletonFrame(view.stamp, view.joints, positions, view.person, frame_id, std, covariance)


def standing(height: float = 0.0, tilt: float = 0.0) -> Float[np.ndarray, "4 4"]:
    """(4, 4) T_world_camera of a camera that is not calibrated: upright, in a world with x to its right and y ahead.

    Args:
        height: above the world's origin [m].
        tilt: by how much it looks down [rad].
    """
    s, c = np.sin(tilt), np.cos(tilt)
    return transform(np.array([[1.0, 0.0, 0.0], [0.0, -s, c], [0.0, -c, -s]]), np.array([0.0, 0.0, height]))
