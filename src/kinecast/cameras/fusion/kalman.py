"""A Kalman filter for each joint of one person: position, velocity and an acceleration that fades (Singer 1970)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import expm

from kinecast.body.skeleton import without_side

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

_MOTION = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1 / FADE]])
_NOISE = np.diag([0.0, 0.0, 2 / FADE])  # spectral density that keeps an acceleration at 1 m/s²


class JointStates:
    """What is known of the joints of one person at an instant [s], in an order of theirs."""

    def __init__(self, joints: Sequence[str], stamp: float) -> None:
        self.mean = np.full((len(joints), 3, 3), np.nan)  # position [m], velocity, acceleration; NaN where never seen
        self.covariance = np.tile(np.eye(9), (len(joints), 1, 1))  # of the same nine numbers
        self.seen_at = np.full(len(joints), -np.inf)  # when a joint was last seen [s]; -inf where never
        self.stamp = stamp
        self._variances = np.array([ACCELERATIONS.get(without_side(each), ACCELERATION) ** 2 for each in joints])

    @property
    def known(self) -> Flags:
        """(J,) whether there is anything to go on from."""
        return self.seen_at > -np.inf

    def seen_within(self, period: float) -> Flags:
        """(J,) whether the joint was seen in the last so many seconds."""
        return self.stamp - self.seen_at < period

    def advance(self, stamp: float) -> None:
        """Goes on to a later instant [s]; who is not seen slows down: an unseen hand is not thrown away."""
        dt = stamp - self.stamp
        if dt <= 0:
            return
        block = expm(dt * np.block([[-_MOTION, _NOISE], [np.zeros((3, 3)), _MOTION.T]]))  # Van Loan 1978
        step = block[3:, 3:].T
        F, Q = np.kron(step, np.eye(3)), np.kron(step @ block[:3, 3:], np.eye(3))
        self.mean = step @ self.mean
        self.mean[stamp - self.seen_at > UNSEEN, 1:] *= np.exp(-dt / SLOWING)
        self.covariance = F @ self.covariance @ F.T + self._variances[:, None, None] * Q
        self.stamp = stamp

    def at(self, stamps: Float[np.ndarray, " V"]) -> Float[np.ndarray, "V J 3"]:
        """(V, J, 3) positions at earlier instants (V,) [s]."""
        return np.einsum("va,jax->vjx", np.array([_back(self.stamp - stamp) for stamp in stamps]), self.mean)

    def correct(self, information: Matrices, surprise: Points, delay: float = 0.0) -> None:
        """One weighted least squares over what is known of each joint and what is said of its position p.

        That is AᵀWA (J, 3, 3), zero where nothing is said, and AᵀW(b − A p) (J, 3), of so long ago [s].
        """
        told = information.any(axis=(1, 2)) & self.known
        B = np.kron(_back(delay), np.eye(3))
        covariance = np.linalg.inv(np.linalg.inv(self.covariance[told]) + B.T @ information[told] @ B)
        self.mean[told] += (covariance @ B.T @ surprise[told, :, None]).reshape(-1, 3, 3)
        self.covariance[told] = (covariance + np.swapaxes(covariance, 1, 2)) / 2

    def start(self, joints: Flags, positions: Points, covariance: Matrices) -> None:
        """Begins anew with these joints, where a first look places them (J, 3), with its covariance (J, 3, 3)."""
        self.mean[joints] = 0.0
        self.mean[joints, 0] = positions[joints]
        self.covariance[joints] = np.diag(np.repeat([0.0, START_SPEED**2, START_ACCELERATION**2], 3))
        self.covariance[joints, :3, :3] = covariance[joints]


def _back(dt: float) -> tuple[float, float, float]:
    """Weights of position, velocity and acceleration now in the position dt ago [s]."""
    return 1.0, -dt, dt * dt / 2
