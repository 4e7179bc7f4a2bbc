"""The panel beside the cell: what the arm does and why, and the controls."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from kinecast.errors import MissingExtraError
from kinecast.robot.cell import Cell
from kinecast.robot.episode import Scenery
from kinecast.view.film import Film
from kinecast.view.playback import Playback
from kinecast.view.runs import Setting
from kinecast.view.words import decisions_html, figures_html, note_html, state_html

try:
    from viser import GuiApi, GuiHtmlHandle, Icon
except ImportError as error:  # pragma: no cover - the tests install it
    raise MissingExtraError("the browser view", "view") from error

__all__ = ["LAYERS", "LEVELS", "Panel"]

LAYERS = {"samples": "samples", "region": "region", "plan": "path"}
"""What can be hidden: predicted wrists, occupied space, planned path."""
LEVELS = (0.5, 0.8, 0.9, 0.95, 0.99)
RATES = {"¼": 0.25, "½": 0.5, "1": 1.0, "2": 2.0}
STEP = 0.05
"""Of the slider [s]."""
LAST = 4
"""Decisions shown."""
PREPARING = "The simulation is being prepared …"


class Panel:
    """Texts and controls.

    Args:
        gui: of the server.
        cell: with the cubes.
        setting: what is simulated first.
        scenarios, predictors: to choose from.
        playback: what play, pause and slider act on.
        choose: called with what is to be simulated from now on.
        layers: which of LAYERS are shown; changed by the checkboxes.
    """

    def __init__(
        self,
        gui: GuiApi,
        cell: Cell,
        setting: Setting,
        scenarios: Sequence[str],
        predictors: Sequence[str],
        playback: Playback,
        choose: Callable[[Setting], None],
        layers: dict[str, bool],
    ) -> None:
        self._gui, self._cell, self._playback, self._choose = gui, cell, playback, choose
        self._setting = setting
        self._film: Film | None = None
        self._said: dict[str, str] = {}
        self._state = gui.add_html("")
        self._slider = gui.add_slider("time [s]", 0.0, STEP, STEP, 0.0)
        self._play = gui.add_button("Pause", icon=Icon.PLAYER_PAUSE)
        self._figures = gui.add_html("")
        with gui.add_folder("Decisions"):
            self._decisions = gui.add_html("")
        with gui.add_folder("Simulation"):
            scenario = gui.add_dropdown("scenario", tuple(scenarios), initial_value=setting.scenario)
            predictor = gui.add_dropdown("predictor", tuple(predictors), initial_value=setting.predictor)
            levels = tuple(f"{100 * level:g} %" for level in sorted({*LEVELS, setting.level}))
            level = gui.add_dropdown(
                "region holds", levels, initial_value=f"{100 * setting.level:g} %",
                hint="Probability that each occupied capsule holds its limb; the arm is fast or slow by it.",
            )  # fmt: skip
            rate = gui.add_dropdown("speed of play", tuple(RATES), initial_value="1")
        with gui.add_folder("Show"):
            for name, label in LAYERS.items():
                box = gui.add_checkbox(label, layers[name])
                box.on_update(lambda event, name=name: layers.update({name: event.target.value}))  # type: ignore[misc]

        self._play.on_click(lambda _: playback.toggle())
        # Values set from here call back too, without a client.
        self._slider.on_update(lambda event: playback.seek(event.target.value) if event.client else None)
        rate.on_update(lambda event: playback.pace(RATES[event.target.value]))
        scenario.on_update(lambda event: self._change(replace(self._setting, scenario=event.target.value)))
        predictor.on_update(lambda event: self._change(replace(self._setting, predictor=event.target.value)))
        level.on_update(
            lambda event: self._change(replace(self._setting, level=float(event.target.value.rstrip(" %")) / 100))
        )

    def show(self, film: Film, moment: Scenery | None) -> None:
        """Says what is seen at a moment; that it is being prepared where there is none yet."""
        playback = self._playback
        if moment is None:
            self._say("state", self._state, note_html(film.ending or PREPARING))
            self._say("figures", self._figures, "")
            self._say("decisions", self._decisions, "")
        else:
            self._say("state", self._state, state_html(moment.decision, moment.stamp))
            self._say("figures", self._figures, figures_html(moment.decision, self._cell))
            ended = note_html(film.ending) if film.finished and moment.stamp >= film.end else ""
            last = film.decisions(moment.stamp, LAST)
            self._say("decisions", self._decisions, ended + decisions_html(last))
        end = max(STEP * round(film.end / STEP), STEP)
        if self._slider.max != end:
            self._slider.max = end
        self._slider.value = min(STEP * round(playback.position / STEP), end)  # type: ignore[misc]
        label = "Pause" if playback.playing else "Play"
        if self._play.label != label:
            self._play.label = label
            self._play.icon = Icon.PLAYER_PAUSE if playback.playing else Icon.PLAYER_PLAY

    def _say(self, name: str, handle: GuiHtmlHandle, text: str) -> None:
        """Sends a text that is new."""
        if self._said.get(name) != text:
            self._said[name] = handle.content = text

    def _change(self, setting: Setting) -> None:
        if setting != self._setting:
            self._setting = setting
            self._choose(setting)
