"""Which cube next: the order, and which of them the person is about to take."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

__all__ = ["TaskSequence"]

TAKEN = 0.5
"""Probability from which on a cube is the person's, at once."""
FREE, AFTER = 0.2, 0.5
"""Probability below which it may be the arm's again, once it has stayed below for so long [s]."""


class TaskSequence:
    """The cubes still to be moved, in order.

    Args:
        order: names of the cubes.
    """

    def __init__(self, order: tuple[str, ...]) -> None:
        self.remaining = list(order)
        self.given_up: list[str] = []
        self.probabilities = dict.fromkeys(order, 0.0)
        self._taken = dict.fromkeys(order, False)
        self._free_from = dict.fromkeys(order, np.inf)

    def update(self, now: float, probabilities: Mapping[str, float]) -> None:
        """Takes in, per cube, the probability that the person reaches for it.

        Args:
            now: [s].
            probabilities: of cubes by name; one that is not named keeps its own.
        """
        for name, probability in probabilities.items():
            self.probabilities[name] = probability
            if probability >= TAKEN or (self._taken[name] and probability > FREE):
                self._taken[name], self._free_from[name] = True, np.inf
            elif self._taken[name]:
                self._free_from[name] = min(self._free_from[name], now + AFTER)
                self._taken[name] = now < self._free_from[name]

    def is_taken(self, name: str) -> bool:
        """Whether the cube is the person's for now."""
        return self._taken[name]

    def finish(self, name: str) -> None:
        """The cube is in its place."""
        self.remaining.remove(name)

    def give_up(self, name: str) -> None:
        """The cube cannot be had."""
        self.remaining.remove(name)
        self.given_up.append(name)
