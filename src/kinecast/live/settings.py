"""What stands behind the question mark of a SOURCE or SINK."""

from __future__ import annotations

import math
from collections.abc import Mapping

from kinecast.errors import OptionError

__all__ = ["number", "whole_number"]


def number(
    settings: Mapping[str, str], name: str, default: float, text: str, low: float = -math.inf, high: float = math.inf
) -> float:
    """One of the settings.

    Args:
        settings: those given.
        name: of this one.
        default: where it is not given.
        text: the SOURCE or SINK, for messages.
        low, high: least and largest allowed; where there are none, whoever takes the number checks it.

    Raises:
        OptionError: it is no number, or outside its range.
    """
    try:
        value = float(settings.get(name, default))
    except ValueError:
        raise OptionError(f"{text}: {name} {settings[name]!r} is no number") from None
    if not low <= value <= high and (low, high) != (-math.inf, math.inf):
        raise OptionError(f"{text}: {name} {settings[name]!r} is outside {low:g}..{high:g}")
    return value


def whole_number(
    settings: Mapping[str, str], name: str, default: int, text: str, low: float = -math.inf, high: float = math.inf
) -> int:
    """See `number`.

    Raises:
        OptionError: it is no whole number, or outside its range.
    """
    value = number(settings, name, float(default), text, low, high)
    if not value.is_integer():
        raise OptionError(f"{text}: {name} {settings[name]!r} is no whole number")
    return int(value)
