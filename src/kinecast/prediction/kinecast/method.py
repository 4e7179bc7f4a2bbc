"""`kinecast`: the project's own predictor. Positions are predicted, angles constrained.

Experts, trivial and learned, forecast all steps at once; a gate mixes them by what each one got wrong lately on the
person in view; a guard hands over to the trivial ones where learning does not help (mean). The spread around that mean
depends on the window and on how well things went lately. Samples are whole motions drawn from it, moved inside joint
limits and speeds by the exact inverse kinematics, and rejected by the scene.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from kinecast.body.limits import JointLimits
from kinecast.body.posture import postures_from_points
from kinecast.geometry.scene import Scene
from kinecast.prediction.allowance import Allowance
from kinecast.prediction.draws import normals
from kinecast.prediction.forecast import Forecast, WorldDensity, within_scene
from kinecast.prediction.goals import PATH, WRISTS, Pursuit, pursue
from kinecast.prediction.kinecast.actions import Actions, actions_from_arrays
from kinecast.prediction.kinecast.calibration import LEVEL, AdaptiveScale
from kinecast.prediction.kinecast.density import GoalMixtureDensity, ScaleMixtureDensity
from kinecast.prediction.kinecast.features import arm_views, yaw_frame
from kinecast.prediction.kinecast.gate import (
    TRIVIAL,
    Gate,
    GateInputs,
    gate_inputs,
    gate_memory,
    guard,
    guard_memory,
    trivial_experts,
)
from kinecast.prediction.kinecast.learned import Expert, expert_from_arrays, forecast
from kinecast.prediction.kinecast.memory import DueErrors
from kinecast.prediction.kinecast.spread import SCALES, Spread, mixture_radius, spread_features
from kinecast.prediction.motions import draw_motions
from kinecast.prediction.observation import Observation
from kinecast.types import Density

__all__ = ["Horizon", "Means", "Memory", "Mixture", "horizon_from_arrays"]

MEAN_LEADS, MEAN_HALF_LIVES = (3, 10), (10.0,)
LONGEST_PAUSE = 20
"""After a longer gap [frames] nothing of the person is remembered."""


@dataclass
class Memory:
    """What is remembered of one person: what was predicted before, and the mean and scale of the newest prediction."""

    gate: DueErrors
    guard: DueErrors
    mean: DueErrors
    adaptive: AdaptiveScale | None = None
    current: Means | None = None
    scale: Float[np.ndarray, "T 6"] | None = None
    stamp: float = -np.inf
    path: deque[Float[np.ndarray, "2 3"]] = field(default_factory=deque)
    actions: DueErrors | None = None

    def skip(self, frames: int) -> None:
        """Frames of which nothing is known."""
        nothing = np.full((6, 3), np.nan)
        for _ in range(frames):
            for errors in (self.gate, self.guard, self.mean, self.actions):
                if errors is not None:
                    errors.observe(nothing)
                    errors.predicted(None)
            if self.adaptive is not None:
                self.adaptive.skip()


@dataclass(frozen=True)
class Means:
    """The mixture's mean and what it came from.

    Attributes:
        mean: (T, 6, 3) world [m].
        forecasts: (E, T, 6, 3) of each expert, world [m].
        inputs: of the gate.
        features: (6, F) of the spread.
        learned: weight of the learned experts in the mean, averaged over steps and joints.
        actions: share of each action's own model in the mean.
    """

    mean: Float[np.ndarray, "T 6 3"]
    forecasts: Float[np.ndarray, "E T 6 3"]
    inputs: GateInputs
    features: Float[np.ndarray, "6 F"]
    learned: float
    actions: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Mixture:
    """Experts, gate and guard: the mean.

    Attributes:
        experts: the learned ones.
        gate: None while it is being trained; experts then count alike.
        frames, steps: N and T.
        guarded: whether the trivial experts may take over.
        actions: models of single actions, or None.
    """

    experts: Sequence[Expert]
    gate: Gate | None
    frames: int
    steps: int
    guarded: bool = True
    actions: Actions | None = None

    def memory(self) -> Memory:
        """Nothing remembered yet."""
        steps = self.steps
        leads = tuple(min(lead, steps) for lead in MEAN_LEADS)
        return Memory(
            gate_memory(TRIVIAL + len(self.experts), steps),
            guard_memory(steps),
            DueErrors(1, leads, MEAN_HALF_LIVES),
            actions=None if self.actions is None else self.actions.memory(steps),
        )

    def forecasts(self, windows: Float[np.ndarray, "W N 6 3"]) -> Float[np.ndarray, "W E T 6 3"]:
        """What every expert forecasts, trivial ones first [m]."""
        trivial = np.tensordot(windows, trivial_experts(self.frames, self.steps), axes=(1, 2))
        views = arm_views(windows)
        learned = [forecast(expert, views, self.steps)[:, None] for expert in self.experts]
        return np.concatenate([trivial.transpose(0, 3, 4, 1, 2), *learned], axis=1)

    def follow(
        self,
        memory: Memory,
        window: Float[np.ndarray, "N 6 3"],
        measured: Float[np.ndarray, "6 3"],
        forecasts: Float[np.ndarray, "E T 6 3"] | None = None,
    ) -> Means:
        """Learns from the newest frame how the experts did, and mixes them anew.

        Args:
            memory: of this person; changed.
            window: (N, 6, 3) repaired window, world [m].
            measured: (6, 3) the newest frame as measured [m], NaN where it was not.
            forecasts: of the experts, where they are known already.
        """
        for errors in (memory.gate, memory.guard, memory.mean):
            errors.observe(measured)
        made = self.forecasts(window[None])[0] if forecasts is None else forecasts
        inputs = gate_inputs(memory.gate.mean(), window, made)
        if self.gate is None:
            weights = np.full((len(made), self.steps, 6), 1.0 / len(made))
        else:
            weights = self.gate.weights(inputs, self.steps)
        mixed = np.einsum("etj,etjd->tjd", weights, made)
        rivals = np.concatenate([mixed[None], made[:TRIVIAL]])
        trust = guard(memory.guard.mean(), memory.guard.frames)
        if not self.guarded:
            trust = np.zeros_like(trust)
            trust[0] = 1.0
        mean = np.einsum("ej,etjd->tjd", trust, rivals)
        actions: dict[str, float] = {}
        if self.actions is not None and memory.actions is not None:
            mean, actions = self.actions.follow(memory.actions, window, measured, mean)
        features = spread_features(window, made, mean, inputs, memory.mean.mean()[0, :, :, 0])
        memory.gate.predicted(made)
        memory.guard.predicted(rivals)
        memory.mean.predicted(mean[None])
        learned = float((trust[0] * weights[TRIVIAL:].sum(axis=0).mean(axis=0)).mean())
        memory.current = Means(mean, made, inputs, features, learned, actions)
        return memory.current


@dataclass(frozen=True)
class Horizon:
    """The method `kinecast`.

    Attributes:
        mixture: the mean.
        spread: around it.
        dt: time between frames [s].
        noise: spread of a measured joint about the true one in training [m].
        limits: range and speed of the arm's angles; None for none.
        adaptive: whether the spread follows the person in view.
        following: whether anything does; without it every window is a stranger's.
    """

    mixture: Mixture
    spread: Spread
    dt: float
    noise: float
    limits: JointLimits | None = field(default_factory=JointLimits)
    adaptive: bool = True
    following: bool = True

    @property
    def frames(self) -> int:
        """N, length of the observation window."""
        return self.mixture.frames

    @property
    def steps(self) -> int:
        """T, number of predicted steps."""
        return self.mixture.steps

    def memory(self) -> Memory:
        """Nothing remembered yet of a person."""
        memory = self.mixture.memory()
        if self.adaptive:
            memory.adaptive = AdaptiveScale(self.steps, self._radius)
        return memory

    @cached_property
    def _radius(self) -> float:
        return mixture_radius(self.spread.weights, LEVEL)

    def follow(self, memory: Memory, observation: Observation, measured: Float[np.ndarray, "6 3"]) -> None:
        """Takes in one frame; call it once a frame, dt apart, whether or not a forecast is wanted.

        Args:
            memory: of this person; changed.
            observation: the window that ends with this frame.
            measured: (6, 3) the frame as measured [m], NaN where it was not.
        """
        if not self.following:
            memory.__dict__.update(self.memory().__dict__)
        pause = round((observation.stamp - memory.stamp) / self.dt) - 1 if np.isfinite(memory.stamp) else 0
        if 0 < pause <= LONGEST_PAUSE:
            memory.skip(pause)
        elif pause != 0:
            memory.__dict__.update(self.memory().__dict__)
        if memory.adaptive is not None:
            memory.adaptive.observe(measured)
        means = self.mixture.follow(memory, observation.positions, measured)
        memory.stamp = observation.stamp
        memory.scale = self.spread.scale(means.features, observation.positions)
        memory.path.extend(observation.positions[-1 if memory.path else 0 :, WRISTS])
        while len(memory.path) > PATH / self.dt + 1:
            memory.path.popleft()
        if memory.adaptive is not None:
            rotation = yaw_frame(observation.positions[-1])
            memory.adaptive.predicted(means.mean, self.spread.whiteners(memory.scale, rotation))

    def forecast(
        self,
        observation: Observation,
        rng: np.random.Generator,
        samples: int,
        scene: Scene | None = None,
        memory: Memory | None = None,
    ) -> Forecast:
        """See kinecast.prediction.forecast.Method.

        Args:
            memory: of this person, having followed this observation; None for a person never seen before.
        """
        if memory is None or memory.current is None:
            memory = self.memory()
            self.follow(memory, observation, observation.positions[-1])
        means, scale = memory.current, memory.scale
        assert means is not None
        assert scale is not None
        torso, _ = observation.frame
        if memory.adaptive is not None:
            scale = scale * memory.adaptive.factor[:, None]
        maps = self.spread.matrices(scale, torso.T @ yaw_frame(observation.positions[-1]))
        factor = maps @ self.spread.factor
        if observation.noise.any():
            shared = np.zeros((self.steps, 6, 3, 18))
            shared.reshape(self.steps, 18, 18)[:, np.arange(18), np.arange(18)] = np.repeat(observation.noise, 3)
            factor = np.concatenate([factor, shared], axis=-1)
        mean = observation.to_torso(means.mean)
        draws = normals(rng, factor.shape[-1], samples)
        common = common_factors(self.spread.weights, samples, rng)
        pursuit = self._pursuit(scene, observation, memory, mean, factor)
        if pursuit is None:
            draws *= common
        else:
            draws *= rng.permutation(common)
            pursuit.move(draws, rng)
        initial = postures_from_points(observation.points, continuous=True)[-1]
        motions = draw_motions(mean, factor, draws, rng, initial, self.limits, self.dt, *observation.frame)
        allowance = None
        if self.limits is not None:
            allowance = Allowance(
                lambda: mean + np.tensordot(draws, factor, axes=(0, 3)),
                observation,
                initial,
                self.limits,
                scene,
                self.noise,
            )
        density: Density = ScaleMixtureDensity(mean, factor, self.spread.weights, allowance)
        expected = means.mean
        if pursuit is not None:
            density = GoalMixtureDensity(mean, factor, self.spread.weights, pursuit, allowance)
            expected = expected + pursuit.mean(factor) @ observation.frame[0].T
        forecast = Forecast(
            motions,
            expected,
            WorldDensity(observation, density),
            np.ones(self.steps),
            samples,
            {"learned_share": means.learned} | {f"action {name}": share for name, share in means.actions.items()},
            {} if pursuit is None else pursuit.goals,
        )
        if self.limits is None or scene is None:
            return forecast
        # The samples' own mean is noisy; only what the scene moved is taken from it.
        before = motions.mean(axis=0)
        kept = within_scene(replace(forecast, mean=before), observation, rng, scene)
        return replace(kept, mean=expected + (kept.mean - before))

    def _pursuit(
        self,
        scene: Scene | None,
        observation: Observation,
        memory: Memory,
        mean: Float[np.ndarray, "T 6 3"],
        factor: Float[np.ndarray, "T 6 3 R"],
    ) -> Pursuit | None:
        """The mixture over the scene's goals; None where it has none."""
        if scene is None or not scene.goals:
            return None
        return pursue(scene.regions, observation, np.array(memory.path), mean, factor, (SCALES, self.spread.weights))

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Plain arrays for a checkpoint."""
        assert self.mixture.gate is not None
        arrays = {f"gate.{name}": array for name, array in self.mixture.gate.to_arrays().items()}
        arrays |= {f"spread.{name}": array for name, array in self.spread.to_arrays().items()}
        for k, expert in enumerate(self.mixture.experts):
            arrays |= {f"expert{k}.{name}": array for name, array in expert.to_arrays().items()}
        return arrays if self.mixture.actions is None else arrays | self.mixture.actions.to_arrays()


def common_factors(weights: Float[np.ndarray, " K"], samples: int, rng: np.random.Generator) -> Float[np.ndarray, " S"]:
    """(S,) draws of the common factor: as near to its weights as S allows."""
    places = (np.arange(samples) + rng.random()) / samples
    return SCALES[np.minimum(np.searchsorted(np.cumsum(weights), places), len(SCALES) - 1)]


def horizon_from_arrays(
    arrays: Mapping[str, np.ndarray], frames: int, steps: int, dt: float, noise: float, limits: JointLimits | None
) -> Horizon:
    """The method that `Horizon.to_arrays` described.

    Raises:
        KeyError: an array is missing.
    """
    parts: dict[str, dict[str, np.ndarray]] = {}
    for name, array in arrays.items():
        owner, _, own = name.partition(".")
        parts.setdefault(owner, {})[own] = np.asarray(array, float)
    experts = [expert_from_arrays(parts[f"expert{k}"]) for k in range(sum(name.startswith("expert") for name in parts))]
    gate = Gate(**{f.name: parts["gate"][f.name] for f in fields(Gate)})
    spread = Spread(**{f.name: parts["spread"][f.name] for f in fields(Spread)})
    if gate.bias.shape[0] != TRIVIAL + len(experts) or spread.factor.shape[0] != steps:
        raise ValueError(f"{len(experts)} experts, {spread.factor.shape[0]} steps")
    actions = actions_from_arrays(parts, frames, steps)
    return Horizon(Mixture(experts, gate, frames, steps, actions=actions), spread, dt, noise, limits)
