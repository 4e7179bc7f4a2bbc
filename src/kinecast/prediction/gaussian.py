"""Methods whose forecast is one Gaussian over all steps and coordinates: a mean model and its residual covariance.

`PositionGaussian` states it over the joints' positions, `PostureGaussian` over the smooth posture coordinates; either
can be held inside joint limits and scene. Any mean model (kinecast.prediction.linear) fits into both.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np
from jaxtyping import Float, Int

from kinecast.body.limits import JointLimits, posture_bounds
from kinecast.body.posture import (
    coordinates_from_postures,
    points_from_postures,
    postures_from_coordinates,
    postures_from_points,
)
from kinecast.errors import ModelError
from kinecast.prediction.density import ConstraintFactor, GaussianMixture, PoseDensity
from kinecast.prediction.linear import MeanModel, mean_from_arrays
from kinecast.prediction.method import Forecast, Memoryless
from kinecast.prediction.model_file import ModelCard, shaped
from kinecast.prediction.noise import coordinate_noise
from kinecast.prediction.observation import Observation
from kinecast.prediction.rollout import hold
from kinecast.prediction.sampling import sample_motions
from kinecast.prediction.training_windows import TrainingWindows

G = TypeVar("G", bound="_Gaussian")
Square: TypeAlias = Float[np.ndarray, "K K"]

Fit: TypeAlias = Callable[[Float[np.ndarray, "W N D"], Float[np.ndarray, "W T D"], Int[np.ndarray, " W"]], MeanModel]
"""Fits a mean model to windows, futures and folds."""

FLOOR = 1e-3
"""Least spread of a residual [m or rad]: a millimetre."""
FOLDS = 4


class Examples(NamedTuple):
    """Windows and futures of D coordinates, and the fold of each."""

    observed: Float[np.ndarray, "W N D"]
    future: Float[np.ndarray, "W T D"]
    folds: Int[np.ndarray, " W"]


def position_examples(windows: TrainingWindows) -> Examples:
    """Positions in the torso frame as 18 coordinates [m]."""
    observed, future = (points.reshape(*points.shape[:2], 18) for points in (windows.points, windows.future_points))
    return Examples(observed, future, windows.folds(FOLDS))


def posture_examples(windows: TrainingWindows) -> Examples:
    """Smooth posture coordinates, continuous from one frame to the next."""
    tracks = np.concatenate([windows.points, windows.future_points], axis=1)
    coordinates = coordinates_from_postures(postures_from_points(tracks, continuous=True))
    frames = windows.points.shape[1]
    return Examples(coordinates[:, :frames], coordinates[:, frames:], windows.folds(FOLDS))


def residual_factor(fit: Fit, examples: Examples) -> Square:
    """Cholesky factor of the second moment of the errors on left-out folds, over all steps and coordinates at once."""
    moment: Any = 0.0
    for fold in np.unique(examples.folds):
        outside = examples.folds == fold
        inside = ~outside if (~outside).any() else outside
        model = fit(*(each[inside] for each in examples))
        errors = (examples.future[outside] - model.mean(examples.observed[outside])).reshape(outside.sum(), -1)
        moment = moment + errors.T @ errors
    moment = moment / len(examples.folds)
    return np.linalg.cholesky(moment + FLOOR**2 * np.eye(len(moment)))


def with_noise(cholesky: Square, noise: Float[np.ndarray, " D"]) -> Square:
    """Factor of the covariance (steps outermost) once the last frame's error, the same at every step, is added."""
    if not noise.any():
        return cholesky
    steps = len(cholesky) // len(noise)
    return np.linalg.cholesky(cholesky @ cholesky.T + np.kron(np.ones((steps, steps)), np.diag(noise**2)))


