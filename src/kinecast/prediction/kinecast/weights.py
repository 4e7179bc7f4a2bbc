"""Who is trusted: weights of the experts, learned in training and moved by each one's errors on the person in view.

The gate mixes all experts, its weights a softmax of what each one got wrong lately and of what the window looks like.
A regression then learns, on this person alone, what the mixture leaves over: first from how the experts differ and from
the way back to where the person mostly is, then from the window itself.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from kinecast.geometry.transforms import lengths
from kinecast.prediction.kinecast.experts import NEWEST, TRIVIAL, PersonView, WindowMotion
from kinecast.prediction.model_file import Arrays

LEADS, HALF_LIVES = (1, 3, 6, 10, 15), (8.0, 40.0, 200.0, 10.0)
"""Steps ahead at which forecasts are judged, and how long that is remembered [frames]."""
LONG_RUN = 2
"""Which of the half-lives correction and skill go by; the gate goes by it and those before it, the error model by the
last."""
REGRESSED, KEPT = (*LEADS, 30), 1000.0
"""Steps ahead at which the regression learns, and half-life of what it learned [frames]."""
PRIORS = (100.0, 300.0)
"""Precision of the prior that nothing is left over, in weighted rows: of the regressions on experts and on windows."""
FINE = (0.01, 0.02)
"""Errors and motions smaller than this weigh no more [m]."""
HOMEWARD = 15.0
"""The way home is walked evenly over so many steps."""
POWER = 40.0
"""How steeply a forecast and its correction are weighed by their long-run errors."""
DOUBT, DOUBT_FRAMES = 1.05, 30.0
"""For so many frames' worth a correction is taken to err 5 % more than what it corrects."""

JOINT_TYPE = np.array([0, 1, 2, 0, 1, 2])
"""Shoulder, elbow, wrist: left and right share what is learned."""


@cache
def step_basis(steps: int) -> Float[np.ndarray, "T 3"]:
    """(T, 3) constant, slope and curve over the steps: how what is learned varies with them."""
    centre = (np.arange(1.0, steps + 1) - 0.5 * (steps + 1)) / max(0.5 * (steps - 1), 1.0)
    return np.stack([np.ones(steps), centre, centre**2], axis=1)


class Outstanding:
    """What was predicted for frames to come, the newest last; None for frames of which nothing is known.

    Args:
        steps: so many frames ahead are predicted.
    """

    def __init__(self, steps: int) -> None:
        self._made: deque[Any] = deque([None] * steps, maxlen=steps)

    def skip(self, frames: int) -> None:
        """Frames of which nothing is known."""
        self._made.extend([None] * frames)

    def _due(self, leads: Iterable[int]) -> list[tuple[int, Any]]:
        """What was predicted so many frames ago and is known by now, and the place of its lead."""
        return [(k, self._made[-lead]) for k, lead in enumerate(leads) if self._made[-lead] is not None]


