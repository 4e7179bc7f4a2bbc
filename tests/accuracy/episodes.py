"""What the simulated arm decides beside a person, episode by episode, and what it decided when it was recorded.

python -m tests.accuracy.episodes           every episode anew, compared with episodes.json
python -m tests.accuracy.episodes --record  writes episodes.json

An episode is one scenario of `kinecast simulate` with one seed, of person and camera. The predictor draws random
numbers of its own, which the seed does not change; another count of samples makes it draw others. What is recorded is
therefore what was seen with each of `VARIANTS`.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import sys
import tempfile
from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any
from unittest import mock

RECORDED = Path(__file__).with_name("episodes.json")
SCENARIOS = ("avoid", "reorder", "replan")
SEEDS = range(5)
VARIANTS = (200, 201)
"""Samples per prediction of the runs that are recorded; the first is the command's default."""
LEAST = 0.5
"""The time to done is compared no more closely than this [s]: a planner's path may end a little later."""
SPREADS = 4.0
"""And no more closely than so many standard deviations between variants."""

Facts = dict[str, Any]


class _NoPictures(Exception):  # noqa: N818 - nothing is wrong
    """Raised where the first picture would be drawn."""


def play(scenario: str, seed: int, samples: int = VARIANTS[0]) -> Facts:
    """Runs one episode by the command `kinecast simulate`, without its pictures.

    Args:
        scenario: one of SCENARIOS, or `all`.
        seed: of person and camera.
        samples: drawn per prediction.

    Returns:
        By scenario, or of the only one: `steps`, the decisions as [state, target, reaction] wherever one of them
        changed; of these `reactions` as [reaction, target] and `targets`, each where it changed; `placed`, cubes in the
        order in which they were; `result`; `contacts`; `done`, the time until all was done [s].
    """
    from matplotlib.figure import Figure

    from kinecast.cli.commands import run

    with tempfile.TemporaryDirectory() as folder:
        arguments = ("--scenario", scenario, "--seed", seed, "--samples", samples, "--out", folder)
        # The decisions are written before anything is drawn.
        with (
            mock.patch.object(Figure, "__init__", side_effect=_NoPictures),
            contextlib.redirect_stdout(io.StringIO()),
            contextlib.suppress(_NoPictures),
        ):
            run(["simulate", *map(str, arguments)])
        episodes = json.loads((Path(folder) / "episode.json").read_text())["episodes"]
    facts = {name: facts_of(episode) for name, episode in episodes.items()}
    return facts if scenario == "all" else facts[scenario]


def facts_of(episode: Mapping[str, Any]) -> Facts:
    """What is compared of one entry of episode.json."""
    told = [[each["state"], each["target"], each["reaction"]] for each in episode["decisions"]]
    steps = [step for step, _ in groupby(told)]
    return {
        "steps": steps,
        "reactions": [[reaction, target] for _, target, reaction in steps if reaction is not None],
        "targets": [target for target, _ in groupby(target for _, target, _ in steps if target is not None)],
        "placed": list(episode["placed"]),
        "result": episode["outcome"]["result"],
        "contacts": episode["outcome"]["contacts"],
        "done": round(episode["outcome"]["time_to_done"], 3),
    }


def differences(found: Facts, recorded: Mapping[str, Any], tolerance: float) -> list[str]:
    """How an episode differs from what was recorded, in words; empty where it does not.

    Args:
        found: of `play`.
        recorded: its entry in episodes.json: whatever was seen with one of the variants is right.
        tolerance: of the time to done, beyond the span that was seen [s].
    """
    wrong = [
        f"{name} {found[name]}, recorded {' or '.join(map(str, recorded[name]))}"
        for name in ("reactions", "targets", "placed", "result")
        if found[name] not in recorded[name]
    ]
    if found["contacts"] != 0:
        wrong.append(f"{found['contacts']} contacts, allowed is none")
    low, high = min(recorded["done"]) - tolerance, max(recorded["done"]) + tolerance
    if not low <= found["done"] <= high:
        wrong.append(f"done after {found['done']} s, allowed are {low:.2f} to {high:.2f} s")
    return wrong


