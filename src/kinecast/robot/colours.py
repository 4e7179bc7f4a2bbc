"""Colours of cubes and states, in pictures and in the browser."""

from __future__ import annotations

from kinecast.types import RobotState

Colour = tuple[int, int, int]
"""Red, green, blue, 0..255."""

INK: Colour = (27, 31, 36)
MUTED: Colour = (110, 118, 127)
CUBE_COLOURS: dict[str, Colour] = {"red": (212, 54, 44), "green": (42, 157, 75), "blue": (37, 102, 200)}
"""Of cubes, their places and the path to each."""
SKIN: Colour = (224, 176, 140)
SHIRT: Colour = (92, 126, 178)
SKIN_PARTS = (False, True, True, False, True, True, False, False, True)
"""Of kinecast.robot.body.body_capsules: forearms, hands and head; the others are shirt."""

STATES: dict[RobotState, Colour] = {
    RobotState.MOVING: (31, 122, 77),
    RobotState.GRASPING: (32, 140, 150),
    RobotState.PLACING: (110, 150, 45),
    RobotState.SLOWED: (205, 135, 10),
    RobotState.REPLANNING: (126, 80, 178),
    RobotState.WAITING: (140, 98, 50),
    RobotState.STOPPED: (190, 38, 38),
    RobotState.DONE: (110, 118, 127),
}
"""Shades of green go on, of amber are held back, violet changes its mind, red is stopped; the word stands beside."""


def cube_colour(name: str | None) -> Colour:
    """Of what belongs to a cube; dark where it belongs to none."""
    return CUBE_COLOURS.get(name or "", INK)


def hex_of(colour: Colour) -> str:
    """As HTML writes it."""
    return "#{:02x}{:02x}{:02x}".format(*colour)
