"""What the panel says of a moment, as HTML."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from kinecast.robot.cell import Cell
from kinecast.types import Decision
from kinecast.view.colours import INK, MUTED, STATES, cube_colour, hex_of

__all__ = ["decisions_html", "figures_html", "note_html", "state_html"]

FRAME = f"font-size:13px;line-height:1.4;color:{hex_of(INK)};padding:2px 14px 6px 14px"


def state_html(decision: Decision, stamp: float) -> str:
    """State, cube and reason, at a time [s]."""
    state = decision.state.name.lower()
    badge = (
        f'<span style="background:{hex_of(STATES[decision.state])};color:#fff;border-radius:5px;padding:2px 9px;'
        f'font-weight:600;letter-spacing:.02em">{escape(state)}</span>'
    )
    target = "" if decision.target is None else f'<span style="float:right">cube: {_chip(decision.target)}</span>'
    reason = f'<div style="margin-top:6px;min-height:37px">{escape(decision.reason)}</div>'
    return f'<div id="state" data-stamp="{stamp:.3f}" style="{FRAME}">{badge}{target}{reason}</div>'


def figures_html(decision: Decision, cell: Cell) -> str:
    """Probability of every cube, and what the arm goes by."""
    rows = [_bar(_chip(name), decision.taken.get(name, 0.0), hex_of(cube_colour(name))) for name in cell.order]
    speed = _bar("speed", decision.speed, "#6b7784")
    near = "nobody near" if not np.isfinite(decision.distance) else f"{decision.distance:.2f} m"
    asked = f"stops below {decision.separation:.2f} m" if np.isfinite(decision.separation) else ""
    distance = (
        f'<div style="display:flex;justify-content:space-between"><span>distance</span>'
        f'<span>{near} <span style="color:{hex_of(MUTED)}">{asked}</span></span></div>'
    )
    person = _head("The person takes, with probability") + "".join(rows)
    return f'<div id="figures" style="{FRAME}">{person}{_head("The arm")}{speed}{distance}</div>'


def decisions_html(decisions: Sequence[Decision]) -> str:
    """The last decisions, the newest first."""
    lines = []
    for each in decisions:
        reaction = "" if each.reaction is None else f"<b>{escape(each.reaction.name.lower().replace('_', ' '))}:</b> "
        stamp = f'<span style="color:{hex_of(MUTED)};flex:0 0 42px">{each.stamp:.1f} s</span>'
        lines.append(
            f'<div style="display:flex;margin-bottom:3px">{stamp}<span>{reaction}{escape(each.reason)}</span></div>'
        )
    return f'<div id="decisions" style="{FRAME};font-size:12px">{"".join(lines)}</div>'


def note_html(text: str) -> str:
    """A remark."""
    return f'<div id="note" style="{FRAME};color:{hex_of(MUTED)}">{escape(text)}</div>'


def _head(text: str) -> str:
    return f'<div style="font-weight:600;margin:6px 0 2px 0">{escape(text)}</div>'


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
