"""What `kinecast live` shows: sources, sinks and statuses, while it runs and at the end."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Group
from rich.live import Live as Screen
from rich.text import Text

from kinecast.cli.progress import CONSOLE, columns, plain, status_lines
from kinecast.live.loop import Live
from kinecast.live.mailbox import Feed
from kinecast.types import Status

SILENT = 0.5  # after so long without a frame [s] a source is said to be silent
PER_SECOND = 4


@contextmanager
def shown(loop: Live) -> Iterator[None]:
    """A table in the terminal while it runs; nothing where there is no terminal."""
    if not CONSOLE.is_terminal:
        yield
        return
    with Screen(get_renderable=lambda: tables(loop), console=CONSOLE, refresh_per_second=PER_SECOND, transient=True):
        yield


def summary(loop: Live) -> str:
    """The same as plain text."""
    return plain(tables(loop, running=False))


def tables(loop: Live, running: bool = True) -> Group:
    """One table for what comes, one for what goes, one line for each status."""
    comes = columns("source", "status", numbers="frames,stale,refused,clients,clock [s],set")
    for feed in loop.mailbox.feeds:
        counts = (feed.received, feed.superseded, feed.refused, feed.clients)
        clock = "same" if feed.difference is None else f"{feed.difference:+.3f}"
        comes.add_row(Text(feed.name), _state(loop, feed, running), *map(str, counts), clock, str(feed.clock_jumps))
    goes = columns("sink", numbers="published,dropped,p50 [ms],p99 [ms]")
    for sink in loop.sinks:
        counters = sink.counters
        latencies = (f"{1e3 * counters.latency(share):.1f}" if counters.published else "–" for share in (0.5, 0.99))
        goes.add_row(Text(sink.address), str(counters.published), str(counters.dropped), *latencies)
    lines = map(Text, status_lines(loop.statuses.copy()))
    return Group(comes, Text(), goes, Text(), *lines)


def _state(loop: Live, feed: Feed, running: bool) -> Text:
    """The status of the newest prediction, or why there is none."""
    status = loop.last.get(feed)
    if feed.ended or not running:
        return Text("ended" if feed.ended else "–", "dim")
    if feed.last is None or (status is None and not feed.fused):
        return Text("waiting", "yellow")
    silence = time.monotonic() - feed.last
    if silence > SILENT:
        return Text(f"silent for {silence:.0f} s", "red")
    if status is None:
        return Text("fused", "green")
    return Text(status.name, "green" if status is Status.OK else "yellow")
