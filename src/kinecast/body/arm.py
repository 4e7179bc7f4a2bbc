"""One arm as a chain of four or seven angles: where elbow, wrist and hand tip are, and how they move (Eq. 1).

Points are relative to the shoulder, in the torso frame (x forward, y to the left, z up); side is +1 left,
−1 right.
The first four angles are those of kinecast.body.arm_angles. Three more turn the hand:

| angle | positive is | zero is |
|---|---|---|
| theta5 pronation | palm turns down, elbow bent | thumb up, elbow bent |
| theta6 wrist flexion | towards the palm | hand in line with the forearm |
| theta7 wrist deviation | ulnar: away from the thumb | hand in line with the forearm |
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from kinecast.errors import OptionError

__all__ = ["forward_kinematics", "jacobian"]


@dataclass(frozen=True)
class _Chain:
    """Unit vectors of an arm: along its segments (…, P, 3), and the axes its angles turn about (…, D, 3)."""

    segments: Float[np.ndarray, "*batch P 3"]
    axes: Float[np.ndarray, "*batch D 3"]


def forward_kinematics(
    theta: Float[np.ndarray, "*batch D"], lengths: Float[np.ndarray, "*#batch P"], side: float
) -> Float[np.ndarray, "*batch P 3"]:
    """Points of an arm: elbow L1·u, wrist L1·u + L2·f, and with seven angles hand tip L1·u + L2·f + L3·h.

    With u, e1, e2 the axes of the upper arm (method.md, section 1) and b = cos θ3 e1 + sin θ3 e2,
    the forearm is f = cos θ4 u + sin θ4 b and bends on along g = cos θ4 b − sin θ4 u. With n = f × g,
    palm = side cos θ5 n − sin θ5 g and thumb = cos θ5 g + side sin θ5 n,
    the hand is h = cos θ7 (cos θ6 f + sin θ6 palm) − sin θ7 thumb.

    Args:
        theta: (…, 4) or (…, 7) angles [rad].
        lengths: (…, 2) upper arm and forearm [m]; (…, 3) with the hand for seven angles.
        side: +1 left, −1 right.

    Returns:
        (…, 2, 3) elbow and wrist [m]; (…, 3, 3) with the hand tip for seven angles.

    Raises:
        OptionError: another number of angles or lengths, or another side.
    """
    chain = _chain(theta, lengths, side)
    return np.cumsum(lengths[..., :, None] * chain.segments, axis=-2)


def jacobian(
    theta: Float[np.ndarray, "*batch D"], lengths: Float[np.ndarray, "*#batch P"], side: float
) -> Float[np.ndarray, "*batch P 3 D"]:
    """∂point/∂θ_i = axis_i × (point − joint_i), zero for points before joint i.

    Args:
        theta: (…, 4) or (…, 7) angles [rad].
        lengths: (…, 2) or (…, 3) lengths [m].
        side: +1 left, −1 right.

    Returns:
        (…, 2, 3, 4) or (…, 3, 3, 7) derivatives of `forward_kinematics` [m/rad].

    Raises:
        OptionError: another number of angles or lengths, or another side.
    """
    chain = _chain(theta, lengths, side)
    points = np.cumsum(lengths[..., :, None] * chain.segments, axis=-2)
    before = np.concatenate([np.zeros_like(points[..., :1, :]), points[..., :-1, :]], axis=-2)
    angles = theta.shape[-1]
    joint = np.array([0, 0, 0, 1, 1, 2, 2][:angles])  # shoulder, elbow, wrist
    levers = points[..., :, None, :] - before[..., None, joint, :]
    columns = np.cross(chain.axes[..., None, :, :], levers)
    columns[..., np.arange(points.shape[-2])[:, None] < joint, :] = 0.0
    return np.swapaxes(columns, -1, -2)


def _chain(theta: Float[np.ndarray, "*batch D"], lengths: Float[np.ndarray, "*#batch P"], side: float) -> _Chain:
    if (theta.shape[-1], lengths.shape[-1]) not in ((4, 2), (7, 3)):
        raise OptionError(
            f"an arm of {theta.shape[-1]} angles and {lengths.shape[-1]} lengths; "
            "allowed are 4 angles with 2 lengths and 7 angles with 3"
        )
    if side not in (1.0, -1.0):
        raise OptionError(f"side {side} is neither +1 (left) nor -1 (right)")
    sine, cosine = np.sin(theta)[..., None, :], np.cos(theta)[..., None, :]
    (s1, s2, s3, s4), (c1, c2, c3, c4) = (np.moveaxis(x[..., 0, :4], -1, 0) for x in (sine, cosine))
    u = np.stack([c2 * s1, side * s2, -c2 * c1], axis=-1)
    e1 = np.stack([c1, np.zeros_like(c1), s1], axis=-1)
    e2 = np.stack([-s2 * s1, side * c2, s2 * c1], axis=-1)
    b = c3[..., None] * e1 + s3[..., None] * e2
    f = c4[..., None] * u + s4[..., None] * b
    n = np.cross(u, b)
    sideways = np.broadcast_to(np.array([0.0, -1.0, 0.0]), u.shape)
    segments, axes = [u, f], [sideways, side * e1, -side * u, n]
    if theta.shape[-1] == 7:
        g = c4[..., None] * b - s4[..., None] * u
        palm = side * cosine[..., 4] * n - sine[..., 4] * g
        thumb = cosine[..., 4] * g + side * sine[..., 4] * n
        flexed = cosine[..., 5] * f + sine[..., 5] * palm
        segments.append(cosine[..., 6] * flexed - sine[..., 6] * thumb)
        axes += [side * f, -side * thumb, side * (sine[..., 5] * f - cosine[..., 5] * palm)]
    return _Chain(np.stack(segments, axis=-2), np.stack(axes, axis=-2))
