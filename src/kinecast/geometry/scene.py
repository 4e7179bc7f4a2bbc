"""A scene: static and moving obstacles, and regions where hands are expected to go (Eq. 7); and its YAML file.

The file is read strictly: a misspelt entry is an error, not a missing obstacle.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float

from kinecast.errors import DatasetError, OptionError
from kinecast.geometry.distances import ROW, limb_distances
from kinecast.geometry.entries import Entry, read_text
from kinecast.geometry.regions import Regions
from kinecast.geometry.shapes import Box, Capsule, ConstantVelocity, HalfSpace, MovingObstacle, Shape, Sphere, Waypoints
from kinecast.geometry.transforms import from_quaternion, rotation_z

MAXIMUM_ENTRIES = 1000

TABLE_THICKNESS = 0.04  # of a table top with an extent [m]; office and workshop tables have 20 to 50 mm

NO_GOAL = "none"
"""What predictions say of a hand that heads for none of the goals; no goal may have this name."""
RESERVED = f"a goal cannot be named {NO_GOAL!r}: predictions say that of a hand that heads for no goal"

LIMBS = np.array([[0, 1], [1, 2], [3, 4], [4, 5]])  # upper arms and forearms among the six arm joints


Times: TypeAlias = Float[np.ndarray, " T"]
Obstacle: TypeAlias = Shape | MovingObstacle


@dataclass(frozen=True, eq=False)
class Scene:
    """Obstacles and goals in the world frame, on the clock of the frames' stamps."""

    obstacles: tuple[Obstacle, ...] = ()
    goals: Mapping[str, Sphere | Box] = field(default_factory=dict)
    """Named regions that a hand may be heading for; they are no obstacles."""

    def __post_init__(self) -> None:
        if NO_GOAL in self.goals:
            raise OptionError(RESERVED)

    @cached_property
    def regions(self) -> Regions:
        """The goals as arrays."""
        return Regions.of(self.goals)

    @classmethod
    def load(cls, path: str | Path) -> Scene:
        """Read a YAML scene file, as `from_yaml`; an example of every entry: `kinecast/data/example_scene.yaml`."""
        return cls.from_yaml(read_text(Path(path)), path)

    @classmethod
    def from_yaml(cls, text: str, where: object = "scene") -> Scene:
        """The scene a YAML text describes; `where`, e.g. its file, is named in errors.

        Raises:
            DatasetError: names the entry, what was found and what is allowed.
        """
        root = Entry.read(text, where, "table", *_OBSTACLES, "goals")
        obstacles: list[Obstacle] = []
        if "table" in root.values:
            obstacles.append(root.child("table", root.values["table"]).build(_table))
        for key, make in _OBSTACLES.items():
            obstacles += root.children(key, make)
        goals = root.named_children("goals", _goal)
        if len(obstacles) + len(goals) > MAXIMUM_ENTRIES:
            raise DatasetError(where, f"{len(obstacles) + len(goals)} entries, at most {MAXIMUM_ENTRIES}")
        return cls(tuple(obstacles), goals)

    def rows(self, times: Times) -> Float[np.ndarray, "T O 17"]:
        """(T, O, ROW) every obstacle at every time [s], for compiled code (kinecast.geometry.distances)."""
        if not self.obstacles:
            return np.empty((len(times), 0, ROW))
        return np.stack([obstacle.rows(times) for obstacle in self.obstacles], axis=1)

    def clearance(self, poses: Float[np.ndarray, "*batch T 6 3"], times: Times) -> Float[np.ndarray, "*batch T"]:
        """(…, T) distance [m] from the nearest limb to the nearest obstacle, > 0 free; inf without obstacles.

        `poses` (…, T, 6, 3) are positions [m] of the six arm joints (kinecast.body.skeleton.ARM_JOINTS).
        """
        return np.asarray(limb_distances(self.rows(times), poses, LIMBS).min(axis=-1))

    def free(
        self, arm_points: Float[np.ndarray, "S T 6 3"], times: Times, limb_radius: float = 0.0
    ) -> Bool[np.ndarray, "S T"]:
        """(S, T) whether no joint and no limb of either arm touches an obstacle where it is at each time (Eq. 7).

        Takes (S, T, 6, 3) positions [m] of the six arm joints, and the radius [m] of upper arms and forearms around
        their centre lines. False where an arm has a NaN.

        Raises:
            OptionError: a limb radius below 0.
        """
        if not 0 <= limb_radius < np.inf:
            raise OptionError(f"limb_radius {limb_radius} m must be 0 or more")
        beyond = float(np.nextafter(limb_radius, np.inf))  # how much farther does not matter
        clear = limb_distances(self.rows(times), arm_points, LIMBS, beyond) > limb_radius
        return clear[..., 0] & clear[..., 1] & clear[..., 2] & clear[..., 3]


