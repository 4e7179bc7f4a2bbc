"""Which of a scene's goals a hand is heading for, and where it is if so: a mixture around any joint Gaussian.

For each hand the hypotheses are the goals, each with several times left until arrival, and "none of them". Their
probabilities are updated frame by frame (Bayes with stabilised forgetting, R. Kulhavy and M. B. Zarrop, 1993): every
frame's way towards a goal speaks for it, as in A. D. Dragan and S. S. Srinivasa, 2013, and what spoke long ago is
forgotten, so that a person may change their mind; where the forecast without goals ends speaks for what lies there.

Given a goal and a time left, the wrist is expected on the minimum-jerk path from its present place and velocity
(T. Flash and N. Hogan, 1985). That is an observation with noise of the base forecast, a Gaussian over all joints and
steps; conditioned on it, elbow and shoulder follow. All of it happens in the coordinates of the Gaussian's factor: a
component is a shift of them, and one share of their spread. Each component is thus exactly a Gaussian, samples are
drawn from their mixture, and its density is exact.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from jaxtyping import Float, Int

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.geometry.regions import Regions
from kinecast.geometry.scene import NO_GOAL
from kinecast.prediction.linear import slope_weights
from kinecast.prediction.observation import Observation

HANDS = ("left", "right")
WRISTS = [ARM_JOINTS.index(f"{hand}_wrist") for hand in HANDS]

PATH = 0.5
"""So much of a wrist's path is looked at [s]."""
FORGET = 0.1
"""What spoke for a goal counts half after this time [s]."""
PROGRESS, AWAY, KNOWN = 46.0, 27.0, 3.2
"""log odds of a goal: per metre that the hand came nearer, less per metre between it and where the forecast ends, plus
a constant shared by all goals. Fitted by maximum likelihood on generated people (decision 0014)."""
TIMES = (0.15, 0.3, 0.45, 0.65, 0.9)
"""Times left until arrival [s]."""
TEMPER = 0.2
"""Share of the evidence for a time left that counts: the forecast's errors at its steps are not independent."""
DOUBT = 0.5
"""Variance of the wrist about the minimum-jerk path, over that of the base forecast."""
NARROWED = float(np.sqrt(DOUBT / (1.0 + DOUBT)))
"""What that observation leaves of the base forecast's spread."""
CORE = 0.3
"""Hands arrive within this share of a region about its centre, on the side they come from."""
PINS = 3
"""Steps at which the path is an observation."""
NUGGET = 1e-12
"""Added to the wrists' covariance, over its trace, where the base forecast ties steps together without remainder."""
LEAST = 0.01
"""Components less likely than this, beside the likeliest one, are left out."""
CHANGE = 0.03
"""Share of hands that are about to do something else, with every hypothesis as likely as any other."""
VELOCITY = 4
"""Frames that the wrist's velocity is fitted to, a parabola in time."""

Path: TypeAlias = Float[np.ndarray, "K 2 3"]
Scales: TypeAlias = tuple[Float[np.ndarray, " F"], Float[np.ndarray, " F"]]


@dataclass(frozen=True)
class GoalMixture:
    """The mixture over goals, in the coordinates z of a Gaussian mean + factor · z.

    Attributes:
        goals: per hand, name → probability, "none" among them.
        weights: (C,) of the components.
        shifts: (R, C) mean of z in each.
        spaces: (R, Q) orthonormal directions in which z is narrowed, by kind.
        kind: (C,) rising: which hands have a goal in each component: none 0, left 1, right 2, both 3.
    """

    goals: Mapping[str, Mapping[str, float]]
    weights: Float[np.ndarray, " C"]
    shifts: Float[np.ndarray, "R C"]
    spaces: Mapping[int, Float[np.ndarray, "R Q"]] = field(default_factory=dict)
    kind: Int[np.ndarray, " C"] = field(default_factory=lambda: np.zeros(1, dtype=int))

    def move(self, draws: Float[np.ndarray, "R S"], rng: np.random.Generator) -> None:
        """Makes draws of the base forecast, in random order, draws from the mixture: each component by its weight."""
        count = draws.shape[1]
        ends = np.ceil(np.cumsum(self.weights) * count - rng.random()).astype(int)
        ends[-1] = count
        starts = np.concatenate([[0], ends[:-1]])
        for kind, space in self.spaces.items():
            own = np.flatnonzero(self.kind == kind)
            part = draws[:, starts[own[0]] : ends[own[-1]]]
            part -= (1.0 - NARROWED) * (space @ (space.T @ part))
        for start, end, shift in zip(starts, ends, self.shifts.T, strict=True):
            draws[:, start:end] += shift[:, None]

    def mean(self, factor: Float[np.ndarray, "T 6 3 R"]) -> Float[np.ndarray, "T 6 3"]:
        """(T, 6, 3) by which the mixture's mean differs from that of the base forecast [m]."""
        return factor @ (self.shifts @ self.weights)

    def factor(self, factor: Float[np.ndarray, "T 6 3 R"], kind: int) -> Float[np.ndarray, "T 6 3 R"]:
        """(T, 6, 3, R) of the covariance of components of a kind [m]."""
        if kind == 0:
            return factor
        space = self.spaces[kind]
        return factor - (1.0 - NARROWED) * (factor @ space) @ space.T


