"""Which cube next: the order, and which of them the person is about to take."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from kinecast.errors import OptionError

__all__ = ["SequenceOptions", "TaskSequence"]


@dataclass(frozen=True)
class SequenceOptions:
    """When a cube counts as the person's. Two thresholds and a delay, so that the arm does not dither.

    Attributes:
        taken: probability from which on a cube is the person's, at once.
        free: probability below which it may be the arm's again …
        after: … once it has stayed below for so long [s].
    """

    taken: float = 0.5
    free: float = 0.2
    after: float = 0.5

    def __post_init__(self) -> None:
        if not 0.0 <= self.free < self.taken <= 1.0:
            raise OptionError(f"free {self.free} and taken {self.taken}: must rise from 0 to 1")
        if not self.after >= 0.0:
            raise OptionError(f"after {self.after} s must be 0 or more")


class TaskSequence:
    """The cubes still to be moved, in order.

    Args:
        order: names of the cubes.
        options: see SequenceOptions.
    """

    def __init__(self, order: tuple[str, ...], options: SequenceOptions | None = None) -> None:
        self.options = options or SequenceOptions()
        self.remaining = list(order)
        self.given_up: list[str] = []
        self.probabilities = dict.fromkeys(order, 0.0)
        self._taken = dict.fromkeys(order, False)
        self._low_since: dict[str, float | None] = dict.fromkeys(order, None)

    def update(self, now: float, probabilities: Mapping[str, float]) -> None:
        """Takes in, per cube, the probability that the person reaches for it.

        Args:
            now: [s].
            probabilities: of cubes by name; one that is not named keeps its own.
        """
        for name, probability in probabilities.items():
            self.probabilities[name] = probability
            if probability >= self.options.taken:
                self._taken[name], self._low_since[name] = True, None
            elif probability > self.options.free:
                self._low_since[name] = None
            elif self._taken[name]:
                since = self._low_since[name]
                since = now if since is None else since
                self._low_since[name] = since
                self._taken[name] = now - since < self.options.after

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
