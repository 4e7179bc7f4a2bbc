"""YAML files of mappings, read strictly: what is misspelt, repeated, too large or no number is named with its place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
import yaml
from jaxtyping import Float

from kinecast.errors import DatasetError, OptionError

MAXIMUM_BYTES = 1_000_000
MAXIMUM_DEPTH = 8
MOST_DIGITS = 40  # of a whole number
LARGEST = 100.0  # no cell is 100 m wide and nothing in it moves at 100 m/s: a larger number is in millimetres
T = TypeVar("T")


def read_text(path: Path) -> str:
    """The text of a file, bounded.

    Raises:
        DatasetError: no such file, too large, or not text.
    """
    if not path.is_file():
        raise DatasetError(path, "no such file")
    with path.open("rb") as file:
        content = file.read(MAXIMUM_BYTES + 1)
    if len(content) > MAXIMUM_BYTES:
        raise DatasetError(path, f"at most {MAXIMUM_BYTES} bytes are read; this file is larger")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DatasetError(path, f"byte {error.start} is not UTF-8 text") from None


class _Loader(yaml.SafeLoader):
    """Safe types only; refuses what SafeLoader would swallow or choke on."""

    where: object
    depth = 0

    def _refuse(self, mark: yaml.Mark, problem: str) -> DatasetError:
        return DatasetError(f"{self.where}, line {mark.line + 1}", problem)

    def compose_node(self, parent: yaml.Node | None, index: object) -> yaml.Node | None:
        mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
        if self.check_event(yaml.AliasEvent):
            raise self._refuse(mark, "aliases (`*name`) are not allowed")
        self.depth += 1
        if self.depth > MAXIMUM_DEPTH and self.check_event(yaml.CollectionStartEvent):
            raise self._refuse(mark, f"nested deeper than {MAXIMUM_DEPTH} levels")
        node = super().compose_node(parent, index)  # type: ignore[arg-type]
        self.depth -= 1
        if isinstance(node, yaml.ScalarNode) and node.tag == "tag:yaml.org,2002:int" and len(node.value) > MOST_DIGITS:
            raise self._refuse(mark, f"a whole number of {len(node.value)} digits")
        if isinstance(node, yaml.MappingNode):
            found: set[str] = set()
            for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
                if key.value in found:
                    raise self._refuse(key.start_mark, f"`{key.value[:40]}` is given twice")
                found.add(key.value)
        return node


@dataclass(frozen=True)
class Entry:
    """One mapping of a file, which knows its place for errors."""

    where: object
    name: str
    values: dict[object, object]

    @classmethod
    def read(cls, text: str, where: object, *allowed: str) -> Entry:
        """The mapping a YAML text is, of nothing but these keys.

        Raises:
            DatasetError: unsafe types, aliases, repeated keys, or deep nesting.
        """
        try:
            loader = _Loader(text)
            loader.where = where
            content = loader.get_single_data()
        except DatasetError:
            raise
        except (yaml.YAMLError, ValueError) as error:
            mark = getattr(error, "problem_mark", None)
            problem = error.problem if isinstance(error, yaml.MarkedYAMLError) else f"{str(error)!r:.40}"
            line = "" if mark is None else f", line {mark.line + 1}"
            raise DatasetError(f"{where}{line}", f"not valid YAML: {problem}") from None
        root = cls(where, "", {}).child("", content)
        root.only(*allowed)
        return root

    def error(self, problem: str, key: str = "") -> DatasetError:
        place = ".".join(part for part in (self.name, key) if part)
        return DatasetError(f"{self.where}, {place}" if place else self.where, problem)

    def only(self, *allowed: str) -> None:
        """Nothing but these keys."""
        for key in self.values:
            if key not in allowed:
                raise self.error(f"unknown entry {key!r:.40}; allowed: {', '.join(allowed)}")

    def child(self, key: str, value: object) -> Entry:
        if not isinstance(value, dict):
            raise self.error(f"expected entries `key: value`, found {value!r:.40}", key)
        return Entry(self.where, ".".join(part for part in (self.name, key) if part), value)

    def build(self, make: Callable[[Entry], T]) -> T:
        """What `make` makes of this entry; its own complaints get the place in the file."""
        try:
            return make(self)
        except OptionError as error:
            raise self.error(str(error)) from None

    def children(self, key: str, make: Callable[[Entry], T]) -> list[T]:
        """What `make` makes of each entry of a list; nothing if the key is absent."""
        items = self.values.get(key, [])
        if not isinstance(items, list):
            raise self.error(f"expected a list of entries, each starting with `- `, found {items!r:.40}", key)
        return [self.child(f"{key}[{i}]", item).build(make) for i, item in enumerate(items)]

    def named_children(self, key: str, make: Callable[[Entry], T]) -> dict[str, T]:
        """What `make` makes of each entry of a mapping from names; nothing if the key is absent."""
        items = self.values.get(key, {})
        if not isinstance(items, dict):
            raise self.error(f"expected entries `name: ...`, found {items!r:.40}", key)
        if wrong := [name for name in items if not isinstance(name, str)]:
            raise self.error(f"a name must be text, found {wrong[0]!r:.40}", key)
        return {name: self.child(f"{key}.{name}", item).build(make) for name, item in items.items()}

    def number(self, key: str, unit: str, limit: float = LARGEST) -> float:
        """A finite number."""
        return self._checked(key, self._value(key), unit, limit)

    def vector(self, key: str, size: int, unit: str, limit: float = LARGEST) -> Float[np.ndarray, " size"]:
        """A list of finite numbers."""
        value = self._value(key)
        if not isinstance(value, list) or len(value) != size:
            raise self.error(f"expected a list of {size} numbers {unit}, found {value!r:.40}", key)
        return np.array([self._checked(f"{key}[{i}]", item, unit, limit) for i, item in enumerate(value)])

    def _value(self, key: str) -> object:
        if key not in self.values:
            raise self.error(f"`{key}` is missing; found: {', '.join(map(str, self.values)) or 'nothing'}")
        return self.values[key]

    def _checked(self, key: str, value: object, unit: str, limit: float) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.error(f"expected a number {unit}, found {value!r:.40}", key)
        if not -limit <= value <= limit:
            hint = "; lengths are in metres" if limit == LARGEST else ""
            raise self.error(f"{value} {unit} is outside -{limit:g}..{limit:g}{hint}", key)
        return float(value)
