"""`kinecast simulate`: an arm picks and places three cubes beside a person."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import numpy as np
from tyro.conf import arg

from kinecast import __version__
from kinecast.cli.options import Switch, check_folder, check_seed
from kinecast.cli.progress import columns, compiling, plain
from kinecast.cli.recordings import read_recordings
from kinecast.errors import OptionError

if TYPE_CHECKING:
    from kinecast.robot.episode import Episode, Outcome
    from kinecast.robot.simulated_person import PlayedPerson
    from kinecast.robot.simulation import Simulation
    from kinecast.types import Decision

    Episodes: TypeAlias = Mapping[str, tuple[Episode, Outcome]]

SYNTHETIC, RECORDED = "synthetic", "recorded person"
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
        cell: constants of the camera and of monitoring, and where things stand (docs/cell.md).
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
    if scenario not in (*SCENARIOS, "all"):
        raise OptionError(f"--scenario {scenario}: allowed are {', '.join(SCENARIOS)}, all")
    scripted = tuple(name for name, each in SCENARIOS.items() if each.fetches)
    names = scripted if scenario == "all" else (scenario,)
    if out is not None or not view:
        check_folder(out or OUT)
    world = _World(person, cell, seed, samples)
    if view:
        _serve(host, port, names[0], predictor, world, out)
        return
    out = out or OUT
    episodes = {}
    for name in names:
        simulation = world.simulation(name, predictor)
        print(f"{name}: {SCENARIOS[name].about if world.player is None else 'a recorded person'}")
        for command in simulation.steps():
            if command.news:
                _tell(command.decision)
        episodes[name] = simulation.episode, simulation.outcome()
    world.write(out, episodes, scenario, predictor)
    print(_table(episodes))
    print(f"decisions: {out / 'episode.json'}")
    print(f"pictures: {out / 'storyboard.png'}, and a GIF and a timeline of each scenario beside it")


class _World:
    """Who comes where, and how they are predicted, whatever the scenario.

    An OptionError where there is no such cell, a DatasetError where a recording cannot be read.
    """

    def __init__(self, person: str, cell: str, seed: int, samples: int) -> None:
        from kinecast.robot.cell import cell_named
        from kinecast.robot.collaboration import replayed_person

        self.cell, self.seed, self.samples = cell_named(cell), seed, samples
        self.player: PlayedPerson | None = None
        self._settings = {"person": Path(person).name, "cell": cell, "seed": seed, "samples": samples}
        if person != SYNTHETIC:
            recordings = read_recordings((Path(person),), None)
            self.player = replayed_person(max(recordings, key=lambda each: len(each.stamps)), self.cell)

    def simulation(self, scenario: str, predictor: str, level: float = 0.95) -> Simulation:
        """One episode, ready to run; says that it compiles where that takes long."""
        from kinecast.robot.collaboration import simulate_scenario

        with compiling():
            return simulate_scenario(scenario, predictor, self.seed, self.samples, self.player, level, self.cell)

    def write(self, out: Path, episodes: Episodes, scenario: str, predictor: str, **more: object) -> None:
        """Writes decisions, figures and pictures of episodes, with what was asked for."""
        from kinecast.robot.collaboration import SCENARIOS
        from kinecast.robot.episode import write_episodes
        from kinecast.robot.episode_pictures import animate_episode, draw_storyboard, draw_timeline

        asked = {"version": __version__, "scenario": scenario, "predictor": predictor}
        write_episodes(out, episodes, {**asked, **self._settings, **more})
        about = {name: f"{name}: {each.about}" for name, each in SCENARIOS.items()}
        rows = {about.get(name, name): episode for name, (episode, _) in episodes.items()}
        draw_storyboard(out / "storyboard.png", rows, self.cell)
        for name, (episode, _) in episodes.items():
            animate_episode(out / f"{name}.gif", episode, self.cell, name)
            draw_timeline(out / f"{name}_timeline.png", episode, f"{name}: {predictor}")


def _serve(host: str, port: int, scenario: str, predictor: str, world: _World, out: Path | None) -> None:
    """Simulates and shows in the browser until Ctrl-C; what finished runs leave goes to a folder, if there is one.

    An OptionError where nothing can listen there, or for no such predictor.
    """
    from kinecast.robot.collaboration import PREDICTORS, SCENARIOS
    from kinecast.view.playback import Setting, Simulations
    from kinecast.view.viewer import Viewer

    if predictor not in PREDICTORS:
        raise OptionError(f"--predictor {predictor}: allowed are {', '.join(PREDICTORS)}")
    played = {RECORDED: scenario} if world.player is not None else {name: name for name in SCENARIOS}

    def make(setting: Setting) -> Simulation:
        print(f"{setting.scenario}, {setting.predictor}, {100 * setting.level:g} %", flush=True)
        return world.simulation(played[setting.scenario], setting.predictor, setting.level)

    def end(setting: Setting, simulation: Simulation) -> str:
        outcome = simulation.outcome()
        episodes = {setting.scenario: (simulation.episode, outcome)}
        print(_table(episodes), flush=True)
        if out is not None:
            world.write(out, episodes, setting.scenario, setting.predictor, level=setting.level)
        contacts = "no contact" if outcome.contacts == 0 else f"{outcome.contacts} contacts"
        return f"{outcome.result} after {outcome.time_to_done:.1f} s, {contacts}"

    first = Setting(RECORDED if RECORDED in played else scenario, predictor)
    simulations = Simulations(tuple(played), PREDICTORS, world.cell, make, _tell, end)
    with closing(Viewer(host, port, first, simulations)) as it:
        print(f"view: {it.url} (Ctrl-C ends it)", flush=True)
        it.serve()


def _tell(decision: Decision) -> None:
    """One decision in a line."""
    reaction = "" if decision.reaction is None else f"[{decision.reaction.name.lower().replace('_', ' ')}] "
    print(f"{decision.stamp:7.2f} s  {decision.state.name.lower():10}  {reaction}{decision.reason}", flush=True)


def _table(episodes: Episodes) -> str:
    """The figures of every scenario."""
    table = columns("", "result", numbers="contacts,least [m],done [s],stops,replans,p50 [ms],p99 [ms]")
    for name, (_, outcome) in episodes.items():
        least = f"{outcome.least_distance:.2f}" if np.isfinite(outcome.least_distance) else "–"
        counts = (outcome.contacts, least, f"{outcome.time_to_done:.1f}", outcome.stops, outcome.replans)
        latencies = (f"{outcome.latency_p50:.1f}", f"{outcome.latency_p99:.1f}")
        table.add_row(name, outcome.result, *map(str, counts), *latencies)
    return plain(table)
