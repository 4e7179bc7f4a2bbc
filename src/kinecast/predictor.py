"""The online facade: skeleton frames in, one prediction per frame out, and never an exception."""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.errors import OptionError
from kinecast.geometry.scene import Scene
from kinecast.prediction.method import Forecast, Method, forecast_in_scene, joint_covariances, shortened
from kinecast.prediction.observation import STANDING, Observation
from kinecast.track import Track
from kinecast.types import Density, Prediction, SkeletonFrame, Status

LONGEST_DELAY = 0.3  # a frame older than this when it arrives is LATE [s]
MOST_PERSONS = 64  # followed at once; the one not seen for longest is forgotten first
FORGET_AFTER = 5.0  # a person not seen for this long is forgotten [s]
UNFAMILIAR_SKILL = -0.15  # so much worse than a trivial predictor, and the status says that nobody in training moved so
AT_REST = 0.1  # whose joints all move slower than this [m/s] is best predicted to stay, and that is nothing unfamiliar
HAND_SPEED = 2.0
"""Fastest approach of a hand [m/s] (ISO 13855:2010, clause 5): bounds what is said before anything is known."""

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class PredictorOptions:
    """How the online predictor works."""

    samples: int = 1000  # S, motions drawn per prediction, 1..100000
    seed: int = 0  # of the random draws; the same frames give the same predictions
    horizon: float | None = None  # how far to predict [s]; None for as far as the method does

    def __post_init__(self) -> None:
        if not 1 <= self.samples <= 100_000:
            raise OptionError(f"samples {self.samples} is outside 1..100000")


