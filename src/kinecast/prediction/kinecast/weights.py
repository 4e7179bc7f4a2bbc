"""Who is trusted: weights of the experts, learned in training and moved by each one's errors on the person in view.

Two layers. The gate mixes all experts, its weights a softmax of what each one got wrong lately and of what the window
looks like. Fallback weights then set that mixture against the trivial experts alone by their long-run errors, steeply:
on a recording unlike anything trained on, what is simple and right takes over.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float

from kinecast.geometry.transforms import lengths
from kinecast.prediction.kinecast.experts import TRIVIAL, WindowMotion
from kinecast.prediction.model_file import Arrays

LEADS, HALF_LIVES = (1, 3, 6, 10, 15), (8.0, 40.0, 200.0, 10.0)
"""Steps ahead at which forecasts are judged, and how long that is remembered [frames]."""
LONG_RUN = 2
"""Which of the half-lives the fallback weights go by; the gate goes by it and those before it, the error model by the
last."""
FALLBACK_POWER = 40.0
"""Weight of a forecaster: its long-run error to minus this power."""
MIXTURE_CREDIT = 0.98
"""The mixture is taken for 2 % better than it was: ties go to it."""
USUAL_ERROR = 0.03
"""Of every forecaster before anything is known [m]."""
PRIOR_FRAMES, PRIOR_OTHERS = 8.0, 1.15
"""Before anything is known, and for as many frames' worth, the trivial experts are taken for 15 % worse."""

JOINT_TYPE = np.array([0, 1, 2, 0, 1, 2])
"""Shoulder, elbow, wrist: left and right share what is learned."""


@cache
def step_basis(steps: int) -> Float[np.ndarray, "T 3"]:
    """(T, 3) constant, slope and curve over the steps: how what is learned varies with them."""
    centre = (np.arange(1.0, steps + 1) - 0.5 * (steps + 1)) / max(0.5 * (steps - 1), 1.0)
    return np.stack([np.ones(steps), centre, centre**2], axis=1)


class RollingForecastErrors:
    """Exponentially forgotten mean error of each forecaster's past predictions, once their time has come.

    Args:
        forecasters: E, how many are followed.
        leads: (L,) steps ahead at which they are judged.
        half_lives: (H,) memories, in frames.
    """

    def __init__(self, forecasters: int, leads: tuple[int, ...], half_lives: tuple[float, ...]) -> None:
        self.frames = 0  # seen so far
        self._leads, self._decay = leads, 0.5 ** (1.0 / np.array(half_lives))
        self._sum = np.zeros((len(leads), forecasters, 6, len(half_lives)))
        self._weight = np.zeros((len(leads), len(half_lives)))
        self._past: deque[Float[np.ndarray, "E T 6 3"] | None] = deque([None] * max(leads), maxlen=max(leads))

    def observe(self, pose: Float[np.ndarray, "6 3"]) -> None:
        """Judges what was predicted for this frame; NaN joints judge nothing. Call once a frame, before `predicted`."""
        self.frames += 1
        if not np.isfinite(pose).all():
            return
        for k, lead in enumerate(self._leads):
            made = self._past[-lead]
            if made is not None:
                self._sum[k] *= self._decay
                self._sum[k] += lengths(made[:, lead - 1] - pose)[..., None]
                self._weight[k] = self._weight[k] * self._decay + 1.0

    def predicted(self, forecasts: Float[np.ndarray, "E T 6 3"]) -> None:
        """Keeps what is predicted from this frame on."""
        self._past.append(forecasts)

    def skip(self, frames: int) -> None:
        """Frames of which nothing is known."""
        self.frames += frames
        self._past.extend([None] * frames)

    def mean(self) -> Float[np.ndarray, "E 6 L H"]:
        """(E, 6, L, H) mean errors [m]; NaN where nothing has come due."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return (self._sum / self._weight[:, None, None]).transpose(1, 2, 0, 3)


def rolling_errors(experts: int, steps: int) -> RollingForecastErrors:
    """Nothing remembered yet: of the experts, `experts` learned ones among them, of their mixture, of the mean."""
    return RollingForecastErrors(TRIVIAL + experts + 2, tuple(min(lead, steps) for lead in LEADS), HALF_LIVES)


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
    due: Float[np.ndarray, "E2 6 L H"], motion: WindowMotion, forecasts: Float[np.ndarray, "E T 6 3"]
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


def fallback_weights(due: Float[np.ndarray, "E2 6 L H"], frames: int) -> Float[np.ndarray, "F 6"]:
    """(1 + TRIVIAL, 6) weights, per joint, of the mixture (first) and the trivial experts, from their long-run errors.

    `due` are the rolling errors [m], NaN for leads that have not come due, `frames` how many were seen.
    """
    long_run = np.concatenate([due[-2:-1], due[:TRIVIAL]])[..., LONG_RUN]
    known = np.isfinite(long_run).all(axis=(0, 1))
    errors = np.where(known, long_run, 0.0).sum(axis=-1) / max(int(known.sum()), 1)
    age = min(float(frames), HALF_LIVES[LONG_RUN] / np.log(2.0)) if known.any() else 0.0
    level = np.maximum(errors[:1], 1e-4) if known.any() else np.full_like(errors[:1], USUAL_ERROR)
    expected = level * np.where(np.arange(len(errors)) == 0, MIXTURE_CREDIT, PRIOR_OTHERS)[:, None]
    errors = (errors * age + PRIOR_FRAMES * expected) / (age + PRIOR_FRAMES)
    errors[0] *= MIXTURE_CREDIT
    logits = -FALLBACK_POWER * np.log(errors + 3e-4)
    weights = np.exp(logits - logits.max(axis=0))
    return weights / weights.sum(axis=0)
