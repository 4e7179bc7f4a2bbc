"""What is said while a command works, on standard error: progress bars and notes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

__all__ = ["CONSOLE", "note", "progress_bar"]

CONSOLE = Console(stderr=True)


@contextmanager
def progress_bar(title: str) -> Iterator[Callable[[int, int], None]]:
    """A bar while long work runs, on a terminal; yields what the work calls with (done, total)."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=CONSOLE, transient=True, disable=not CONSOLE.is_terminal) as progress:
        task = progress.add_task(title, total=None)

        def update(done: int, total: int) -> None:
            progress.update(task, completed=done, total=total)

        yield update


def note(text: str, style: str = "") -> None:
    """One line for the user, whatever is in it."""
    CONSOLE.print(" ".join(f"kinecast: {text}".split("\n")), style=style, markup=False, highlight=False, soft_wrap=True)
