"""`kinecast`: the project's own predictor. Positions are predicted, angles constrained.

Experts, trivial and learned, forecast all steps at once; a gate mixes them by what each one got wrong lately on the
person in view, and a regression learns what that mixture leaves over on them. The spread around that mean depends on
the window and on how well things went lately. Samples are whole motions drawn from it and held inside joint limits and
speeds by the exact inverse kinematics.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from kinecast.body.limits import JointLimits
from kinecast.prediction.density import Blocks, ConstraintFactor, GaussianMixture, PoseDensity
from kinecast.prediction.goals import PATH, WRISTS, GoalMixture, goal_mixture
from kinecast.prediction.kinecast.error_model import SCALES, AdaptiveScale, ErrorModel, error_features
from kinecast.prediction.kinecast.experts import (
    TRIVIAL,
    FeatureScale,
    Networks,
    PersonView,
    WindowMotion,
    forecasts,
    yaw_frame,
)
from kinecast.prediction.kinecast.weights import (
    Gate,
    GateInputs,
    OnlineRegression,
    corrected_share,
    gate_inputs,
    rolling_errors,
    skill,
)
from kinecast.prediction.method import Forecast
from kinecast.prediction.model_file import ModelCard
from kinecast.prediction.observation import Observation
from kinecast.prediction.sampling import sample_motions

GENERAL = 2
"""Networks that know all collections: as they are, and as poor sensors would give them."""
LONGEST_PAUSE = 20
"""After a longer gap [frames] nothing of the person is remembered."""
RECENT_LEADS = [1, 3]
"""Of the leads of the rolling errors, those by which the spread goes."""
FLOOR = 5e-4
"""Least spread of a joint [m], for directions that the low-rank factor leaves out."""

Motion: TypeAlias = Float[np.ndarray, "T 6 3"]
Motions: TypeAlias = Float[np.ndarray, "E T 6 3"]
Factor: TypeAlias = Float[np.ndarray, "T 6 3 R"]


@dataclass(frozen=True)
class MixtureOutput:
    """The mixture's mean and what it came from.

    Attributes:
        mean: (T, 6, 3) world [m].
        forecasts: (E, T, 6, 3) of each expert, world [m].
        inputs: of the gate.
        features: (6, F) of the error model.
        motion: of the window.
        skill: of the mean so far (kinecast.prediction.kinecast.weights.skill).
    """

    mean: Motion
    forecasts: Motions
    inputs: GateInputs
    features: Float[np.ndarray, "6 F"]
    motion: WindowMotion
    skill: float


class OnlineMixture:
    """The mixture of the experts as it follows one person.

    Args:
        gate: None while it is being trained; experts then count alike.
        experts: how many learned ones.
        steps: T.
        regresses: whether what the mixture leaves over is learned too.
    """

    def __init__(self, gate: Gate | None, experts: int, steps: int, regresses: bool) -> None:
        self.errors, self._gate = rolling_errors(experts, steps), gate
        self._regression = OnlineRegression(TRIVIAL + experts, steps) if regresses else None

    def skip(self, frames: int) -> None:
        """Frames of which nothing is known."""
        self.errors.skip(frames)
        if self._regression is not None:
            self._regression.skip(frames)

    def step(
        self, window: Float[np.ndarray, "N 6 3"], measured: Float[np.ndarray, "6 3"], made: Motions, view: PersonView
    ) -> MixtureOutput:
        """Learns from the newest frame how the experts did, and mixes what they make of it.

        Args:
            window: that ends with the frame, world [m].
            measured: the frame [m], NaN where it was not.
            made: (E, T, 6, 3) forecasts of the experts from it [m].
            view: of the window.
        """
        errors, regression = self.errors, self._regression
        errors.observe(measured)
        due, motion = errors.mean(), WindowMotion.of(window)
        inputs = gate_inputs(due, motion, made)
        alike = np.full(made.shape[:3], 1.0 / len(made))
        weights = alike if self._gate is None else self._gate.weights(inputs, made.shape[1])
        mixed = (weights[..., None] * made).sum(axis=0)
        steps_to_mean = [mixed] * 5
        if regression is not None:
            regression.observe(measured)
            corrected = regression.by_experts(mixed, made, window[-1])
            first = mixed + corrected_share(due[-5:-3], errors.frames)[:, None] * (corrected - mixed)
            again = regression.by_window(first, view, window[-1])
            mean = first + corrected_share(due[-3:-1], errors.frames)[:, None] * (again - first)
            steps_to_mean = [mixed, corrected, first, again, mean]
        mean = steps_to_mean[-1]
        features = error_features(window, motion, made, mean, inputs, due[-1, :, RECENT_LEADS, -1].T)
        errors.predicted(np.concatenate([made, steps_to_mean]))
        return MixtureOutput(mean, made, inputs, features, motion, skill(due, errors.frames))


@dataclass
class State:
    """What is remembered of one person, and what is predicted from the newest frame on.

    Attributes:
        mixture: how the experts did.
        adaptive: how the spread has had to grow; None where it does not follow the person.
        output: the newest mean; None before the first frame.
        scale: (T, 6) of the newest error, without the adaptive factor.
        weights: (K,) of its common factors.
        stamp: of the newest frame [s].
        path: where the wrists were, the newest last [m].
    """

    mixture: OnlineMixture
    adaptive: AdaptiveScale | None
    output: MixtureOutput | None = None
    scale: Float[np.ndarray, "T 6"] | None = None
    weights: Float[np.ndarray, " K"] | None = None
    stamp: float = -np.inf
    path: deque[Float[np.ndarray, "2 3"]] = field(default_factory=deque)


@dataclass(frozen=True)
class Kinecast:
    """The method `kinecast`.

    Attributes:
        experts: the learned ones: two that know all collections, then one for each, where there are several.
        gate: mixes them; None for all alike.
        error_model: around their mixture.
        frames, steps, dt: N, T, and time between frames [s]; T may be less than the error model's.
        noise: spread of a measured joint about the true one in training [m].
        limits: range and speed of the arm's angles; None for none.
        regresses: whether what the mixture leaves over is learned on the person in view.
        adaptive: whether the spread follows the person in view.
        remembers: whether anything does; without it every window is a stranger's.
    """

    experts: Networks
    gate: Gate | None
    error_model: ErrorModel
    frames: int
    steps: int
    dt: float
    noise: float
    limits: JointLimits | None = field(default_factory=JointLimits)
    regresses: bool = True
    adaptive: bool = True
    remembers: bool = True

    def init_state(self) -> State:
        """See kinecast.prediction.method.Method."""
        adaptive = AdaptiveScale(self.error_model, self.steps, self.dt) if self.adaptive else None
        return State(OnlineMixture(self.gate, len(self.experts), self.error_model.steps, self.regresses), adaptive)

    def update(self, state: State, observation: Observation, measured: Float[np.ndarray, "6 3"]) -> State:
        """See kinecast.prediction.method.Method."""
        pause = round((observation.stamp - state.stamp) / self.dt) - 1 if np.isfinite(state.stamp) else 0
        if not self.remembers or not 0 <= pause <= LONGEST_PAUSE:
            state = self.init_state()
        else:
            state.mixture.skip(pause)
            if state.adaptive is not None:
                state.adaptive.skip(pause)
        if state.adaptive is not None:
            state.adaptive.observe(measured)
        window = observation.positions
        [made], [view] = forecasts(self.experts, window[None], self.error_model.steps)
        output = state.mixture.step(window, measured, made, view)
        scale, weights = self.error_model.scale(output.features), self.error_model.weights(output.features)
        if state.adaptive is not None:
            near = output.mean[: self.steps], scale[: self.steps]
            state.adaptive.predicted(*near, yaw_frame(window[-1]), weights, output.motion.speed)
        state.path.extend(window[-1 if state.path else 0 :, WRISTS])
        while len(state.path) > PATH / self.dt + 1:
            state.path.popleft()
        state.output, state.scale, state.weights, state.stamp = output, scale, weights, observation.stamp
        return state

    def forecast(self, state: State, observation: Observation, rng: np.random.Generator, samples: int) -> Forecast:
        """See kinecast.prediction.method.Method."""
        if state.output is None or state.scale is None or state.weights is None:
            state = self.update(state, observation, observation.positions[-1])
            return self.forecast(state, observation, rng, samples)
        steps, output, model = self.steps, state.output, self.error_model
        scale, scales = state.scale[:steps], SCALES
        if state.adaptive is not None:
            scale, scales = scale * state.adaptive.factor(output.motion.speed), state.adaptive.scales
        rotation = observation.frame[0].T @ yaw_frame(observation.positions[-1])
        factor = with_noise(model.factor_in(scale, rotation), observation.noise)
        world_mean = output.mean[:steps]
        mean = observation.to_torso(world_mean)
        draws = rng.standard_normal((factor.shape[-1], samples))
        common, goals = common_factors(scales, state.weights, samples, rng), None
        if observation.goals is None:
            draws *= common
        else:
            path, mixture = np.array(state.path), (scales, state.weights)
            goals = goal_mixture(observation.goals, observation, path, mean, factor, mixture)
            draws *= rng.permutation(common)
            goals.move(draws, rng)
            world_mean = world_mean + goals.mean(factor) @ observation.frame[0].T

        def drawn() -> Float[np.ndarray, "S T 6 3"]:
            return mean + np.tensordot(draws, factor, axes=(0, 3))

        constraint = None if self.limits is None else ConstraintFactor(drawn, observation, self.limits, self.noise)
        blocks = MixtureBlocks(mean, factor, model.rough[:steps], scales, state.weights, goals)
        return Forecast(
            sample_motions(observation, mean, factor, draws, self.limits, model.farthest[:steps]),
            world_mean,
            PoseDensity(observation, mean, blocks, constraint),
            self.limits is not None,
            {"skill": output.skill},
            {} if goals is None else goals.goals,
        )

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Plain arrays for a model file."""
        parts = {"gate": self.gate, "spread": self.error_model, "experts": self.experts}
        known = {part: of.to_arrays() for part, of in parts.items() if of is not None}
        return {f"{part}.{name}": array for part, arrays in known.items() for name, array in arrays.items()}


