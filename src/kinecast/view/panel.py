"""The panel beside the cell: what the arm does and why, and the controls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from html import escape
from typing import Any

import numpy as np
from viser import GuiApi, GuiEvent, Icon

from kinecast.robot.cell import Cell
from kinecast.robot.colours import INK, MUTED, STATES, cube_colour, hex_of
from kinecast.robot.episode import SceneSnapshot
from kinecast.types import Decision
from kinecast.view.playback import Playback, Run, Setting, Simulations

LEVELS = {f"{100 * level:g} %": level for level in (0.5, 0.8, 0.9, 0.95, 0.99)}
RATES = {"¼": 0.25, "½": 0.5, "1": 1.0, "2": 2.0}
STEP = 0.05  # of the slider [s]
LAST = 4  # decisions shown
PREPARING = "The simulation is being prepared …"
FRAME = f"font-size:13px;line-height:1.4;color:{hex_of(INK)};padding:2px 14px 6px 14px"
GREY = f"color:{hex_of(MUTED)}"


class Panel:
    """Texts and controls; play, pause and slider act on the playback, checkboxes change which layers are shown."""

    def __init__(
        self, gui: GuiApi, setting: Setting, simulations: Simulations, playback: Playback, layers: dict[str, bool]
    ) -> None:
        self._setting, self._simulations, self._playback = setting, simulations, playback
        self.state = gui.add_html("")
        self.slider = gui.add_slider("time [s]", 0.0, STEP, STEP, 0.0)
        self.play = gui.add_button("Pause", icon=Icon.PLAYER_PAUSE)
        self.figures = gui.add_html("")
        with gui.add_folder("Decisions"):
            self.decisions = gui.add_html("")
        with gui.add_folder("Simulation"):
            scenario = gui.add_dropdown("scenario", simulations.scenarios, initial_value=setting.scenario)
            predictor = gui.add_dropdown("predictor", simulations.predictors, initial_value=setting.predictor)
            level = gui.add_dropdown(
                "region holds", tuple(LEVELS), initial_value=f"{100 * setting.level:g} %",
                hint="Probability that each occupied capsule holds its limb; the arm is fast or slow by it.",
            )  # fmt: skip
            rate = gui.add_dropdown("speed of play", tuple(RATES), initial_value="1")
        with gui.add_folder("Show"):
            for name, shown in layers.items():
                box = gui.add_checkbox(name, shown)
                box.on_update(lambda event, name=name: layers.update({name: event.target.value}))  # type: ignore[misc]

        self.play.on_click(lambda _: playback.toggle())
        self.slider.on_update(self._seek)
        rate.on_update(lambda event: setattr(playback, "rate", RATES[event.target.value]))
        scenario.on_update(lambda event: self.change(scenario=event.target.value))
        predictor.on_update(lambda event: self.change(predictor=event.target.value))
        level.on_update(lambda event: self.change(level=LEVELS[event.target.value]))

    async def _seek(self, event: GuiEvent[Any]) -> None:
        """Not in another thread, or a picture that is just drawn may set the slider back before it is read."""
        if event.client is not None:  # values set from here call back too
            self._playback.seek(event.target.value)

    def show(self, moment: SceneSnapshot | None) -> None:
        """Says what is seen at a moment; that it is being prepared where there is none yet."""
        playback, run = self._playback, self._playback.run
        if moment is None:
            state, figures, decisions = note_html(run.ending or PREPARING), "", ""
        else:
            state = state_html(moment.decision, moment.stamp)
            figures = figures_html(moment.decision, self._simulations.cell)
            told = [each for each in run.episode.decisions if each.stamp <= moment.stamp]
            ended = note_html(run.ending) if run.ending and moment.stamp >= run.last else ""
            decisions = ended + decisions_html(told[: -LAST - 1 : -1])
        # Nothing is sent that is as before.
        self.state.content, self.figures.content, self.decisions.content = state, figures, decisions
        self.slider.max = end = max(STEP * round(run.last / STEP), STEP)
        self.slider.value = min(STEP * round(playback.position / STEP), end)  # type: ignore[misc]
        label = "Pause" if playback.playing else "Play"
        if self.play.label != label:
            self.play.label = label
            self.play.icon = Icon.PLAYER_PAUSE if playback.playing else Icon.PLAYER_PLAY

    def change(self, **changed: object) -> None:
        """Begins another run where a part of the setting is new."""
        setting = replace(self._setting, **changed)  # type: ignore[arg-type]
        if setting != self._setting:
            self._setting = setting
            self._playback.load(Run(setting, self._simulations, self._playback.run))


def state_html(decision: Decision, stamp: float) -> str:
    """State, cube and reason, at a time [s]."""
    badge = (
        f'<span style="background:{hex_of(STATES[decision.state])};color:#fff;border-radius:5px;padding:2px 9px;'
        f'font-weight:600;letter-spacing:.02em">{decision.state.name.lower()}</span>'
    )
    target = "" if decision.target is None else f'<span style="float:right">cube: {_chip(decision.target)}</span>'
    reason = f'<div style="margin-top:6px;min-height:37px">{escape(decision.reason)}</div>'
    return f'<div id="state" data-stamp="{stamp:.3f}" style="{FRAME}">{badge}{target}{reason}</div>'


def figures_html(decision: Decision, cell: Cell) -> str:
    """Probability of every cube, and what the arm goes by."""
    rows = [_bar(_chip(name), decision.taken.get(name, 0.0), hex_of(cube_colour(name))) for name in cell.order]
    near = "nobody near" if not np.isfinite(decision.distance) else f"{decision.distance:.2f} m"
    asked = f"stops below {decision.separation:.2f} m" if np.isfinite(decision.separation) else ""
    return (
        f'<div id="figures" style="{FRAME}"><b>The person takes, with probability</b>{"".join(rows)}'
        f"<b>The arm</b>{_bar('speed', decision.speed, '#6b7784')}"
        f'<div style="display:flex;justify-content:space-between"><span>distance</span>'
        f'<span>{near} <span style="{GREY}">{asked}</span></span></div></div>'
    )


def decisions_html(decisions: Sequence[Decision]) -> str:
    """The last decisions, the newest first."""
    lines = []
    for each in decisions:
        reaction = "" if each.reaction is None else f"<b>{each.reaction.name.lower().replace('_', ' ')}:</b> "
        stamp = f'<span style="{GREY};flex:0 0 42px">{each.stamp:.1f} s</span>'
        said = f"{stamp}<span>{reaction}{escape(each.reason)}</span>"
        lines.append(f'<div style="display:flex;margin-bottom:3px">{said}</div>')
    return f'<div id="decisions" style="{FRAME};font-size:12px">{"".join(lines)}</div>'


def note_html(text: str) -> str:
    """A remark."""
    return f'<div id="note" style="{FRAME};{GREY}">{escape(text)}</div>'


def _chip(name: str) -> str:
    """A cube's name beside its colour."""
    colour = hex_of(cube_colour(name))
    box = f"display:inline-block;width:10px;height:10px;border-radius:2px;background:{colour};margin-right:5px"
    return f'<span style="white-space:nowrap"><span style="{box}"></span>{escape(name)}</span>'


def _bar(label: str, share: float, colour: str) -> str:
    """A share as a bar and in per cent; label is HTML."""
    percent = 100 * min(max(share, 0.0), 1.0)
    fill = f"height:8px;border-radius:4px;background:{colour};width:{percent:.0f}%"
    return (
        f'<div style="display:flex;align-items:center;gap:8px"><span style="flex:0 0 82px">{label}</span>'
        f'<div style="flex:1;background:#e9ecef;border-radius:4px;height:8px"><div style="{fill}"></div></div>'
        f'<span style="flex:0 0 42px;text-align:right">{percent:.0f} %</span></div>'
    )
