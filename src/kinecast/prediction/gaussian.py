"""Methods whose forecast is one Gaussian over all steps and coordinates: a mean model and its residual covariance.

`PositionGaussian` states it over the joints' positions, `PostureGaussian` over the smooth posture coordinates, where
the constraint stage can act. Any mean model (kinecast.prediction.baselines) fits into either.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from kinecast.body.limits import JointLimits, posture_bounds
from kinecast.body.posture import (
    coordinates_from_postures,
    points_from_postures,
    postures_from_coordinates,
    postures_from_points,
)
from kinecast.geometry.scene import Scene
from kinecast.prediction.allowance import Allowance
from kinecast.prediction.arrays import covariance_factor
from kinecast.prediction.baselines import MeanModel, mean_from_arrays
from kinecast.prediction.density import JOINT_ORDER, CoordinateGaussianDensity, PositionGaussianDensity
from kinecast.prediction.draws import normals
from kinecast.prediction.forecast import Forecast, WorldDensity, within_scene
from kinecast.prediction.motions import draw_motions
from kinecast.prediction.noise import coordinate_noise
from kinecast.prediction.observation import Observation, TrainingWindows
from kinecast.prediction.rollout import roll_gaussian
from kinecast.tasks.workers import Serial, Workers

__all__ = [
    "Examples",
    "PositionGaussian",
    "PostureGaussian",
    "position_examples",
    "posture_coordinates",
    "posture_examples",
    "residual_factor",
    "residual_moment",
]

Fit = Callable[[Float[np.ndarray, "W N D"], Float[np.ndarray, "W T D"], Int[np.ndarray, " W"]], MeanModel]
"""Fits a mean model to windows, futures and folds."""


class Examples(NamedTuple):
    """Windows and futures of D coordinates, and the fold of each."""

    observed: Float[np.ndarray, "W N D"]
    future: Float[np.ndarray, "W T D"]
    folds: Int[np.ndarray, " W"]


FLOOR = 1e-3
"""Least spread of a residual [m or rad]: a millimetre."""
FOLDS = 4
POSITION_ORDER = np.arange(18).reshape(6, 3)[JOINT_ORDER].ravel()
"""The 18 coordinates of the joints in block order."""


def residual_moment(fit: Fit, examples: Examples, fold: int) -> tuple[Float[np.ndarray, "K K"], int]:
    """Sum of the outer products of the errors on one left-out fold, and how many there are."""
    outside = examples.folds == fold
    inside = ~outside if (~outside).any() else outside
    model = fit(examples.observed[inside], examples.future[inside], examples.folds[inside])
    errors = (examples.future[outside] - model.mean(examples.observed[outside])).reshape(outside.sum(), -1)
    return errors.T @ errors, len(errors)


def residual_factor(moments: Sequence[tuple[Float[np.ndarray, "K K"], int]]) -> Float[np.ndarray, "K K"]:
    """Cholesky factor of the second moment of all folds' errors, over all steps and coordinates at once."""
    moment = np.sum([moment for moment, _ in moments], axis=0) / sum(count for _, count in moments)
    return np.linalg.cholesky(moment + FLOOR**2 * np.eye(len(moment)))


def fit_all(fit: Fit, examples: Examples) -> MeanModel:
    """The mean model of all examples."""
    return fit(examples.observed, examples.future, examples.folds)


def _fitting(workers: Workers, fit: Fit, examples: Any, folds: Int[np.ndarray, " W"]) -> tuple[Any, Any]:
    """What stands for a mean model, and for the factor of its errors' covariance."""
    moments = [workers.submit(residual_moment, fit, examples, fold) for fold in np.unique(folds).tolist()]
    return workers.submit(fit_all, fit, examples), workers.submit(residual_factor, moments)


def with_noise(cholesky: Float[np.ndarray, "K K"], noise: Float[np.ndarray, " D"]) -> Float[np.ndarray, "K K"]:
    """Factor of the covariance once the last frame's error, the same at every step, is added.

    Args:
        cholesky: (T·D, T·D) lower factor, steps outermost.
        noise: (D,) spread of that error.
    """
    if not noise.any():
        return cholesky
    steps = len(cholesky) // len(noise)
    shared = np.kron(np.ones((steps, steps)), np.diag(noise**2))
    return np.linalg.cholesky(cholesky @ cholesky.T + shared)


