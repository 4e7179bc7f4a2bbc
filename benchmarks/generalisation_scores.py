"""What `benchmarks.generalisation` scores beside the project's own evaluation: coverage by speed, tubes, motions.

A `Watched` method stands in for a method during an evaluation and notes what each of its forecasts was worth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit
from scipy.stats import rankdata

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.errors import OptionError
from kinecast.evaluation.metrics import LEVELS, WRISTS, regions, scored
from kinecast.prediction.method import Forecast, Method
from kinecast.prediction.observation import Observation
from kinecast.types import LIMBS, Density, Prediction, Tubes

SPEEDS = {"rest": (0.0, 0.05), "slow": (0.05, 0.3), "fast": (0.3, np.inf)}
"""A joint's mean speed over what is seen [m/s]."""
BY_SPEED = (0.5, 0.9)
"""Levels at which coverage is told by speed and by how long somebody was followed."""
SINCE = {"at first": (0.0, 0.5), "later": (0.5, np.inf)}
"""For how long somebody had been followed when a forecast was made [s]."""
TUBES = (0.99, 0.999)
REACH = 1.6
"""Speed at which a person comes near by ISO 13855 [m/s]."""
DRAWN = 4
"""Motions kept of each forecast, to be held beside true ones."""
DERIVATIVES = {"speed": "m/s", "acceleration": "m/s^2", "jerk": "m/s^3"}
PERCENTILES = (50.0, 95.0, 99.9)


@dataclass(frozen=True)
class FirstSteps:
    """The density of the first steps of a longer prediction; steps after those asked for are unknown."""

    density: Density
    steps: int

    def log_prob(self, positions: np.ndarray) -> np.ndarray:
        """See kinecast.types.Density."""
        unknown = np.full((self.steps - len(positions), *positions.shape[1:]), np.nan)
        return self.density.log_prob(np.concatenate([positions, unknown]))[: len(positions)]


def shortened(forecast: Forecast, steps: int) -> Forecast:
    """The first steps of a forecast. The one place where a model that predicts further than is scored is cut."""
    if len(forecast.mean) == steps:
        return forecast
    samples = np.ascontiguousarray(forecast.samples[:, :steps])
    density = FirstSteps(forecast.density, len(forecast.mean))
    return replace(forecast, samples=samples, mean=forecast.mean[:steps], density=density)


class Note(NamedTuple):
    """One forecast beside what came.

    Attributes:
        speed: (6,) mean speed of each joint over what is seen [m/s].
        error: (T, 6) distance from the mean of the drawn motions to the truth [m], NaN where that is missing.
        inside: (2, T, 6) whether its region at `BY_SPEED` holds the truth, NaN where that is missing.
        held: (3, T, 4) whether each limb lies in its tube at `TUBES` and in ISO 13855's reach, NaN where it is missing.
        litres: (3, T, 4) volumes of these.
        paths: (1 + DRAWN, 3 + T, 2, 3) wrists over the last three frames seen and the steps after them [m]: the true
            motion, then drawn ones where motions are asked for.
    """

    speed: np.ndarray
    error: np.ndarray
    inside: np.ndarray
    held: np.ndarray
    litres: np.ndarray
    paths: np.ndarray


@dataclass(frozen=True)
class Watched:
    """A method whose forecasts are cut to `steps` and noted beside the truth.

    Attributes:
        method: any.
        steps: T to be scored; OptionError where the method predicts fewer.
        truths: (T, 6, 3) what came after each observation [m], by its `id`.
        motions: whether paths of the wrists are kept.
        notes: one a forecast, in order.
    """

    method: Method[Any]
    steps: int
    truths: Mapping[int, np.ndarray]
    motions: bool = False
    notes: list[Note] = field(default_factory=list)

    def __post_init__(self) -> None:
        if self.method.steps < self.steps:
            raise OptionError(f"a method predicts {self.method.steps} steps, scored are {self.steps}")

    @property
    def frames(self) -> int:
        return self.method.frames

    @property
    def dt(self) -> float:
        return self.method.dt

    def init_state(self) -> Any:
        """See kinecast.prediction.method.Method, as below."""
        return self.method.init_state()

    def update(self, state: Any, observation: Observation, measured: np.ndarray) -> Any:
        return self.method.update(state, observation, measured)

    def forecast(self, state: Any, observation: Observation, rng: np.random.Generator, samples: int) -> Forecast:
        forecast = shortened(self.method.forecast(state, observation, rng, samples), self.steps)
        # By chance, anew for each window: methods may give samples in an order, `kinecast` by how wide they spread.
        kept = np.random.default_rng(len(self.notes)).integers(samples, size=DRAWN if self.motions else 0)
        self.notes.append(note(forecast.samples, observation, self.truths[id(observation)], kept))
        return forecast

    def to_arrays(self) -> dict[str, np.ndarray]:
        return self.method.to_arrays()


