"""`kinecast simulate --view`: the cell in the browser."""

from __future__ import annotations

from pathlib import Path

from kinecast.cli.progress import compiling
from kinecast.cli.simulate import SimulationConfig, closing_table, sentence, write
from kinecast.errors import OptionError
from kinecast.robot.body import OccupancyOptions
from kinecast.robot.collaboration import PREDICTORS, SCENARIOS, Forecasters, simulate_scenario
from kinecast.robot.outcome import outcome_of
from kinecast.robot.simulation import Simulation
from kinecast.robot.supervisor import SupervisorOptions
from kinecast.types import Decision
from kinecast.view.runs import Setting
from kinecast.view.server import check_address
from kinecast.view.viewer import Viewer

RECORDED = "recorded person"


def serve(host: str, port: int, scenario: str, predictor: str, config: SimulationConfig, out: Path | None) -> None:
    """Simulates and shows until Ctrl-C.

    Args:
        host, port: where it listens.
        scenario: shown first; "all" begins with the first.
        predictor: at first.
        config: who comes.
        out: folder for what each finished run leaves; nothing is written without.

    Raises:
        OptionError: nothing can listen there, or no such predictor.
    """
    check_address(host, port, f"--host {host} --port {port}")
    if predictor not in PREDICTORS:
        raise OptionError(f"--predictor {predictor}: allowed are {', '.join(PREDICTORS)}")
    player, forecasters = config.player(), Forecasters(config.samples)
    scenarios = tuple(SCENARIOS) if player is None else (RECORDED,)

    def make(setting: Setting) -> Simulation:
        name = setting.scenario if player is None else next(iter(SCENARIOS))
        print(f"{setting.scenario}, {setting.predictor}, {100 * setting.level:g} %", flush=True)
        options = SupervisorOptions(occupancy=OccupancyOptions(level=setting.level))
        with compiling():
            return simulate_scenario(name, setting.predictor, config.seed, forecasters, player, options)

    def tell(decision: Decision) -> None:
        print(sentence(decision), flush=True)

    def end(setting: Setting, simulation: Simulation) -> str:
        outcome = outcome_of(simulation.episode, simulation.people, simulation.cell)
        episodes = {setting.scenario: (simulation.episode, outcome)}
        print(closing_table(episodes), flush=True)
        if out is not None:
            write(out, episodes, {**config.settings(setting.scenario, setting.predictor), "level": setting.level})
        contacts = "no contact" if outcome.contacts == 0 else f"{outcome.contacts} contacts"
        return f"{outcome.result} after {outcome.time_to_done:.1f} s, {contacts}"

    first = scenario if scenario in scenarios else scenarios[0]
    viewer = Viewer(host, port, Setting(first, predictor), scenarios, PREDICTORS, config.scene(), make, tell, end)
    print(f"view: {viewer.url} (Ctrl-C ends it)", flush=True)
    try:
        viewer.serve()
    except KeyboardInterrupt:
        pass
    finally:
        viewer.close()
