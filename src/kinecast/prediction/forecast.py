"""What a trained method gives for one window, and what it must offer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int
from numba import njit

from kinecast.geometry.scene import Scene
from kinecast.prediction.observation import Observation
from kinecast.types import Density

__all__ = ["Follower", "Forecast", "Method", "WorldDensity", "forecast_with", "joint_covariances", "within_scene"]


@dataclass(frozen=True)
class Forecast:
    """A distribution over the motion of both arms, in the world.

    Attributes:
        samples: (S, T, 6, 3) equally likely motions [m].
        mean: (T, 6, 3) expected positions [m].
        density: the exact density at each step.
        accepted: (T,) share of drawn motions still inside the scene's free space at each step; 1 without one.
        distinct: number of distinct motions among the samples.
        diagnostics: what else the method says of itself, e.g. `learned_share`.
        goals: per hand, the probability of each goal of the scene; empty where none were given.
    """

    samples: Float[np.ndarray, "S T 6 3"]
    mean: Float[np.ndarray, "T 6 3"]
    density: Density
    accepted: Float[np.ndarray, " T"]
    distinct: int
    diagnostics: Mapping[str, float] = field(default_factory=dict)
    goals: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @property
    def blocked(self) -> bool:
        """True where the scene left no motion at all; the samples then disregard it."""
        return self.distinct == 0


@runtime_checkable
class Method(Protocol):
    """A trained predictor of both arms."""

    @property
    def frames(self) -> int:
        """N, length of the observation window."""
        ...

    @property
    def steps(self) -> int:
        """T, number of predicted steps."""
        ...

    @property
    def dt(self) -> float:
        """Time between frames [s]."""
        ...

    def forecast(
        self, observation: Observation, rng: np.random.Generator, samples: int, scene: Scene | None = None
    ) -> Forecast:
        """The distribution over the next T steps.

        Args:
            observation: the window, N frames.
            rng: source of randomness; equal states give equal forecasts.
            samples: S, number of motions to draw.
            scene: obstacles; methods without scene constraints disregard it.
        """
        ...

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Everything the method needs, as plain arrays."""
        ...


@runtime_checkable
class Follower(Method, Protocol):
    """A method that learns from the person in view, frame by frame; its `forecast` takes that memory last."""

    def memory(self) -> Any:
        """Nothing remembered yet of a person."""
        ...

    def follow(self, memory: Any, observation: Observation, measured: Float[np.ndarray, "6 3"]) -> None:
        """Takes in one frame, dt after the last one.

        Args:
            memory: of this person; changed.
            observation: the window that ends with this frame.
            measured: (6, 3) the frame as measured [m], NaN where it was not.
        """
        ...


def forecast_with(
    method: Method,
    memory: Any,
    observation: Observation,
    rng: np.random.Generator,
    samples: int,
    scene: Scene | None,
) -> Forecast:
    """The forecast of any method, with what it remembers of the person; None where it remembers nothing."""
    if memory is None:
        return method.forecast(observation, rng, samples, scene)
    return method.forecast(observation, rng, samples, scene, memory)  # type: ignore[call-arg]


@njit(cache=True)
@no_type_check
def joint_covariances(samples: Float[np.ndarray, "S T 6 3"]) -> Float[np.ndarray, "T 6 3 3"]:
    """(T, 6, 3, 3) covariance of each joint's position at each step [m^2]."""
    draws, steps, joints, _ = samples.shape
    means = np.zeros((steps, joints, 3))
    for s in range(draws):
        means += samples[s]
    means /= draws
    covariances = np.zeros((steps, joints, 3, 3))
    for s in range(draws):
        for t in range(steps):
            for j in range(joints):
                x = samples[s, t, j, 0] - means[t, j, 0]
                y = samples[s, t, j, 1] - means[t, j, 1]
                z = samples[s, t, j, 2] - means[t, j, 2]
                c = covariances[t, j]
                c[0, 0] += x * x
                c[0, 1] += x * y
                c[0, 2] += x * z
                c[1, 1] += y * y
                c[1, 2] += y * z
                c[2, 2] += z * z
    covariances /= draws
    covariances[..., 1, 0], covariances[..., 2, 0] = covariances[..., 0, 1], covariances[..., 0, 2]
    covariances[..., 2, 1] = covariances[..., 1, 2]
    return covariances


@dataclass(frozen=True)
class WorldDensity:
    """A density stated in the torso frame, asked in the world; a rigid motion leaves its value as it is."""

    observation: Observation
    density: Density

    def log_prob(self, positions: Float[np.ndarray, "T 6 3"]) -> Float[np.ndarray, " T"]:
        """(T,) log density [nats per m^18]; NaN where a joint is NaN."""
        return self.density.log_prob(self.observation.to_torso(positions))


def within_scene(forecast: Forecast, observation: Observation, rng: np.random.Generator, scene: Scene) -> Forecast:
    """Eq. 7: motions that enter an obstacle are rejected; those left are drawn up to the same number again.

    A motion leaves the set at the step where a joint or limb enters an obstacle and does not come back.
    """
    steps = forecast.samples.shape[1]
    alive = steps_alive(scene.free(forecast.samples, observation.times(steps)))
    survivors = np.flatnonzero(alive == steps)
    accepted = np.cumsum(np.bincount(alive, minlength=steps + 1)[:0:-1])[::-1] / len(alive)
    if len(survivors) == 0:
        return replace(forecast, accepted=accepted, distinct=0)
    if len(survivors) == len(alive):
        return forecast
    # Systematic resampling: every survivor is kept equally often, to within one.
    offsets = (np.arange(len(alive)) + rng.random()) * len(survivors) / len(alive)
    samples = forecast.samples[survivors[offsets.astype(int)]]
    return replace(forecast, samples=samples, mean=samples.mean(axis=0), accepted=accepted, distinct=len(survivors))


@njit(cache=True)
@no_type_check
def steps_alive(free: Bool[np.ndarray, "S T"]) -> Int[np.ndarray, " S"]:
    """(S,) steps that each motion takes before the first at which it is not free."""
    alive = np.empty(len(free), dtype=np.int64)
    for s in range(len(free)):
        t = 0
        while t < free.shape[1] and free[s, t]:
            t += 1
        alive[s] = t
    return alive
