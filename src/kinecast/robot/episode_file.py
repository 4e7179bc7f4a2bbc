"""An episode as JSON: what was asked for, every decision, what happened over time, and the figures."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from kinecast.evaluation.output import write_atomically
from kinecast.robot.episode import Episode
from kinecast.robot.outcome import Outcome
from kinecast.types import Decision

__all__ = ["write_episode", "write_outcome"]

EVERY = 5
"""Control steps between two rows of the timeline: 25 a second."""


def write_episode(path: Path, episodes: Mapping[str, tuple[Episode, Outcome]], settings: Mapping[str, Any]) -> None:
    """Write episodes by name to one file.

    Args:
        path: of the JSON.
        episodes: and their figures.
        settings: what was asked for.
    """
    content = {
        "settings": dict(settings),
        "episodes": {name: _content(episode, outcome) for name, (episode, outcome) in episodes.items()},
    }
    write_atomically(path, (json.dumps(_plain(content), indent=1) + "\n").encode())


def write_outcome(path: Path, outcome: Outcome) -> None:
    """Write the figures of one episode; its folder is made where it is missing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, (json.dumps(outcome.plain(), indent=1) + "\n").encode())


def _content(episode: Episode, outcome: Outcome) -> dict[str, Any]:
    return {
        "outcome": dataclasses.asdict(outcome),
        "placed": episode.placed,
        "given_up": list(episode.given_up),
        "decisions": [_decision(each) for each in episode.decisions],
        "timeline": [{**dataclasses.asdict(tick), "state": tick.state.name.lower()} for tick in episode.ticks[::EVERY]],
    }


def _decision(decision: Decision) -> dict[str, Any]:
    row = {each.name: getattr(decision, each.name) for each in dataclasses.fields(decision)}
    row["state"] = decision.state.name.lower()
    row["reaction"] = None if decision.reaction is None else decision.reaction.name.lower()
    row["taken"] = dict(decision.taken)
    return row


def _plain(value: Any) -> Any:
    """Numbers rounded to what they mean; what JSON cannot say (no distance, no time) as null."""
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, float):
        return round(value, 5) if math.isfinite(value) else None
    return value
