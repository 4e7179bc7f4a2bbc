"""A Kalman filter for each joint of one person: position, velocity and an acceleration that fades (Singer 1970).

Beside it how far joints can be from one another: enough to tell a hand from the wall behind it.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from kinecast.body.skeleton import without_side
from kinecast.cameras.fusion.measurement import FUSED_JOINTS, TRUNK

Flags = Bool[np.ndarray, " J"]
Points = Float[np.ndarray, "J 3"]
Matrices = Float[np.ndarray, "J 3 3"]
FADE = 0.4  # time in which an acceleration fades [s], from tuning: docs/decisions/0022
ACCELERATIONS = {"elbow": 2.0, "wrist": 3.0, "hand": 4.0}
ACCELERATION = 1.0
"""Standard deviation of a joint's acceleration along each axis [m/s²]: two to three times what it is in recorded work,
for the sake of a small lag (docs/decisions/0022)."""
START_SPEED, START_ACCELERATION = 0.7, 3.0  # standard deviations of a joint not seen before [m/s], [m/s²]
UNSEEN, SLOWING = 0.1, 0.3  # a joint that nobody has seen for so long [s] loses its speed in so long [s]

_VARIANCES = np.array([ACCELERATIONS.get(without_side(joint), ACCELERATION) ** 2 for joint in FUSED_JOINTS])
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)


_WITHIN_SIDE = {
    ("shoulder", "elbow"): 0.42, ("elbow", "wrist"): 0.36, ("shoulder", "wrist"): 0.75, ("wrist", "hand"): 0.22,
    ("elbow", "hand"): 0.55, ("shoulder", "hip"): 0.75, ("hip", "knee"): 0.60, ("knee", "ankle"): 0.60,
    ("hip", "ankle"): 1.15,
}  # fmt: skip
"""Within one side of the body [m]: a tall man's (ANSUR II, 99th percentile) and a fifth more, since points are marker
clusters and estimates, no joint centres."""
_ACROSS = {"shoulder": 0.60, "hip": 0.50}
_TO_TRUNK = {
    "pelvis": {"shoulder": 0.80, "hip": 0.35}, "lumbar": {"shoulder": 0.65, "hip": 0.40},
    "spine": {"shoulder": 0.60, "hip": 0.50}, "thorax": {"shoulder": 0.55, "hip": 0.55},
    "chest": {"shoulder": 0.45, "hip": 0.65}, "collar": {"shoulder": 0.40, "hip": 0.80},
    "neck": {"shoulder": 0.40, "hip": 0.85}, "head": {"shoulder": 0.55}, "nose": {"shoulder": 0.60},
}  # fmt: skip
_WITHIN_TRUNK = 1.0

RECENT = 0.3  # a joint not seen for so long [s] says nothing of its neighbours
ANCHOR_STD = 0.25  # how near a joint is to its neighbours [m]: about an upper arm's length


def _longest() -> Float[np.ndarray, "J J"]:
    """(J, J) longest distance of each two joints [m]; inf where there is none."""
    sides = ("left", "right")
    pairs = {(f"{side}_{a}", f"{side}_{b}"): far for (a, b), far in _WITHIN_SIDE.items() for side in sides}
    pairs |= {(f"left_{joint}", f"right_{joint}"): far for joint, far in _ACROSS.items()}
    pairs |= {(a, b): _WITHIN_TRUNK for k, a in enumerate(TRUNK) for b in TRUNK[:k]}
    pairs |= {(a, f"{side}_{b}"): far for a, near in _TO_TRUNK.items() for b, far in near.items() for side in sides}
    longest = np.full((len(FUSED_JOINTS), len(FUSED_JOINTS)), np.inf)
    for (a, b), far in pairs.items():
        i, j = FUSED_JOINTS.index(a), FUSED_JOINTS.index(b)
        longest[i, j] = longest[j, i] = far
    return longest


_LONGEST = _longest()


def _response(times: Float[np.ndarray, " N"]) -> Float[np.ndarray, "3 N"]:
    """(3, N) position, velocity and acceleration, so long after [s] an acceleration of 1 m/s² from rest: ȧ = −a/τ."""
    fallen = -np.expm1(-times / FADE)
    return np.stack([FADE * (times - FADE * fallen), FADE * fallen, 1 - fallen])


def back(dt: Float[np.ndarray, "*v"] | float) -> Float[np.ndarray, "*v 3"]:
    """(…, 3) weights of position, velocity and acceleration now in the position dt ago [s]."""
    dt = np.asarray(dt)
    return np.stack([np.ones_like(dt), -dt, dt * dt / 2], axis=-1)


class JointStates:
    """What is known of the joints of one person at an instant [s], in the order of FUSED_JOINTS."""

    def __init__(self, stamp: float) -> None:
        joints = len(FUSED_JOINTS)
        self.mean = np.full((joints, 3, 3), np.nan)  # position [m], velocity, acceleration; NaN where never seen
        self.covariance = np.tile(np.eye(9), (joints, 1, 1))  # of the same nine numbers
        self.standing = np.zeros((joints, 3, 3))  # of the part of a position's error that stays in the next image [m²]
        self.seen_at = np.full(joints, -np.inf)  # when a joint was last seen [s]; -inf where never
        self.stamp = stamp

    @property
    def known(self) -> Flags:
        """(J,) whether there is anything to go on from."""
        return self.seen_at > -np.inf

    def seen_within(self, period: float) -> Flags:
        """(J,) whether the joint was seen in the last so many seconds."""
        return self.stamp - self.seen_at < period

    def forget(self, joints: Flags) -> None:
        """As if these had never been seen."""
        self.mean[joints], self.covariance[joints], self.seen_at[joints] = np.nan, np.eye(9), -np.inf
        self.standing[joints] = 0.0

    def advance(self, stamp: float) -> None:
        """Goes on to a later instant [s]; who is not seen slows down: an unseen hand is not thrown away."""
        dt = stamp - self.stamp
        if dt <= 0:
            return
        step = np.array([[1.0, dt, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
        step[:, 2] = _response(np.array([dt]))[:, 0]
        r = _response(dt * (_NODES + 1) / 2)
        disturbance = dt / FADE * (r * _WEIGHTS) @ r.T  # 2/τ ∫ r rᵀ, of an acceleration of 1 m/s²
        F, Q = np.kron(step, np.eye(3)), np.kron(disturbance, np.eye(3))
        unseen = stamp - self.seen_at > UNSEEN
        self.mean = step @ self.mean
        self.mean[unseen, 1:] *= np.exp(-dt / SLOWING)
        self.covariance = F @ self.covariance @ F.T + _VARIANCES[:, None, None] * Q
        self.stamp = stamp

    def at(self, stamp: float) -> tuple[Points, Matrices]:
        """(J, 3) positions at an earlier instant [s], and (J, 3, 3) their covariance [m²]."""
        b = back(self.stamp - stamp)
        B = np.kron(b, np.eye(3))
        return b @ self.mean, self.standing + B @ self.covariance @ B.T

    def correct(
        self,
        stamps: Float[np.ndarray, " V"],
        information: Float[np.ndarray, "V J 3 3"],
        surprise: Float[np.ndarray, "V J 3"],
    ) -> None:
        """One weighted least squares over what is known of each joint and all that several images say of it.

        They were taken at stamps (V,) [s] and give AᵀWA (V, J, 3, 3) about where the joint was then, zero where nothing
        is said, and AᵀW(b − A p) (V, J, 3), with p as `at` gives it.
        """
        told = information.any(axis=(0, 2, 3)) & self.known
        if not told.any():
            return
        b = back(self.stamp - stamps)
        B = np.kron(b[:, None], np.eye(3))[:, None]  # (V, 1, 3, 9)
        more = (np.swapaxes(B, -1, -2) @ information[:, told] @ B).sum(axis=0)
        covariance = np.linalg.inv(np.linalg.inv(self.covariance[told]) + more)
        step = covariance @ np.einsum("va,vjx->jax", b, surprise[:, told]).reshape(-1, 9, 1)
        self.mean[told] += step.reshape(-1, 3, 3)
        self.covariance[told] = (covariance + np.swapaxes(covariance, 1, 2)) / 2

    def start(self, joints: Flags, positions: Points, covariance: Matrices) -> None:
        """Begins anew with these joints, where a first look places them (J, 3), with its covariance (J, 3, 3)."""
        self.mean[joints] = 0.0
        self.mean[joints, 0] = positions[joints]
        self.covariance[joints] = np.diag(np.repeat([0.0, START_SPEED**2, START_ACCELERATION**2], 3))
        self.covariance[joints, :3, :3] = covariance[joints]

    def share_too_far(self, places: Float[np.ndarray, "*h J 3"]) -> Float[np.ndarray, "*h J"]:
        """(…, J) share of its neighbours that a joint at a place (…, J, 3) would be too far from; 0 without any."""
        told = np.isfinite(_LONGEST) & self.seen_within(RECENT)
        with np.errstate(invalid="ignore"):
            away = np.linalg.norm(places[..., :, None, :] - self.mean[:, 0], axis=-1)
            return ((away > _LONGEST) & told).sum(axis=-1) / np.maximum(told.sum(axis=-1), 1)

    def anchors(self) -> tuple[Points, Flags]:
        """(J, 3) the middle of each joint's neighbours, nearer ones first, and whether there is one."""
        weight = np.where(self.seen_within(RECENT), _LONGEST**-4.0, 0.0)
        there = np.where(self.known[:, None], self.mean[:, 0], 0.0)
        total = weight.sum(axis=1)
        return weight @ there / np.maximum(total, 1e-9)[:, None], total > 0
