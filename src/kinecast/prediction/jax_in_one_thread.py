"""JAX for training, in one thread: sums over several would depend on their number."""

from __future__ import annotations

import os
from functools import cache
from types import ModuleType

from kinecast.errors import MissingExtraError

__all__ = ["jax_in_one_thread"]


def jax_in_one_thread() -> ModuleType:
    """JAX, its CPU backend started with one thread unless the program had started it before.

    These fits gain nothing from more: their matrices are small.

    Raises:
        MissingExtraError: JAX is not installed.
    """
    try:
        import jax
    except ImportError as error:
        raise MissingExtraError("training", "train") from error
    _start(jax)
    return jax


@cache
def _start(jax: ModuleType) -> None:
    before = os.environ.get("NPROC")
    os.environ["NPROC"] = "1"  # read once, by XLA, when its CPU backend starts
    try:
        jax.local_devices(backend="cpu")
    finally:
        if before is None:
            del os.environ["NPROC"]
        else:
            os.environ["NPROC"] = before