@dataclass(frozen=True)
class MixtureBlocks:
    """The density behind the draws: a scale mixture about the mean, or about each goal's; made once it is asked for.

    Of the spread of each number, `rough` is its own: what is measured is not as smooth as what is drawn.
    """

    mean: Motion
    factor: Factor
    rough: Motion
    scales: Float[np.ndarray, " K"]
    weights: Float[np.ndarray, " K"]
    goals: GoalMixture | None

    def log_blocks(self, poses: Motion) -> Blocks:
        """See kinecast.prediction.density.BlockDensity."""
        return self.mixture.log_blocks(poses)

    @cached_property
    def mixture(self) -> GaussianMixture:
        """Of all 18 coordinates at each step."""
        mean, factor, goals = self.mean, self.factor, self.goals
        spread = np.sqrt((factor**2).sum(axis=-1))
        smooth = factor * np.sqrt(1.0 - self.rough**2)[..., None]
        centres, each, kind, factors = mean[None], np.ones(1), np.zeros(1, dtype=int), smooth[None]
        if goals is not None:
            kinds, kind = np.unique(goals.kind, return_inverse=True)
            factors = np.stack([goals.factor(smooth, one) for one in kinds.tolist()])
            centres, each = mean + np.moveaxis(factor @ goals.shifts, -1, 0), goals.weights
        floor = np.broadcast_to(np.hypot(self.rough * spread, FLOOR), factors.shape[:-1])
        return GaussianMixture.of_positions(
            centres, factors, floor, weights=each, kind=kind, scales=self.scales, scale_weights=self.weights
        )