def _table(entry: Entry) -> Shape:
    """A plane by point and normal, an endless plane by height, or a slab by height, center and extent."""
    if "point" in entry.values or "normal" in entry.values:
        return _plane(entry)
    entry.only("height", "center", "extent", "thickness")
    height = entry.number("height", "m")
    if "extent" not in entry.values:
        entry.only("height")
        return HalfSpace(np.array([0.0, 0.0, height]), np.array([0.0, 0.0, 1.0]))
    extent, center = entry.vector("extent", 2, "m"), entry.vector("center", 2, "m")
    thickness = entry.number("thickness", "m") if "thickness" in entry.values else TABLE_THICKNESS
    return Box(np.array([*center, height - thickness / 2]), np.array([*extent, thickness]))


def _plane(entry: Entry) -> Shape:
    entry.only("point", "normal")
    return HalfSpace(entry.vector("point", 3, "m"), entry.vector("normal", 3, ""))


def _box(entry: Entry) -> Obstacle:
    entry.only("center", "size", "yaw_degrees", "quaternion", "velocity", "waypoints")
    return _moving(entry, lambda center: Box(center, entry.vector("size", 3, "m"), _rotation(entry)))


def _sphere(entry: Entry) -> Obstacle:
    entry.only("center", "radius", "velocity", "waypoints")
    return _moving(entry, lambda center: Sphere(center, entry.number("radius", "m")))


def _capsule(entry: Entry) -> Obstacle:
    entry.only("start", "end", "radius", "velocity")
    capsule = Capsule(entry.vector("start", 3, "m"), entry.vector("end", 3, "m"), entry.number("radius", "m"))
    return _gliding(entry, capsule)


_OBSTACLES = {"planes": _plane, "boxes": _box, "spheres": _sphere, "capsules": _capsule}


def _goal(entry: Entry) -> Sphere | Box:
    """A region: a sphere if it has a radius, else a box."""
    if entry.name == f"goals.{NO_GOAL}":
        raise OptionError(RESERVED)
    if "radius" in entry.values:
        entry.only("center", "radius")
        return Sphere(entry.vector("center", 3, "m"), entry.number("radius", "m"))
    entry.only("center", "size", "yaw_degrees", "quaternion")
    return Box(entry.vector("center", 3, "m"), entry.vector("size", 3, "m"), _rotation(entry))


def _moving(entry: Entry, at: Callable[[Float[np.ndarray, " 3"]], Shape]) -> Obstacle:
    """A shape at its center, or on its way if that is given point by point."""
    if "waypoints" not in entry.values:
        return _gliding(entry, at(entry.vector("center", 3, "m")))
    for key in ("center", "velocity"):
        if key in entry.values:
            raise entry.error(f"`{key}` and `waypoints` exclude each other: the waypoints say where it is", key)
    points = np.array(entry.children("waypoints", _waypoint)).reshape(-1, 4)
    path = Waypoints(points[:, 0], points[:, 1:])
    return MovingObstacle(at(path.positions[0]), path)


def _waypoint(entry: Entry) -> Float[np.ndarray, " 4"]:
    entry.only("time", "position")
    return np.array([entry.number("time", "s", limit=1e12), *entry.vector("position", 3, "m")])  # epoch stamps fit


def _gliding(entry: Entry, shape: Shape) -> Obstacle:
    if "velocity" not in entry.values:
        return shape
    return MovingObstacle(shape, ConstantVelocity(entry.vector("velocity", 3, "m/s")))


def _rotation(entry: Entry) -> Float[np.ndarray, "3 3"]:
    if "quaternion" in entry.values:
        if "yaw_degrees" in entry.values:
            raise entry.error("`yaw_degrees` and `quaternion` exclude each other", "quaternion")
        return from_quaternion(entry.vector("quaternion", 4, "w, x, y, z"))
    if "yaw_degrees" in entry.values:
        return rotation_z(np.radians(entry.number("yaw_degrees", "degrees", limit=360.0)))
    return np.eye(3)
