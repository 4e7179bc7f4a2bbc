"""`kinecast simulate`: an arm picks and places three cubes beside a person."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from rich.table import Table
from rich.text import Text
from tyro.conf import arg

from kinecast import __version__
from kinecast.cli.options import Switch, check_folder, check_seed
from kinecast.cli.progress import compiling, plain
from kinecast.cli.recordings import read_recordings
from kinecast.errors import OptionError

if TYPE_CHECKING:
    from kinecast.robot.cell import Cell
    from kinecast.robot.episode import Episode
    from kinecast.robot.outcome import Outcome
    from kinecast.robot.person import PlayedPerson
    from kinecast.types import Decision

SYNTHETIC = "synthetic"
OUT = Path("kinecast-simulate")

ScenarioName = Annotated[
    str,
    arg(
        metavar="NAME",
        help="avoid: the same cube, around the person; reorder: another cube first; replan: another in mid-motion; "
        "all: one after the other; none: a person without a script.",
    ),
]
PredictorName = Annotated[
    str,
    arg(
        metavar="NAME",
        help="kinecast, gp_constrained, damped_velocity, zero_velocity: shipped models; "
        "reachable: all the person can reach; oracle: what will happen; none: measured distances alone; "
        "MODULE:FUNCTION: your own method (docs/predictor.md).",
    ),
]
CellName = Annotated[str, arg(metavar="lab|camera|certified")]
OutFolder = Annotated[Path | None, arg(metavar="FOLDER", help_behavior_hint=f"(default: {OUT})")]
PersonName = Annotated[str, arg(metavar="synthetic|PATH", help="a generated person, or a recording that is played.")]


def simulate(
    scenario: ScenarioName = "all",
    person: PersonName = SYNTHETIC,
    predictor: PredictorName = "kinecast",
    cell: CellName = "camera",
    seed: int = 0,
    samples: int = 200,
    view: Switch = False,
    host: str = "127.0.0.1",
    port: int = 8080,
    out: OutFolder = None,
) -> None:
    """Simulates a UR5 that picks and places a red, a green and a blue cube at a table shared with a person.

    Args:
        cell: constants of the camera and of monitoring, and where things stand (docs/robot.md).
        seed: of the person and the camera; the same seed gives the same episode.
        samples: motions drawn per prediction.
        view: shows the cell in the browser until Ctrl-C; writes files only with --out.
        host: address the view listens on; other machines can see and control it where that is not this machine's own.
        port: of the view; 0 is any that is free.
        out: folder for episode.json, storyboard.png, and an outcome.json (of several scenarios each in a folder of its
            name), a GIF and a timeline of each scenario.
    """
    from kinecast.robot.collaboration import SCENARIOS  # here, since robot and drawing are extras

    check_seed(seed)
    check_scenario(scenario)
    config = SimulationConfig(person, seed, samples, cell)
    config.scene()
    if view:
        from kinecast.cli.view import serve  # here, since the view is an extra

        if out is not None:
            check_folder(out)
        serve(host, port, scenario, predictor, config, out)
        return
    out = OUT if out is None else out
    check_folder(out)
    names = tuple(SCENARIOS) if scenario == "all" else (scenario,)
    episodes = play(names, predictor, config)
    write(out, episodes, config.settings(scenario, predictor))
    print(closing_table(episodes))
    print(f"decisions: {out / 'episode.json'}")
    print(f"pictures: {out / 'storyboard.png'}, and a GIF and a timeline of each scenario beside it")


@dataclass(frozen=True)
class SimulationConfig:
    """Who comes, and how they are predicted, whatever the scenario.

    Attributes:
        person: SYNTHETIC, or the path of a recording.
        seed: of the person and the camera.
        samples: motions drawn per prediction.
        cell: name of the cell.
    """

    person: str
    seed: int
    samples: int
    cell: str = "camera"

    def scene(self) -> Cell:
        """The cell of that name.

        Raises:
            OptionError: there is none.
        """
        from kinecast.robot.cell import cell_named

        return cell_named(self.cell)

    def player(self) -> PlayedPerson | None:
        """The recorded person; None for a generated one.

        Raises:
            DatasetError: the recording cannot be read.
        """
        from kinecast.robot.collaboration import replayed_person

        if self.person == SYNTHETIC:
            return None
        recordings = read_recordings((Path(self.person),), None)
        return replayed_person(max(recordings, key=lambda each: len(each.stamps)), self.scene())

    def settings(self, scenario: str, predictor: str) -> dict[str, object]:
        """What was asked for, as written to files."""
        return {
            "version": __version__,
            "scenario": scenario,
            "person": self.person if self.person == SYNTHETIC else Path(self.person).name,
            "predictor": predictor,
            "cell": self.cell,
            "seed": self.seed,
            "samples": self.samples,
        }


def check_scenario(name: str) -> None:
    """Raises OptionError for a scenario that there is not."""
    from kinecast.robot.collaboration import SCENARIOS, UNSCRIPTED

    if name not in (*SCENARIOS, UNSCRIPTED, "all"):
        raise OptionError(f"--scenario {name}: allowed are {', '.join(SCENARIOS)}, {UNSCRIPTED}, all")


def play(names: tuple[str, ...], predictor: str, config: SimulationConfig) -> dict[str, tuple[Episode, Outcome]]:
    """Runs scenarios, and prints the decisions as they fall."""
    from kinecast.robot.collaboration import Forecasters, simulate_scenario
    from kinecast.robot.outcome import outcome_of

    player, forecasters, episodes = config.player(), Forecasters(config.samples), {}
    for name in names:
        with compiling():
            simulation = simulate_scenario(name, predictor, config.seed, forecasters, player, cell=config.scene())
        print(f"{name}: {about(name) if player is None else 'a recorded person'}")
        for command in simulation.steps():
            if command.news:
                print(sentence(command.decision), flush=True)
        episode = simulation.episode
        episodes[name] = (episode, outcome_of(episode, simulation.people, simulation.cell))
    return episodes


def about(name: str) -> str:
    """What a scenario shows."""
    from kinecast.robot.collaboration import SCENARIOS

    return SCENARIOS[name].about if name in SCENARIOS else "A person who does what they would at a table."


def sentence(decision: Decision) -> str:
    """One decision in a line."""
    reaction = "" if decision.reaction is None else f"[{decision.reaction.name.lower().replace('_', ' ')}] "
    return f"{decision.stamp:7.2f} s  {decision.state.name.lower():10}  {reaction}{decision.reason}"


def write(out: Path, episodes: Mapping[str, tuple[Episode, Outcome]], settings: Mapping[str, object]) -> None:
    """Writes the decisions and the pictures."""
    from kinecast.robot.cell import cell_named
    from kinecast.robot.episode_file import write_episode, write_outcome
    from kinecast.robot.storyboard import Row, animate_episode, draw_storyboard
    from kinecast.robot.timeline import draw_timeline
    from kinecast.robot.ur5 import UR5

    arm, cell = UR5(), cell_named(str(settings["cell"]))
    out.mkdir(parents=True, exist_ok=True)
    write_episode(out / "episode.json", episodes, settings)
    for name, (_, outcome) in episodes.items():
        write_outcome((out if len(episodes) == 1 else out / name) / "outcome.json", outcome)
    rows = [Row(f"{name}: {about(name)}", episode) for name, (episode, _) in episodes.items()]
    draw_storyboard(out / "storyboard.png", rows, cell, arm)
    for name, (episode, _) in episodes.items():
        animate_episode(out / f"{name}.gif", episode, cell, arm, name)
        draw_timeline(out / f"{name}_timeline.png", episode, f"{name}: {settings['predictor']}")


def closing_table(episodes: Mapping[str, tuple[Episode, Outcome]]) -> str:
    """The figures of every scenario."""
    table = Table("", "result", box=None, pad_edge=False)
    for title in ("contacts", "least [m]", "done [s]", "stops", "replans", "p50 [ms]", "p99 [ms]"):
        table.add_column(Text(title), justify="right")
    for name, (_, outcome) in episodes.items():
        least = f"{outcome.least_distance:.2f}" if np.isfinite(outcome.least_distance) else "–"
        counts = (outcome.contacts, least, f"{outcome.time_to_done:.1f}", outcome.stops, outcome.replans)
        latencies = (f"{outcome.latency_p50:.1f}", f"{outcome.latency_p99:.1f}")
        table.add_row(name, outcome.result, *map(str, counts), *latencies)
    return plain(table)
