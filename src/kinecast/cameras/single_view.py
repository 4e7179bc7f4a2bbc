"""One person before one camera without depth, over time: landmarks to a skeleton in the room, and how unsure it is.

The network sees no more than a cut-out around the person, so that its shape is in the axes of somebody who looks
straight at them: it is turned towards the ray of the hips first. Where it stands is a translation t, the least squares
of Σ ‖π(X + t) − d‖² / σ² over directions d = x/z, y/z (perspective-n-point with a known turn), solved as Hartley and
Sturm's linear rows (Triangulation, 1997), weighted anew with each depth and with Huber's weights.

Across the ray a joint is where its pixel is. Along the ray it is where the shape stands, times the body's scale: the
stated height over the height of the shape's bones, or the camera's height over how far below it the feet are. An error
of scale or focal length moves the whole person along the ray and stays; it is in `covariance`, not in `std`, which says
how unsure joints are of each other and is what widens a prediction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from kinecast.cameras.fusion.kalman import JointStates
from kinecast.cameras.fusion.measurement import FUSED_JOINTS
from kinecast.cameras.keypoints import keypoint_std
from kinecast.cameras.landmarker import JOINTS, Landmarks
from kinecast.cameras.pinhole import PinholeCamera
from kinecast.types import SkeletonFrame

BODY = tuple(joint for joint in FUSED_JOINTS if joint in JOINTS)  # nose, arms and legs
_ROWS = np.array([JOINTS.index(joint) for joint in BODY])
_HIPS = [JOINTS.index("left_hip"), JOINTS.index("right_hip")]
_FEET = [JOINTS.index(f"{side}_{part}") for side in ("left", "right") for part in ("heel", "foot")]

DEPTH_STD = 0.06
"""Error of a joint's depth within the shape [m]: 97 mm of a joint in three dimensions, by 1.6 for one (Kim et al. 2023,
Human Pose Estimation Using MediaPipe Pose and Optimization Method Based on a Humanoid Model)."""
STATED_STD, FLOOR_STD, UNKNOWN_STD = 0.03, 0.05, 0.08
"""Relative errors of the scale: bones of people of one height differ by so much; a camera's tilt that is 1° off at 3 m;
statures differ by 5.5 %, and the network's guess by as much again."""
JITTER, DEPTH_JITTER = 0.3, 0.02
"""What changes from image to image: share of a pixel's error, and of the depth (docs/decisions/0026)."""
SOLE = 0.03  # heel and toe landmarks above the floor [m]
LEAST_DROP = 0.5  # feet that are less below the camera say nothing of the scale [m]
SETTLED = 300  # images over which the scale is averaged
SHOWN = 0.15  # a joint that was not seen for so long [s] is not given
RESTART = 1.0  # after so long without an image [s] nothing of before holds
STEPS = 5  # of the fit; each brings about a digit
HUBER = 1.5  # standard deviations beyond which an error counts linearly
LEAST_DISTANCE = 0.2  # nobody is nearer to the camera [m]
LEAST_JOINTS = 4
_BONES = {
    ("shoulder", "elbow"): 0.186, ("elbow", "wrist"): 0.146, ("hip", "knee"): 0.245, ("knee", "ankle"): 0.246,
    ("shoulder", "hip"): 0.288,
}  # fmt: skip
"""Length of a bone as a share of the body's height: Drillis and Contini 1966, as in Winter, Biomechanics and Motor
Control of Human Movement; from shoulder to hip as of its heights 0.818 and 0.530."""


@dataclass(frozen=True)
class ScaleOptions:
    """What is known of a person's size; nothing: the network's own guess."""

    body: float | None = None  # height of everybody [m]
    feet_on_floor: bool = False  # somebody's lower foot stands at z = 0
    focal_std: float = 0.0  # relative error of the focal length
    least_confidence: float = 0.3  # from which a joint counts as seen


