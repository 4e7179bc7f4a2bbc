"""Denavit-Hartenberg chains, and the arm as one (Eq. 1: j = H1 … Hp).

Standard (distal) convention: H = Rz(sign·θ + offset) Tz(d) Tx(a) Rx(α).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from kinecast.errors import OptionError

__all__ = ["T_TORSO_BASE", "Link", "arm_links", "link_frames"]

HALF = 0.5 * math.pi

T_TORSO_BASE = np.array([
    [1.0, 0.0, 0.0, 0.0],
    [0.0, 0.0, -1.0, 0.0],
    [0.0, 1.0, 0.0, 0.0],
    [0.0, 0.0, 0.0, 1.0],
])  # fmt: skip
"""Base of the arm's chain in the torso frame, at the shoulder: x forward, y up, z to the right."""


@dataclass(frozen=True)
class Link:
    """One row of a table: a revolute joint and the way to the next.

    Attributes:
        offset: of the angle [rad].
        alpha: twist about x [rad].
        d: offset along z [m].
        a: length along x [m].
        sign: +1, or −1 where the angle turns the other way.
    """

    offset: float
    alpha: float
    d: float = 0.0
    a: float = 0.0
    sign: float = 1.0


def arm_links(lengths: Sequence[float], side: float) -> tuple[Link, ...]:
    """The table of an arm: the same chain as kinecast.body.arm, in the base `T_TORSO_BASE`.

    Flexion comes first: it turns about the line of the shoulders, abduction about an axis flexion carries.

    Args:
        lengths: upper arm and forearm [m] for four angles; with the hand for seven.
        side: +1 left, −1 right.

    Returns:
        Four or seven links.

    Raises:
        OptionError: another number of lengths.
    """
    if len(lengths) not in (2, 3):
        raise OptionError(f"{len(lengths)} lengths of an arm; allowed are 2 (four angles) and 3 (seven)")
    upper, fore = lengths[:2]
    shoulder = (
        Link(-HALF, HALF),
        Link(HALF, HALF, sign=-side),
        Link(HALF, HALF, d=upper, sign=-side),
    )
    if len(lengths) == 2:
        return (*shoulder, Link(HALF, 0.0, a=fore))
    return (
        *shoulder,
        Link(math.pi, HALF),
        Link(-side * HALF, HALF, d=fore, sign=side),
        Link(-HALF, HALF),
        Link(math.pi, 0.0, a=lengths[2], sign=-side),
    )


def link_frames(links: Sequence[Link], theta: Float[np.ndarray, "*batch D"]) -> Float[np.ndarray, "*batch D 4 4"]:
    """Frames after each link, H1 … Hi, in the base of the chain.

    Args:
        links: D rows of the table.
        theta: (…, D) angles [rad].

    Returns:
        (…, D, 4, 4) transforms.

    Raises:
        OptionError: not as many angles as links.
    """
    if theta.shape[-1] != len(links):
        raise OptionError(f"{theta.shape[-1]} angles for a chain of {len(links)} links")
    frames = np.empty((*theta.shape, 4, 4))
    frame = np.eye(4)
    for i, link in enumerate(links):
        angle = link.sign * theta[..., i] + link.offset
        s, c = np.sin(angle), np.cos(angle)
        sa, ca = math.sin(link.alpha), math.cos(link.alpha)
        H = np.zeros((*angle.shape, 4, 4))
        H[..., 0, 0], H[..., 0, 1], H[..., 0, 2], H[..., 0, 3] = c, -s * ca, s * sa, link.a * c
        H[..., 1, 0], H[..., 1, 1], H[..., 1, 2], H[..., 1, 3] = s, c * ca, -c * sa, link.a * s
        H[..., 2, 1], H[..., 2, 2], H[..., 2, 3] = sa, ca, link.d
        H[..., 3, 3] = 1.0
        frame = frame @ H
        frames[..., i, :, :] = frame
    return frames
