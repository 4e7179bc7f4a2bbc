"""Where a person stands before one camera: their shape in metres fitted to where its joints are in the image.

The network sees no more than a cut-out around the person, so that its shape is in the axes of somebody who looks
straight at them: it is turned towards the ray of the hips first. What is left is a translation t, the least squares
of Σ ‖π(X + t) − d‖² / σ² over directions d = x/z, y/z (perspective-n-point with a known turn), solved as Hartley and
Sturm's linear rows (Triangulation, 1997), weighted anew with each depth and with Huber's weights.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

STEPS = 5  # each brings about a digit
HUBER = 1.5  # standard deviations beyond which an error counts linearly
NEAREST = 0.2  # nobody is nearer to the camera [m]
LEAST_JOINTS = 4

_BONES = {
    ("shoulder", "elbow"): 0.186, ("elbow", "wrist"): 0.146, ("hip", "knee"): 0.245, ("knee", "ankle"): 0.246,
    ("shoulder", "hip"): 0.288,
}  # fmt: skip
"""Length of a bone as a share of the body's height: Drillis and Contini 1966, as in Winter, Biomechanics and Motor
Control of Human Movement; from shoulder to hip as of its heights 0.818 and 0.530."""


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
        if not (np.isfinite(t).all() and depth.min() > NEAREST):
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
