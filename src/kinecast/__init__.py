"""Where a person's arms will be over the next half second, as a distribution that obeys joints, speeds and the scene.

from kinecast import Predictor, SkeletonFrame
predictor = Predictor.shipped()
prediction = predictor.observe(SkeletonFrame(stamp, joints, positions))
prediction.mean, prediction.samples, prediction.status.advice
prediction.tubes(0.95), prediction.log_prob(positions), prediction.probability_of_hitting(shape)
"""

from kinecast.geometry.scene import Scene
from kinecast.prediction.predictor import Predictor, PredictorOptions
from kinecast.types import Prediction, SkeletonFrame, Status, Tubes

__all__ = [
    "Prediction",
    "Predictor",
    "PredictorOptions",
    "Scene",
    "SkeletonFrame",
    "Status",
    "Tubes",
    "__version__",
]

__version__ = "0.1.0"