def recorded_of(variants: Sequence[Facts]) -> dict[str, Any]:
    """The entry of one episode: every different thing that was seen, the first variant's first."""
    entry: dict[str, Any] = {"contacts": max(each["contacts"] for each in variants)}
    for name in ("reactions", "targets", "placed", "result"):
        entry[name] = []
        for each in variants:
            if each[name] not in entry[name]:
                entry[name].append(each[name])
    entry["done"] = [each["done"] for each in variants]
    entry["steps"] = variants[0]["steps"]
    return entry


def spread(entries: Sequence[Mapping[str, Any]]) -> float:
    """Standard deviation of the time to done between variants of the same episode, over all of them [s]."""
    squares = degrees = 0.0
    for entry in entries:
        mean = sum(entry["done"]) / len(entry["done"])
        squares += sum((value - mean) ** 2 for value in entry["done"])
        degrees += len(entry["done"]) - 1
    return float((squares / degrees) ** 0.5)


def record(path: Path = RECORDED) -> None:
    """Runs every episode with every variant and writes what was seen."""
    episodes: dict[str, dict[str, Any]] = {name: {} for name in SCENARIOS}
    for seed in SEEDS:
        runs = [play("all", seed, samples) for samples in VARIANTS]
        for name in SCENARIOS:
            entry = recorded_of([run[name] for run in runs])
            print(f"{name} {seed}: {entry['reactions']}, done after {entry['done']} s", flush=True)
            episodes[name][str(seed)] = entry
    stated = {
        name: {
            "spread": round(spread(list(entries.values())), 4),
            "tolerance": round(max(LEAST, SPREADS * spread(list(entries.values()))), 3),
        }
        for name, entries in episodes.items()
    }
    write(path, stated, episodes)


def write(path: Path, stated: Mapping[str, Any], episodes: Mapping[str, Any]) -> None:
    """Writes episodes.json, a line for each value."""
    content: dict[str, Any] = {
        "about": "Written by `python -m tests.accuracy.episodes --record`. Each list of reactions, targets, placed and "
        "result holds every different one that was seen with one of the counts of samples in `samples`; an episode "
        "is right if it has any of them. done: time to done with each [s]; allowed is that span and `tolerance` "
        f"around it, at least {LEAST} s, or {SPREADS:g} times `spread`, the standard deviation between counts of "
        "samples of the same episode. contacts: 0, exactly. steps: the decisions with the first count, [state, target, "
        "reaction]; to read, not compared.",
        "samples": list(VARIANTS),
        "time_to_done": stated,
        "episodes": episodes,
    }
    lines = json.dumps(content, indent=1).splitlines()
    path.write_text("\n".join(_joined(lines)) + "\n")


def _joined(lines: Sequence[str], depth: int = 4) -> list[str]:
    """JSON with everything deeper than so many levels on one line."""
    out: list[str] = []
    for line in lines:
        indent = len(line) - len(line.lstrip())
        closing = line.strip()[0] in "]}"
        if indent > depth or (indent == depth and closing):
            out[-1] += ("" if out[-1].endswith(("[", "{")) or closing else " ") + line.strip()
        else:
            out.append(line)
    return out


def main() -> None:
    """Records, or compares every episode and says what differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--record", action="store_true")
    parser.add_argument("--samples", type=int, default=VARIANTS[0])
    arguments = parser.parse_args()
    if arguments.record:
        record()
        return
    content, failed = json.loads(RECORDED.read_text()), False
    for seed in SEEDS:
        for name, found in play("all", seed, arguments.samples).items():
            tolerance = content["time_to_done"][name]["tolerance"]
            wrong = differences(found, content["episodes"][name][str(seed)], tolerance)
            print(f"{name} {seed}: {'; '.join(wrong) or 'as recorded'}, done after {found['done']} s", flush=True)
            failed |= bool(wrong)
    sys.exit(failed)


if __name__ == "__main__":
    main()
