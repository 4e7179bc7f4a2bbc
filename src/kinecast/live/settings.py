"""What stands behind the question mark of a SOURCE or SINK."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from urllib.parse import parse_qsl

from kinecast.errors import OptionError


def settings_of(text: str, query: str, allowed: tuple[str, ...]) -> dict[str, str]:
    """Those in the query of a SOURCE or SINK, `name=value` with `&` between; OptionError for a name not allowed."""
    found = dict(parse_qsl(query, keep_blank_values=True))
    unknown = sorted(set(found) - set(allowed))
    if unknown or (query and not found):
        raise OptionError(f"{text}: {', '.join(unknown) or query} unknown; allowed are {', '.join(allowed) or 'none'}")
    return found


def choice(settings: Mapping[str, str], name: str, allowed: tuple[str, ...], text: str) -> str | None:
    """One of the settings, None where it is not given; OptionError unless it is one of those allowed."""
    value = settings.get(name)
    if value not in (None, *allowed):
        raise OptionError(f"{text}: {name} {value!r}, allowed are {', '.join(allowed)}")
    return value


def number(
    settings: Mapping[str, str], name: str, default: float, text: str, low: float = -math.inf, high: float = math.inf
) -> float:
    """One of the settings as a number, OptionError for others; without a range, whoever takes it checks that."""
    try:
        value = float(settings.get(name, default))
    except ValueError:
        raise OptionError(f"{text}: {name} {settings[name]!r} is no number") from None
    if not low <= value <= high and (low, high) != (-math.inf, math.inf):
        raise OptionError(f"{text}: {name} {settings[name]!r} is outside {low:g}..{high:g}")
    return value


def numbers(settings: Mapping[str, str], text: str, **ranges: tuple[float, float]) -> dict[str, float]:
    """Those of several settings that are given; see `number`."""
    return {name: number(settings, name, 0.0, text, *span) for name, span in ranges.items() if name in settings}


def picture_size(settings: Mapping[str, str], text: str, usual: str) -> tuple[int, int]:
    """Width and height of pictures [px], written as 640x480; OptionError for anything else."""
    found = re.fullmatch(r"([1-9]\d{1,3})x([1-9]\d{1,3})", settings.get("size", usual))
    if found is None:
        raise OptionError(f"{text}: size {settings['size']!r}, expected a size such as {usual}")
    return int(found[1]), int(found[2])


def whole_number(
    settings: Mapping[str, str], name: str, default: int, text: str, low: float = -math.inf, high: float = math.inf
) -> int:
    """See `number`; a fraction is an OptionError too."""
    value = number(settings, name, float(default), text, low, high)
    if not value.is_integer():
        raise OptionError(f"{text}: {name} {settings[name]!r} is no whole number")
    return int(value)
