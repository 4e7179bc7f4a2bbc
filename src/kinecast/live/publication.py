"""What goes out for each frame, and its message: the schema is in docs/live.md and data/schemas."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import msgspec
import numpy as np

from kinecast.body.skeleton import arms_of
from kinecast.types import Prediction, SkeletonFrame, Status, Tubes

_GREEN, _AMBER, _RED = (0.25, 0.75, 0.35), (0.95, 0.65, 0.15), (0.9, 0.2, 0.2)
UPPER_TRIANGLE = np.triu_indices(3)  # rows and columns of xx, xy, xz, yy, yz, zz in a covariance
TENTH_OF_MILLIMETRE = 4  # decimals of a position in metres; twice as many for a variance


@dataclass(frozen=True)
class Publication:
    """A prediction, with what it rests on; samples and density are left behind, so that waiting ones stay small."""

    number: int  # counts publications from 1
    source: str
    frame: SkeletonFrame  # that it rests on
    prediction: Prediction  # without samples and density
    tubes: Tubes
    acquired: float  # when the frame was taken [s], on `time.monotonic`

    @classmethod
    def of(
        cls, number: int, source: str, frame: SkeletonFrame, prediction: Prediction, level: float, acquired: float
    ) -> Publication:
        """With tubes at a level."""
        tubes = prediction.tubes(level)
        return cls(number, source, frame, prediction.without_samples(), tubes, acquired)

    @property
    def key(self) -> tuple[str, str]:
        """Source and person."""
        return self.source, self.prediction.person

    @cached_property
    def message(self) -> dict[str, Any]:
        """As in docs/live.md; NaN where nothing is known, which JSON has as null."""
        prediction, tubes = self.prediction, self.tubes
        covariance = prediction.covariance[..., *UPPER_TRIANGLE]
        return {
            "kind": "prediction",
            "version": 1,
            "number": self.number,
            "source": self.source,
            "person": prediction.person,
            "frame_id": self.frame.frame_id,
            "stamp": prediction.stamp,
            "status": prediction.status.name,
            "advice": prediction.status.advice,
            "joints": prediction.joints,
            "observed": _metres(arms_of(self.frame)),
            "times": np.round(prediction.times, 6).tolist(),
            "mean": _metres(prediction.mean),
            "covariance": np.round(covariance, 2 * TENTH_OF_MILLIMETRE).tolist(),
            "tubes": {
                "level": tubes.level,
                **{part: _metres(getattr(tubes, part)) for part in ("start", "end", "radius")},
            },
            "goals": {hand: dict(goals) for hand, goals in prediction.goals.items()},
        }

    @cached_property
    def json(self) -> bytes:
        """The message as JSON."""
        return msgspec.json.encode(self.message)

    @cached_property
    def msgpack(self) -> bytes:
        """The message as msgpack."""
        return msgspec.msgpack.encode(self.message)


def colour_of(status: Status) -> tuple[float, float, float]:
    """Red, green and blue [0..1] that what is predicted is drawn in: green, amber, or red where it says nothing."""
    if status is Status.OK:
        return _GREEN
    return _RED if status in (Status.FAULT, Status.BLOCKED) else _AMBER


def _metres(values: np.ndarray) -> Any:
    return np.round(values, TENTH_OF_MILLIMETRE).tolist()
