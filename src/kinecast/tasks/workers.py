"""What does tasks: this process, one after another. kinecast.tasks.cluster spreads the same ones over many.

A task is a function and its arguments; an argument may be what `submit` returned for another task, alone or in a list.
Nothing else may pass between tasks: no global state, and no generator of random numbers but one made from a seed and
the task's own place (`generator`). Their order then does not matter, nor where they run.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any, Protocol, runtime_checkable

import numpy as np
from threadpoolctl import threadpool_limits

__all__ = ["CARRIED", "Progress", "Serial", "Workers", "alone", "generator", "given"]

CARRIED: set[ModuleType] = set()
"""Modules of the user's own, whose code travels with tasks: workers elsewhere may not have them."""

Progress = Callable[[int, int], None]
"""Called with (done, total) tasks."""


@runtime_checkable
class Workers(Protocol):
    """Does tasks."""

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Takes a task on.

        Args:
            function: of a module, or a partial of one: its name travels, not its code.
            arguments: values, or what `submit` returned for other tasks, alone or in a list.

        Returns:
            What stands for the task's result.
        """
        ...

    def results(self, handles: Sequence[Any], progress: Progress | None = None) -> list[Any]:
        """What tasks gave, once every task taken on is done.

        Args:
            handles: what `submit` returned.
            progress: called with (done, total) tasks taken on since the last results.

        Raises:
            Exception: what the first task that failed raised.
        """
        ...


class _Task:
    """A task of this process; its arguments are let go once it is done."""

    def __init__(self, function: Callable[..., Any], arguments: Sequence[Any]) -> None:
        self._call: tuple[Callable[..., Any], Sequence[Any]] | None = (function, arguments)
        self.result: Any = None

    def run(self) -> None:
        assert self._call is not None
        function, arguments = self._call
        self._call = None
        self.result = alone(function, *map(_result, arguments))


class Serial:
    """This process: each task in its turn."""

    def __init__(self) -> None:
        self._waiting: list[_Task] = []

    def submit(self, function: Callable[..., Any], *arguments: Any) -> _Task:
        """See Workers."""
        task = _Task(function, arguments)
        self._waiting.append(task)
        return task

    def results(self, handles: Sequence[_Task], progress: Progress | None = None) -> list[Any]:
        """See Workers."""
        waiting, self._waiting = self._waiting, []
        for done, task in enumerate(waiting, 1):
            task.run()
            if progress:
                progress(done, len(waiting))
        return [task.result for task in handles]


def alone(function: Callable[..., Any], *arguments: Any) -> Any:
    """A function's result, its linear algebra in one thread: sums over several threads would depend on their number."""
    import scipy.linalg  # noqa: F401 - a BLAS that is not loaded yet could not be limited

    with threadpool_limits(1, user_api="blas"):
        return function(*arguments)


def generator(seed: int, *place: int) -> np.random.Generator:
    """Random numbers of one task: the same for the same place, unlike those of every other place and seed."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=place))


def given(value: Any) -> Any:
    """A value as a task, so that it travels once to each worker, however many tasks need it."""
    return value


def _result(argument: Any) -> Any:
    """What an argument stands for."""
    if isinstance(argument, list):
        return [_result(each) for each in argument]
    return argument.result if isinstance(argument, _Task) else argument