def _step_factors(cholesky: Float[np.ndarray, "K K"], order: Int[np.ndarray, "18"]) -> Float[np.ndarray, "T 18 18"]:
    """Cholesky factor of each step's marginal covariance, coordinates reordered."""
    rows = cholesky.reshape(-1, 18, cholesky.shape[1])[:, order]
    return np.linalg.cholesky(rows @ rows.transpose(0, 2, 1))


@dataclass(frozen=True)
class PositionGaussian:
    """A Gaussian over the joints' positions in the torso frame, free or held inside joint limits and scene.

    Attributes:
        noise: spread of a measured joint about the true one [m], for the density of measurements.
        limits: range and speed of the arm's angles; None leaves the Gaussian as it is and disregards the scene.
    """

    frames: int
    steps: int
    dt: float
    mean_model: MeanModel
    cholesky: Float[np.ndarray, "K K"]
    noise: float = 0.0
    limits: JointLimits | None = None

    @staticmethod
    def fitting(workers: Workers, fit: Fit, windows: TrainingWindows, examples: Any) -> Any:
        """Mean model and residual covariance from training windows; stands for the method.

        Args:
            workers: that fit.
            fit: how the mean model is fitted.
            windows: of training.
            examples: stands for their `position_examples`.
        """
        model, cholesky = _fitting(workers, fit, examples, windows.folds(FOLDS))
        return workers.submit(PositionGaussian, *windows.shape, model, cholesky)

    @cached_property
    def _step_cholesky(self) -> Float[np.ndarray, "T 18 18"]:
        return _step_factors(self.cholesky, POSITION_ORDER)

    def with_limits(self, limits: JointLimits, noise: float) -> PositionGaussian:
        """The same Gaussian, constrained."""
        return replace(self, limits=limits, noise=noise)

    def forecast(
        self, observation: Observation, rng: np.random.Generator, samples: int, scene: Scene | None = None
    ) -> Forecast:
        """See kinecast.prediction.forecast.Method; without limits the scene is disregarded."""
        window = observation.points.reshape(1, self.frames, 18)
        mean = self.mean_model.mean(window)[0].reshape(self.steps, 6, 3)
        cholesky, step_cholesky = self.cholesky, self._step_cholesky
        if observation.noise.any():
            cholesky = with_noise(cholesky, np.repeat(observation.noise, 3))
            step_cholesky = _step_factors(cholesky, POSITION_ORDER)
        draws = normals(rng, len(cholesky), samples)
        factor = cholesky.reshape(self.steps, 6, 3, -1)
        initial = postures_from_points(observation.points, continuous=True)[-1]
        motions = draw_motions(mean, factor, draws, rng, initial, self.limits, self.dt, *observation.frame)
        allowance = None
        if self.limits is not None:

            def free() -> Float[np.ndarray, "S T 6 3"]:
                return mean + (cholesky @ draws).T.reshape(samples, self.steps, 6, 3)

            allowance = Allowance(free, observation, initial, self.limits, scene, self.noise)
        forecast = Forecast(
            motions,
            observation.to_world(mean),
            WorldDensity(observation, PositionGaussianDensity(mean, step_cholesky, allowance)),
            np.ones(self.steps),
            samples,
        )
        if self.limits is None or scene is None:
            return forecast
        return within_scene(forecast, observation, rng, scene)

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Plain arrays for a checkpoint."""
        return {**self.mean_model.to_arrays(), "cholesky": self.cholesky}

    @staticmethod
    def from_arrays(
        arrays: Mapping[str, np.ndarray],
        frames: int,
        steps: int,
        dt: float,
        noise: float = 0.0,
        limits: JointLimits | None = None,
    ) -> PositionGaussian:
        """The method that `to_arrays` described."""
        cholesky = covariance_factor(arrays, "cholesky", 18 * steps)
        return PositionGaussian(frames, steps, dt, mean_from_arrays(arrays, frames, steps, 18), cholesky, noise, limits)


def posture_coordinates(
    observed: Float[np.ndarray, "W N 6 3"], future: Float[np.ndarray, "W T 6 3"]
) -> tuple[Float[np.ndarray, "W N 18"], Float[np.ndarray, "W T 18"]]:
    """Smooth posture coordinates of windows and futures, continuous from one frame to the next."""
    both = np.concatenate([observed, future], axis=1)
    coordinates = np.stack([coordinates_from_postures(postures_from_points(track, continuous=True)) for track in both])
    return coordinates[:, : observed.shape[1]], coordinates[:, observed.shape[1] :]


def position_examples(windows: TrainingWindows) -> Examples:
    """Positions in the torso frame as 18 coordinates [m]."""
    observed, future = (points.reshape(*points.shape[:2], 18) for points in (windows.points, windows.future_points))
    return Examples(observed, future, windows.folds(FOLDS))


def posture_examples(windows: TrainingWindows) -> Examples:
    """Smooth posture coordinates."""
    return Examples(*posture_coordinates(windows.points, windows.future_points), windows.folds(FOLDS))


@dataclass(frozen=True)
class PostureGaussian:
    """A Gaussian over the smooth posture coordinates, free or held inside joint limits and scene.

    Attributes:
        limits: range and speed of the arm's angles; None leaves the Gaussian as it is and disregards the scene.
        noise: spread of a measured joint about the true one [m], for the density of measurements.
    """

    frames: int
    steps: int
    dt: float
    mean_model: MeanModel
    cholesky: Float[np.ndarray, "K K"]
    noise: float
    limits: JointLimits | None = None

    @staticmethod
    def fit(fit: Fit, windows: TrainingWindows, noise: float, limits: JointLimits | None) -> PostureGaussian:
        """Mean model and residual covariance from training windows."""
        workers = Serial()
        examples = workers.submit(posture_examples, windows)
        [method] = workers.results([PostureGaussian.fitting(workers, fit, windows, examples, noise, limits)])
        return method

    @staticmethod
    def fitting(
        workers: Workers, fit: Fit, windows: TrainingWindows, examples: Any, noise: float, limits: JointLimits | None
    ) -> Any:
        """The same by workers; `examples` stands for the windows' `posture_examples`, the result for the method."""
        model, cholesky = _fitting(workers, fit, examples, windows.folds(FOLDS))
        return workers.submit(PostureGaussian, *windows.shape, model, cholesky, noise, limits)

    @cached_property
    def _step_cholesky(self) -> Float[np.ndarray, "T 18 18"]:
        return _step_factors(self.cholesky, np.arange(18))

    def forecast(
        self, observation: Observation, rng: np.random.Generator, samples: int, scene: Scene | None = None
    ) -> Forecast:
        """See kinecast.prediction.forecast.Method."""
        track = postures_from_points(observation.points, continuous=True)
        mean = self.mean_model.mean(coordinates_from_postures(track)[None])[0]
        cholesky, step_cholesky = self.cholesky, self._step_cholesky
        if observation.noise.any():
            cholesky = with_noise(cholesky, coordinate_noise(track[-1], observation.noise))
            step_cholesky = _step_factors(cholesky, np.arange(18))
        draws = rng.standard_normal((samples, len(cholesky)))
        uniforms = rng.random((samples, self.steps, 8))
        postures = roll_gaussian(mean, cholesky, track[-1], draws, uniforms, *posture_bounds(self.limits), self.dt)
        points = points_from_postures(postures)
        centre = points_from_postures(postures_from_coordinates(mean))
        allowance = None
        if self.limits is not None:

            def free_poses() -> Float[np.ndarray, "S T 6 3"]:
                free = mean + (draws @ cholesky.T).reshape(samples, self.steps, 18)
                return points_from_postures(postures_from_coordinates(free))

            allowance = Allowance(free_poses, observation, track[-1], self.limits, scene, self.noise)
        density = CoordinateGaussianDensity(mean, step_cholesky, centre, allowance)
        forecast = Forecast(
            observation.to_world(points),
            observation.to_world(points.mean(axis=0)),
            WorldDensity(observation, density),
            np.ones(self.steps),
            samples,
        )
        if self.limits is not None and scene is not None:
            return within_scene(forecast, observation, rng, scene)
        return forecast

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Plain arrays for a checkpoint."""
        return {**self.mean_model.to_arrays(), "cholesky": self.cholesky}

    @staticmethod
    def from_arrays(
        arrays: Mapping[str, np.ndarray],
        frames: int,
        steps: int,
        dt: float,
        noise: float,
        limits: JointLimits | None,
    ) -> PostureGaussian:
        """The method that `to_arrays` described."""
        cholesky = covariance_factor(arrays, "cholesky", 18 * steps)
        mean_model = mean_from_arrays(arrays, frames, steps, 18)
        return PostureGaussian(frames, steps, dt, mean_model, cholesky, noise, limits)
