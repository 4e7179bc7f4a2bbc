"""Models of single actions beside the general one, weighted by how well each explains the last second.

Each action has learned experts of its own, trained on its windows alone; their mean is the action's forecast. The
general mean and the actions' forecasts are mixed by their errors that came due on this person: the same memory that the
gate and the guard use, and as with the guard ties go to the general mean. Spread and constraints are the general ones.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from kinecast.errors import ModelError
from kinecast.prediction.kinecast.features import arm_views
from kinecast.prediction.kinecast.learned import Expert, expert_from_arrays, forecast
from kinecast.prediction.kinecast.memory import DueErrors

__all__ = ["Actions", "actions_from_arrays"]

LEADS, HALF_LIVES = (3, 6, 10), (15.0,)
"""Steps ahead at which forecasts are judged, and the memory [frames]: half a second."""
POWER = 16.0
"""Weight of a forecast: its mean error to minus this power."""
CREDIT = 0.95
"""The general mean is taken for 5 % better than it was: an action must be clearly ahead to count."""
PRIOR, USUAL_ERROR = 5.0, 0.03
"""For as many frames' worth, the actions are taken for so wrong [m], the general mean for less."""
BEHIND = 1.3
"""How much worse than the general mean actions are taken for at the start."""
MOST_ACTIONS = 64


@dataclass(frozen=True)
class Actions:
    """A actions.

    Attributes:
        labels: their names.
        experts: of each.
    """

    labels: tuple[str, ...]
    experts: tuple[tuple[Expert, ...], ...]

    def memory(self, steps: int) -> DueErrors:
        """Nothing remembered yet: of the general mean, first, and of each action."""
        return DueErrors(1 + len(self.labels), tuple(min(lead, steps) for lead in LEADS), HALF_LIVES)

    def forecasts(self, windows: Float[np.ndarray, "W N 6 3"], steps: int) -> Float[np.ndarray, "W A T 6 3"]:
        """What each action's experts forecast [m]."""
        views = arm_views(windows)
        means = [sum(forecast(expert, views, steps) for expert in own) / len(own) for own in self.experts]
        return np.stack(means, axis=1)

    def follow(
        self,
        memory: DueErrors,
        window: Float[np.ndarray, "N 6 3"],
        measured: Float[np.ndarray, "6 3"],
        general: Float[np.ndarray, "T 6 3"],
    ) -> tuple[Float[np.ndarray, "T 6 3"], dict[str, float]]:
        """Learns from the newest frame how each did, and mixes them anew.

        Args:
            memory: of this person; changed.
            window: (N, 6, 3) the repaired window [m].
            measured: (6, 3) the newest frame as measured [m], NaN where it was not.
            general: (T, 6, 3) the general mean [m].

        Returns:
            (T, 6, 3) the mixture [m], and each action's share in it; what is left is the general mean's.
        """
        memory.observe(measured)
        made = np.concatenate([general[None], self.forecasts(window[None], len(general))[0]])
        weights = self._weights(memory)
        memory.predicted(made)
        mixed = np.tensordot(weights, made, axes=1)
        return mixed, dict(zip(self.labels, weights[1:].tolist(), strict=True))

    def _weights(self, memory: DueErrors) -> Float[np.ndarray, " A1"]:
        due = memory.mean()[..., 0]
        known = np.isfinite(due).all(axis=(0, 1))
        start = np.full(len(due), BEHIND)
        start[0] = 1.0
        errors, age = USUAL_ERROR * start, 0.0
        if known.any():
            errors = due[:, :, known].mean(axis=(1, 2))
            age = min(float(memory.frames), HALF_LIVES[0] / np.log(2.0))
            errors = (age * errors + PRIOR * errors[0] * start) / (age + PRIOR)
        errors[0] *= CREDIT
        logits = -POWER * np.log(errors + 1e-4)
        weights = np.exp(logits - logits.max())
        return weights / weights.sum()

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Plain arrays for a checkpoint."""
        arrays = {"actions.labels": np.frombuffer(json.dumps(self.labels).encode(), np.uint8)}
        for a, own in enumerate(self.experts):
            for k, expert in enumerate(own):
                arrays |= {f"action{a}.{k}.{name}": array for name, array in expert.to_arrays().items()}
        return arrays


def actions_from_arrays(parts: Mapping[str, Mapping[str, np.ndarray]], frames: int, steps: int) -> Actions | None:
    """The actions that `Actions.to_arrays` described; None where there are none.

    Args:
        parts: arrays by owner ("actions", "action0", …) and own name.
        frames, steps: N and T that they must fit.

    Raises:
        ModelError: labels that are no list of names, no experts to a label, or arrays that do not fit together.
    """
    owners = [name for name in parts if name.startswith("action") and name != "actions"]
    if "actions" not in parts and not owners:
        return None
    try:
        labels = json.loads(np.asarray(parts["actions"]["labels"], np.uint8).tobytes())
        if not isinstance(labels, list) or not all(isinstance(label, str) and label for label in labels):
            raise ValueError(f"labels {str(labels)[:80]}")
        if not 0 < len(labels) == len(set(labels)) == len(owners) <= MOST_ACTIONS:
            raise ValueError(f"{len(labels)} labels for {len(owners)} models, at most {MOST_ACTIONS}")
        experts = tuple(_experts(parts[f"action{a}"]) for a in range(len(labels)))
        actions = Actions(tuple(labels), experts)
        # Arrays of wrong shapes must fail here, not in front of a robot.
        forecasts = actions.forecasts(np.arange(18.0 * frames).reshape(1, frames, 6, 3), steps)
        if forecasts.shape != (1, len(labels), steps, 6, 3) or not np.isfinite(forecasts).all():
            raise ValueError(f"forecasts of shape {forecasts.shape}")
    except (KeyError, ValueError, IndexError, TypeError, RecursionError) as error:
        raise ModelError(f"arrays of the models per action do not fit ({error})") from None
    return actions


def _experts(arrays: Mapping[str, np.ndarray]) -> tuple[Expert, ...]:
    """One action's experts, in order."""
    numbers = sorted({int(name.partition(".")[0]) for name in arrays})
    if not numbers or numbers != list(range(len(numbers))):
        raise ValueError(f"experts {numbers}")
    return tuple(_expert(arrays, k) for k in numbers)


def _expert(arrays: Mapping[str, np.ndarray], number: int) -> Expert:
    own: Sequence[tuple[str, np.ndarray]] = [
        (name.partition(".")[2], array) for name, array in arrays.items() if name.partition(".")[0] == str(number)
    ]
    return expert_from_arrays(dict(own))
