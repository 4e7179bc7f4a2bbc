"""What can be chosen about generated people, and the scene they stand in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinecast.errors import OptionError
from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Box, Sphere

__all__ = ["SyntheticOptions", "table_scene"]


@dataclass(frozen=True)
class SyntheticOptions:
    """Options of `generate`. The sensor's defaults are what two HA4M clips show.

    Attributes:
        subjects: how many people, each with an own build, tempo and handedness.
        recordings: per person; the tasks pick_and_place, carrying, reaching take turns.
        duration: of each recording [s].
        rate: frames per second [Hz].
        table_height: of the table's top [m]. People stand.
        hesitation: share of reaches that set out for another goal first.
        noise: standard deviation of each coordinate of the trunk [m]; 1.5 times as much at elbows and wrists.
        breathing: standard deviation of the one factor by which all bones grow and shrink together.
        repeated: share of frames that repeat the frame before.
        jumps: tracker jumps per second.
        dropouts: share of frames in which an arm is lost.
    """

    subjects: int = 4
    recordings: int = 3
    duration: float = 20.0
    rate: float = 30.0
    table_height: float = 0.9
    hesitation: float = 0.1
    noise: float = 0.0015  # HA4M: 1.3 mm at the neck to 2.4 mm at a wrist, from third differences
    breathing: float = 0.04  # HA4M: 0.043 and 0.039 in V001 and V002
    repeated: float = 0.025  # HA4M: 0.028 and 0.023
    jumps: float = 0.15  # HA4M: about 20 in 80 s of V001, 10 in 88 s of V002
    dropouts: float = 0.01  # HA4M has none, the Vicon recordings 0-5 %

    def __post_init__(self) -> None:
        for name, low, high in (
            ("subjects", 1, 10_000),
            ("recordings", 1, 10_000),
            ("duration", 0.1, 3600.0),
            ("rate", 1.0, 1000.0),
            ("table_height", 0.8, 0.9),  # lower than any elbow, and within the reach of all
            ("hesitation", 0.0, 1.0),
            ("noise", 0.0, 0.1),
            ("breathing", 0.0, 0.2),
            ("repeated", 0.0, 0.9),
            ("jumps", 0.0, 10.0),
            ("dropouts", 0.0, 0.9),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise OptionError(f"{name} {value} is outside {low}..{high}")


def table_scene(options: SyntheticOptions) -> Scene:
    """The table as a slab, and where a wrist is when its hand is at each cube, tray or side of the crate.

    People stand at the origin and look along x. Wrists stay 8 cm above the table, the length of a bent hand.
    """
    wrist = options.table_height + 0.08
    thickness = 0.04
    top = Box(np.array([0.55, 0.0, options.table_height - thickness / 2]), np.array([0.76, 1.6, thickness]))
    goals: dict[str, Sphere | Box] = {
        name: Sphere(np.array([x, y, wrist + 0.01]), 0.05)
        for name, x, y in (("red_cube", 0.42, 0.24), ("green_cube", 0.45, 0.0), ("blue_cube", 0.42, -0.24))
    }
    for name, y in (("left_tray", 0.42), ("right_tray", -0.42)):
        goals[name] = Box(np.array([0.3, y, wrist + 0.02]), np.array([0.14, 0.2, 0.04]))
    for name, y in (("crate_left", 0.16), ("crate_right", -0.16)):
        goals[name] = Box(np.array([0.36, y, wrist + 0.03]), np.array([0.1, 0.36, 0.04]))
    return Scene((top,), goals)
