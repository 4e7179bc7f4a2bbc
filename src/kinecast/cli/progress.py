"""What is said while a command works, on standard error: progress bars and notes."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from kinecast.types import Status

CONSOLE = Console(stderr=True)

PATIENCE = 2.0  # compiling is mentioned where it takes longer than this [s]
WIDE = 1000


@contextmanager
def progress_bar(title: str) -> Iterator[Callable[[int, int], None]]:
    """A bar while long work runs, on a terminal; yields what the work calls with (done, total)."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=CONSOLE, transient=True, disable=not CONSOLE.is_terminal) as progress:
        task = progress.add_task(title, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)


@contextmanager
def compiling() -> Iterator[None]:
    """Around the first prediction: says that it compiles, as it does once on each machine, if it takes over 2 s."""
    timer = threading.Timer(PATIENCE, note, ["compiling once for this machine ..."])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def columns(*words: str, numbers: str) -> Table:
    """An empty table: columns of words, then of numbers, whose titles have commas between them."""
    table = Table(*words, box=None, pad_edge=False)
    for title in numbers.split(","):
        table.add_column(Text(title), justify="right")
    return table


def plain(what: RenderableType) -> str:
    """A table of Rich's as plain text, so wide that nothing is cut."""
    console = Console(width=WIDE, color_system=None, force_terminal=False)
    with console.capture() as text:
        console.print(what)
    return "\n".join(line.rstrip() for line in text.get().splitlines())


def status_lines(counts: Counter[Status]) -> list[str]:
    """A line for each status, the most frequent first, with what to do about it."""
    return [
        f"{status.name}: {count}" + ("" if status is Status.OK else f"  ({status.advice})")
        for status, count in counts.most_common()
    ]


def note(text: str, style: str = "") -> None:
    """One line for the user, whatever is in it."""
    CONSOLE.print(" ".join(f"kinecast: {text}".split("\n")), style=style, markup=False, highlight=False, soft_wrap=True)
