"""A scene: static and moving obstacles, and regions where hands are expected to go (Eq. 7)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from kinecast.errors import OptionError
from kinecast.geometry.distances import ROW, arms_are_free, scene_distances, segment_distances
from kinecast.geometry.entries import read_text
from kinecast.geometry.motion import MovingObstacle
from kinecast.geometry.regions import Regions
from kinecast.geometry.scene_file import NO_GOAL, parse_scene
from kinecast.geometry.shapes import Box, Shape, Sphere

__all__ = ["Scene"]


@dataclass(frozen=True, eq=False)
class Scene:
    """Obstacles and goals in the world frame, on the clock of the frames' stamps.

    Attributes:
        obstacles: shapes that stay, and shapes that move.
        goals: named regions that a hand may be heading for; they are no obstacles.
    """

    obstacles: tuple[Shape | MovingObstacle, ...] = ()
    goals: Mapping[str, Sphere | Box] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if NO_GOAL in self.goals:
            raise OptionError(
                f"a goal cannot be named {NO_GOAL!r}: predictions say that of a hand that heads for no goal"
            )

    @cached_property
    def regions(self) -> Regions:
        """The goals as arrays."""
        return Regions.of(self.goals)

    @classmethod
    def load(cls, path: str | Path) -> Scene:
        """Read a YAML scene file; docs and an example: `kinecast/data/example_scene.yaml`.

        Raises:
            DatasetError: names the file, the entry, what was found and what is allowed.
        """
        return cls.from_yaml(read_text(Path(path)), path)

    @classmethod
    def from_yaml(cls, text: str, where: object = "scene") -> Scene:
        """The scene a YAML text describes.

        Args:
            text: the content of a scene file.
            where: named in errors, e.g. the file.

        Raises:
            DatasetError: names the entry, what was found and what is allowed.
        """
        obstacles, goals = parse_scene(text, where)
        return cls(obstacles, goals)

    def rows(self, times: Float[np.ndarray, " T"]) -> Float[np.ndarray, "T O 17"]:
        """(T, O, ROW) every obstacle at every time [s], for compiled code (kinecast.geometry.distances)."""
        if not self.obstacles:
            return np.empty((len(times), 0, ROW))
        return np.stack([obstacle.rows(times) for obstacle in self.obstacles], axis=1)

    def signed_distance(
        self, points: Float[np.ndarray, "*batch T J 3"], times: Float[np.ndarray, " T"]
    ) -> Float[np.ndarray, "*batch T J"]:
        """Distance [m] of each point to the nearest obstacle where it is at that point's time.

        Args:
            points: (…, T, J, 3) [m].
            times: (T,) [s].

        Returns:
            (…, T, J) [m], > 0 free, negative inside; inf without obstacles, NaN where a coordinate is NaN.
        """
        flat = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, *points.shape[-3:])
        distances: Float[np.ndarray, "S T J"] = scene_distances(self.rows(times), flat)
        return distances.reshape(points.shape[:-1])

    def free(
        self,
        arm_points: Float[np.ndarray, "S T 6 3"],
        times: Float[np.ndarray, " T"],
        limb_radius: float = 0.0,
    ) -> Bool[np.ndarray, "S T"]:
        """Whether no joint and no limb of either arm touches an obstacle where it is at each time (Eq. 7).

        Args:
            arm_points: (S, T, 6, 3) positions [m] of the six arm joints (kinecast.body.skeleton.ARM_JOINTS).
            times: (T,) [s], on the clock of moving obstacles.
            limb_radius: thickness of upper arms and forearms around their centre lines [m].

        Returns:
            (S, T); False where an arm has a NaN.

        Raises:
            OptionError: a limb radius below 0.
        """
        if not 0 <= limb_radius < np.inf:
            raise OptionError(f"limb_radius {limb_radius} m must be 0 or more")
        arms = np.ascontiguousarray(arm_points, dtype=np.float64)
        result: Bool[np.ndarray, "S T"] = arms_are_free(self.rows(times), arms, float(limb_radius))
        return result

    def clearance(
        self, poses: Float[np.ndarray, "*batch T 6 3"], times: Float[np.ndarray, " T"]
    ) -> Float[np.ndarray, "*batch T"]:
        """(…, T) distance [m] from the nearest limb to the nearest obstacle, > 0 free; inf without obstacles.

        Args:
            poses: (…, T, 6, 3) positions [m] of the six arm joints.
            times: (T,) [s], on the clock of moving obstacles.
        """
        starts, ends = poses[..., [0, 1, 3, 4], :], poses[..., [1, 2, 4, 5], :]
        nearest = np.full(poses.shape[:-2], np.inf)
        for step, rows in enumerate(self.rows(times)):
            start, end = starts[..., step, :, :], ends[..., step, :, :]
            for row in rows:
                limbs = segment_distances(row, start.reshape(-1, 3), end.reshape(-1, 3)).reshape(*start.shape[:-1])
                nearest[..., step] = np.minimum(nearest[..., step], limbs.min(axis=-1))
        return nearest
