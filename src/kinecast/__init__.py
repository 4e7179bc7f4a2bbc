"""Where a person's arms will be over the next half second, as a distribution that obeys joints, speeds and the scene.

predictor = Predictor.shipped(scene=Scene.load("scene.yaml"))
prediction = predictor.observe(SkeletonFrame(stamp, joints, positions))
prediction.mean, prediction.samples, prediction.status.advice
prediction.tubes(0.95), prediction.log_prob(positions), prediction.probability_of_hitting(Box(center, size))

Types first: kinecast.types. Recordings: kinecast.datasets.loading. Training: kinecast.prediction.methods.
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

# Threads of compiled loops that wait by spinning starve whatever else the robot runs, and then each other: with one
# other busy process on two cores p99 of an online step was 80 ms, 14 ms without (docs/decisions/0015). Read once, when
# the OpenMP library is loaded; who has chosen otherwise keeps their choice.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

if TYPE_CHECKING:
    from kinecast.body.skeleton import ARM_JOINTS
    from kinecast.errors import KinecastError
    from kinecast.geometry.scene import Scene
    from kinecast.geometry.shapes import Box, Capsule
    from kinecast.predictor import Predictor, PredictorOptions
    from kinecast.types import Prediction, SkeletonFrame, Status, Tubes

__all__ = [
    "ARM_JOINTS",
    "Box",
    "Capsule",
    "KinecastError",
    "Prediction",
    "Predictor",
    "PredictorOptions",
    "Scene",
    "SkeletonFrame",
    "Status",
    "Tubes",
    "__version__",
]

__version__ = "0.2.0"

MODULES = {
    "body.skeleton": ("ARM_JOINTS",),
    "errors": ("KinecastError",),
    "geometry.scene": ("Scene",),
    "geometry.shapes": ("Box", "Capsule"),
    "predictor": ("Predictor", "PredictorOptions"),
    "types": ("Prediction", "SkeletonFrame", "Status", "Tubes"),
}
"""Where public names are: imported when one is first used, so that the command line is there before NumPy is."""


def __getattr__(name: str) -> Any:
    for module, names in MODULES.items():
        if name in names:
            value = getattr(import_module(f"kinecast.{module}"), name)
            globals()[name] = value
            return value
    raise AttributeError(f"module 'kinecast' has no attribute {name!r}")