class RollingForecastErrors(Outstanding):
    """Exponentially forgotten mean error of each forecaster's past predictions, once their time has come.

    Args:
        forecasters: E, how many are followed.
        leads: (L,) steps ahead at which they are judged.
        half_lives: (H,) memories, in frames.
    """

    def __init__(self, forecasters: int, leads: tuple[int, ...], half_lives: tuple[float, ...]) -> None:
        super().__init__(max(leads))
        self.frames = 0  # seen so far
        self._leads, self._decay = leads, 0.5 ** (1.0 / np.array(half_lives))
        self._sum = np.zeros((len(leads), forecasters, 6, len(half_lives)))
        self._weight = np.zeros((len(leads), len(half_lives)))

    def observe(self, pose: Float[np.ndarray, "6 3"]) -> None:
        """Judges what was predicted for this frame; NaN joints judge nothing. Call once a frame, before `predicted`."""
        self.frames += 1
        if not np.isfinite(pose).all():
            return
        for k, made in self._due(self._leads):
            self._sum[k] *= self._decay
            self._sum[k] += lengths(made[:, self._leads[k] - 1] - pose)[..., None]
            self._weight[k] = self._weight[k] * self._decay + 1.0

    def predicted(self, forecasts: Float[np.ndarray, "E T 6 3"]) -> None:
        """Keeps what is predicted from this frame on."""
        self._made.append(forecasts)

    def skip(self, frames: int) -> None:
        """Frames of which nothing is known."""
        super().skip(frames)
        self.frames += frames

    def mean(self) -> Float[np.ndarray, "E 6 L H"]:
        """(E, 6, L, H) mean errors [m]; NaN where nothing has come due."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return (self._sum / self._weight[:, None, None]).transpose(1, 2, 0, 3)


def rolling_errors(experts: int, steps: int) -> RollingForecastErrors:
    """Nothing remembered yet: of the experts, `experts` learned ones among them, then of the mixture and, twice, of a
    correction and what is taken of it; the last is the mean.
    """
    return RollingForecastErrors(TRIVIAL + experts + 5, tuple(min(lead, steps) for lead in LEADS), HALF_LIVES)


@dataclass(frozen=True)
class GateInputs:
    """What the gate looks at.

    Attributes:
        errors: (E, 6, Q) log errors come due, relative to the mean over experts; 0 where nothing is known.
        window: (6, 5) log speed, log jitter, log disagreement of the learned experts, whether errors are known, and the
            joint's own share of the speed.
    """

    errors: Float[np.ndarray, "E 6 Q"]
    window: Float[np.ndarray, "6 5"]


def gate_inputs(
    due: Float[np.ndarray, "E5 6 L H"], motion: WindowMotion, forecasts: Float[np.ndarray, "E T 6 3"]
) -> GateInputs:
    """The gate's inputs from the rolling errors [m], the window's motion and what the experts forecast [m]."""
    errors = np.log(due[: len(forecasts), :, 1:, : LONG_RUN + 1].reshape(len(forecasts), 6, -1) + 0.002)
    unknown = np.isnan(errors)
    errors[unknown] = 0.0
    learned = forecasts[TRIVIAL:, -1]
    disagreement = lengths(learned - learned.sum(axis=0) / len(learned)).mean() if len(learned) else 0.0
    # Shifts bring the logarithms near zero at common values: 3 cm per frame, 3 cm apart.
    table = np.empty((6, 5))
    table[:, 0] = math.log(motion.shared) + 3.5
    table[:, 1] = math.log(motion.jitter / motion.shared)
    table[:, 2] = math.log(disagreement + 0.003) + 3.5
    table[:, 3] = not unknown[0, 0, 0]
    table[:, 4] = np.log(motion.own / motion.shared)
    return GateInputs(errors - errors.sum(axis=0) / len(errors), table)


@dataclass(frozen=True)
class Gate(Arrays):
    """softmax over experts of bias − Σ share · errors + slope · window, each varying smoothly with the step.

    Attributes:
        bias: (E, 3, 3) per expert, joint type and function of `step_basis`.
        share: (Q, 3) how much each due error counts.
        slope: (E, 5, 3) how the window moves each expert's weight.
    """

    bias: Float[np.ndarray, "E 3 3"]
    share: Float[np.ndarray, "Q 3"]
    slope: Float[np.ndarray, "E 5 3"]

    def weights(self, inputs: GateInputs, steps: int) -> Float[np.ndarray, "E T 6"]:
        """(E, T, 6) weights of the experts; they sum to one."""
        smooth = self.bias[:, JOINT_TYPE] - inputs.errors @ self.share + inputs.window @ self.slope
        logits = (smooth @ step_basis(steps).T).transpose(0, 2, 1)
        weights = np.exp(logits - logits.max(axis=0))
        return weights / weights.sum(axis=0)


class OnlineRidge:
    """Ridge regressions, one for each lead, by recursive least squares with forgetting.

    Args:
        leads: L, how many.
        features, outputs: F and O, numbers that each goes by and gives.
        prior: precision of the prior that all coefficients are zero.
    """

    def __init__(self, leads: int, features: int, outputs: int, prior: float) -> None:
        self._gram, self._moment = np.zeros((leads, features, features)), np.zeros((leads, features, outputs))
        self._prior, self._decay = prior * np.eye(features), 0.5 ** (1.0 / KEPT)

    def learn(
        self,
        leads: Int[np.ndarray, " K"],
        features: Float[np.ndarray, "K R F"],
        outputs: Float[np.ndarray, "K R O"],
        weight: Float[np.ndarray, "K R"],
    ) -> None:
        """Takes in R rows for each of some leads."""
        weighted = (features * weight[..., None]).transpose(0, 2, 1)
        self._gram[leads] = self._decay * self._gram[leads] + weighted @ features
        self._moment[leads] = self._decay * self._moment[leads] + weighted @ outputs

    def coefficients(self) -> Float[np.ndarray, "L F O"]:
        """(L, F, O)."""
        return np.linalg.solve(self._gram + self._prior, self._moment)


class OnlineRegression(Outstanding):
    """What forecasts leave over on one person, learned from those whose time has come.

    First the mixture's error ≈ Σ coefficient · (expert − mixture) + coefficient · (home − last pose), all joints alike,
    home being where a joint mostly is. Then what is left of it, an arm at a time and from its own side, over the
    amplitude, by the window's last steps, pose and levels. Rows weigh one over their error and their motion: it is
    distances that get small, as they are scored, not squares.

    Args:
        experts: E, how many forecast.
        steps: T.
    """

    def __init__(self, experts: int, steps: int) -> None:
        super().__init__(steps)
        self._leads = tuple(sorted({min(lead, steps) for lead in REGRESSED}))
        self._at = np.array(self._leads) - 1
        self._experts = OnlineRidge(len(self._leads), experts + 1, 1, PRIORS[0])
        self._window = OnlineRidge(len(self._leads), NEWEST + 1, 9, PRIORS[1])
        self._begun: tuple[np.ndarray, ...] = ()
        self._home, self._known = np.zeros((6, 3)), 0.0

    def observe(self, pose: Float[np.ndarray, "6 3"]) -> None:
        """Learns from what was predicted for this frame; NaN joints teach nothing. Call once a frame, first."""
        known = [(k, view, *(part[k] for part in made)) for k, (made, view) in self._due(self._leads)]
        if not known or not np.isfinite(pose).all():
            return
        rows, views, *made = zip(*known, strict=True)
        leads = np.array(rows)
        mixed, mixed_moved, regressors, mean, moved = map(np.array, made)
        error = pose - mixed
        weight = 1.0 / ((lengths(error) + FINE[0]) * (mixed_moved + FINE[1]))
        self._experts.learn(leads, regressors, error.reshape(-1, 18, 1), np.repeat(weight, 3, axis=1))
        error = pose - mean
        size, moved = (each.reshape(-1, 2, 3).mean(axis=2) for each in (lengths(error), moved))
        view = PersonView(*map(np.array, zip(*views, strict=True)))
        weight = view.amplitude**2 / ((size + FINE[0]) * (moved + FINE[1]))
        self._window.learn(leads, view.features, view.to_arms(error), weight)

    def by_experts(
        self, mixed: Float[np.ndarray, "T 6 3"], forecasts: Float[np.ndarray, "E T 6 3"], last: Float[np.ndarray, "6 3"]
    ) -> Float[np.ndarray, "T 6 3"]:
        """The mixture [m] and what it is expected to leave over."""
        steps, experts = len(mixed), len(forecasts)
        self._known = self._known * 0.5 ** (1.0 / HALF_LIVES[LONG_RUN]) + 1.0
        self._home = self._home + (last - self._home) / self._known
        regressors = np.empty((steps, 18, experts + 1))
        regressors[..., :-1] = (forecasts - mixed).reshape(experts, steps, 18).transpose(1, 2, 0)
        homeward = np.minimum(np.arange(1.0, steps + 1) / HOMEWARD, 1.0)
        regressors[..., -1] = homeward[:, None] * (self._home - last).ravel()
        self._begun = mixed[self._at], lengths(mixed[self._at] - last), regressors[self._at]
        learned = _between(self._leads, steps) @ self._experts.coefficients()[..., 0]
        return mixed + (regressors @ learned[..., None]).reshape(steps, 6, 3)

    def by_window(
        self, mean: Float[np.ndarray, "T 6 3"], view: PersonView, last: Float[np.ndarray, "6 3"]
    ) -> Float[np.ndarray, "T 6 3"]:
        """What was taken of `by_experts` [m], and what it is expected to leave over; both are kept, to learn from."""
        self._made.append(((*self._begun, mean[self._at], lengths(mean[self._at] - last)), view))
        at_leads = (view.features @ self._window.coefficients()).reshape(len(self._leads), 18)
        return mean + view.to_world((_between(self._leads, len(mean)) @ at_leads).reshape(-1, 2, 9))


@cache
def _between(leads: tuple[int, ...], steps: int) -> Float[np.ndarray, "T L"]:
    """(T, L) what counts of each lead at each step: linear between two, the last one's beyond it."""
    return np.stack([np.interp(np.arange(1, steps + 1), leads, each) for each in np.eye(len(leads))], axis=1)


