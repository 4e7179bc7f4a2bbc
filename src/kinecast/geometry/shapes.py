"""Obstacle shapes and their signed distances: > 0 is free, exact outside and inside."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from kinecast.errors import OptionError
from kinecast.geometry.distances import HALF_SPACE, ROUNDED_BOX, ROW, point_distances, segment_distances

__all__ = ["Box", "Capsule", "HalfSpace", "Shape", "Sphere"]

ORTHONORMAL = 1e-6
"""How far RᵀR may be from the identity: matrices typed with seven digits pass."""


class Shape(ABC):
    """A convex obstacle."""

    @property
    @abstractmethod
    def row(self) -> Float[np.ndarray, " 17"]:
        """The shape as one row of floats (kinecast.geometry.distances)."""

    @property
    @abstractmethod
    def origin(self) -> Float[np.ndarray, " 3"]:
        """(3,) the point [m] that moves when the shape does: its centre, or the point of a half-space."""

    def rows(self, times: Float[np.ndarray, " T"]) -> Float[np.ndarray, "T 17"]:
        """(T, ROW) the shape at each time [s]: it stays where it is."""
        return np.tile(self.row, (len(times), 1))

    def signed_distance(self, points: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch"]:
        """Distance [m] to the surface, negative inside, exact on both sides.

        Args:
            points: (…, 3) [m].

        Returns:
            (…) [m]; NaN where a coordinate is NaN.
        """
        flat = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3)
        distances: Float[np.ndarray, " N"] = point_distances(self.row, flat)
        return distances.reshape(points.shape[:-1])

    def segment_distance(
        self, start: Float[np.ndarray, "*batch 3"], end: Float[np.ndarray, "*batch 3"]
    ) -> Float[np.ndarray, "*batch"]:
        """Least signed distance [m] over the points of a limb's centre line, exact for every shape.

        For a limb outside this is its distance to the shape; for one that touches, minus the depth of its
        deepest point. A limb with radius r touches where the result is ≤ r: subtract r. The minimum is
        found in closed form, also for a box: the squared distance is convex along the segment and quadratic
        between the planes of the faces.

        Args:
            start, end: (…, 3) ends of the limbs [m]; they may coincide.

        Returns:
            (…) [m]; NaN where a coordinate is NaN.
        """
        starts = np.ascontiguousarray(start, dtype=np.float64).reshape(-1, 3)
        ends = np.ascontiguousarray(end, dtype=np.float64).reshape(-1, 3)
        distances: Float[np.ndarray, " N"] = segment_distances(self.row, starts, ends)
        return distances.reshape(start.shape[:-1])


@dataclass(frozen=True, eq=False)
class HalfSpace(Shape):
    """Everything behind a plane: n · (p − point) < 0.

    Attributes:
        point: (3,) any point of the plane [m].
        normal: (3,) pointing to the free side; scaled to length one.
    """

    point: Float[np.ndarray, " 3"]
    normal: Float[np.ndarray, " 3"]

    def __post_init__(self) -> None:
        normal = _vector("half-space normal", self.normal)
        length = float(np.linalg.norm(normal))
        if not length > 1e-9:
            raise OptionError(f"half-space normal {normal.tolist()} has no direction")
        _freeze(self, point=_vector("half-space point", self.point), normal=normal / length)

    @property
    def row(self) -> Float[np.ndarray, " 17"]:
        row = np.zeros(ROW)
        row[0] = HALF_SPACE
        row[1:4] = self.point
        row[4:7] = self.normal
        return row

    @property
    def origin(self) -> Float[np.ndarray, " 3"]:
        return self.point


@dataclass(frozen=True, eq=False)
class Box(Shape):
    """A box at any angle.

    Attributes:
        center: (3,) [m].
        size: (3,) full lengths along its own axes [m].
        rotation: (3, 3) whose columns are the box's axes in the world.
    """

    center: Float[np.ndarray, " 3"]
    size: Float[np.ndarray, " 3"]
    rotation: Float[np.ndarray, "3 3"] = field(default_factory=lambda: np.eye(3))

    def __post_init__(self) -> None:
        size = _vector("box size", self.size)
        if not np.all(size > 0):
            raise OptionError(f"box size {size.tolist()} m: every length must be above 0")
        rotation = np.array(self.rotation, dtype=np.float64)
        if rotation.shape != (3, 3) or not np.allclose(rotation.T @ rotation, np.eye(3), atol=ORTHONORMAL):
            raise OptionError("box rotation is not a rotation matrix: its columns must be orthogonal and of length 1")
        if np.linalg.det(rotation) < 0:
            raise OptionError("box rotation is a reflection: its determinant must be +1")
        _freeze(self, center=_vector("box center", self.center), size=size, rotation=rotation)

    @property
    def row(self) -> Float[np.ndarray, " 17"]:
        return _rounded_box(self.center, self.rotation, self.size / 2, 0.0)

    @property
    def origin(self) -> Float[np.ndarray, " 3"]:
        return self.center


@dataclass(frozen=True, eq=False)
class Sphere(Shape):
    """A ball.

    Attributes:
        center: (3,) [m].
        radius: [m].
    """

    center: Float[np.ndarray, " 3"]
    radius: float

    def __post_init__(self) -> None:
        _freeze(self, center=_vector("sphere center", self.center), radius=_radius("sphere", self.radius))

    @property
    def row(self) -> Float[np.ndarray, " 17"]:
        return _rounded_box(self.center, np.eye(3), np.zeros(3), self.radius)

    @property
    def origin(self) -> Float[np.ndarray, " 3"]:
        return self.center


@dataclass(frozen=True, eq=False)
class Capsule(Shape):
    """All points within a radius of a segment: a limb, a tube, a robot link.

    Attributes:
        start, end: (3,) ends of the axis [m]; they may coincide.
        radius: [m].
    """

    start: Float[np.ndarray, " 3"]
    end: Float[np.ndarray, " 3"]
    radius: float

    def __post_init__(self) -> None:
        _freeze(
            self,
            start=_vector("capsule start", self.start),
            end=_vector("capsule end", self.end),
            radius=_radius("capsule", self.radius),
        )

    @property
    def row(self) -> Float[np.ndarray, " 17"]:
        axis = self.end - self.start
        length = float(np.linalg.norm(axis))
        return _rounded_box(self.origin, _frame_along(axis), np.array([0.0, 0.0, length / 2]), self.radius)

    @property
    def origin(self) -> Float[np.ndarray, " 3"]:
        return 0.5 * self.start + 0.5 * self.end


def _rounded_box(
    center: Float[np.ndarray, " 3"],
    rotation: Float[np.ndarray, "3 3"],
    half_extents: Float[np.ndarray, " 3"],
    radius: float,
) -> Float[np.ndarray, " 17"]:
    """The row of a box with its surface moved outwards."""
    return np.concatenate([[ROUNDED_BOX], center, rotation.ravel(), half_extents, [radius]])


def _frame_along(axis: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """A rotation whose z axis points along a vector; the identity for a vector without length."""
    length = float(np.linalg.norm(axis))
    if length == 0.0:
        return np.eye(3)
    z = axis / length
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(z)))], z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def _freeze(shape: Shape, **values: np.ndarray | float) -> None:
    """Store checked values in a frozen shape, arrays read-only."""
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
        object.__setattr__(shape, name, value)


def _vector(what: str, value: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    """A checked copy of a 3-vector."""
    vector = np.array(value, dtype=np.float64)
    if vector.shape != (3,) or not np.all(np.isfinite(vector)):
        raise OptionError(f"{what} {vector.tolist()} must be three finite numbers")
    return vector


def _radius(what: str, value: float) -> float:
    """A checked radius."""
    if not (np.isfinite(value) and value > 0):
        raise OptionError(f"{what} radius {value} m must be above 0")
    return float(value)
