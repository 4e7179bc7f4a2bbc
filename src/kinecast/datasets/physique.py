"""A person: how long the bones are, and where the joints are when the hands are somewhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.geometry.transforms import rotation_x, rotation_y, rotation_z

JOINTS = (*ARM_JOINTS, "neck", "head", "pelvis", "chest")
"""The joints of a generated recording."""

HANGING = np.array([-1.0, 0.0, -1.0]) / np.sqrt(2.0)
"""Where an elbow goes that is not turned outwards: down, and back when the hand is below the shoulder."""

LONGEST = 0.995  # an arm never gets straighter than this share of its length
PROTRACTION = 0.03  # how far a shoulder slides towards a far hand [m]

Points: TypeAlias = Float[np.ndarray, "N 3"]
Series: TypeAlias = Float[np.ndarray, " N"]


@dataclass(frozen=True)
class Body:
    """One person's build and habits. Lengths in metres."""

    hip_height: float  # of the pelvis above the ground
    trunk: float  # pelvis to the middle between the shoulders
    shoulder_half_width: float
    neck: float  # above the middle between the shoulders
    head: float  # above the neck
    upper_arm: float
    forearm: float
    swivel: float  # how far the elbows stand out from hanging straight down [rad]
    tempo: float  # peak speed of a usual reach [m/s]
    stretch: float  # leans forward rather than stretch an arm beyond this share of its length
    right_handed: bool  # which hand takes what lies in the middle

    @classmethod
    def sample(cls, rng: np.random.Generator) -> Body:
        """A random adult, 1.55 to 1.90 m tall."""
        height = float(np.clip(rng.normal(1.72, 0.09), 1.55, 1.90))
        # shares of body height: Drillis & Contini (1966), as in Winter, Biomechanics and Motor Control;
        # single bones vary by 3 % at the same height
        shares = np.array([0.129, 0.040, 0.110, 0.186, 0.146])  # half width, neck, head, upper arm, forearm
        bones = height * shares * np.clip(rng.normal(1.0, 0.03, 5), 0.94, 1.06)
        half_width, neck, head, upper, fore = bones.tolist()
        return cls(
            0.530 * height, 0.288 * height, half_width, neck, head, upper, fore,
            swivel=float(np.radians(rng.uniform(15.0, 40.0))),
            tempo=float(rng.uniform(0.75, 1.05)),
            stretch=float(rng.uniform(0.88, 0.98)),
            right_handed=bool(rng.random() < 0.9),
        )  # fmt: skip

    def reach_ratio(self, shoulders: Points, wrists: Points) -> Series:
        """(N,) distance from shoulder to wrist as a share of the arm's length."""
        return np.divide(np.linalg.norm(wrists - shoulders, axis=-1), self.upper_arm + self.forearm)


@dataclass(frozen=True)
class Trunk:
    """How a trunk is held: pelvis (N, 2) x, y [m]; lean forward, twist to the left, tilt to the right (N,) [rad]."""

    body: Body
    pelvis: Float[np.ndarray, "N 2"]
    lean: Series
    twist: Series
    tilt: Series

    def at(self, place: list[float], share: float = 1.0) -> Points:
        """(N, 3) a point fixed to the trunk, at a share of its twist."""
        pelvis = np.column_stack([self.pelvis, np.full(len(self.pelvis), self.body.hip_height)])
        turn = rotation_y(self.lean) @ rotation_x(self.tilt) @ rotation_z(share * self.twist)
        return np.add(pelvis, turn @ np.array(place))

    def shoulder(self, side: float) -> Points:
        """(N, 3) one shoulder [m] before it slides; side +1 left, −1 right."""
        return self.at([0.0, side * self.body.shoulder_half_width, self.body.trunk])


def joints(
    trunk: Trunk, hands: Float[np.ndarray, "N 2 3"], swivel: Float[np.ndarray, "N 2"]
) -> Float[np.ndarray, "N 10 3"]:
    """(N, 10, 3) joints [m] in the order of `JOINTS` of a person whose wrists are at given places, or fall short.

    `swivel` [rad] is the turn of each elbow about the line from shoulder to wrist, outwards from hanging. Bones keep
    their lengths exactly.
    """
    body = trunk.body
    arms = [_arm(trunk, hands[:, i], swivel[:, i], side) for i, side in enumerate((1.0, -1.0))]
    neck = trunk.at([0.0, 0.0, body.trunk + body.neck])
    looking = rotation_z(1.5 * trunk.twist) @ rotation_y(0.2 + 0.6 * trunk.lean)
    head = neck + body.head * looking[:, :, 2]
    pelvis = trunk.at([0.0, 0.0, 0.0], 0.0)
    chest = trunk.at([0.0, 0.0, 0.65 * body.trunk], 0.6)
    return np.stack([*arms[0], *arms[1], neck, head, pelvis, chest], axis=1)


def _arm(trunk: Trunk, wrists: Points, swivel: Series, side: float) -> tuple[Points, Points, Points]:
    """Shoulder, elbow and wrist: the elbow lies on a circle, the swivel angle says where."""
    body, shoulders = trunk.body, trunk.shoulder(side)
    upper, fore = body.upper_arm, body.forearm
    far = np.clip((body.reach_ratio(shoulders, wrists) - 0.7) / 0.3, 0.0, 1.0)
    shoulders = shoulders + PROTRACTION * (far * far * (3 - 2 * far))[:, None] * _unit(wrists - shoulders)
    line = wrists - shoulders
    along = _unit(line)
    distance = np.minimum(np.linalg.norm(line, axis=-1), LONGEST * (upper + fore))
    foot = (upper**2 - fore**2 + distance**2) / (2 * distance)
    down = _unit(HANGING - (along @ HANGING)[:, None] * along)
    out = side * np.cross(along, down)
    circle = np.cos(swivel)[:, None] * down + np.sin(swivel)[:, None] * out
    elbows = shoulders + foot[:, None] * along + np.sqrt(upper**2 - foot**2)[:, None] * circle
    return shoulders, elbows, shoulders + distance[:, None] * along


def _unit(vectors: Points) -> Points:
    return np.divide(vectors, np.linalg.norm(vectors, axis=-1, keepdims=True))
