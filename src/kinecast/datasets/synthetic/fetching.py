"""Somebody at a table who reaches for chosen places at chosen times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from kinecast.datasets.recording import Recording
from kinecast.datasets.synthetic.activity import LEFT, RIGHT, Actor
from kinecast.datasets.synthetic.body import JOINTS, Body
from kinecast.datasets.synthetic.options import SyntheticOptions, table_scene
from kinecast.errors import OptionError

__all__ = ["Fetch", "fetching"]


@dataclass(frozen=True, eq=False)
class Fetch:
    """One reach.

    Attributes:
        start: when it begins [s].
        place: (3,) of the wrist, in the person's frame: on the floor, x forward, z up [m].
        hold: how long the hand stays there [s].
        left: with which hand; None for the one on the place's side.
    """

    start: float
    place: Float[np.ndarray, "3"]
    hold: float = 1.0
    left: bool | None = None


def fetching(fetches: Sequence[Fetch], duration: float, seed: int, rate: float = 100.0) -> Recording:
    """The true motion of somebody who reaches for places one after the other.

    Args:
        fetches: in order of their starts; one that begins before the last has ended waits for it.
        duration: [s].
        seed: of the build, the tempo and the way they move.
        rate: frames per second [Hz].

    Raises:
        OptionError: a duration or rate that is not above 0.
    """
    if not (duration > 0 and rate > 0):
        raise OptionError(f"duration {duration} s and rate {rate} Hz must be above 0")
    build, motion = np.random.SeedSequence(seed).spawn(2)
    body = Body.sample(np.random.default_rng(build))
    options = SyntheticOptions(hesitation=0.0)
    actor = Actor(body, options, table_scene(options), np.random.default_rng(motion))
    for fetch in fetches:
        left = fetch.place[1] > 0 if fetch.left is None else fetch.left
        actor.fetch(fetch.start, fetch.place, LEFT if left else RIGHT, fetch.hold)
    stamps = np.arange(max(2, round(duration * rate))) / rate
    return Recording(
        name=f"synthetic/fetching/{seed}",
        joints=JOINTS,
        stamps=stamps,
        positions=actor.joints(stamps),
        rate=rate,
        subject=f"synthetic-{seed}",
        task="fetching",
        labels=actor.labels(stamps),
        notes=("generated",),
    )
