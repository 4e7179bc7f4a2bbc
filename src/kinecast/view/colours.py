"""The colours of the browser view."""

from __future__ import annotations

from kinecast.types import RobotState

__all__ = ["CUBE_COLOURS", "INK", "MUTED", "STATES", "Colour", "cube_colour", "hex_of"]

Colour = tuple[int, int, int]
"""Red, green, blue, 0..255."""

INK: Colour = (27, 31, 36)
MUTED: Colour = (110, 118, 127)
CUBE_COLOURS: dict[str, Colour] = {"red": (212, 54, 44), "green": (42, 157, 75), "blue": (37, 102, 200)}
"""Of cubes, their places and the path to each."""

STATES: dict[RobotState, Colour] = {
    RobotState.MOVING: (31, 122, 77),
    RobotState.GRASPING: (31, 122, 77),
    RobotState.PLACING: (31, 122, 77),
    RobotState.DONE: (31, 122, 77),
    RobotState.SLOWED: (181, 110, 0),
    RobotState.WAITING: (181, 110, 0),
    RobotState.REPLANNING: (126, 80, 178),
    RobotState.STOPPED: (190, 38, 38),
}
"""Green goes on, amber is held back, violet changes its mind, red is stopped; the word stands beside each."""


def cube_colour(name: str | None) -> Colour:
    """Of what belongs to a cube; dark where it belongs to none."""
    return CUBE_COLOURS.get(name or "", INK)


def hex_of(colour: Colour) -> str:
    """As HTML writes it."""
    return "#{:02x}{:02x}{:02x}".format(*colour)
