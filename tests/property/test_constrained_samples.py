"""No sample of a constrained method violates anything: any window, any limits, any scene."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from benchmarks.generated_people import SyntheticOptions, generate
from hypothesis import given, settings
from hypothesis import strategies as st

from kinecast.body.limits import AngleLimit, JointLimits, violations
from kinecast.body.posture import USUAL_RANGE, points_from_postures, postures_from_points
from kinecast.datasets.windows import WindowOptions
from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Box, HalfSpace, Shape, Sphere
from kinecast.pipeline import training_windows
from kinecast.prediction.gaussian import PostureGaussian
from kinecast.prediction.linear import constant_velocity
from kinecast.prediction.method import forecast_in_scene
from kinecast.prediction.methods import shipped_methods, train
from kinecast.prediction.observation import Observation
from kinecast.prediction.paper import PostureSeries

DT = 1.0 / 30.0
STEPS = 4
SAMPLES = 60
UP = np.array([0.0, 0.0, 1.0])


@cache
def fitted() -> PostureGaussian:
    """A Kalman filter trained on generated people."""
    recordings = generate(SyntheticOptions(subjects=1, recordings=2, duration=4.0), seed=1)
    windows = training_windows(recordings, WindowOptions(window=0.2, horizon=STEPS * DT))
    method = train(["kalman_constrained"], windows)["kalman_constrained"]
    assert isinstance(method, PostureGaussian)
    return method


@cache
def shipped() -> PostureSeries:
    """The paper's method, as it comes with kinecast, over fewer steps."""
    method = shipped_methods()[1]["gp_constrained"]
    assert isinstance(method, PostureSeries)
    return replace(method, steps=STEPS, length_spread=method.length_spread[:STEPS])


def wild(spread: float, limits: JointLimits) -> PostureGaussian:
    """Constant velocity with an error as large as may be: nearly every draw violates something."""
    factor = spread * (np.eye(18 * STEPS) + 0.3 * np.tril(np.ones((18 * STEPS, 18 * STEPS)), -1))
    # Bones stay bones, and the torso does not turn over: no constraint holds them.
    others = [18 * t + k for t in range(STEPS) for k in (0, 1, 2, 3, 4, 5, 10, 11, 16, 17)]
    factor[others] *= 0.02
    return PostureGaussian(6, STEPS, DT, constant_velocity(6, STEPS), factor, 0.002, limits)


# Strategies draw numbers alone; what they mean is built inside the test.
Numbers = list[float]
unit = st.floats(0.0, 1.0)


def window(numbers: Numbers) -> Observation:
    """Somebody anywhere, arms anywhere in and out of their usual range, moving at any speed, noisy or not."""
    u = np.array(numbers)
    low = np.array([-1.5, -1.0, -2.0, 0.7, 0.3, 0.26])
    high = np.array([2.5, 1.2, 1.8, 2.4, 0.3, 0.26])
    arms = [low + (high - low) * np.append(part, [0.0, 0.0]) for part in (u[:4], u[4:8])]
    start = np.array([0, 0, 0, u[8] - 0.5, 0.8 * u[9] - 0.4, 0.36, *arms[0], *arms[1]])
    rates = np.zeros(18)
    rates[[0, 1, 2, 3, 6, 7, 9, 12, 13, 15]] = 8.0 * u[10:20] - 4.0
    postures = start + rates * DT * np.arange(-5, 1)[:, None]
    turn = 6.0 * u[20]
    spin = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    noise = np.full(6, 0.02 if u[21] > 0.5 else 0.0)
    return Observation(points_from_postures(postures) @ spin.T + np.array([1.0, 2.0, 1.4]), UP, DT, 7.0, noise)


def joint_limits(numbers: Numbers) -> JointLimits:
    """Ranges inside the usual ones, however narrow, and speeds; now and then a limit on the wrist."""
    angles = []
    for k, (low, high) in enumerate(USUAL_RANGE):
        a, b, c = numbers[3 * k : 3 * k + 3]
        lower = low + a * (high - low - 0.1)
        angles.append(AngleLimit(lower, lower + 0.05 + b * (high - lower - 0.05), (0.3, 3.0, 12.0)[int(2.9 * c)]))
    return JointLimits(*angles, wrist_speed=(None, 0.2, 1.5)[int(2.9 * numbers[12])])


def obstacles(numbers: Numbers, around: Observation) -> Scene:
    """None, one or two obstacles near elbows and wrists."""
    shapes: list[Shape] = []
    for u in (numbers[:6], numbers[6:12])[: int(2.9 * numbers[12])]:
        where = around.positions[-1, (1, 2, 4, 5)[int(3.9 * u[0])]]
        off = 0.4 * np.array(u[1:4]) - 0.2
        if u[4] < 0.4:
            shapes.append(Sphere(where + off, 0.01 + 0.14 * u[5]))
        elif u[4] < 0.8:
            shapes.append(Box(where + off, np.array([0.3, 0.2, 0.1])))
        else:
            shapes.append(HalfSpace(where - np.array([0.0, 0.0, abs(off[2])]), UP))
    return Scene(tuple(shapes))


def drawn(count: int) -> st.SearchStrategy[Numbers]:
    return st.lists(unit, min_size=count, max_size=count)


def assert_nothing_violated(
    method: PostureGaussian | PostureSeries, seen: Observation, held: JointLimits, scene: Scene
) -> None:
    forecast = forecast_in_scene(method, None, seen, np.random.default_rng(0), SAMPLES, scene)
    assert np.isfinite(forecast.samples).all()
    initial = postures_from_points(seen.points, continuous=True)[-1]
    postures = postures_from_points(seen.to_torso(forecast.samples), initial, continuous=True, usual=False)
    # What the positions say: the sampler's own angles, unless an arm is straight out sideways, where flexion and
    # rotation turn about one axis and no position tells them apart.
    position, speed = violations(postures, initial, seen.dt, held)
    assert not position.any()
    assert not speed.any()
    if forecast.effective_sample_size != 0:
        assert scene.free(forecast.samples, seen.times(STEPS)).all()
    assert not np.isnan(forecast.density.log_prob(forecast.mean)).any()


every = given(seen=drawn(22), held=drawn(13), scene=drawn(13))


@settings(max_examples=40)
@every
def test_kalman_constrained(seen: Numbers, held: Numbers, scene: Numbers) -> None:
    limits, observation = joint_limits(held), window(seen)
    assert_nothing_violated(replace(fitted(), limits=limits), observation, limits, obstacles(scene, observation))


@settings(max_examples=40)
@every
def test_gp_constrained(seen: Numbers, held: Numbers, scene: Numbers) -> None:
    limits, observation = joint_limits(held), window(seen)
    assert_nothing_violated(replace(shipped(), limits=limits), observation, limits, obstacles(scene, observation))


@pytest.mark.parametrize("spread", [1e-6, 0.05, 1.0])
@settings(max_examples=20)
@every
def test_wild_gaussians(spread: float, seen: Numbers, held: Numbers, scene: Numbers) -> None:
    limits, observation = joint_limits(held), window(seen)
    assert_nothing_violated(wild(spread, limits), observation, limits, obstacles(scene, observation))
