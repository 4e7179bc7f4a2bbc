"""The paper's three methods: one-step sparse Gaussian processes, rolled out over the horizon by sampling (Alg. 1).

`gp_xyz` is `PositionSeries`: a process for each coordinate of each joint, in the world. `gp_angles` and
`gp_constrained` are `PostureSeries`: a process for each smooth posture coordinate, free or inside joint limits, speeds
and scene. Each series' next value depends on its own last 200 ms alone, as in the paper.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from kinecast.body.limits import JointLimits, posture_bounds
from kinecast.body.posture import coordinates_from_postures, points_from_postures, postures_from_points
from kinecast.errors import ModelError
from kinecast.prediction.constraint import ConstraintFactor
from kinecast.prediction.density import PoseDensity
from kinecast.prediction.gaussian import Examples
from kinecast.prediction.method import Forecast, Memoryless
from kinecast.prediction.model_file import ModelCard, shaped
from kinecast.prediction.noise import coordinate_noise
from kinecast.prediction.observation import Observation, TrainingWindows
from kinecast.prediction.rollout import (
    BONES,
    RELATIVE,
    SERIES,
    PositionRolloutBlocks,
    PostureRolloutBlocks,
    roll_positions,
    roll_series,
)
from kinecast.prediction.sparse_gp import SparseGPOptions, SparseGPs, fit_sparse_gp
from kinecast.tasks import Workers

LEAST_NOISE = 1e-6
"""Where bounds leave a single value, its density needs some noise to be finite [m]."""


class _Series(NamedTuple):
    """D series and their next values, at the windows that processes are trained on; how far bones stray."""

    inputs: Float[np.ndarray, "D W N"]
    outputs: Float[np.ndarray, "D W"]
    length_spread: Float[np.ndarray, "T 4"] | None = None


def _chosen(windows: int, options: SparseGPOptions) -> Int[np.ndarray, " K"]:
    """The same random choice of windows for every series."""
    return np.sort(np.random.default_rng(options.seed).permutation(windows)[: options.points])


def _position_series(windows: TrainingWindows, options: SparseGPOptions) -> _Series:
    """World coordinates as they are, as the paper has it."""
    rows = _chosen(len(windows), options)
    inputs = windows.observed[rows].reshape(len(rows), -1, 18).transpose(2, 0, 1)
    return _Series(inputs, windows.future[rows, 0].reshape(-1, 18).T)


def _posture_series(examples: Examples, options: SparseGPOptions) -> _Series:
    """Torso pose relative to its last value, angles as they are; how far bone lengths stray from their last value."""
    stray = examples.future[..., BONES] - examples.observed[:, -1:, BONES]
    rows = _chosen(len(examples.observed), options)
    inputs, outputs = examples.observed[rows][:, :, SERIES], examples.future[rows, 0][:, SERIES]
    last = inputs[:, -1:, :RELATIVE].copy()
    inputs[..., :RELATIVE] -= last
    outputs[:, :RELATIVE] -= last[:, 0]
    return _Series(inputs.transpose(2, 0, 1), outputs.T, np.sqrt((stray**2).mean(axis=0) + 1e-6))


def _process(series: _Series, place: int, options: SparseGPOptions) -> SparseGPs:
    return fit_sparse_gp(series.inputs[place], series.outputs[place], options)


def _fit(workers: Workers, series: Any, count: int, options: SparseGPOptions) -> Any:
    """A process for each of the series; stands for all of them."""
    return workers.submit(SparseGPs.joined, [workers.submit(_process, series, d, options) for d in range(count)])


@dataclass(frozen=True)
class PositionSeries(Memoryless):
    """`gp_xyz`: 18 independent series of world coordinates; knows neither body nor scene."""

    frames: int
    steps: int
    dt: float
    processes: SparseGPs

    @staticmethod
    def fitting(workers: Workers, windows: TrainingWindows, data: Any, options: SparseGPOptions) -> Any:
        """Stands for the method, one process per coordinate; `data` stands for the windows."""
        series = workers.submit(_position_series, data, options)
        return workers.submit(PositionSeries, *windows.shape, _fit(workers, series, 18, options))

    def forecast(self, state: None, observation: Observation, rng: np.random.Generator, samples: int) -> Forecast:
        """See kinecast.prediction.method.Method."""
        window = observation.positions.reshape(self.frames, 18)
        offsets = rng.standard_normal((samples, 18)) * np.repeat(observation.noise, 3)
        normals = rng.standard_normal((samples, self.steps, 18))
        positions, means, spreads = roll_positions(window, offsets, self.processes, normals)
        points = positions.reshape(samples, self.steps, 6, 3)
        mean = points.mean(axis=0)
        blocks = PositionRolloutBlocks(observation, means, spreads)
        return Forecast(points, mean, PoseDensity(observation, observation.to_torso(mean), blocks))

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Plain arrays for a model file."""
        return dict(self.processes._asdict())

    @staticmethod
    def from_arrays(arrays: Mapping[str, np.ndarray], card: ModelCard) -> PositionSeries:
        """The method that `to_arrays` described."""
        return PositionSeries(card.frames, card.steps, card.dt, SparseGPs.from_arrays(arrays, 18, card.frames))