@dataclass(frozen=True)
class _Gaussian(Memoryless):
    """A mean model of D = 18 coordinates and the covariance of its errors.

    Attributes:
        frames, steps, dt: N, T, and time between frames [s]; T may be less than those below know of.
        mean_model: gives the expected coordinates.
        cholesky: (18 T, 18 T) lower factor of the errors' covariance, steps outermost.
        noise: spread of a measured joint about the true one [m], for the density of measurements.
        limits: range and speed of the arm's angles; None leaves the Gaussian as it is and disregards the scene.
    """

    frames: int
    steps: int
    dt: float
    mean_model: MeanModel
    cholesky: Square
    noise: float = 0.0
    limits: JointLimits | None = None

    examples = staticmethod(position_examples)

    @classmethod
    def fit(
        cls: type[G], fit: Fit, windows: TrainingWindows, noise: float = 0.0, limits: JointLimits | None = None
    ) -> G:
        """Mean model and residual covariance from training windows."""
        examples = cls.examples(windows)
        return cls(*windows.shape, fit(*examples), residual_factor(fit, examples), noise, limits)

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Plain arrays for a model file."""
        return {**self.mean_model.to_arrays(), "cholesky": self.cholesky}

    @classmethod
    def from_arrays(cls: type[G], arrays: Mapping[str, np.ndarray], card: ModelCard) -> G:
        """The method that `to_arrays` described, without limits."""
        model = mean_from_arrays(arrays, card.frames, card.steps, 18)
        cholesky = shaped(arrays, "cholesky", 18 * card.steps, 18 * card.steps)
        if np.triu(cholesky, 1).any() or not (np.diag(cholesky) > 0).all():
            raise ModelError("array cholesky is no lower triangle with a positive diagonal")
        return cls(card.frames, card.steps, card.dt, model, cholesky, card.noise)

    def _first(self) -> Square:
        """The factor of the steps that are predicted."""
        return self.cholesky[: 18 * self.steps, : 18 * self.steps]

    def _constraint(self, observation: Observation, draws: Callable[[], np.ndarray]) -> ConstraintFactor | None:
        return None if self.limits is None else ConstraintFactor(draws, observation, self.limits, self.noise)


@dataclass(frozen=True)
class PositionGaussian(_Gaussian):
    """A Gaussian over the joints' positions in the torso frame, free or held inside joint limits and scene."""

    def forecast(self, state: None, observation: Observation, rng: np.random.Generator, samples: int) -> Forecast:
        """See kinecast.prediction.method.Method."""
        window = observation.points.reshape(1, self.frames, 18)
        mean = self.mean_model.mean(window)[0, : self.steps].reshape(self.steps, 6, 3)
        factor = with_noise(self._first(), np.repeat(observation.noise, 3)).reshape(self.steps, 6, 3, -1)
        draws = rng.standard_normal((factor.shape[-1], samples))
        constraint = self._constraint(observation, lambda: mean + np.tensordot(draws, factor, axes=(0, 3)))
        motions = sample_motions(observation, mean, factor, draws, self.limits)
        density = PoseDensity(observation, mean, GaussianMixture.of_positions(mean[None], factor[None]), constraint)
        return Forecast(motions, observation.to_world(mean), density, self.limits is not None)


@dataclass(frozen=True)
class PostureGaussian(_Gaussian):
    """A Gaussian over the smooth posture coordinates, free or held inside joint limits and scene."""

    examples = staticmethod(posture_examples)

    def forecast(self, state: None, observation: Observation, rng: np.random.Generator, samples: int) -> Forecast:
        """See kinecast.prediction.method.Method."""
        track = postures_from_points(observation.points, continuous=True)
        mean = self.mean_model.mean(coordinates_from_postures(track)[None])[0, : self.steps]
        cholesky = with_noise(self._first(), coordinate_noise(track[-1], observation.noise))
        drawn = mean + (rng.standard_normal((samples, len(cholesky))) @ cholesky.T).reshape(samples, self.steps, 18)
        free, spread = postures_from_coordinates(drawn), np.linalg.norm(cholesky, axis=1).reshape(self.steps, 18)
        uniforms, within = rng.random((samples, self.steps, 8)), posture_bounds(self.limits)
        postures = hold(free, mean, spread, track[-1], uniforms, within, self.dt)
        motions = observation.to_world(points_from_postures(postures))
        constraint = self._constraint(observation, lambda: points_from_postures(free))
        blocks = GaussianMixture(mean[None], cholesky.reshape(1, self.steps, 18, -1), posture=True)
        centre = points_from_postures(postures_from_coordinates(mean))
        density = PoseDensity(observation, centre, blocks, constraint)
        return Forecast(motions, motions.mean(axis=0), density, self.limits is not None)