def goal_probabilities(
    regions: Regions, path: Path, end: Float[np.ndarray, "2 3"], dt: float
) -> Float[np.ndarray, "2 G1"]:
    """(2, G + 1) probability that each hand heads for each of G > 0 goals; the last for none.

    `path` is where the wrists were, dt [s] apart, the newest last, `end` where the base forecast ends [m].
    """
    away = np.sqrt(((path[:, :, None] - regions.centers) ** 2).sum(axis=-1))
    age = np.arange(len(path) - 2, -1, -1)
    kept = 0.5 ** (age * dt / FORGET)
    spoken = PROGRESS * np.tensordot(kept, away[:-1] - away[1:], axes=1)
    odds = np.zeros((2, len(regions.names) + 1))
    odds[:, :-1] = KNOWN - np.log(len(regions.names)) + spoken - AWAY * regions.distance(end)
    odds = np.exp(odds - odds.max(axis=1, keepdims=True))
    return (1.0 - CHANGE) * odds / odds.sum(axis=1, keepdims=True) + CHANGE / odds.shape[1]


def goal_mixture(
    regions: Regions,
    observation: Observation,
    path: Path,
    mean: Float[np.ndarray, "T 6 3"],
    factor: Float[np.ndarray, "T 6 3 R"],
    scales: Scales,
) -> GoalMixture:
    """The mixture over G > 0 goals around a base forecast: its mean and factor in the torso frame [m], its common
    factors and their weights. `path` is where the wrists were, the newest last, world [m].
    """
    end = observation.to_world(mean[-1, WRISTS])
    chances = goal_probabilities(regions, path, end, observation.dt)
    names = (*regions.names, NO_GOAL)
    goals = {hand: dict(zip(names, map(float, row), strict=True)) for hand, row in zip(HANDS, chances, strict=True)}

    steps = len(mean)
    pins = np.unique(np.ceil(np.arange(1, PINS + 1) * steps / PINS).astype(int)) - 1
    wanted = _paths(regions.within(end, CORE), observation, pins)
    seen = factor[pins][:, WRISTS].transpose(1, 0, 2, 3).reshape(2, 3 * len(pins), -1)
    missing = observation.to_torso(wanted) - mean[pins][:, WRISTS].transpose(1, 0, 2)[:, None, None]
    missing = missing.reshape(2, len(regions.names) * len(TIMES), -1)

    both = seen.reshape(-1, seen.shape[2])
    gram = both @ both.T
    gram += NUGGET * np.trace(gram) * np.eye(len(gram))
    size = seen.shape[1]
    halves = [_space(both[part], gram[part, part]) for part in (slice(0, size), slice(size, None))]
    solved = [missing[hand] @ halves[hand][1] for hand in (0, 1)]
    pairs = np.outer(*(_hypotheses(chances[hand], solved[hand], scales) for hand in (0, 1)))
    left, right = np.nonzero(pairs >= LEAST * pairs.max())
    order = np.argsort((left > 0) + 2 * (right > 0), kind="stable")
    left, right = left[order], right[order]
    kind, weights = (left > 0) + 2 * (right > 0), pairs[left, right]
    spaces, shifts = {}, np.zeros((both.shape[1], len(weights)))
    for which in np.unique(kind[kind > 0]).tolist():
        own = kind == which
        if which == 3:
            spaces[which], triangle = _space(both, gram)
            white = np.concatenate([missing[0][left[own] - 1], missing[1][right[own] - 1]], axis=1) @ triangle
        else:
            spaces[which] = halves[which - 1][0]
            white = solved[which - 1][(left, right)[which - 1][own] - 1]
        shifts[:, own] = spaces[which] @ white.T
    return GoalMixture(goals, weights / weights.sum(), shifts / (1.0 + DOUBT), spaces, kind)


def _space(
    seen: Float[np.ndarray, "Q R"], gram: Float[np.ndarray, "Q Q"]
) -> tuple[Float[np.ndarray, "R Q"], Float[np.ndarray, "Q Q"]]:
    """Orthonormal directions of z that what is seen depends on, and the triangle with seenᵀ · triangle = directions."""
    triangle = np.linalg.inv(np.linalg.cholesky(gram)).T
    return seen.T @ triangle, triangle


def _paths(
    goals: Float[np.ndarray, "2 G 3"], observation: Observation, pins: Int[np.ndarray, " P"]
) -> Float[np.ndarray, "2 G L P 3"]:
    """Minimum-jerk paths of both wrists to each goal for each time left, at some steps; at rest there afterwards."""
    wrists = observation.positions[:, WRISTS]
    count = min(VELOCITY, len(wrists))
    slope = slope_weights(count, min(2, count - 1))
    velocity = np.tensordot(slope, wrists[-len(slope) :], axes=1) / observation.dt
    left = np.array(TIMES)[:, None]
    u = np.clip(observation.dt * (pins + 1) / left, 0.0, 1.0)
    way = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    drift = left * (u - 6.0 * u**3 + 8.0 * u**4 - 3.0 * u**5)
    now = wrists[-1][:, None, None, None]
    return now + way[..., None] * (goals[:, :, None, None] - now) + drift[..., None] * velocity[:, None, None, None]


def _hypotheses(
    chance: Float[np.ndarray, " G1"], solved: Float[np.ndarray, "H Q"], scales: Scales
) -> Float[np.ndarray, " H1"]:
    """(1 + H,) probabilities of one hand: none first, then each goal with each time left."""
    factors, weights = scales
    square = (solved**2).sum(axis=1) / (1.0 + DOUBT)
    parts = np.log(np.maximum(weights, 1e-300)) - solved.shape[1] * np.log(factors) - 0.5 * square[:, None] / factors**2
    evidence = np.logaddexp.reduce(parts, axis=1).reshape(len(chance) - 1, -1)
    times = np.exp(TEMPER * (evidence - evidence.max(axis=1, keepdims=True)))
    times /= times.sum(axis=1, keepdims=True)
    result = np.concatenate([chance[-1:], (chance[:-1, None] * times).ravel()])
    result[result < LEAST * result.max()] = 0.0
    return result / result.sum()
