"""`kinecast live` from end to end: a take at its pace to the browser view, a WebSocket client and an MCAP file at once.

python -m benchmarks.live [--data RECORDING] [--minutes N] [--samples S] [--out JSON]

The command runs in a process of its own, as a user starts it; this one is the client. A frame is acquired when it is
due. Latency is until the client has it, and until the file has it: both processes read the same clock; for the view,
until the picture is sent to the one who looks on, a client that reads all and draws nothing. Without --data a person
is generated, at 100 Hz.
"""

from __future__ import annotations

import argparse
import json
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from benchmarks.generated_people import SyntheticOptions, generate
from benchmarks.machine import facts, milliseconds, save
from kinecast.datasets import table
from kinecast.datasets.loading import load
from kinecast.live.mcap_file import PREDICTIONS

COMMAND = (sys.executable, "-c", "from kinecast.cli import main; main()", "live")
SETTLED = 10.0
"""Seconds after which memory should not grow any more."""
LOOK = 1.0
"""Between two looks at the memory [s]."""
LONG = 120.0


def main() -> None:
    """Runs, prints, writes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--samples", type=int, default=1000)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    before = facts()
    with tempfile.TemporaryDirectory() as folder:
        result = run(arguments.data, arguments.minutes, arguments.samples, Path(folder))
    if arguments.out:
        save("live", result, arguments.out, before)
    print(f"load {before['load']:.1f} before, {facts()['load']:.1f} after, on {before['cores']} cores")
    print(json.dumps(result, indent=1))


def run(data: Path | None, minutes: float, samples: int, folder: Path) -> dict[str, Any]:
    """Plays for so long and accounts for every frame.

    Args:
        data: a recording of one take; None for a generated person.
        minutes: of playing.
        samples: per prediction.
        folder: for files.

    Returns:
        Counts of frames, latencies and memory.
    """
    if data is None:
        data = folder / "generated.parquet"
        table.write(data, generate(SyntheticOptions(subjects=1, recordings=1, rate=100.0), seed=0))
    take = load(data)[0]
    repeat = int(np.ceil(60 * minutes / take.duration)) + 20
    source, out = f"recording:{data}?repeat={repeat}", folder / "live.mcap"
    sinks = ("--sink", "ws://127.0.0.1:0", "--sink", f"mcap:{out}", "--sink", "view://127.0.0.1:0")
    arguments = ("--source", source, *sinks, "--samples", str(samples))
    with subprocess.Popen((*COMMAND, *arguments), stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        sink, view = (
            next(match[1] for line in process.stdout if (match := re.match(rf"sink: ({scheme}:\S+)", line)))
            for scheme in ("ws", "http")
        )
        received: dict[int, float] = {}
        heard = threading.Event()
        client = threading.Thread(target=listen, args=(sink, received, heard), daemon=True)
        client.start()
        threading.Thread(target=look_on, args=(view,), daemon=True).start()
        heard.wait(LONG)
        resident = [resident_mib(process.pid) for _ in seconds(60 * minutes)]
        process.send_signal(signal.SIGINT)
        summary = process.stdout.read()
        client.join(LONG)
    return {"rate_hz": take.rate, "minutes": minutes, "samples": samples, **account(summary, out, received, resident)}


def account(summary: str, out: Path, received: dict[int, float], resident: list[float]) -> dict[str, Any]:
    """What became of every frame, from the command's summary, the file and the client."""
    counts = re.search(r"^recording:\S+\s+ended\s+(\d+)\s+(\d+)", summary, re.MULTILINE)
    assert counts is not None, summary
    frames, stale = map(int, counts.groups())
    dropped = [int(line.split()[2]) for line in re.findall(r"^(?:ws:|\S+\.mcap).*$", summary, re.MULTILINE)]
    drawn = re.search(r"^http:\S+\s+(\d+)\s+(\d+)\s+(\S+)\s+(\S+)", summary, re.MULTILINE)
    assert drawn is not None, summary
    acquired, written = {}, {}
    with out.open("rb") as file:
        for _, _, message in make_reader(file).iter_messages([PREDICTIONS]):
            acquired[message.sequence] = message.log_time / 1e9
            written[message.sequence] = message.publish_time / 1e9
    settled = resident[int(SETTLED / LOOK) :] or resident
    first = min(received)
    return {
        "frames": frames,
        "stale": stale,
        "published": len(acquired),
        "unaccounted": frames - stale - len(acquired) - dropped[1],
        "dropped_by_file": dropped[1],
        "dropped_by_socket": dropped[0],
        "missed_by_client": sum(number not in received for number in acquired if number >= first),
        "to_file": milliseconds([written[number] - acquired[number] for number in acquired]),
        "to_client": milliseconds([received[number] - acquired[number] for number in received if number in acquired]),
        "to_view": {
            "count": int(drawn[1]),
            "replaced": int(drawn[2]),
            "p50_ms": float(drawn[3]),
            "p99_ms": float(drawn[4]),
        },
        "resident_mib": {"settled": settled[0], "last": settled[-1], "growth": max(settled) / settled[0] - 1},
    }


def listen(address: str, received: dict[int, float], heard: threading.Event) -> None:
    """Notes when each prediction came, until the server says goodbye; says when the first has."""
    with connect(address, proxy=None, open_timeout=LONG) as client:
        try:
            for content in client:
                received[json.loads(content)["number"]] = time.time()
                heard.set()
        except ConnectionClosed:
            pass


def look_on(address: str) -> None:
    """Reads what a browser is sent, until the server says goodbye."""
    url, protocol = address.replace("http:", "ws:"), Subprotocol(f"viser-v{version('viser')}")
    with connect(url, proxy=None, open_timeout=LONG, subprotocols=[protocol], max_size=None) as client:
        try:
            for _ in client:
                pass
        except ConnectionClosed:
            pass


def seconds(duration: float) -> Any:
    """Every second of a duration, as it passes."""
    end = time.monotonic() + duration
    while (left := end - time.monotonic()) > 0:
        time.sleep(min(LOOK, left))
        yield


def resident_mib(process: int) -> float:
    """Memory that a process holds now; NaN where the system does not say."""
    try:
        status = Path(f"/proc/{process}/status").read_text()
    except OSError:
        return float("nan")
    found = re.search(r"VmRSS:\s+(\d+) kB", status)
    return int(found[1]) / 1024 if found else float("nan")


if __name__ == "__main__":
    main()
