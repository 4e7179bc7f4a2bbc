"""Small generated windows and every method trained on them, once for all tests of the prediction core."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from typing import Any

import numba
import numpy as np
import pytest
from benchmarks.generated_people import SyntheticOptions, generate

from kinecast.body.posture import points_from_postures
from kinecast.datasets.windows import WindowOptions
from kinecast.pipeline import training_windows
from kinecast.prediction import paper
from kinecast.prediction.method import Method
from kinecast.prediction.methods import METHODS, train
from kinecast.prediction.observation import Observation
from kinecast.prediction.training_windows import TrainingWindows

OWN = ("kinecast", "mixer", "mixer_constrained")
UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="session", autouse=True)
def one_thread() -> Iterator[None]:
    """Compiled loops on one core: test processes share the machine, and waiting for one another costs more."""
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    yield
    numba.set_num_threads(before)


@pytest.fixture(scope="session")
def compiled_once(tmp_path_factory: pytest.TempPathFactory) -> None:
    """What JAX compiles is kept for the next fit of this process: compiling is nearly all of a short training."""
    jax = pytest.importorskip("jax")
    jax.config.update("jax_compilation_cache_dir", str(tmp_path_factory.mktemp("jax")))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    importlib.import_module("jax.experimental.compilation_cache.compilation_cache").reset_cache()


@pytest.fixture(scope="session")
def windows() -> TrainingWindows:
    """Windows of six frames and the three that followed, from two people and four recordings."""
    recordings = generate(SyntheticOptions(subjects=2, recordings=2, duration=6.0), seed=0)
    every = training_windows(recordings, WindowOptions(window=0.2, horizon=0.1))
    return every.take(np.arange(0, len(every), 4))


@pytest.fixture(scope="session")
def trained(windows: TrainingWindows) -> dict[str, Method[Any]]:
    """Every method but the horizon model and the neural forecaster, which have tests of their own."""
    with pytest.MonkeyPatch.context() as patch:  # trained in seconds
        for name, value in (("PSEUDO_INPUTS", 8), ("ITERATIONS", 10), ("POINTS", 200)):
            patch.setattr(paper, name, value)
        return train([name for name in METHODS if name not in OWN], windows)


@pytest.fixture(scope="session")
def observation(windows: TrainingWindows) -> Observation:
    """A window of somebody at work."""
    return Observation(windows.observed[60].astype(float), windows.up[60], windows.dt, stamp=100.0)


@pytest.fixture(scope="session")
def posed() -> Observation:
    """A window with both arms bent and slowly rising, away from every degenerate pose, in a turned torso frame."""
    start = np.array(
        [0, 0, 0, 0, 0, 0.36, 0.1, 0.3, -0.5, 0.6, 0.30, 0.26, 0.1, 0.2, -0.4, 0.7, 0.30, 0.26]
    )  # layout of kinecast.body.posture
    postures = np.repeat(start[None], 6, axis=0)
    postures[:, [6, 12]] += np.linspace(-0.05, 0.0, 6)[:, None]
    postures[:, [7, 13]] += np.linspace(-0.08, 0.0, 6)[:, None]
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    positions = points_from_postures(postures) @ turn.T + np.array([0.4, -1.0, 1.4])
    return Observation(positions, UP, 1.0 / 30.0, stamp=5.0)
