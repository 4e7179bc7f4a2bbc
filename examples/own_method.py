"""Your own method beside kinecast's.

A whole method in plain NumPy, by its name in the commands: `--methods own_method:fit` trains it on recordings, `--model
own_method:trained` takes it as it is.

Shows: the five things a method must have, a density, and the two functions by which the commands find it; a model that
only gives means is shorter still (04_any_predictor_constrained.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinecast.datasets.loading import shipped_clips
from kinecast.datasets.windows import WindowOptions
from kinecast.pipeline import training_windows
from kinecast.prediction.method import Forecast, Memoryless
from kinecast.prediction.observation import Observation
from kinecast.prediction.training_windows import TrainingWindows


@dataclass(frozen=True)
class Normal:
    """Independent normal errors of every coordinate."""

    mean: np.ndarray
    spread: np.ndarray

    def log_prob(self, positions: np.ndarray) -> np.ndarray:
        """(T,) log density of a pose of both arms, (T, 6, 3), at each step; NaN where a joint is NaN."""
        z = (positions - self.mean) / self.spread
        return -(0.5 * z**2 + np.log(self.spread) + 0.5 * np.log(2 * np.pi)).sum(axis=(1, 2))


@dataclass(frozen=True)
class Fading(Memoryless):
    """x + v · decay · (1 − exp(−t / decay)), v over the last two frames; `spread` (T, 6, 3) as errors were [m]."""

    frames: int
    steps: int
    dt: float
    spread: np.ndarray
    decay: float = 0.15

    def mean(self, windows: np.ndarray) -> np.ndarray:
        """(W, N, 6, 3) windows in, (W, T, 6, 3) expected positions out [m]."""
        velocity = (windows[:, -1:] - windows[:, -3:-2]) / (2 * self.dt)
        time = self.dt * np.arange(1, self.steps + 1)
        reach = self.decay * (1 - np.exp(-time / self.decay))
        return windows[:, -1:] + reach[:, None, None] * velocity

    def forecast(self, state: None, observation: Observation, rng: np.random.Generator, samples: int) -> Forecast:
        """A distribution over the next T steps, all randomness from rng."""
        mean = self.mean(observation.positions[None])[0]
        motions = mean + rng.standard_normal((samples, 1, 6, 3)) * self.spread
        return Forecast(motions, mean, Normal(mean, self.spread))

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Everything it has learned."""
        return {"spread": self.spread}


def fit(windows: TrainingWindows) -> Fading:
    """For `--methods own_method:fit`: a method of training windows."""
    frames, steps, dt = windows.shape
    unfitted = Fading(frames, steps, dt, np.ones((steps, 6, 3)))
    error = windows.future - unfitted.mean(windows.observed)
    return Fading(frames, steps, dt, np.sqrt((error**2).mean(axis=0)))


def trained() -> Fading:
    """For `--model own_method:trained`: a method that is ready, fitted to two recordings; yours may read a file."""
    return fit(training_windows(shipped_clips(), WindowOptions()))


if __name__ == "__main__":
    method = trained()
    print("spread of the right wrist [mm], step by step:", (1e3 * method.spread[:, 5].mean(axis=1)).round(0))
