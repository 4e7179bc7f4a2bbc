"""Obstacles: shapes with exact signed distances, > 0 is free, and shapes that move."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from kinecast.errors import OptionError
from kinecast.geometry.distances import HALF_SPACE, ROUNDED_BOX, ROW, limb_distances

ORTHONORMAL = 1e-6  # how far RᵀR may be from the identity: matrices typed with seven digits pass


Vector: TypeAlias = Float[np.ndarray, " 3"]
Rotation: TypeAlias = Float[np.ndarray, "3 3"]
Row: TypeAlias = Float[np.ndarray, " 17"]
Rows: TypeAlias = Float[np.ndarray, "T 17"]
Times: TypeAlias = Float[np.ndarray, " T"]
Points: TypeAlias = Float[np.ndarray, "*batch 3"]
Distances: TypeAlias = Float[np.ndarray, "*batch"]


class Shape:
    """A convex obstacle."""

    row: Row  # the shape as one row of floats (kinecast.geometry.distances)

    def rows(self, times: Times) -> Rows:
        """(T, ROW) the shape at each time [s]: it stays where it is."""
        return np.tile(self.row, (len(times), 1))

    def signed_distance(self, points: Points) -> Distances:
        """Distance (…) [m] of points (…, 3) to the surface, negative inside; NaN where a coordinate is NaN."""
        return self.segment_distance(points, points)

    def segment_distance(self, start: Points, end: Points) -> Distances:
        """Least signed distance (…) [m] over the points of a limb from start to end (…, 3) [m], exact for every shape.

        For a limb outside this is its distance to the shape; for one that touches, minus the depth of its
        deepest point. A limb with radius r touches where the result is ≤ r. NaN where a coordinate is NaN.
        """
        ends = np.stack([start, end], axis=-2)[..., None, :, :]
        return limb_distances(self.row[None, None], ends, np.array([[0, 1]]))[..., 0, 0]


@dataclass(frozen=True, eq=False)
class HalfSpace(Shape):
    """Everything behind a plane through a point (3,) [m]: n · (p − point) < 0, with the normal scaled to length one."""

    point: Vector
    normal: Vector

    def __post_init__(self) -> None:
        normal, point = _vector("half-space normal", self.normal), _vector("half-space point", self.point)
        length = float(np.linalg.norm(normal))
        if not length > 1e-9:
            raise OptionError(f"half-space normal {normal.tolist()} has no direction")
        normal /= length
        row = np.concatenate([[HALF_SPACE], point, normal, np.zeros(ROW - 7)])
        _freeze(self, point=point, normal=normal, row=row)


@dataclass(frozen=True, eq=False)
class Box(Shape):
    """A box: center (3,) [m], full lengths (3,) along its own axes [m], these axes in the world as columns (3, 3)."""

    center: Vector
    size: Vector
    rotation: Rotation = field(default_factory=lambda: np.eye(3))

    def __post_init__(self) -> None:
        center, size = _vector("box center", self.center), _vector("box size", self.size)
        if not np.all(size > 0):
            raise OptionError(f"box size {size.tolist()} m: every length must be above 0")
        rotation = np.array(self.rotation, dtype=np.float64)
        if rotation.shape != (3, 3) or not np.allclose(rotation.T @ rotation, np.eye(3), atol=ORTHONORMAL):
            raise OptionError("box rotation is not a rotation matrix: its columns must be orthogonal and of length 1")
        if np.linalg.det(rotation) < 0:
            raise OptionError("box rotation is a reflection: its determinant must be +1")
        _freeze(self, center=center, size=size, rotation=rotation, row=_rounded_box(center, rotation, size / 2, 0.0))


@dataclass(frozen=True, eq=False)
class Sphere(Shape):
    """A ball: center (3,) [m] and radius [m]."""

    center: Vector
    radius: float

    def __post_init__(self) -> None:
        center, radius = _vector("sphere center", self.center), _radius("sphere", self.radius)
        _freeze(self, center=center, radius=radius, row=_rounded_box(center, np.eye(3), np.zeros(3), radius))


@dataclass(frozen=True, eq=False)
class Capsule(Shape):
    """All points within a radius [m] of the segment from start to end, (3,) [m]: a limb, a tube, a robot link."""

    start: Vector
    end: Vector
    radius: float

    def __post_init__(self) -> None:
        start, end = _vector("capsule start", self.start), _vector("capsule end", self.end)
        radius, length, rotation = _radius("capsule", self.radius), float(np.linalg.norm(end - start)), np.eye(3)
        if length > 0.0:
            z = (end - start) / length
            x = np.cross(np.eye(3)[int(np.argmin(np.abs(z)))], z)
            x /= np.linalg.norm(x)
            rotation = np.column_stack([x, np.cross(z, x), z])
        row = _rounded_box(0.5 * (start + end), rotation, np.array([0.0, 0.0, length / 2]), radius)
        _freeze(self, start=start, end=end, radius=radius, row=row)


def _rounded_box(center: Vector, rotation: Rotation, half: Vector, radius: float) -> Row:
    return np.concatenate([[ROUNDED_BOX], center, rotation.ravel(), half, [radius]])


def _freeze(shape: object, **values: np.ndarray | float) -> None:
    """Store checked values in a frozen shape or motion, arrays read-only."""
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
        object.__setattr__(shape, name, value)


def _vector(what: str, value: Vector) -> Vector:
    vector = np.array(value, dtype=np.float64)
    if vector.shape != (3,) or not np.all(np.isfinite(vector)):
        raise OptionError(f"{what} {vector.tolist()} must be three finite numbers")
    return vector


def _radius(what: str, value: float) -> float:
    if not (np.isfinite(value) and value > 0):
        raise OptionError(f"{what} radius {value} m must be above 0")
    return float(value)


@dataclass(frozen=True, eq=False)
class ConstantVelocity:
    """x(t) = x0 + v (t − since): velocity v (3,) [m/s], and the time `since` [s] of the place x0 it was defined at."""

    velocity: Vector
    since: float = 0.0

    def __post_init__(self) -> None:
        if not np.isfinite(self.since):
            raise OptionError(f"since {self.since} s must be finite")
        _freeze(self, velocity=_vector("velocity", self.velocity))

    def centers(self, start: Vector, times: Times) -> Float[np.ndarray, "T 3"]:
        """(T, 3) places [m] at times [s] of what was defined at `start`."""
        return start + self.velocity * (times - self.since)[:, None]


@dataclass(frozen=True, eq=False)
class Waypoints:
    """Straight from one position (K, 3) [m] to the next, at increasing times (K,) [s]; at rest before and after."""

    times: Float[np.ndarray, " K"]
    positions: Float[np.ndarray, "K 3"]

    def __post_init__(self) -> None:
        times, positions = np.array(self.times, dtype=np.float64), np.array(self.positions, dtype=np.float64)
        if times.ndim != 1 or positions.shape != (len(times), 3) or len(times) == 0:
            found = f"{positions.shape} positions for {times.shape} times"
            raise OptionError(f"waypoints: {found}, expected (K, 3) for (K,)")
        if not (np.all(np.isfinite(times)) and np.all(np.isfinite(positions))):
            raise OptionError("waypoints: times and positions must be finite")
        if not np.all(np.diff(times) > 0):
            raise OptionError(f"waypoints: times must increase, found {times.tolist()} s")
        _freeze(self, times=times, positions=positions)

    def centers(self, _start: Vector, times: Times) -> Float[np.ndarray, "T 3"]:
        """(T, 3) places [m] at times [s], wherever the shape was defined."""
        return np.stack([np.interp(times, self.times, axis) for axis in self.positions.T], axis=-1)


Motion: TypeAlias = ConstantVelocity | Waypoints
"""Where the center of a shape is over time (of a half-space, its point)."""


@dataclass(frozen=True, eq=False)
class MovingObstacle:
    """A shape as it is when its motion starts, carried along without turning."""

    shape: Shape
    motion: Motion

    def rows(self, times: Times) -> Rows:
        """(T, ROW) the shape at each time [s] (kinecast.geometry.distances)."""
        rows = self.shape.rows(times)
        rows[:, 1:4] = self.motion.centers(self.shape.row[1:4], times)
        return rows
