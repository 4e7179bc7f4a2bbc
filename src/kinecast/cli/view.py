"""`kinecast simulate --view`: the cell in the browser."""

from __future__ import annotations

from pathlib import Path

from kinecast.cli.simulate import SimulationConfig, closing_table, sentence
from kinecast.errors import OptionError
from kinecast.robot.collaboration import PREDICTORS, SCENARIOS
from kinecast.robot.outcome import outcome_of
from kinecast.robot.simulation import Simulation
from kinecast.types import Decision
from kinecast.view.playback import Setting, Simulations
from kinecast.view.viewer import Viewer

RECORDED = "recorded person"


def serve(host: str, port: int, scenario: str, predictor: str, config: SimulationConfig, out: Path | None) -> None:
    """Simulates and shows until Ctrl-C.

    Args:
        host, port: where it listens.
        scenario: shown first.
        predictor: at first.
        config: who comes.
        out: folder for what each finished run leaves; nothing is written without.

    Raises:
        OptionError: nothing can listen there, or no such predictor.
    """
    if predictor not in PREDICTORS:
        raise OptionError(f"--predictor {predictor}: allowed are {', '.join(PREDICTORS)}")
    played = {RECORDED: scenario} if config.player is not None else {name: name for name in SCENARIOS}

    def make(setting: Setting) -> Simulation:
        print(f"{setting.scenario}, {setting.predictor}, {100 * setting.level:g} %", flush=True)
        return config.simulation(played[setting.scenario], setting.predictor, setting.level)

    def tell(decision: Decision) -> None:
        print(sentence(decision), flush=True)

    def end(setting: Setting, simulation: Simulation) -> str:
        outcome = outcome_of(simulation.episode, simulation.people, simulation.cell)
        episodes = {setting.scenario: (simulation.episode, outcome)}
        print(closing_table(episodes), flush=True)
        if out is not None:
            config.write(out, episodes, setting.scenario, setting.predictor, level=setting.level)
        contacts = "no contact" if outcome.contacts == 0 else f"{outcome.contacts} contacts"
        return f"{outcome.result} after {outcome.time_to_done:.1f} s, {contacts}"

    first = next(name for name, what in played.items() if what == scenario)
    simulations = Simulations(tuple(played), PREDICTORS, config.cell, make, tell, end)
    viewer = Viewer(host, port, Setting(first, predictor), simulations)
    print(f"view: {viewer.url} (Ctrl-C ends it)", flush=True)
    try:
        viewer.serve()
    except KeyboardInterrupt:
        pass
    finally:
        viewer.close()