def with_noise(factor: Factor, noise: Float[np.ndarray, "6"]) -> Float[np.ndarray, "T 6 3 R2"]:
    """The factor once the last frame's error, the same at every step, is added [m]."""
    if not noise.any():
        return factor
    shared = np.diag(np.repeat(noise, 3)).reshape(6, 3, 18)
    return np.concatenate([factor, np.broadcast_to(shared, (len(factor), *shared.shape))], axis=-1)


def common_factors(
    scales: Float[np.ndarray, " K"], weights: Float[np.ndarray, " K"], samples: int, rng: np.random.Generator
) -> Float[np.ndarray, " S"]:
    """(S,) draws of the common factor: as near to its weights as S allows."""
    places = (np.arange(samples) + rng.random()) / samples
    return scales[np.minimum(np.searchsorted(np.cumsum(weights), places), len(scales) - 1)]


def ablations(whole: Kinecast) -> dict[str, Kinecast]:
    """The method without each of its stages in turn, by what is missing."""
    networks = range(len(whole.experts))
    own = {"no networks of one collection": _with_networks(whole, networks[:GENERAL])} if networks[GENERAL:] else {}
    return {
        "no network": _with_networks(whole, []),
        **own,
        "no gate": replace(whole, gate=None),
        "no regression": replace(whole, regresses=False),
        "no memory": replace(whole, remembers=False),
        "no adaptive spread": replace(whole, adaptive=False),
        "no limits, no scene": replace(whole, limits=None),
    }


def _with_networks(whole: Kinecast, which: Sequence[int]) -> Kinecast:
    """The method with some of its networks; the gate keeps what it learned of them."""
    rows, gate = [*range(TRIVIAL), *(TRIVIAL + k for k in which)], whole.gate
    gate = gate and replace(gate, bias=gate.bias[rows], slope=gate.slope[rows])
    return replace(whole, experts=whole.experts.take(which), gate=gate)


def kinecast_from_arrays(arrays: Mapping[str, np.ndarray], card: ModelCard) -> Kinecast:
    """The method that `Kinecast.to_arrays` described; ValueError where arrays are missing or do not fit."""
    experts = Networks.from_arrays(arrays, "experts.", scale=FeatureScale.from_arrays(arrays, "experts.scale."))
    gate, error_model = Gate.from_arrays(arrays, "gate."), ErrorModel.from_arrays(arrays, "spread.")
    if gate.bias.shape[0] != TRIVIAL + len(experts) or error_model.steps != card.steps:
        raise ValueError(f"{len(experts)} experts, {error_model.steps} steps")
    return Kinecast(experts, gate, error_model, card.frames, card.steps, card.dt, card.noise, card.limits)
