"""Scene files: YAML in, shapes out. Strict: a misspelt entry is an error, not a missing obstacle."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from reprlib import Repr
from typing import TypeVar

import numpy as np
import yaml
from jaxtyping import Float

from kinecast.errors import DatasetError, OptionError
from kinecast.geometry.motion import ConstantVelocity, MovingObstacle, Waypoints
from kinecast.geometry.shapes import Box, Capsule, HalfSpace, Shape, Sphere
from kinecast.geometry.transforms import from_quaternion, rotation_z

__all__ = ["NO_GOAL", "parse_scene", "read_scene_text"]

MAXIMUM_BYTES = 1_000_000
MAXIMUM_ENTRIES = 1000
MAXIMUM_DEPTH = 8
MAXIMUM_VALUE = 100.0
"""No cell is 100 m wide and nothing in it moves at 100 m/s: a larger number is in millimetres."""

TABLE_THICKNESS = 0.04
"""Of a table top with an extent [m]; office and workshop tables have 20 to 50 mm."""

NO_GOAL = "none"
"""What predictions say of a hand that heads for none of the goals; no goal may have this name."""

T = TypeVar("T")

_short = Repr()
_short.maxother = _short.maxstring = 40


def read_scene_text(path: Path) -> str:
    """The text of a scene file, bounded.

    Raises:
        DatasetError: no such file, too large, or not text.
    """
    if not path.is_file():
        raise DatasetError(path, "no such file")
    with path.open("rb") as file:
        content = file.read(MAXIMUM_BYTES + 1)
    if len(content) > MAXIMUM_BYTES:
        raise DatasetError(path, f"a scene file has at most {MAXIMUM_BYTES} bytes; this one is larger")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DatasetError(path, f"byte {error.start} is not UTF-8 text") from None


def parse_scene(text: str, where: object) -> tuple[tuple[Shape | MovingObstacle, ...], Mapping[str, Sphere | Box]]:
    """Obstacles and goals of a scene file's text.

    Raises:
        DatasetError: names the entry, what was found and what is allowed.
    """
    root = _Entry(where, "", _yaml(text, where), ("table", "planes", "boxes", "spheres", "capsules", "goals"))
    obstacles: list[Shape | MovingObstacle] = []
    if "table" in root.values:
        obstacles.append(_built(root.child("table", root.values["table"]), _table))
    obstacles += [_built(entry, _plane) for entry in root.children("planes")]
    obstacles += [_built(entry, _box) for entry in root.children("boxes")]
    obstacles += [_built(entry, _sphere) for entry in root.children("spheres")]
    obstacles += [_built(entry, _capsule) for entry in root.children("capsules")]
    named = root.named_children("goals")
    if NO_GOAL in named:
        raise named[NO_GOAL].error(f"a goal cannot be named {NO_GOAL!r}: predictions say that of a hand without a goal")
    goals = {name: _built(entry, _goal) for name, entry in named.items()}
    if len(obstacles) + len(goals) > MAXIMUM_ENTRIES:
        raise DatasetError(where, f"{len(obstacles) + len(goals)} entries, at most {MAXIMUM_ENTRIES}")
    return tuple(obstacles), goals


@dataclass(frozen=True)
class _Entry:
    """One mapping of the file, which knows its place for errors; `allowed` keys, or None until told."""

    where: object
    name: str
    found: object
    allowed: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.found, dict):
            raise self.error(f"expected entries `key: value`, found {_short.repr(self.found)}")
        if self.allowed is not None:
            self.only(*self.allowed)

    @property
    def values(self) -> dict[object, object]:
        assert isinstance(self.found, dict)
        return self.found

    def error(self, problem: str, key: str = "") -> DatasetError:
        place = ".".join(part for part in (self.name, key) if part)
        return DatasetError(f"{self.where}, {place}" if place else self.where, problem)

    def only(self, *allowed: str) -> None:
        """Nothing but these keys."""
        for key in self.values:
            if key not in allowed:
                raise self.error(f"unknown entry {_short.repr(key)}; allowed: {', '.join(allowed)}")

    def child(self, key: str, value: object) -> _Entry:
        return _Entry(self.where, f"{self.name}.{key}" if self.name else key, value)

    def children(self, key: str) -> list[_Entry]:
        """The entries of a list; none if the key is absent."""
        items = self.values.get(key, [])
        if not isinstance(items, list):
            raise self.error(f"expected a list of entries, each starting with `- `, found {_short.repr(items)}", key)
        return [self.child(f"{key}[{i}]", item) for i, item in enumerate(items)]

    def named_children(self, key: str) -> dict[str, _Entry]:
        """The entries of a mapping from names; none if the key is absent."""
        items = self.values.get(key, {})
        if not isinstance(items, dict):
            raise self.error(f"expected entries `name: ...`, found {_short.repr(items)}", key)
        for name in items:
            if not isinstance(name, str):
                raise self.error(f"a name must be text, found {_short.repr(name)}", key)
        return {name: self.child(f"{key}.{name}", item) for name, item in items.items()}

    def number(self, key: str, unit: str, limit: float = MAXIMUM_VALUE) -> float:
        """A finite number."""
        return self._checked(key, self._value(key), unit, limit)

    def vector(self, key: str, size: int, unit: str) -> Float[np.ndarray, " size"]:
        """A list of finite numbers."""
        value = self._value(key)
        if not isinstance(value, list) or len(value) != size:
            raise self.error(f"expected a list of {size} numbers {unit}, found {_short.repr(value)}", key)
        return np.array([self._checked(f"{key}[{i}]", item, unit, MAXIMUM_VALUE) for i, item in enumerate(value)])

    def _value(self, key: str) -> object:
        if key not in self.values:
            raise self.error(f"`{key}` is missing; found: {', '.join(map(str, self.values)) or 'nothing'}")
        return self.values[key]

    def _checked(self, key: str, value: object, unit: str, limit: float) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.error(f"expected a number {unit}, found {_short.repr(value)}", key)
        if not -limit <= value <= limit:
            raise self.error(f"{value} {unit} is outside -{limit:g}..{limit:g}; lengths are in metres", key)
        return float(value)


def _built(entry: _Entry, build: Callable[[_Entry], T]) -> T:
    """Build a shape; its own complaints get the place in the file."""
    try:
        return build(entry)
    except OptionError as error:
        raise entry.error(str(error)) from None


def _table(entry: _Entry) -> Shape:
    """A plane by point and normal, an endless plane by height, or a slab by height, center and extent."""
    if "point" in entry.values or "normal" in entry.values:
        return _plane(entry)
    entry.only("height", "center", "extent", "thickness")
    height = entry.number("height", "m")
    if "extent" not in entry.values:
        entry.only("height")
        return HalfSpace(np.array([0.0, 0.0, height]), np.array([0.0, 0.0, 1.0]))
    extent = entry.vector("extent", 2, "m")
    center = entry.vector("center", 2, "m")
    thickness = entry.number("thickness", "m") if "thickness" in entry.values else TABLE_THICKNESS
    return Box(np.array([*center, height - thickness / 2]), np.array([*extent, thickness]))


def _plane(entry: _Entry) -> Shape:
    entry.only("point", "normal")
    return HalfSpace(entry.vector("point", 3, "m"), entry.vector("normal", 3, ""))


def _box(entry: _Entry) -> Shape | MovingObstacle:
    entry.only("center", "size", "yaw_degrees", "quaternion", "velocity", "waypoints")
    return _moving(entry, lambda center: Box(center, entry.vector("size", 3, "m"), _rotation(entry)))


def _sphere(entry: _Entry) -> Shape | MovingObstacle:
    entry.only("center", "radius", "velocity", "waypoints")
    return _moving(entry, lambda center: Sphere(center, entry.number("radius", "m")))


def _capsule(entry: _Entry) -> Shape | MovingObstacle:
    entry.only("start", "end", "radius", "velocity")
    capsule = Capsule(entry.vector("start", 3, "m"), entry.vector("end", 3, "m"), entry.number("radius", "m"))
    if "velocity" in entry.values:
        return MovingObstacle(capsule, ConstantVelocity(entry.vector("velocity", 3, "m/s")))
    return capsule


def _goal(entry: _Entry) -> Sphere | Box:
    """A region: a sphere if it has a radius, else a box."""
    if "radius" in entry.values:
        entry.only("center", "radius")
        return Sphere(entry.vector("center", 3, "m"), entry.number("radius", "m"))
    entry.only("center", "size", "yaw_degrees", "quaternion")
    return Box(entry.vector("center", 3, "m"), entry.vector("size", 3, "m"), _rotation(entry))


def _moving(entry: _Entry, shape: Callable[[Float[np.ndarray, " 3"]], Shape]) -> Shape | MovingObstacle:
    """A shape at rest at its center, moving from there since time 0, or along waypoints of its center."""
    if "waypoints" in entry.values:
        for key in ("center", "velocity"):
            if key in entry.values:
                raise entry.error(f"`{key}` and `waypoints` exclude each other: the waypoints say where it is", key)
        points = entry.children("waypoints")
        for point in points:
            point.only("time", "position")
        positions = np.array([point.vector("position", 3, "m") for point in points]).reshape(-1, 3)
        times = np.array([point.number("time", "s", limit=1e12) for point in points])  # epoch stamps fit
        path = Waypoints(times, positions)
        return MovingObstacle(shape(positions[0]), path)
    center = entry.vector("center", 3, "m")
    if "velocity" in entry.values:
        return MovingObstacle(shape(center), ConstantVelocity(entry.vector("velocity", 3, "m/s")))
    return shape(center)


def _rotation(entry: _Entry) -> Float[np.ndarray, "3 3"]:
    if "quaternion" in entry.values:
        if "yaw_degrees" in entry.values:
            raise entry.error("`yaw_degrees` and `quaternion` exclude each other", "quaternion")
        return from_quaternion(entry.vector("quaternion", 4, "w, x, y, z"))
    if "yaw_degrees" in entry.values:
        return rotation_z(np.radians(entry.number("yaw_degrees", "degrees", limit=360.0)))
    return np.eye(3)


def _yaml(text: str, where: object) -> object:
    """The parsed text: safe types only, no aliases, no repeated keys, bounded nesting."""
    if len(text) > MAXIMUM_BYTES:
        raise DatasetError(where, f"a scene has at most {MAXIMUM_BYTES} characters, found {len(text)}")
    try:
        _check_structure(text, where)
        return yaml.safe_load(text)
    except yaml.MarkedYAMLError as error:
        line = "" if error.problem_mark is None else f", line {error.problem_mark.line + 1}"
        raise DatasetError(f"{where}{line}", f"not valid YAML: {error.problem}") from None
    except (yaml.YAMLError, ValueError) as error:
        if isinstance(error, DatasetError):
            raise
        raise DatasetError(where, f"not valid YAML: {_short.repr(str(error))}") from None


def _check_structure(text: str, where: object) -> None:
    """Refuse what safe_load would swallow or choke on: aliases, repeated keys, deep nesting."""
    keys: list[set[str] | None] = []  # per open node: the keys seen so far, None for a list
    is_key: list[bool] = []  # per open node: whether a mapping's next child is a key
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        mark = event.start_mark
        place = where if mark is None else f"{where}, line {mark.line + 1}"
        if isinstance(event, yaml.AliasEvent):
            raise DatasetError(place, "aliases (`*name`) are not allowed in a scene")
        if isinstance(event, yaml.CollectionEndEvent):
            keys.pop()
            is_key.pop()
            continue
        if not isinstance(event, yaml.NodeEvent):
            continue
        seen = keys[-1] if keys else None
        if seen is not None:
            if is_key[-1] and isinstance(event, yaml.ScalarEvent):
                if event.value in seen:
                    raise DatasetError(place, f"`{event.value[:40]}` is given twice")
                seen.add(event.value)
            is_key[-1] = not is_key[-1]
        if isinstance(event, yaml.CollectionStartEvent):
            keys.append(set() if isinstance(event, yaml.MappingStartEvent) else None)
            is_key.append(True)
            if len(keys) > MAXIMUM_DEPTH:
                raise DatasetError(place, f"nested deeper than {MAXIMUM_DEPTH} levels")
