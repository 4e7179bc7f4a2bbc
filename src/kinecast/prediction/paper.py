"""The paper's three methods: one-step sparse Gaussian processes, rolled out over the horizon by sampling (Alg. 1).

`gp_xyz` is `PositionSeries`: a process for each coordinate of each joint, in the world. `gp_angles` and
`gp_constrained` are `PostureSeries`: a process for each smooth posture coordinate, free or inside joint limits, speeds
and scene. Each series' next value depends on its own last 200 ms alone, as in the paper.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from kinecast.body.limits import JointLimits, posture_bounds
from kinecast.body.posture import coordinates_from_postures, postures_from_points, to_world
from kinecast.errors import ModelError
from kinecast.geometry.scene import Scene
from kinecast.prediction.allowance import Allowance
from kinecast.prediction.arrays import shaped
from kinecast.prediction.draws import normals, uniforms
from kinecast.prediction.forecast import Forecast, WorldDensity, within_scene
from kinecast.prediction.gaussian import Examples
from kinecast.prediction.mixture_density import PositionSeriesDensity, PostureSeriesDensity
from kinecast.prediction.noise import coordinate_noise
from kinecast.prediction.observation import Observation, TrainingWindows
from kinecast.prediction.rollout import RELATIVE, SERIES, roll_positions, roll_series
from kinecast.prediction.series import SeriesStack, stack_from_arrays, stack_of
from kinecast.prediction.sparse_gp import SparseGP
from kinecast.prediction.training import SparseGPOptions, fit_sparse_gp
from kinecast.tasks.workers import Workers

__all__ = ["PositionSeries", "PostureSeries"]

LENGTHS = (10, 11, 16, 17)
"""Where a posture holds bone lengths: left upper arm and forearm, right upper arm and forearm."""


@runtime_checkable
class SeriesOptions(Protocol):
    """What training a set of series needs to know (kinecast.prediction.methods.TrainingOptions)."""

    @property
    def seed(self) -> int: ...
    @property
    def pseudo_inputs(self) -> int: ...
    @property
    def points(self) -> int: ...
    @property
    def iterations(self) -> int: ...


class _Series(NamedTuple):
    """D series and their next values, at the windows that processes are trained on."""

    inputs: Float[np.ndarray, "D W N"]
    outputs: Float[np.ndarray, "D W"]
    length_spread: Float[np.ndarray, "T 4"]


def _chosen(inputs: Float[np.ndarray, "D W N"], options: SeriesOptions) -> Int[np.ndarray, " K"]:
    """The same random choice of windows for every series."""
    windows = inputs.shape[1]
    return np.sort(np.random.default_rng(options.seed).permutation(windows)[: options.points])


def _position_series(windows: TrainingWindows, options: SeriesOptions) -> _Series:
    """World coordinates as they are, as the paper has it."""
    count, frames = windows.observed.shape[:2]
    inputs = windows.observed.reshape(count, frames, 18).transpose(2, 0, 1)
    outputs = windows.future[:, 0].reshape(count, 18).T
    rows = _chosen(inputs, options)
    return _Series(inputs[:, rows], outputs[:, rows], np.empty((0, len(LENGTHS))))


def _posture_series(examples: Examples, options: SeriesOptions) -> _Series:
    """Torso pose relative to its last value, angles as they are; how far bone lengths stray from their last value."""
    series = list(SERIES)
    inputs, outputs = examples.observed[:, :, series], examples.future[:, 0, series]
    torso = np.array(SERIES) < RELATIVE
    last = examples.observed[:, -1:, series][..., torso]
    inputs[..., torso] -= last
    outputs[:, torso] -= last[:, 0]
    stray = examples.future[..., list(LENGTHS)] - examples.observed[:, -1:, list(LENGTHS)]
    whole, rows = inputs.transpose(2, 0, 1), _chosen(inputs.transpose(2, 0, 1), options)
    return _Series(whole[:, rows], outputs.T[:, rows], np.sqrt((stray**2).mean(axis=0) + 1e-6))


def _process(series: _Series, place: int, options: SparseGPOptions) -> SparseGP:
    return fit_sparse_gp(series.inputs[place], series.outputs[place, :, None], options)


def _fit(workers: Workers, series: Any, count: int, options: SeriesOptions) -> Any:
    """A process for each of the series; stands for a SeriesStack."""
    settings = SparseGPOptions(pseudo_inputs=options.pseudo_inputs, iterations=options.iterations, seed=options.seed)
    return workers.submit(stack_of, [workers.submit(_process, series, place, settings) for place in range(count)])


@dataclass(frozen=True)
class PositionSeries:
    """`gp_xyz`: 18 independent series of world coordinates; knows neither body nor scene."""

    frames: int
    steps: int
    dt: float
    stack: SeriesStack

    @staticmethod
    def fitting(workers: Workers, windows: TrainingWindows, data: Any, options: SeriesOptions) -> Any:
        """One process per coordinate; stands for the method.

        Args:
            workers: that do the tasks.
            windows: to train on.
            data: stands for the same.
            options: of training.
        """
        stack = _fit(workers, workers.submit(_position_series, data, options), 18, options)
        return workers.submit(PositionSeries, *windows.shape, stack)

    def forecast(
        self, observation: Observation, rng: np.random.Generator, samples: int, scene: Scene | None = None
    ) -> Forecast:
        """See kinecast.prediction.forecast.Method; the scene is disregarded."""
        del scene
        window = observation.positions.reshape(self.frames, 18)
        offsets = np.zeros((samples, 18))
        if observation.noise.any():
            offsets = normals(rng, samples, 18) * np.repeat(observation.noise, 3)
        positions, means, spreads = roll_positions(window, offsets, self.stack, normals(rng, samples, self.steps, 18))
        points = positions.reshape(samples, self.steps, 6, 3)
        mean = points.mean(axis=0)
        density = PositionSeriesDensity(mean, means, spreads)
        return Forecast(points, mean, density, np.ones(self.steps), samples)

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Plain arrays for a checkpoint."""
        return dict(self.stack._asdict())

    @staticmethod
    def from_arrays(arrays: Mapping[str, np.ndarray], frames: int, steps: int, dt: float) -> PositionSeries:
        """The method that `to_arrays` described."""
        return PositionSeries(frames, steps, dt, stack_from_arrays(arrays, 18, frames))