class SingleView:
    """What is known of one person; the camera stands in a z-up world."""

    def __init__(self, camera: PinholeCamera, options: ScaleOptions) -> None:
        self._camera, self._options = camera, options
        self.stamp = np.inf  # of the last image [s]
        self._states: JointStates | None = None
        self._scale, self._scales = 0.0, 0  # log, and from how many images
        known = STATED_STD if options.body else FLOOR_STD if options.feet_on_floor else UNKNOWN_STD
        self._depth_share = float(np.hypot(known, options.focal_std))

    def update(self, stamp: float, person: Landmarks, name: str = "0") -> SkeletonFrame | None:
        """The skeleton at the stamp [s] of an image; None where the person cannot be placed."""
        camera, self.stamp = self._camera, stamp
        directions = camera.intrinsics.directions(person.pixels)
        shape = person.shape @ turn_towards(directions[_HIPS].mean(axis=0)).T
        seen = (person.confidence >= self._options.least_confidence)[_ROWS] & np.isfinite(directions[_ROWS]).all(axis=1)
        unsure = 1 / np.maximum(person.confidence[_ROWS], self._options.least_confidence or 1.0)
        pixel_std = keypoint_std(BODY, person.pixels[_ROWS], seen) * unsure
        focal = camera.intrinsics.fx
        rows = _ROWS[seen]
        fit = translation(shape[rows], directions[rows], pixel_std[seen] / focal)
        if fit is None:
            return None
        t, covariance = fit
        self._follow_scale(person, shape + t, directions)
        scale = np.exp(self._scale)
        depth = scale * (shape[_ROWS, 2] + t[2])
        points = camera.back_project(person.pixels[_ROWS], depth)
        jitter = camera.covariance(points, JITTER * pixel_std, DEPTH_JITTER * depth)
        states = self._filtered(stamp, points, jitter, seen)
        own = camera.covariance(points, pixel_std, np.full(len(points), DEPTH_STD))
        common = np.hypot(scale * np.sqrt(covariance[2, 2]), self._depth_share * depth)
        whole = camera.covariance(points, pixel_std, np.hypot(DEPTH_STD, common))
        filtered = states.covariance[:, :3, :3]
        std = np.sqrt(np.trace(filtered + own, axis1=1, axis2=2) / 3)
        positions = np.where(states.seen_within(SHOWN)[:, None], states.mean[:, 0], np.nan)
        return SkeletonFrame(stamp, BODY, positions, name, std=std, covariance=filtered + whole)

    def _filtered(self, stamp: float, points: np.ndarray, jitter: np.ndarray, seen: np.ndarray) -> JointStates:
        """All joints after this image: one filter a joint, wide along the ray and narrow across it."""
        if self._states is None or not 0 <= stamp - self._states.stamp <= RESTART:
            self._states = JointStates(BODY, stamp)
        states = self._states
        states.advance(stamp)
        start = seen & ~states.known
        information = np.zeros_like(jitter)
        information[seen] = np.linalg.inv(jitter[seen])
        states.correct(information, np.einsum("jxy,jy->jx", information, points - states.mean[:, 0]))
        states.start(start, points, jitter)
        states.seen_at[seen] = stamp
        return states

    def _follow_scale(self, person: Landmarks, local: np.ndarray, directions: np.ndarray) -> None:
        """Averages what this image says of the scale; `local` (33, 3) is in the camera's axes, unscaled [m]."""
        options, seen = self._options, person.confidence >= self._options.least_confidence
        measured = np.nan
        if options.body:
            measured = options.body / height_of(JOINTS, person.shape, seen)
        elif options.feet_on_floor and seen[_FEET].all():
            feet = directions[_FEET] * local[_FEET, 2:]
            T = self._camera.T_world_camera
            drop = -(np.column_stack([feet, local[_FEET, 2]]) @ T[2, :3]).min()
            measured = (T[2, 3] - SOLE) / drop if drop > LEAST_DROP else np.nan
        if 0.5 < measured < 2.0:  # NaN is not
            self._scales = min(self._scales + 1, SETTLED)
            self._scale += (float(np.log(measured)) - self._scale) / self._scales


def turn_towards(direction: Float[np.ndarray, " 2"]) -> Float[np.ndarray, "3 3"]:
    """(3, 3) the shortest rotation of the optical axis (0, 0, 1) onto the ray (x/z, y/z, 1)."""
    ray = np.append(direction, 1.0) / np.sqrt(1.0 + direction @ direction)
    x, y, z = ray
    cross = np.array([[0.0, 0.0, x], [0.0, 0.0, y], [-x, -y, 0.0]])  # of (0, 0, 1) × ray = (−y, x, 0)
    return np.eye(3) + cross + cross @ cross / (1.0 + z)


def translation(
    shape: Float[np.ndarray, "J 3"], directions: Float[np.ndarray, "J 2"], std: Float[np.ndarray, " J"]
) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, "3 3"]] | None:
    """Translation of a shape [m] so that it is seen in directions (J, 2), and its covariance (3, 3) [m²].

    Args:
        shape: (J, 3) in the camera's axes, turned already.
        directions: (J, 2) x/z, y/z of each joint.
        std: (J,) standard deviation of both.

    Returns:
        None with fewer than 4 joints, or where no place before the camera fits.
    """
    if len(shape) < LEAST_JOINTS:
        return None
    joints = len(shape)
    rows = np.zeros((joints, 2, 3))
    rows[:, 0, 0] = rows[:, 1, 1] = 1.0
    rows[:, :, 2] = -directions
    values = directions * shape[:, 2:] - shape[:, :2]
    depth, share = np.ones(joints), np.ones(joints)
    for _ in range(STEPS):
        weight = (share / (std * depth) ** 2)[:, None, None]
        information = (rows * weight).reshape(-1, 3).T @ rows.reshape(-1, 3)
        try:
            t = np.linalg.solve(information, (rows * weight).reshape(-1, 3).T @ values.ravel())
        except np.linalg.LinAlgError:
            return None
        depth = shape[:, 2] + t[2]
        if not (np.isfinite(t).all() and depth.min() > LEAST_DISTANCE):
            return None
        off = np.linalg.norm(rows @ t - values, axis=1) / (std * depth)
        share = HUBER / np.maximum(off, HUBER)
    return t, np.linalg.inv(information)


def height_of(joints: tuple[str, ...], shape: Float[np.ndarray, "J 3"], seen: np.ndarray) -> float:
    """Height of the body that bones of these lengths belong to [m], whatever its posture; NaN where none is seen."""
    lengths, shares = 0.0, 0.0
    for side in ("left_", "right_"):
        for (a, b), share in _BONES.items():
            i, j = joints.index(side + a), joints.index(side + b)
            if seen[i] and seen[j]:
                lengths += float(np.linalg.norm(shape[i] - shape[j]))
                shares += share
    return lengths / shares if shares else float("nan")