def note(samples: np.ndarray, observation: Observation, truth: np.ndarray, kept: np.ndarray) -> Note:
    """What (S, T, 6, 3) drawn motions were worth once (T, 6, 3) the truth came [m]; paths are of those `kept`."""
    seen, times = observation.positions, observation.times(len(truth))
    speed = np.linalg.norm(np.diff(seen, axis=0), axis=-1).mean(axis=0) / observation.dt
    inside = regions(samples, truth)[0][[LEVELS.index(level) for level in BY_SPEED]]
    mean = samples.mean(axis=0)
    prediction = Prediction(observation.stamp, times, samples, mean, np.zeros((*mean.shape, 3)), ARM_JOINTS)
    tubes = [*(prediction.tubes(level) for level in TUBES), reach(observation, len(truth))]
    ahead = np.concatenate([truth[None], samples[kept]])[:, :, WRISTS]
    paths = np.concatenate([np.broadcast_to(seen[-3:, WRISTS], (len(ahead), 3, 2, 3)), ahead], axis=1)
    held = np.stack([limbs_held(tube, truth) for tube in tubes])
    litres = np.stack([1e3 * volume(tube) for tube in tubes])
    error = np.linalg.norm(mean - truth, axis=-1)
    return Note(speed, error, np.where(scored(truth), inside, np.nan), held, litres, paths)


def reach(observation: Observation, steps: int) -> Tubes:
    """Capsules about each limb where it was last seen, their radius growing by 1.6 m/s: what ISO 13855 reckons with."""
    start, end = observation.positions[-1][np.array(LIMBS).T]
    ahead = observation.dt * np.arange(1, steps + 1)
    radius = np.repeat(REACH * ahead[:, None], 4, axis=1)
    start, end = (np.tile(points, (steps, 1, 1)) for points in (start, end))
    return Tubes(observation.times(steps), start, end, radius, 1.0)


def limbs_held(tubes: Tubes, truth: np.ndarray) -> np.ndarray:
    """(T, 4) 1.0 where both ends of a limb, and so all of it, lie in its capsule, 0.0 where not; NaN where missing."""
    axis = tubes.end - tubes.start
    square = np.maximum((axis**2).sum(axis=-1), 1e-12)
    ends = truth[:, np.array(LIMBS)]  # (T, 4, 2, 3)
    along = np.einsum("tlpd,tld->tlp", ends - tubes.start[:, :, None], axis) / square[..., None]
    nearest = tubes.start[:, :, None] + np.clip(along, 0.0, 1.0)[..., None] * axis[:, :, None]
    away = np.linalg.norm(ends - nearest, axis=-1).max(axis=-1)
    return np.where(np.isfinite(away), away <= tubes.radius, np.nan)


def volume(tubes: Tubes) -> np.ndarray:
    """(T, 4) volumes of the capsules [m^3]."""
    length = np.linalg.norm(tubes.end - tubes.start, axis=-1)
    return np.pi * tubes.radius**2 * (length + 4.0 / 3.0 * tubes.radius)


def summary(notes: Sequence[Note], since: np.ndarray) -> dict[str, Any]:
    """Coverage by speed; error and coverage by how long somebody was followed, (W,) `since` [s]; tubes: shares of
    limbs, arms and whole motions held, and litres a limb at the end.
    """
    speed, error, inside, held, litres = (np.array(values) for values in list(zip(*notes, strict=True))[:5])
    by_speed = {}
    for name, (least, most) in SPEEDS.items():
        here = (least <= speed) & (speed < most)
        values = np.moveaxis(inside, 3, 1)[here]  # (K, 2, T)
        by_speed[name] = {"joints": len(values), **{str(v): mean(values[:, k]) for k, v in enumerate(BY_SPEED)}}
    tubes = {}
    for k, name in enumerate([*map(str, TUBES), "reach"]):
        final, allowed = litres[:, k, -1], litres[:, -1, -1]
        tubes[name] = {
            "limbs": mean(held[:, k]),
            "arms": mean(held[:, k].min(axis=-1)),
            "motions": mean(held[:, k].min(axis=(-1, -2))),
            "litres": {"mean": mean(final), "median": float(np.median(final))},
            "median_share_of_reach": float(np.median(final / allowed)),
        }
    followed = {}
    for name, (least, most) in SINCE.items():
        here = (least <= since) & (since < most)
        values = {str(v): mean(inside[here, k]) for k, v in enumerate(BY_SPEED)}
        wrong = mean(error[here])
        followed[name] = {"windows": int(here.sum()), "mpjpe_mm": None if wrong is None else 1e3 * wrong, **values}
    return {"coverage_by_speed": by_speed, "followed": followed, "tubes": tubes}


