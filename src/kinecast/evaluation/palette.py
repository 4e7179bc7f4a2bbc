"""The colours of every chart and picture, and one look for every method."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

__all__ = ["BLUE", "INK", "MUTED", "RED", "MethodStyle", "method_style"]

INK = "#1b1f24"
"""Colour of text and axes; `figure_svg` turns it into the page's own."""

MUTED = "#808890"
"""Grid lines, references and remarks: legible on white and on black."""


@dataclass(frozen=True)
class MethodStyle:
    """How one method looks in every chart. Shape tells methods apart where colour does not."""

    colour: str
    marker: str
    dashes: tuple[float, ...] = ()
    width: float = 1.7


# Okabe and Ito's colour-blind safe hues at a lightness for white and black pages. Trivial baselines are grey.
GREY, GOLD, GREEN, PINK, ORANGE, RED, SKY, BLUE, VIOLET = (
    "#878f99", "#a8862a", "#0f9d76", "#c0709c", "#d9901a", "#d95f1e", "#3f9fd6", "#1f78c8", "#8a6fd1",
)  # fmt: skip

METHODS = {
    "zero_velocity": MethodStyle(GREY, "o", (1.0, 2.0)),
    "constant_velocity": MethodStyle(GREY, "s", (4.0, 2.0)),
    "damped_velocity": MethodStyle(GREY, "D"),
    "kalman": MethodStyle(GOLD, "v"),
    "ridge": MethodStyle(GREEN, "^"),
    "gp_xyz": MethodStyle(PINK, "P", (6.0, 2.0)),
    "gp_angles": MethodStyle(ORANGE, "X", (6.0, 2.0)),
    "gp_constrained": MethodStyle(RED, "*"),
    "kinecast": MethodStyle(BLUE, "o", width=2.6),
}
SPARE = tuple(
    MethodStyle(colour, marker, dashes)
    for dashes in ((), (2.0, 1.5))
    for colour, marker in ((SKY, "h"), (VIOLET, "d"), (GREEN, "<"), (PINK, ">"), (GOLD, "p"))
)


def method_style(name: str) -> MethodStyle:
    """The look of a method: always the same for the same name. `x_constrained` is x with dashes."""
    if name in METHODS:
        return METHODS[name]
    base = METHODS.get(name.removesuffix("_constrained"))
    if base is not None:
        return MethodStyle(base.colour, base.marker, (3.0, 1.5), base.width)
    return SPARE[zlib.crc32(name.encode()) % len(SPARE)]