@dataclass(frozen=True)
class PostureSeries:
    """`gp_angles` and `gp_constrained`: independent series of smooth posture coordinates.

    Attributes:
        stack: the processes of the coordinates in `rollout.SERIES`.
        length_spread: (T, 4) how far bone lengths stray from their last value by each step [m].
        noise: spread of a measured joint about the true one [m], for the density of measurements.
        limits: range and speed of the arm's angles; None leaves them free and disregards the scene.
    """

    frames: int
    steps: int
    dt: float
    stack: SeriesStack
    length_spread: Float[np.ndarray, "T 4"]
    noise: float
    limits: JointLimits | None = None

    @staticmethod
    def fitting(workers: Workers, windows: TrainingWindows, examples: Any, options: SeriesOptions, noise: float) -> Any:
        """One process per coordinate; stands for the method, without limits.

        Args:
            workers: that do the tasks.
            windows: to train on.
            examples: stands for their `posture_examples`.
            options: of training.
            noise: spread of a measured joint about the true one [m].
        """
        series = workers.submit(_posture_series, examples, options)
        return workers.submit(
            _posture_method, windows.shape, _fit(workers, series, len(SERIES), options), series, noise
        )

    def with_limits(self, limits: JointLimits | None) -> PostureSeries:
        """The same processes, constrained or free."""
        return replace(self, limits=limits)

    def forecast(
        self, observation: Observation, rng: np.random.Generator, samples: int, scene: Scene | None = None
    ) -> Forecast:
        """See kinecast.prediction.forecast.Method."""
        track = postures_from_points(observation.points, continuous=True)
        offsets = np.zeros((samples, 18))
        if observation.noise.any():
            offsets = normals(rng, samples, 18) * coordinate_noise(track[-1], observation.noise)
        lower, upper, speed, wrist_speed = posture_bounds(self.limits)
        postures, means, spreads = roll_series(
            coordinates_from_postures(track), offsets, self.stack, self.length_spread, track[-1],
            normals(rng, samples, self.steps, 18), uniforms(rng, samples, self.steps, 8),
            lower, upper, speed, wrist_speed, self.dt,
        )  # fmt: skip
        points = to_world(postures, *observation.frame)
        centre = points.mean(axis=0)
        mean = observation.to_torso(centre)
        allowance = None
        if self.limits is not None and scene is not None:

            def draws() -> Float[np.ndarray, "S T 6 3"]:
                return observation.to_torso(points)

            allowance = Allowance(draws, observation, track[-1], None, scene, self.noise)
        density = PostureSeriesDensity(
            mean, postures, means, spreads, track[-1], self.limits, self.dt, self.noise, allowance
        )
        forecast = Forecast(points, centre, WorldDensity(observation, density), np.ones(self.steps), samples)
        if scene is not None and self.limits is not None:
            return within_scene(forecast, observation, rng, scene)
        return forecast

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Plain arrays for a checkpoint."""
        return {**self.stack._asdict(), "length_spread": self.length_spread}

    @staticmethod
    def from_arrays(
        arrays: Mapping[str, np.ndarray],
        frames: int,
        steps: int,
        dt: float,
        noise: float,
        limits: JointLimits | None,
    ) -> PostureSeries:
        """The method that `to_arrays` described."""
        stack = stack_from_arrays(arrays, len(SERIES), frames)
        spread = shaped(arrays, "length_spread", steps, len(LENGTHS))
        if not (spread > 0).all():
            raise ModelError("array length_spread holds values that are not above 0")
        return PostureSeries(frames, steps, dt, stack, spread, noise, limits)


def _posture_method(shape: tuple[int, int, float], stack: SeriesStack, series: _Series, noise: float) -> PostureSeries:
    return PostureSeries(*shape, stack, series.length_spread, noise)