@dataclass(frozen=True)
class PostureSeries(Memoryless):
    """`gp_angles` and `gp_constrained`: independent series of smooth posture coordinates.

    Attributes:
        processes: of the coordinates in `rollout.SERIES`.
        length_spread: (T, 4) how far bone lengths stray from their last value by each step [m].
        noise: spread of a measured joint about the true one [m], for the density of measurements.
        limits: range and speed of the arm's angles; None leaves them free and disregards the scene.
    """

    frames: int
    steps: int
    dt: float
    processes: SparseGPs
    length_spread: Float[np.ndarray, "T 4"]
    noise: float
    limits: JointLimits | None = None

    @staticmethod
    def fitting(
        workers: Workers, windows: TrainingWindows, examples: Any, options: SparseGPOptions, noise: float
    ) -> Any:
        """Stands for the method, without limits; `examples` stands for the windows' `posture_examples`."""
        series = workers.submit(_posture_series, examples, options)
        processes = _fit(workers, series, len(SERIES), options)
        return workers.submit(_posture_method, windows.shape, processes, series, noise)

    def with_limits(self, limits: JointLimits | None) -> PostureSeries:
        """The same processes, constrained or free."""
        return replace(self, limits=limits)

    def forecast(self, state: None, observation: Observation, rng: np.random.Generator, samples: int) -> Forecast:
        """See kinecast.prediction.method.Method."""
        track = postures_from_points(observation.points, continuous=True)
        offsets = rng.standard_normal((samples, 18)) * coordinate_noise(track[-1], observation.noise)
        rollout = roll_series(
            coordinates_from_postures(track), offsets, self.processes, self.length_spread, track[-1],
            rng.standard_normal((samples, self.steps, 18)), rng.random((samples, self.steps, 8)),
            posture_bounds(self.limits), self.dt,
        )  # fmt: skip
        points, held = points_from_postures(rollout.postures), self.limits is not None
        mean = points.mean(axis=0)
        # Limits hold every draw already; only a scene is left to do anything.
        constraint = ConstraintFactor(lambda: points, observation, None, self.noise) if held else None
        blocks = PostureRolloutBlocks(rollout, track[-1], max(self.noise, LEAST_NOISE) if held else 0.0)
        density = PoseDensity(observation, mean, blocks, constraint)
        return Forecast(observation.to_world(points), observation.to_world(mean), density, held)

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Plain arrays for a model file."""
        return {**self.processes._asdict(), "length_spread": self.length_spread}

    @staticmethod
    def from_arrays(arrays: Mapping[str, np.ndarray], card: ModelCard) -> PostureSeries:
        """The method that `to_arrays` described, without limits."""
        processes = SparseGPs.from_arrays(arrays, len(SERIES), card.frames)
        spread = shaped(arrays, "length_spread", card.steps, len(BONES))
        if not (spread > 0).all():
            raise ModelError("array length_spread holds values that are not above 0")
        return PostureSeries(card.frames, card.steps, card.dt, processes, spread, card.noise)


def _posture_method(
    shape: tuple[int, int, float], processes: SparseGPs, series: _Series, noise: float
) -> PostureSeries:
    assert series.length_spread is not None
    return PostureSeries(*shape, processes, series.length_spread, noise)
