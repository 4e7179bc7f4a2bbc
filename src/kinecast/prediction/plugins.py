"""Plug-ins, methods of the user's own named MODULE:FUNCTION: imported, called, held to what every method must do.

Naming one runs its code, as Python's own `-m` does; nothing in a model file ever is.
"""

from __future__ import annotations

import importlib
import os
import re
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from kinecast.errors import ModelError, OptionError
from kinecast.prediction.method import Forecast, Method
from kinecast.prediction.observation import STANDING, Observation
from kinecast.prediction.training_windows import TrainingWindows
from kinecast.tasks import CARRIED

NAME = re.compile(r"[\w.]+:[^\W\d]\w*")
SAMPLES = 8


def is_plugin(name: str) -> bool:
    """Whether a name is MODULE:FUNCTION, and no file."""
    return NAME.fullmatch(name) is not None and not os.path.exists(name)


def load_plugin(name: str) -> Method[Any]:
    """What MODULE:FUNCTION gives without arguments: a trained method. Installed modules go before the working folder's.

    Raises:
        OptionError: there is no such function.
        ModelError: what it gives is no method, or breaks what a method must do.
    """
    return _checked(_function(name)(), name)


def train_plugin(name: str, windows: TrainingWindows) -> Method[Any]:
    """What MODULE:FUNCTION makes of training windows: a method for windows like them. Raises as `load_plugin`."""
    method = _function(name)(windows)
    frames, steps, dt = windows.shape
    if isinstance(method, Method) and (
        (method.frames, method.steps) != (frames, steps) or abs(method.dt / dt - 1) > 1e-6
    ):
        found = f"{method.frames} frames, {method.steps} steps, {method.dt:g} s"
        raise ModelError(f"{name}: is for {found}; trained on {frames} frames, {steps} steps, {dt:g} s")
    return _checked(method, name)


def _function(name: str) -> Callable[..., Any]:
    place, _, function = name.partition(":")
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    try:
        module = importlib.import_module(place)
    except ImportError as error:
        raise OptionError(f"{name}: {error}") from error
    CARRIED.add(module)
    found = getattr(module, function, None)
    if not callable(found):
        raise OptionError(f"{name}: {place} has no function {function}")
    return found


def _checked(method: object, name: str) -> Method[Any]:
    """A method whose forecast of somebody who stands is what a forecast must be; ModelError where it is not."""
    if not isinstance(method, Method):
        wanted = "frames, steps, dt, init_state, update, forecast and to_arrays"
        raise ModelError(f"{name}: gave {type(method).__name__}, which lacks one of {wanted}")
    steps = method.steps
    window = np.repeat(STANDING[None], method.frames, axis=0)
    observation = Observation(window, np.array([0.0, 0.0, 1.0]), method.dt)
    forecast, again = (
        method.forecast(
            method.update(method.init_state(), observation, window[-1]), observation, np.random.default_rng(0), SAMPLES
        )
        for _ in range(2)
    )
    if not isinstance(forecast, Forecast):
        raise ModelError(f"{name}: forecast gave {type(forecast).__name__}, expected kinecast's Forecast")
    log_prob = np.asarray(forecast.density.log_prob(forecast.mean))
    for what, found, shape in (
        ("samples", forecast.samples, (SAMPLES, steps, 6, 3)),
        ("mean", forecast.mean, (steps, 6, 3)),
        ("density.log_prob(mean)", log_prob, (steps,)),
    ):
        if np.shape(found) != shape or not np.isfinite(found).all():
            raise ModelError(f"{name}: {what} of shape {np.shape(found)}, expected {shape}, all of it finite")
    if not np.array_equal(forecast.samples, again.samples):
        raise ModelError(f"{name}: equal generators give unequal samples; take all randomness from rng")
    return method
