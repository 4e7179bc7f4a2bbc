"""What stands behind the question mark of a SOURCE or SINK, read into the dataclass of options that it is for."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar
from urllib.parse import parse_qsl

import msgspec
from msgspec import Meta as Meta  # also for modules of other extras, which import this first
from msgspec import inspect

from kinecast.errors import OptionError

Size = Annotated[str, Meta(pattern=r"^[1-9]\d{1,3}x[1-9]\d{1,3}\Z", description="a size such as 640x480")]
"""Width and height of pictures [px]."""

_T = TypeVar("_T")


@dataclass(frozen=True)
class NoOptions:
    """Of what nothing can be set."""


def read_settings(options: type[_T], query: str, text: str) -> _T:
    """Options from `name=value` with `&` between.

    Args:
        options: a dataclass; its annotations say what is allowed of each setting (Meta, Literal).
        query: what was written.
        text: the SOURCE or SINK, for messages.

    Raises:
        OptionError: a name is none of its fields, or a value is not allowed.
    """
    given = dict(parse_qsl(query, keep_blank_values=True))
    fields = {field.name: field.type for field in inspect.type_info(options).fields}  # type: ignore[attr-defined]
    unknown = sorted(given.keys() - fields)
    if unknown or (query and not given):
        raise OptionError(f"{text}: {', '.join(unknown) or query} unknown; allowed are {', '.join(fields) or 'none'}")
    try:
        said = {name: value for name, value in given.items() if value}
        return msgspec.convert(said, options, strict=False, dec_hook=lambda _, value: Path(value))
    except msgspec.ValidationError as error:
        if found := re.search(r" - at `\$\.(\w+)`$", str(error)):
            name = found[1]
            raise OptionError(f"{text}: {name} {given[name]!r}, expected {_allowed(fields[name])}") from None
        raise OptionError(f"{text}: {error}") from None


def width_height(size: str) -> tuple[int, int]:
    """Of a size [px]."""
    width, _, height = size.partition("x")
    return int(width), int(height)


def _allowed(type_: Any) -> str:
    """What values a setting may have."""
    if isinstance(type_, inspect.UnionType):  # with None, where it is not given
        type_ = type_.types[0]
    if isinstance(type_, inspect.Metadata):
        return str((type_.extra_json_schema or {})["description"])
    if isinstance(type_, inspect.LiteralType):
        return " or ".join(map(str, type_.values))
    whole = "a whole number in " if isinstance(type_, inspect.IntType) else ""
    return f"{whole}{type_.ge:g}..{type_.le:g}"
