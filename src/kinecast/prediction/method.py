"""What every method of prediction offers, what it gives for one window, and where the scene rejects."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, is_dataclass, replace
from typing import Any, Protocol, TypeVar, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Float
from numba import njit

from kinecast.errors import OptionError
from kinecast.geometry.scene import Scene
from kinecast.prediction.density import PoseDensity
from kinecast.prediction.observation import Observation
from kinecast.types import Density

__all__ = ["Forecast", "Memoryless", "Method", "forecast_in_scene", "joint_covariances", "shortened"]

State = TypeVar("State")
M = TypeVar("M", bound="Method[Any]")


@dataclass(frozen=True)
class Forecast:
    """A distribution over the motion of both arms, in the world.

    Attributes:
        samples: (S, T, 6, 3) equally likely motions [m].
        mean: (T, 6, 3) expected positions [m].
        density: the exact density at each step.
        constrained: whether joint limits hold the samples; only then does the scene reject some of them.
        diagnostics: what else the method says of itself, e.g. `skill`.
        goals: per hand, the probability of each goal of the scene; empty where none were given.
        accepted: (T,) share of motions that no obstacle had stopped by each step; None where nothing rejected any.
        distinct: number of distinct motions among the samples; None for all of them.
    """

    samples: Float[np.ndarray, "S T 6 3"]
    mean: Float[np.ndarray, "T 6 3"]
    density: Density
    constrained: bool = False
    diagnostics: Mapping[str, float] = field(default_factory=dict)
    goals: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    accepted: Float[np.ndarray, " T"] | None = None
    distinct: int | None = None

    @property
    def accepted_fraction(self) -> float:
        """Share of drawn motions that the scene left."""
        return 1.0 if self.accepted is None else float(self.accepted[-1])

    @property
    def effective_sample_size(self) -> int:
        """Number of distinct motions; 0 where the scene left none, and the samples then disregard it."""
        return len(self.samples) if self.distinct is None else self.distinct


@runtime_checkable
class Method(Protocol[State]):
    """A trained predictor of both arms; what it remembers of a person is a state, which `update` changes."""

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

    def init_state(self) -> State:
        """Nothing remembered yet of a person."""
        ...

    def update(self, state: State, observation: Observation, measured: Float[np.ndarray, "6 3"]) -> State:
        """Takes in one frame, dt after the last one.

        Args:
            state: of this person; used up.
            observation: the window that ends with this frame.
            measured: (6, 3) the frame as measured [m], NaN where it was not.

        Returns:
            The state after this frame.
        """
        ...

    def forecast(self, state: State, observation: Observation, rng: np.random.Generator, samples: int) -> Forecast:
        """The distribution over the next T steps.

        Args:
            state: of this person; one that has not been updated yet stands for a stranger.
            observation: the window, N frames.
            rng: source of randomness; equal states give equal forecasts.
            samples: S, number of motions to draw.
        """
        ...

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Everything the method needs, as plain arrays."""
        ...


def shortened(method: M, horizon: float) -> M:
    """The same method, predicting only so far [s]: what it says of those steps does not change.

    Raises:
        OptionError: it predicts less far, or is not one of kinecast's own, which alone are known to bear that.
    """
    steps = round(horizon / method.dt) if math.isfinite(horizon) else 0
    if steps == method.steps:
        return method
    if not 1 <= steps < method.steps:
        raise OptionError(f"horizon {horizon:g} s is outside {method.dt:.3g}..{method.steps * method.dt:.3g} s")
    if not (is_dataclass(method) and type(method).__module__.startswith(__package__)):
        raise OptionError(f"horizon {horizon:g} s: this method predicts {method.steps * method.dt:.3g} s, no less")
    return replace(method, steps=steps)


class Memoryless:
    """Base of methods that remember nothing of a person: their state is None."""

    def init_state(self) -> None:
        """Nothing."""

    def update(self, state: None, observation: Observation, measured: Float[np.ndarray, "6 3"]) -> None:
        """Nothing is remembered."""


def forecast_in_scene(
    method: Method[State],
    state: State,
    observation: Observation,
    rng: np.random.Generator,
    samples: int,
    scene: Scene | None,
) -> Forecast:
    """A method's forecast, of which the scene rejects what enters an obstacle (Eq. 7).

    A motion leaves the set at the step where a joint or limb enters an obstacle and does not come back. Those left are
    drawn up to the same number again; the mean moves as theirs does.

    Args:
        method, state, observation, rng, samples: see `Method.forecast`.
        scene: obstacles; None for none. Its goals are seen by the method.
    """
    if scene is None:
        return method.forecast(state, observation, rng, samples)
    if scene.goals:
        observation = replace(observation, goals=scene.regions)
    forecast = method.forecast(state, observation, rng, samples)
    if not forecast.constrained:
        return forecast
    density = forecast.density
    if isinstance(density, PoseDensity):
        forecast = replace(forecast, density=density.within(scene))
    drawn, steps = forecast.samples.shape[:2]
    free = np.logical_and.accumulate(scene.free(forecast.samples, observation.times(steps)), axis=1)
    survivors = np.flatnonzero(free[:, -1])
    if len(survivors) == drawn:
        return forecast
    accepted = free.mean(axis=0)
    if len(survivors) == 0:
        return replace(forecast, accepted=accepted, distinct=0)
    # Systematic resampling: every survivor is kept equally often, to within one.
    offsets = (np.arange(drawn) + rng.random()) * len(survivors) / drawn
    kept = survivors[offsets.astype(int)]
    gained = np.bincount(kept, minlength=drawn) - 1.0
    mean = forecast.mean + (gained @ forecast.samples.reshape(drawn, -1)).reshape(steps, 6, 3) / drawn
    return replace(forecast, samples=forecast.samples[kept], mean=mean, accepted=accepted, distinct=len(survivors))


def joint_covariances(samples: Float[np.ndarray, "S T 6 3"]) -> Float[np.ndarray, "T 6 3 3"]:
    """(T, 6, 3, 3) covariance of each joint's position at each step [m^2]."""
    count, steps = samples.shape[:2]
    flat = samples.reshape(count, -1)
    own, next_, last = _lagged_products(flat, flat.mean(axis=0)).reshape(3, steps, 6, 3) / count
    xx, yy, zz = np.moveaxis(own, -1, 0)
    xy, yz, xz = next_[..., 0], next_[..., 1], last[..., 0]
    return np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=-1).reshape(steps, 6, 3, 3)


@njit(cache=True, nogil=True)
@no_type_check
def _lagged_products(rows: Float[np.ndarray, "S K"], mean: Float[np.ndarray, " K"]) -> Float[np.ndarray, "3 K"]:
    """Sums over rows of each departure from the mean times itself, the next, and the next but one."""
    size = len(mean)
    out, departure = np.zeros((3, size)), np.zeros(size + 2)
    for s in range(len(rows)):
        for k in range(size):
            departure[k] = rows[s, k] - mean[k]
        for lag in range(3):
            for k in range(size):
                out[lag, k] += departure[k] * departure[k + lag]
    return out
