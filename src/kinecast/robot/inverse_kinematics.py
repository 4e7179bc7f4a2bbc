"""Inverse kinematics of a UR arm in closed form: every branch.

Three parallel axes (2, 3, 4) make it solvable: the place of wrist 2 gives q1, the flange's height along those axes q5,
its direction q6, and what is left is a triangle in the plane of upper arm and forearm. Derived after K. P. Hawkins,
"Analytic Inverse Kinematics for the Universal Robots UR-5/UR-10 Arms" (Georgia Institute of Technology, 2013).
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

__all__ = ["branches"]

D1, A2, A3, D4, D5, D6 = 0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823
"""Denavit-Hartenberg lengths [m], as in data/ur5.urdf (a test compares them)."""

STRAIGHT = 1e-7
"""|sin q5| under which the wrist counts as straight and q6 as free."""
ROUND_OFF = 1e-9
"""How far a cosine may exceed 1: the arm stretched to its end, but for round-off."""


def branches(T_base_flange: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "B 6"]:
    """Every solution with angles in [−π, π).

    Args:
        T_base_flange: (4, 4) flange in the controller's base frame.

    Returns:
        (B, 6) [rad], B up to 8; 0 out of reach.
    """
    T = np.asarray(T_base_flange, dtype=np.float64)
    found = [
        (q1, q2, q3, q4, q5, q6)
        for q1 in _pans(T)
        for q5 in _bends(T, q1)
        for q6 in [_roll(T, q1, q5)]
        for q2, q3, q4 in _triangles(T, q1, q5, q6)
    ]
    return (np.array(found).reshape(-1, 6) + np.pi) % (2 * np.pi) - np.pi


def _pans(T: Float[np.ndarray, "4 4"]) -> Iterator[float]:
    """q1: the arm's plane lies d4 beside wrist 2."""
    x, y = (T[:3, 3] - D6 * T[:3, 2])[:2]
    distance = math.hypot(x, y)
    if distance < D4 - ROUND_OFF:
        return
    towards, aside = math.atan2(y, x) + np.pi / 2, math.acos(min(D4 / distance, 1.0))
    yield towards + aside
    if aside > 0:
        yield towards - aside


def _bends(T: Float[np.ndarray, "4 4"], q1: float) -> Iterator[float]:
    """q5: how far the flange sticks out of the arm's plane."""
    cosine = (T[0, 3] * math.sin(q1) - T[1, 3] * math.cos(q1) - D4) / D6
    if abs(cosine) > 1 + ROUND_OFF:
        return
    bend = math.acos(min(max(cosine, -1.0), 1.0))
    yield bend
    if math.sin(bend) > STRAIGHT:
        yield -bend


def _roll(T: Float[np.ndarray, "4 4"], q1: float, q5: float) -> float:
    """q6: the direction of the arm's axes as the flange sees it; 0 where it is free."""
    if abs(math.sin(q5)) <= STRAIGHT:
        return 0.0
    sine, cosine = math.sin(q1), math.cos(q1)
    x, y = sine * T[0, 0] - cosine * T[1, 0], sine * T[0, 1] - cosine * T[1, 1]
    sign = math.copysign(1.0, math.sin(q5))
    return math.atan2(-y * sign, x * sign)


def _triangles(T: Float[np.ndarray, "4 4"], q1: float, q5: float, q6: float) -> Iterator[tuple[float, float, float]]:
    """q2, q3, q4: upper arm and forearm reach wrist 1, elbow up and elbow down."""
    T_1_4 = np.linalg.inv(_link(q1, D1, 0.0, np.pi / 2)) @ T
    T_1_4 = T_1_4 @ np.linalg.inv(_link(q5, D5, 0.0, -np.pi / 2) @ _link(q6, D6, 0.0, 0.0))
    # Wrist 1 in the plane of the arm; T_1_4's rotation turns about the plane's normal by q2 + q3 + q4.
    x, y = T_1_4[0, 3], T_1_4[1, 3]
    cosine = (x * x + y * y - A2 * A2 - A3 * A3) / (2 * A2 * A3)
    if abs(cosine) > 1 + ROUND_OFF:
        return
    elbow = math.acos(min(max(cosine, -1.0), 1.0))
    whole = math.atan2(T_1_4[1, 0], T_1_4[0, 0])
    for q3 in (elbow, -elbow) if 0 < elbow < np.pi else (elbow,):
        q2 = math.atan2(y, x) - math.atan2(A3 * math.sin(q3), A2 + A3 * math.cos(q3))
        yield q2, q3, whole - q2 - q3


def _link(theta: float, d: float, a: float, alpha: float) -> Float[np.ndarray, "4 4"]:
    """One row of the table: Rz(θ) Tz(d) Tx(a) Rx(α)."""
    c, s, ca, sa = math.cos(theta), math.sin(theta), math.cos(alpha), math.sin(alpha)
    return np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]])