def corrected_share(due: Float[np.ndarray, "2 6 L H"], frames: int) -> Float[np.ndarray, "6"]:
    """(6,) how much of its correction a forecast takes, joint by joint, by what both got wrong in the long run.

    `due` are the rolling errors [m] of both, NaN for leads that have not come due, `frames` how many were seen.
    """
    forecast, correction = _long_run(due)
    age, ratio = _age(frames), np.nan_to_num((correction + 1e-4) / (forecast + 1e-4), nan=1.0)
    return 1.0 / (1.0 + ((age * ratio + DOUBT_FRAMES * DOUBT) / (age + DOUBT_FRAMES)) ** POWER)


def skill(due: Float[np.ndarray, "E5 6 L H"], frames: int) -> float:
    """Skill score of the mean in the long run: 1 − its error over the best trivial expert's; 0 for a stranger.

    `due` are the rolling errors of all [m], `frames` how many were seen.
    """
    mean, *trivial = (_long_run(np.concatenate([due[-1:], due[:TRIVIAL]])).mean(axis=1) + 1e-4).tolist()
    age = _age(frames)
    return age / (age + DOUBT_FRAMES) * (1.0 - mean / min(trivial)) if math.isfinite(mean) else 0.0


def _long_run(due: Float[np.ndarray, "F 6 L H"]) -> Float[np.ndarray, "F 6"]:
    """(F, 6) mean over the leads that have come due [m]; NaN where none has."""
    errors = due[..., LONG_RUN]
    known = np.isfinite(errors).all(axis=(0, 1))
    return errors[..., known].sum(axis=-1) / known.sum() if known.any() else np.full(errors.shape[:2], np.nan)


def _age(frames: int) -> float:
    """How many frames the long run remembers."""
    return min(float(frames), HALF_LIVES[LONG_RUN] / math.log(2.0))
