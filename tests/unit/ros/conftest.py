"""Random messages, predictions, and every type that is used."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys.msg import normalize_msgtype

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.live.publication import Publication
from kinecast.predictor import Predictor, PredictorOptions
from kinecast.ros.messages import Messages
from kinecast.types import SkeletonFrame

REST = np.array([[0, 0.2, 1.4], [0, 0.25, 1.1], [0.2, 0.2, 1.0], [0, -0.2, 1.4], [0, -0.25, 1.1], [0.2, -0.2, 1.0]])
MODEL = Path(__file__).resolve().parents[3] / "src" / "kinecast" / "data" / "models" / "zero_velocity.npz"

Publish = Callable[..., Publication]
RandomFields = Callable[[Messages, str, np.random.Generator], dict[str, Any]]


@pytest.fixture
def publish() -> Publish:
    """publish(arms, stamp, person="0") → Publication of one frame, acquired at its stamp."""
    predictor = Predictor.load(MODEL, options=PredictorOptions(samples=60, horizon=0.5))

    def make(arms: np.ndarray = REST, stamp: float = 0.0, person: str = "0") -> Publication:
        frame = SkeletonFrame(stamp, ARM_JOINTS, arms, person, "cell")
        return Publication.of(1, "camera", frame, predictor.observe(frame), 0.9, stamp)

    return make


@pytest.fixture(scope="session")
def random_fields() -> RandomFields:
    """random_fields(messages, type, rng): a value for every field, in sequences of 0 to 2 elements."""

    def plain(kind: str, rng: np.random.Generator) -> Any:
        if kind == "string":
            return "".join(rng.choice(list("aßz 日/_"), rng.integers(0, 9)))
        if kind == "bool":
            return bool(rng.integers(2))
        if kind.startswith("float"):
            return float(np.dtype(kind).type(rng.normal()))
        if kind in ("byte", "char"):
            return int(rng.integers(0, 128))
        limits = np.iinfo(kind)
        return int(rng.integers(limits.min, limits.max, endpoint=True, dtype=limits.dtype))

    def value(messages: Messages, node: Nodetype, kind: Any, rng: np.random.Generator) -> Any:
        if node == Nodetype.BASE:
            return plain(kind[0], rng)
        if node == Nodetype.NAME:
            if kind in ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"):
                return int(rng.integers(0, 2**31)) + int(rng.integers(0, 1000)) / 1000
            return fields(messages, kind, rng)
        part, length = kind
        return [value(messages, *part, rng) for _ in range(length or rng.integers(0, 3))]

    def fields(messages: Messages, type_: str, rng: np.random.Generator) -> dict[str, Any]:
        defined = messages.store.fielddefs[normalize_msgtype(type_)][1]
        return {name: value(messages, *kind, rng) for name, kind in defined}

    return fields
