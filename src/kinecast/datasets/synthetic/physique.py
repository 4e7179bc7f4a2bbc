"""A person: how long the bones are, and where the joints are when the hands are somewhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.geometry.transforms import rotation_x, rotation_y, rotation_z

JOINTS = (*ARM_JOINTS, "neck", "head", "pelvis", "chest")
"""The joints of a generated recording."""

HANGING = np.array([-1.0, 0.0, -1.0]) / np.sqrt(2.0)
"""Where an elbow goes that is not turned outwards: down, and back when the hand is below the shoulder."""

LONGEST = 0.995
"""An arm never gets straighter than this share of its length."""

PROTRACTION = 0.03
"""How far a shoulder slides towards a far hand [m]."""


@dataclass(frozen=True)
class Body:
    """One person's build and habits. Lengths in metres.

    Attributes:
        hip_height: of the pelvis above the ground.
        trunk: pelvis to the middle between the shoulders.
        shoulder_half_width: middle to shoulder.
        neck, head: middle to neck, neck to head.
        upper_arm, forearm: bone lengths.
        swivel: how far the elbows stand out from hanging straight down [rad].
        tempo: peak speed of a usual reach [m/s].
        stretch: leans forward rather than stretch an arm beyond this share of its length.
        right_handed: which hand takes what lies in the middle.
    """

    hip_height: float
    trunk: float
    shoulder_half_width: float
    neck: float
    head: float
    upper_arm: float
    forearm: float
    swivel: float
    tempo: float
    stretch: float
    right_handed: bool

    @classmethod
    def sample(cls, rng: np.random.Generator) -> Body:
        """A random adult, 1.55 to 1.90 m tall."""
        height = float(np.clip(rng.normal(1.72, 0.09), 1.55, 1.90))
        # shares of body height: Drillis & Contini (1966), as in Winter, Biomechanics and Motor Control;
        # single bones vary by 3 % at the same height
        half_width, neck, head, upper, fore = (
            height * np.array([0.129, 0.040, 0.110, 0.186, 0.146]) * np.clip(rng.normal(1.0, 0.03, 5), 0.94, 1.06)
        )
        return cls(
            hip_height=0.530 * height,
            trunk=0.288 * height,
            shoulder_half_width=float(half_width),
            neck=float(neck),
            head=float(head),
            upper_arm=float(upper),
            forearm=float(fore),
            swivel=float(np.radians(rng.uniform(15.0, 40.0))),
            tempo=float(rng.uniform(0.75, 1.05)),
            stretch=float(rng.uniform(0.88, 0.98)),
            right_handed=bool(rng.random() < 0.9),
        )


@dataclass(frozen=True)
class Trunk:
    """How the trunk is held, over N frames.

    Attributes:
        pelvis: (N, 2) x and y of the pelvis [m].
        lean, twist, tilt: (N,) forward, to the left about the spine, to the right side [rad].
    """

    pelvis: Float[np.ndarray, "N 2"]
    lean: Float[np.ndarray, " N"]
    twist: Float[np.ndarray, " N"]
    tilt: Float[np.ndarray, " N"]

    def rotation(self, share: float = 1.0) -> Float[np.ndarray, "N 3 3"]:
        """(N, 3, 3) orientation of the spine, at a share of the way up for its twist."""
        return rotation_y(self.lean) @ rotation_x(self.tilt) @ rotation_z(share * self.twist)


def shoulder(body: Body, trunk: Trunk, side: float) -> Float[np.ndarray, "N 3"]:
    """(N, 3) one shoulder [m] before it slides; side +1 left, −1 right."""
    return _on_trunk(body, trunk, np.array([0.0, side * body.shoulder_half_width, body.trunk]), 1.0)


def reach_ratio(
    body: Body, shoulders: Float[np.ndarray, "N 3"], wrists: Float[np.ndarray, "N 3"]
) -> Float[np.ndarray, " N"]:
    """(N,) distance from shoulder to wrist as a share of the arm's length."""
    return np.divide(np.linalg.norm(wrists - shoulders, axis=-1), body.upper_arm + body.forearm)


def joints(
    body: Body, trunk: Trunk, hands: Float[np.ndarray, "N 2 3"], swivel: Float[np.ndarray, "N 2"]
) -> Float[np.ndarray, "N 10 3"]:
    """(N, 10, 3) joints [m] in the order of `JOINTS` of a person whose wrists are at given places, or fall short.

    `swivel` [rad] is the turn of each elbow about the line from shoulder to wrist, outwards from hanging. Bones keep
    their lengths exactly.
    """
    arms = [
        _arm(body, shoulder(body, trunk, side), hands[:, i], swivel[:, i], side) for i, side in enumerate((1.0, -1.0))
    ]
    base = np.array([0.0, 0.0, body.trunk])
    neck = _on_trunk(body, trunk, np.array([0.0, 0.0, body.trunk + body.neck]), 1.0)
    looking = rotation_z(1.5 * trunk.twist) @ rotation_y(0.2 + 0.6 * trunk.lean)
    head = neck + body.head * looking[:, :, 2]
    pelvis = _on_trunk(body, trunk, np.zeros(3), 0.0)
    chest = _on_trunk(body, trunk, 0.65 * base, 0.6)
    return np.stack([*arms[0], *arms[1], neck, head, pelvis, chest], axis=1)


def _on_trunk(body: Body, trunk: Trunk, place: Float[np.ndarray, " 3"], share: float) -> Float[np.ndarray, "N 3"]:
    """A point fixed to the trunk, at a share of its twist."""
    pelvis = np.column_stack([trunk.pelvis, np.full(len(trunk.pelvis), body.hip_height)])
    return np.add(pelvis, trunk.rotation(share) @ place)


def _arm(
    body: Body,
    shoulders: Float[np.ndarray, "N 3"],
    wrists: Float[np.ndarray, "N 3"],
    swivel: Float[np.ndarray, " N"],
    side: float,
) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 3"], Float[np.ndarray, "N 3"]]:
    """Shoulder, elbow and wrist: the elbow lies on a circle, the swivel angle says where."""
    upper, fore = body.upper_arm, body.forearm
    line = wrists - shoulders
    far = np.clip((reach_ratio(body, shoulders, wrists) - 0.7) / 0.3, 0.0, 1.0)
    shoulders = shoulders + PROTRACTION * (far * far * (3 - 2 * far))[:, None] * _unit(line)
    line = wrists - shoulders
    along = _unit(line)
    distance = np.minimum(np.linalg.norm(line, axis=-1), LONGEST * (upper + fore))
    wrists = shoulders + distance[:, None] * along
    foot = (upper**2 - fore**2 + distance**2) / (2 * distance)
    radius = np.sqrt(upper**2 - foot**2)
    down = _unit(HANGING - (along @ HANGING)[:, None] * along)
    out = side * np.cross(along, down)
    circle = np.cos(swivel)[:, None] * down + np.sin(swivel)[:, None] * out
    return shoulders, shoulders + foot[:, None] * along + radius[:, None] * circle, wrists


def _unit(vectors: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
    return np.divide(vectors, np.linalg.norm(vectors, axis=-1, keepdims=True))
