"""Who is trusted: weights of the experts, learned in training and moved by each one's errors on the person in view.

Two layers. The gate mixes all experts, its weights a softmax of what each one got wrong lately and of what the window
looks like. The guard then weighs that mixture against the trivial experts alone by their long-run errors, steeply: on a
recording unlike anything trained on, what is simple and right takes over.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float

from kinecast.prediction.kinecast.memory import DueErrors

__all__ = [
    "TRIVIAL",
    "Gate",
    "GateInputs",
    "gate_inputs",
    "gate_memory",
    "guard",
    "guard_memory",
    "step_basis",
    "trivial_experts",
]

LEADS, HALF_LIVES = (3, 6, 10, 15), (8.0, 40.0)
GUARD_LEADS, GUARD_HALF_LIVES = (1, 3, 6, 10, 15), (200.0,)
GUARD_POWER = 40.0
"""Weight of a forecaster: its long-run error to minus this power."""
GUARD_CREDIT = 0.98
"""The mixture is taken for 2 % better than it was: ties go to it."""
USUAL_ERROR = 0.03
"""Of every forecaster before anything is known [m]."""
GUARD_PRIOR, GUARD_OTHERS = 8.0, 1.15
"""Before anything is known, and for as many frames' worth, the trivial experts are taken for 15 % worse."""

DAMPED = ((0, 1.0), (2, 16.0), (2, np.inf), (1, 4.0), (3, 12.0))
"""Trivial experts: degree of the polynomial whose slope is the velocity (0: none), and time constant [frames]."""
TRIVIAL = len(DAMPED)
JOINT_TYPE = np.array([0, 1, 2, 0, 1, 2])
"""Shoulder, elbow, wrist: left and right share what is learned."""


@cache
def trivial_experts(frames: int, steps: int) -> Float[np.ndarray, "E T N"]:
    """(E, T, N) weights over the window of each trivial expert's prediction: last + velocity · τ(1 − exp(−t/τ))."""
    time = np.arange(frames) - (frames - 1.0)
    ahead = np.arange(1.0, steps + 1)
    weights = np.zeros((TRIVIAL, steps, frames))
    for expert, (degree, tau) in zip(weights, DAMPED, strict=True):
        reach = ahead if np.isinf(tau) else -tau * np.expm1(-ahead / tau)
        if degree:
            expert += np.outer(reach, np.linalg.pinv(np.vander(time, degree + 1, increasing=True))[1])
        expert[:, -1] += 1.0
    return weights


@cache
def step_basis(steps: int) -> Float[np.ndarray, "T 3"]:
    """(T, 3) constant, slope and curve over the steps: how what is learned varies with them."""
    centre = (np.arange(1.0, steps + 1) - 0.5 * (steps + 1)) / max(0.5 * (steps - 1), 1.0)
    return np.stack([np.ones(steps), centre, centre**2], axis=1)


def gate_memory(experts: int, steps: int) -> DueErrors:
    """What the gate needs to remember."""
    return DueErrors(experts, tuple(min(lead, steps) for lead in LEADS), HALF_LIVES)


def guard_memory(steps: int) -> DueErrors:
    """What the guard needs to remember: of the mixture, and of the trivial experts."""
    return DueErrors(1 + TRIVIAL, tuple(min(lead, steps) for lead in GUARD_LEADS), GUARD_HALF_LIVES)


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
    due: Float[np.ndarray, "E 6 L H"], window: Float[np.ndarray, "N 6 3"], forecasts: Float[np.ndarray, "E T 6 3"]
) -> GateInputs:
    """The gate's inputs from due errors [m], the window [m] and what the experts forecast [m]."""
    flat = due.reshape(*due.shape[:2], -1)
    unknown = np.isnan(flat)
    errors = np.where(unknown, 0.0, np.log(np.where(unknown, 1.0, flat) + 0.002))
    steps = np.diff(window, axis=0)
    square = (steps**2).sum(axis=-1)
    speed = np.sqrt(square.mean() + 1e-6)
    jitter = np.sqrt((np.diff(steps, n=2, axis=0) ** 2).sum(axis=-1).mean() + 1e-8)
    learned = forecasts[TRIVIAL:, -1]
    disagreement = np.linalg.norm(learned - learned.mean(axis=0), axis=-1).mean()
    own = np.sqrt(square.mean(axis=0) + 1e-6)
    # Shifts bring the logarithms near zero at common values: 3 cm per frame, 3 cm apart.
    shared = [
        np.log(speed) + 3.5,
        np.log(jitter / speed),
        np.log(disagreement + 0.003) + 3.5,
        float(not unknown[0, 0, 0]),
    ]
    table = np.empty((6, 5))
    table[:, :4] = shared
    table[:, 4] = np.log(own / speed)
    return GateInputs(errors - errors.mean(axis=0), table)


@dataclass(frozen=True)
class Gate:
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
        basis = step_basis(steps)
        logits = (self.bias @ basis.T)[:, JOINT_TYPE].transpose(0, 2, 1)
        logits = logits - ((inputs.errors @ self.share) @ basis.T).transpose(0, 2, 1)
        logits = logits + ((inputs.window @ self.slope) @ basis.T).transpose(0, 2, 1)
        weights = np.exp(logits - logits.max(axis=0))
        return weights / weights.sum(axis=0)

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Plain arrays for a checkpoint."""
        return {"bias": self.bias, "share": self.share, "slope": self.slope}


def guard(due: Float[np.ndarray, "E 6 L 1"], frames: int) -> Float[np.ndarray, "E 6"]:
    """(E, 6) weights, per joint, of the mixture (first) and the trivial experts, from their long-run errors.

    Args:
        due: long-run errors [m], NaN for leads that have not come due.
        frames: how many frames were followed.
    """
    known = np.isfinite(due).all(axis=(0, 1, 3))
    errors = np.where(known, due[..., 0], 0.0).sum(axis=-1) / max(int(known.sum()), 1)
    age = min(float(frames), GUARD_HALF_LIVES[0] / np.log(2.0)) if known.any() else 0.0
    level = np.maximum(errors[:1], 1e-4) if known.any() else np.full_like(errors[:1], USUAL_ERROR)
    expected = level * np.where(np.arange(len(errors)) == 0, GUARD_CREDIT, GUARD_OTHERS)[:, None]
    errors = (errors * age + GUARD_PRIOR * expected) / (age + GUARD_PRIOR)
    errors[0] *= GUARD_CREDIT
    logits = -GUARD_POWER * np.log(errors + 3e-4)
    weights = np.exp(logits - logits.max(axis=0))
    return weights / weights.sum(axis=0)