class Predictor:
    """Follows every person it is shown and predicts both arms after each frame.

    Args:
        method: a trained method (kinecast.prediction.methods).
        noise: spread of a measured joint in its training data [m].
        scene: obstacles the arms must not enter, and goals that hands may head for; or None.
        options: see PredictorOptions.

    Raises:
        OptionError: a horizon that the method does not reach.
    """

    def __init__(
        self,
        method: Method[Any],
        noise: float = 0.0,
        scene: Scene | None = None,
        options: PredictorOptions | None = None,
    ) -> None:
        self.options = options or PredictorOptions()
        self.method = method if self.options.horizon is None else shortened(method, self.options.horizon)
        self.noise = noise
        self.scene = scene
        self._tracks: dict[str, Track] = {}
        self._warm_up()

    @classmethod
    def load(cls, model: str | Path, scene: Scene | None = None, options: PredictorOptions | None = None) -> Predictor:
        """A predictor from a model file.

        Raises:
            ModelError: the file is no model of this kinecast.
        """
        from kinecast.prediction.methods import read_method  # here, since a method may bring its own reader

        card, method = read_method(Path(model))
        return cls(method, card.noise, scene, options)

    @classmethod
    def shipped(cls, scene: Scene | None = None, options: PredictorOptions | None = None) -> Predictor:
        """A predictor with the best model that comes with kinecast."""
        from kinecast.prediction.methods import read_shipped

        card, method = read_shipped("kinecast")
        return cls(method, card.noise, scene, options)

    def _warm_up(self) -> None:
        """Observes a resting figure, so that the first frame is as fast as the thousandth."""
        for stamp in self.method.dt * np.arange(self.method.frames + 1):
            self._observe(SkeletonFrame(float(stamp), ARM_JOINTS, STANDING), float(stamp))
        self._tracks.clear()

    def observe(self, frame: SkeletonFrame, now: float | None = None) -> Prediction:
        """Takes in one frame and predicts.

        Args:
            frame: the newest skeleton of one person.
            now: the present time on the frame's clock [s]. Predicted steps that have already passed are left out,
                so that the delay between acquisition and now is compensated for. None: no delay.

        Returns:
            The prediction. Its status says what was wrong, with advice; nothing is ever raised.
        """
        started = time.perf_counter()
        try:
            prediction = self._observe(frame, frame.stamp if now is None else now)
        except Exception:
            # The loop of a robot must go on whatever happens here; the status makes it stop or slow down.
            log.exception("prediction failed for person %r at %r", frame.person, frame.stamp)
            prediction = self._fault(frame)
            self._forget(frame)
        milliseconds = 1e3 * (time.perf_counter() - started)
        return replace(prediction, diagnostics={**prediction.diagnostics, "milliseconds": milliseconds})

    def _observe(self, frame: SkeletonFrame, now: float) -> Prediction:
        if not np.isfinite(frame.stamp) or not np.isfinite(now):
            return self._fault(frame)
        track = self._track(frame)
        taken = track.add(frame)
        observation, trouble = track.observation(self.noise)
        if observation is None:
            return self._reachable(frame.person, track.stamps[-1], now, *track.last_seen(), trouble, track.rng)
        self._update(track, observation)
        samples = self.options.samples
        forecast = forecast_in_scene(self.method, track.state, observation, track.rng, samples, self.scene)
        covariance = joint_covariances(forecast.samples)
        if not np.isfinite(covariance).all():  # a sample that is not finite makes it so
            self._forget(frame)
            return self._fault(frame)
        times = observation.times(self.method.steps)
        ahead = _ahead(times, now)
        return Prediction(
            stamp=observation.stamp,
            times=times[ahead],
            samples=forecast.samples if ahead.all() else forecast.samples[:, ahead],
            mean=forecast.mean[ahead],
            covariance=covariance[ahead],
            joints=ARM_JOINTS,
            person=frame.person,
            status=self._status(taken, trouble, observation, forecast, now),
            diagnostics={
                **forecast.diagnostics,
                "accepted_fraction": forecast.accepted_fraction,
                "effective_sample_size": float(forecast.effective_sample_size),
                "delay": max(now - observation.stamp, 0.0),
            },
            density=_LaterSteps(forecast.density, ahead),
            goals=forecast.goals,
        )

    def _status(
        self, taken: Status, trouble: Status, observation: Observation, forecast: Forecast, now: float
    ) -> Status:
        """The worst that is known: of the delay, the scene, the window, the frame, the method."""
        delay = now - observation.stamp
        passed = observation.times(self.method.steps)[-1] <= now + 1e-9
        if passed or not -self.method.dt <= delay <= LONGEST_DELAY:
            return Status.LATE
        if forecast.effective_sample_size == 0:
            return Status.BLOCKED
        if trouble is not Status.OK:
            return trouble
        behind = forecast.diagnostics.get("skill", 0.0) < UNFAMILIAR_SKILL
        return Status.UNFAMILIAR if taken is Status.OK and behind and _speed(observation) > AT_REST else taken

    def _update(self, track: Track, observation: Observation) -> None:
        """The method learns of this frame; a camera faster than the model's grid is taken at the grid's pace."""
        if track.state_stamp == -np.inf:
            track.state = self.method.init_state()
        if observation.stamp >= track.state_stamp + 0.9 * self.method.dt:
            track.state = self.method.update(track.state, observation, track.arms[-1])
            track.state_stamp = observation.stamp

    def _forget(self, frame: SkeletonFrame) -> None:
        """The method remembers nothing of this person any more: what it learned may be why it failed."""
        if frame.person in self._tracks:
            self._tracks[frame.person].state_stamp = -np.inf

    def _track(self, frame: SkeletonFrame) -> Track:
        """This person's track; persons long unseen, and the longest unseen of too many, are forgotten."""
        if frame.person not in self._tracks:
            for person, track in list(self._tracks.items()):
                if track.stamps and frame.stamp - track.stamps[-1] > FORGET_AFTER:
                    del self._tracks[person]
            if len(self._tracks) >= MOST_PERSONS:
                newest = {person: max(track.stamps, default=-np.inf) for person, track in self._tracks.items()}
                del self._tracks[min(newest, key=lambda person: newest[person])]
            # A generator each: who else is in view changes nothing.
            rng = np.random.default_rng([self.options.seed, *frame.person.encode()])
            self._tracks[frame.person] = Track(self.method.dt, self.method.frames, rng)
        return self._tracks[frame.person]

    def _fault(self, frame: SkeletonFrame) -> Prediction:
        """What is said of a frame that cannot be used: nothing but NaN."""
        try:
            stamp = float(frame.stamp)
        except (TypeError, ValueError, OverflowError):
            stamp = 0.0
        stamp = stamp if np.isfinite(stamp) else 0.0
        rng = np.random.default_rng(self.options.seed)
        nowhere = np.full((6, 3), np.nan)
        return self._reachable(frame.person, stamp, stamp, nowhere, np.zeros(6), Status.FAULT, rng)

    def _reachable(
        self,
        person: str,
        stamp: float,
        now: float,
        seen: Float[np.ndarray, "6 3"],
        age: Float[np.ndarray, "6"],
        status: Status,
        rng: np.random.Generator,
    ) -> Prediction:
        """All that a person can reach from where the arms were last seen: said while nothing better is known.

        Args:
            seen: (6, 3) last known place of each joint [m]; NaN where never seen, and so is what is predicted.
            age: (6,) how long before the stamp that was [s].
        """
        times = stamp + self.method.dt * np.arange(1, self.method.steps + 1)
        times = times[_ahead(times, now)]
        reach = HAND_SPEED * ((times - stamp)[:, None] + age)
        directions = rng.standard_normal((self.options.samples, 1, 6, 3))
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        radii = np.cbrt(rng.random((self.options.samples, 1, 6, 1)))
        return Prediction(
            stamp=stamp,
            times=times,
            samples=seen + directions * radii * reach[..., None],
            mean=np.repeat(seen[None], len(times), axis=0),
            # A ball filled evenly has variance r²/5 along each axis.
            covariance=(reach**2 / 5)[..., None, None] * np.eye(3),
            joints=ARM_JOINTS,
            person=person,
            status=status,
            diagnostics={
                "accepted_fraction": 1.0,
                "effective_sample_size": float(self.options.samples),
                "delay": max(now - stamp, 0.0),
            },
        )


def _speed(observation: Observation) -> float:
    """Mean speed over the window of the joint that went farthest [m/s]."""
    way = np.linalg.norm(observation.positions[-1] - observation.positions[0], axis=-1)
    return float(way.max()) / (observation.dt * (len(observation.positions) - 1))


def _ahead(times: Float[np.ndarray, " T"], now: float) -> Bool[np.ndarray, " T"]:
    """(T,) the instants still to come; the last one alone where none is."""
    ahead = times > now + 1e-9
    ahead[-1] |= not ahead.any()
    return np.asarray(ahead)


@dataclass(frozen=True)
class _LaterSteps:
    """A density asked only at the steps still ahead."""

    density: Density
    ahead: np.ndarray

    def log_prob(self, positions: Float[np.ndarray, "T 6 3"]) -> Float[np.ndarray, " T"]:
        whole = np.full((len(self.ahead), 6, 3), np.nan)
        whole[self.ahead] = positions
        return self.density.log_prob(whole)[self.ahead]