def mean(values: np.ndarray) -> float | None:
    """Mean of what is known; None where nothing is."""
    known = values[~np.isnan(values)]
    return float(known.mean()) if known.size else None


# Do drawn motions move like people?


def motions_summary(notes: Sequence[Note], owner: np.ndarray, dt: float) -> dict[str, Any]:
    """How wrists move in truth and as drawn, and how well a classifier tells the two apart: AUC, 0.5 if not at all.

    The classifier, a logistic regression on the logarithms of speed, acceleration and jerk at each step, on the cosines
    of turns and on the squares of all these, sees one true and one drawn motion a window and is asked about recordings
    (of a single one: its second half) that it has not seen.
    """
    paths, number = np.array([each.paths for each in notes]), np.arange(len(notes))
    whole = np.isfinite(paths).all(axis=(1, 2, 3, 4))
    true, drawn = paths[:, 0], paths[number, 1 + number % DRAWN]
    unseen = owner % 2 == 1 if len(np.unique(owner)) > 1 else number >= len(number) // 2
    halves = []
    for half in (whole & ~unseen, whole & unseen):
        both = np.concatenate([features(each[half], dt) for each in (true, drawn)])
        halves += [both, np.repeat([1.0, 0.0], len(both) // 2)]
    return {
        "truth": distribution(true[whole], dt),
        "drawn": distribution(paths[whole, 1:].reshape(-1, *paths.shape[2:]), dt),
        "auc": told_apart(*halves),
    }


def derivatives(paths: np.ndarray, dt: float) -> list[np.ndarray]:
    """(M, T, 2) sizes of speed, acceleration and jerk of (M, 3 + T, 2, 3) paths, in m and s; the seam is in them."""
    steps = paths.shape[1] - 3
    return [np.linalg.norm(np.diff(paths, n, axis=1), axis=-1)[:, -steps:] / dt**n for n in (1, 2, 3)]


def distribution(paths: np.ndarray, dt: float) -> dict[str, dict[str, float]]:
    """Percentiles of each derivative over all paths, wrists and steps."""
    return {
        name: {f"p{p:g}": float(np.percentile(values, p)) for p in PERCENTILES}
        for name, values in zip(DERIVATIVES, derivatives(paths, dt), strict=True)
    }


def features(paths: np.ndarray, dt: float) -> np.ndarray:
    """(2 M, F) what the classifier sees of each wrist's motion."""
    logs = [np.log(1e-3 + values) for values in derivatives(paths, dt)]
    steps = np.diff(paths, axis=1)[:, -len(logs[0][0]) - 1 :]
    size = 1e-4 + np.linalg.norm(steps, axis=-1)
    turns = [(a * b).sum(axis=-1) for a, b in pairwise(np.moveaxis(steps / size[..., None], 1, 0))]
    return np.moveaxis(np.concatenate([*logs, np.stack(turns, axis=1)], axis=1), 2, 0).reshape(2 * len(paths), -1)


def told_apart(X: np.ndarray, y: np.ndarray, unseen: np.ndarray, of: np.ndarray) -> float | None:
    """AUC on (K, F) unseen features of classes `of`, of a logistic regression fitted to (M, F) `X` of classes `y`."""
    if len(set(y)) < 2 or len(set(of)) < 2:
        return None
    centre, scale = X.mean(axis=0), np.maximum(X.std(axis=0), 1e-9)

    def design(values: np.ndarray) -> np.ndarray:
        z = np.clip((values - centre) / scale, -5.0, 5.0)
        return np.hstack([np.ones((len(z), 1)), z, z**2 - 1.0])

    A, sign = design(X), 2.0 * y - 1.0

    def loss(w: np.ndarray) -> tuple[float, np.ndarray]:
        margin = sign * (A @ w)
        return np.logaddexp(0.0, -margin).sum() + 0.5 * w @ w, w - A.T @ (sign * expit(-margin))

    rank = rankdata(design(unseen) @ minimize(loss, np.zeros(A.shape[1]), jac=True, method="L-BFGS-B").x)
    ones, zeros = (of == 1).sum(), (of == 0).sum()
    return float((rank[of == 1].sum() - ones * (ones + 1) / 2) / (ones * zeros))
