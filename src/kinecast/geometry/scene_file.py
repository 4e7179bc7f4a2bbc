"""Scene files: YAML in, shapes out. Strict: a misspelt entry is an error, not a missing obstacle."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Float

from kinecast.errors import DatasetError
from kinecast.geometry.entries import Entry, built, parse_yaml
from kinecast.geometry.motion import ConstantVelocity, MovingObstacle, Waypoints
from kinecast.geometry.shapes import Box, Capsule, HalfSpace, Shape, Sphere
from kinecast.geometry.transforms import from_quaternion, rotation_z

__all__ = ["NO_GOAL", "parse_scene"]

MAXIMUM_ENTRIES = 1000

TABLE_THICKNESS = 0.04
"""Of a table top with an extent [m]; office and workshop tables have 20 to 50 mm."""

NO_GOAL = "none"
"""What predictions say of a hand that heads for none of the goals; no goal may have this name."""


def parse_scene(text: str, where: object) -> tuple[tuple[Shape | MovingObstacle, ...], Mapping[str, Sphere | Box]]:
    """Obstacles and goals of a scene file's text.

    Raises:
        DatasetError: names the entry, what was found and what is allowed.
    """
    root = Entry(where, "", parse_yaml(text, where), ("table", "planes", "boxes", "spheres", "capsules", "goals"))
    obstacles: list[Shape | MovingObstacle] = []
    if "table" in root.values:
        obstacles.append(built(root.child("table", root.values["table"]), _table))
    obstacles += [built(entry, _plane) for entry in root.children("planes")]
    obstacles += [built(entry, _box) for entry in root.children("boxes")]
    obstacles += [built(entry, _sphere) for entry in root.children("spheres")]
    obstacles += [built(entry, _capsule) for entry in root.children("capsules")]
    named = root.named_children("goals")
    if NO_GOAL in named:
        raise named[NO_GOAL].error(f"a goal cannot be named {NO_GOAL!r}: predictions say that of a hand without a goal")
    goals = {name: built(entry, _goal) for name, entry in named.items()}
    if len(obstacles) + len(goals) > MAXIMUM_ENTRIES:
        raise DatasetError(where, f"{len(obstacles) + len(goals)} entries, at most {MAXIMUM_ENTRIES}")
    return tuple(obstacles), goals


def _table(entry: Entry) -> Shape:
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


def _plane(entry: Entry) -> Shape:
    entry.only("point", "normal")
    return HalfSpace(entry.vector("point", 3, "m"), entry.vector("normal", 3, ""))


def _box(entry: Entry) -> Shape | MovingObstacle:
    entry.only("center", "size", "yaw_degrees", "quaternion", "velocity", "waypoints")
    return _moving(entry, lambda center: Box(center, entry.vector("size", 3, "m"), _rotation(entry)))


def _sphere(entry: Entry) -> Shape | MovingObstacle:
    entry.only("center", "radius", "velocity", "waypoints")
    return _moving(entry, lambda center: Sphere(center, entry.number("radius", "m")))


def _capsule(entry: Entry) -> Shape | MovingObstacle:
    entry.only("start", "end", "radius", "velocity")
    capsule = Capsule(entry.vector("start", 3, "m"), entry.vector("end", 3, "m"), entry.number("radius", "m"))
    if "velocity" in entry.values:
        return MovingObstacle(capsule, ConstantVelocity(entry.vector("velocity", 3, "m/s")))
    return capsule


def _goal(entry: Entry) -> Sphere | Box:
    """A region: a sphere if it has a radius, else a box."""
    if "radius" in entry.values:
        entry.only("center", "radius")
        return Sphere(entry.vector("center", 3, "m"), entry.number("radius", "m"))
    entry.only("center", "size", "yaw_degrees", "quaternion")
    return Box(entry.vector("center", 3, "m"), entry.vector("size", 3, "m"), _rotation(entry))


def _moving(entry: Entry, shape: Callable[[Float[np.ndarray, " 3"]], Shape]) -> Shape | MovingObstacle:
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


def _rotation(entry: Entry) -> Float[np.ndarray, "3 3"]:
    if "quaternion" in entry.values:
        if "yaw_degrees" in entry.values:
            raise entry.error("`yaw_degrees` and `quaternion` exclude each other", "quaternion")
        return from_quaternion(entry.vector("quaternion", 4, "w, x, y, z"))
    if "yaw_degrees" in entry.values:
        return rotation_z(np.radians(entry.number("yaw_degrees", "degrees", limit=360.0)))
    return np.eye(3)
