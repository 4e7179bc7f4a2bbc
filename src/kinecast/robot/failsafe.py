"""How fast the arm may go on so that it can stop before it is where a person may be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from kinecast.errors import OptionError
from kinecast.robot.occupancy import Occupancy
from kinecast.robot.ur5 import UR5

__all__ = ["FailsafeOptions", "free_speed"]

INSTANTS = 5


@dataclass(frozen=True)
class FailsafeOptions:
    """What stopping takes.

    Attributes:
        reaction: until the next decision [s]: one camera period and a control cycle.
        stopping: from full speed to rest [s], the longest of `Executor.stopping` in the cell; less in proportion from a
            lower speed.
        clearance: kept from the occupied region [m].
        speeds: shares of the planned speed to choose from, falling.
        foresight: who may be on the way within this long makes the arm slower already [s] …
        gentle: … but not below this share: it comes later, and they may be gone.
    """

    reaction: float = 0.04
    stopping: float = 0.2
    clearance: float = 0.01
    speeds: tuple[float, ...] = (1.0, 0.8, 0.6, 0.4, 0.25, 0.12, 0.05)
    foresight: float = 0.45
    gentle: float = 0.25

    def __post_init__(self) -> None:
        for name in ("reaction", "stopping", "clearance"):
            if not 0 <= getattr(self, name) < 10:
                raise OptionError(f"{name} {getattr(self, name)} is outside 0..10")
        if not self.speeds or any(not 0 < speed <= 1 for speed in self.speeds):
            raise OptionError(f"speeds {self.speeds}: at least one, each above 0 and at most 1")


def free_speed(
    arm: UR5,
    path: Callable[[Float[np.ndarray, " N"]], Float[np.ndarray, "N 6"]],
    now: float,
    occupancy: Occupancy,
    options: FailsafeOptions,
) -> float:
    """The greatest share of the planned speed from which the arm stops in time.

    For every share s, the places that the arm passes until it stands, s t along its path for t up to reaction +
    s · stopping, must be free at their times; or at least no nearer to anybody than if it had stood still, so that it
    may always draw back. Where that fails for t up to `foresight` it is slower already, not below `gentle`.

    Args:
        arm: the arm.
        path: configurations (N, 6) [rad] on its path, so many seconds (N,) at full speed from where it is.
        now: [s].
        occupancy: where people may be.
        options: see FailsafeOptions.

    Returns:
        One of the speeds, `gentle`, or 0.
    """
    if occupancy.radius.shape[1] == 0:
        return options.speeds[0]
    speeds = np.array(options.speeds)
    spans = options.reaction + speeds * options.stopping
    ahead = np.linspace(0.0, max(options.foresight, spans[0]), 2 * INSTANTS)
    if (_nearest(arm, path(speeds[0] * ahead), now + ahead, occupancy) >= options.clearance).all():
        return options.speeds[0]  # as nearly always
    until_it_stands, early = _allowed(
        arm, path, now, occupancy, options, speeds, np.stack([spans, np.full(len(speeds), ahead[-1])])
    )
    return min(until_it_stands, max(early, options.gentle))


def _allowed(
    arm: UR5,
    path: Callable[[Float[np.ndarray, " N"]], Float[np.ndarray, "N 6"]],
    now: float,
    occupancy: Occupancy,
    options: FailsafeOptions,
    speeds: Float[np.ndarray, " S"],
    spans: Float[np.ndarray, "B S"],
) -> list[float]:
    """The greatest of the speeds (S,) at which the arm is free for so long [s], or 0: B of them, for all spans."""
    shares = np.linspace(0.0, 1.0, INSTANTS)
    after = spans[..., None] * shares
    waited = spans[:, :1] * shares
    along = (speeds[:, None] * after).ravel()
    q = path(np.concatenate([along, np.zeros(waited.size)]))
    nearest = _nearest(arm, q, now + np.concatenate([after.ravel(), waited.ravel()]), occupancy)
    moving = nearest[: len(along)].reshape(after.shape)
    standing = np.stack([
        np.interp(*row) for row in zip(after, waited, nearest[len(along) :].reshape(waited.shape), strict=True)
    ])  # fmt: skip
    free = (moving >= options.clearance) | (moving >= standing - 1e-9)
    allowed: Bool[np.ndarray, "B S"] = np.all(free, axis=-1)
    return [float(speeds[np.argmax(row)]) if row.any() else 0.0 for row in allowed]


def _nearest(
    arm: UR5, q: Float[np.ndarray, "N 6"], times: Float[np.ndarray, " N"], occupancy: Occupancy
) -> Float[np.ndarray, " N"]:
    """(N,) from the arm at each of the times to the occupied region [m]."""
    body = arm.body_points(q)
    nearest: Float[np.ndarray, " N"] = (occupancy.signed_distance(body.positions, times)[0] - body.radius).min(axis=1)
    return nearest
