"""The paper's three methods: one-step sparse Gaussian processes, rolled out over the horizon by sampling (Alg. 1).

`gp_xyz` is `PositionSeries`: a process for each coordinate of each joint, in the world. `gp_angles` and
`gp_constrained` are `PostureSeries`: a process for each smooth posture coordinate, free or inside joint limits, speeds
and scene. Each series' next value depends on its own last 200 ms alone, as in the paper.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from kinecast.body.limits import JointLimits, posture_bounds
from kinecast.body.posture import coordinates_from_postures, points_from_postures, postures_from_points
from kinecast.errors import ModelError
from kinecast.prediction.density import ConstraintFactor, PoseDensity
from kinecast.prediction.gaussian import posture_examples
from kinecast.prediction.method import Forecast, Memoryless
from kinecast.prediction.model_file import ModelCard, shaped
from kinecast.prediction.noise import coordinate_noise
from kinecast.prediction.observation import Observation
from kinecast.prediction.rollout import (
    BONES,
    RELATIVE,
    SERIES,
    PositionRolloutBlocks,
    PostureRolloutBlocks,
    roll_positions,
    roll_series,
)
from kinecast.prediction.sparse_gp import SparseGPs, fit_sparse_gp
from kinecast.prediction.training_windows import TrainingWindows
from kinecast.tasks import Workers

PSEUDO_INPUTS, POINTS, ITERATIONS = 16, 2000, 100
"""M (docs/decisions/0011); most windows trained on, drawn at random where there are more; iterations of L-BFGS."""
LEAST_NOISE = 1e-6
"""Where bounds leave a single value, its density needs some noise to be finite [m]."""


def _chosen(windows: int, seed: int) -> Int[np.ndarray, " K"]:
    """The same random choice of windows for every series."""
    return np.sort(np.random.default_rng(seed).permutation(windows)[:POINTS])


def _fitting(workers: Workers, inputs: Float[np.ndarray, "K N D"], outputs: Float[np.ndarray, "K D"], seed: int) -> Any:
    """Stands for the processes of D series, each from its last N values to its next one."""
    fit = partial(fit_sparse_gp, seed=seed, pseudo_inputs=PSEUDO_INPUTS, iterations=ITERATIONS)
    series = zip(inputs.transpose(2, 0, 1), outputs.T, strict=True)
    return workers.submit(SparseGPs.joined, [workers.submit(fit, x, y) for x, y in series])


@dataclass(frozen=True)
class PositionSeries(Memoryless):
    """`gp_xyz`: 18 independent series of world coordinates; knows neither body nor scene."""

    frames: int
    steps: int
    dt: float
    processes: SparseGPs

    @staticmethod
    def fitting(workers: Workers, windows: TrainingWindows, seed: int) -> Any:
        """Stands for the method: a process per world coordinate, taken as it is, as the paper has it."""
        rows = _chosen(len(windows), seed)
        inputs = windows.observed[rows].reshape(len(rows), -1, 18).astype(float)
        outputs = windows.future[rows, 0].reshape(-1, 18).astype(float)
        return workers.submit(PositionSeries, *windows.shape, _fitting(workers, inputs, outputs, seed))

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
    def fitting(workers: Workers, windows: TrainingWindows, seed: int, noise: float) -> Any:
        """Stands for the method, without limits: torso pose relative to its last value, angles as they are."""
        observed, future, _ = posture_examples(windows)
        stray = future[..., BONES] - observed[:, -1:, BONES]
        rows = _chosen(len(windows), seed)
        inputs, outputs = observed[rows][:, :, SERIES], future[rows, 0][:, SERIES]
        last = inputs[:, -1, :RELATIVE].copy()
        inputs[..., :RELATIVE] -= last[:, None]
        outputs[:, :RELATIVE] -= last
        processes = _fitting(workers, inputs, outputs, seed)
        length_spread = np.sqrt((stray**2).mean(axis=0) + 1e-6)
        return workers.submit(PostureSeries, *windows.shape, processes, length_spread, noise)

    def forecast(self, state: None, observation: Observation, rng: np.random.Generator, samples: int) -> Forecast:
        """See kinecast.prediction.method.Method."""
        track = postures_from_points(observation.points, continuous=True)
        offsets = rng.standard_normal((samples, 18)) * coordinate_noise(track[-1], observation.noise)
        rollout = roll_series(
            coordinates_from_postures(track), offsets, self.processes, self.length_spread[: self.steps], track[-1],
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
