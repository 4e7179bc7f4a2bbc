"""A trained model as a file: plain arrays and a JSON card in one npz. Nothing in it is ever executed."""

from __future__ import annotations

import dataclasses
import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np

from kinecast.body.limits import AngleLimit, JointLimits
from kinecast.body.skeleton import ARM_JOINTS
from kinecast.errors import ModelError
from kinecast.output import draft

FORMAT = "kinecast-model"
VERSION = 1
LARGEST = 256 * 2**20
"""Most bytes a model may hold once unpacked."""
MOST_ARRAYS = 4096
CARD = "card"
PLAIN: dict[Any, tuple[type, ...]] = {
    "str": (str,), "int": (int,), "float": (int, float), "float | None": (int, float, type(None)),
}  # fmt: skip
NESTED: dict[Any, type] = {"JointLimits": JointLimits, "AngleLimit": AngleLimit}
"""Types of the card's entries, by the annotations of its fields."""

A = TypeVar("A", bound="Arrays")


class Arrays:
    """Base of dataclasses whose fields are arrays and dataclasses of them: they go into a model file by name."""

    PRECISION: ClassVar[type[np.floating]] = np.float64

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Each field by its name; the fields of a field as `name.field`."""
        arrays: dict[str, np.ndarray] = {}
        for name in (f.name for f in dataclasses.fields(self)):  # type: ignore[arg-type]
            value = getattr(self, name)
            if isinstance(value, Arrays):
                arrays |= {f"{name}.{inner}": array for inner, array in value.to_arrays().items()}
            else:
                arrays[name] = np.asarray(value)
        return arrays

    @classmethod
    def from_arrays(cls: type[A], arrays: Mapping[str, np.ndarray], prefix: str = "", **parts: Arrays) -> A:
        """What `to_arrays` described, from names that begin with the prefix, its fields that are not arrays given.

        Raises:
            ModelError: an array is missing.
        """
        names = [f.name for f in dataclasses.fields(cls) if f.name not in parts]  # type: ignore[arg-type]
        own = {name: np.asarray(_present(arrays, prefix + name), cls.PRECISION)[()] for name in names}
        return cls(**parts, **own)


@dataclass(frozen=True)
class ModelCard:
    """What a model is and what it was trained on; written into its file.

    Attributes:
        method: name of the method, e.g. `"gp_constrained"`.
        frames: N, observed frames.
        steps: T, predicted steps.
        rate: frames per second [Hz].
        joints: the joints it predicts.
        limits: joint limits it was trained with.
        noise: spread of a measured joint in the training data [m].
        trained_on: names of the recordings.
        windows: number of training windows.
        label: the action it was trained on; "" for all.
        seed: seed of the training.
        notes: licence of the data, how to cite it, anything else a user must know.
    """

    method: str
    frames: int
    steps: int
    rate: float
    joints: tuple[str, ...] = ARM_JOINTS
    limits: JointLimits = field(default_factory=JointLimits)
    noise: float = 0.005
    trained_on: tuple[str, ...] = ()
    windows: int = 0
    label: str = ""
    seed: int = 0
    notes: tuple[str, ...] = ()

    @property
    def dt(self) -> float:
        """Time between frames [s]."""
        return 1.0 / self.rate

    def to_json(self) -> str:
        """The card as JSON text."""
        return json.dumps({"format": FORMAT, "version": VERSION, **dataclasses.asdict(self)}, indent=1)

    @staticmethod
    def from_json(text: str, where: object) -> ModelCard:
        """The card of `to_json`; ModelError for one of another version, or a value outside its range."""
        try:
            return _card_from(json.loads(text))
        except (TypeError, ValueError, RecursionError) as error:
            raise ModelError(f"{where}: the model's card: {error}") from None


def _card_from(data: Any) -> ModelCard:
    """Raises TypeError or ValueError, without the file's name."""
    if not isinstance(data, dict) or data.pop("format", None) != FORMAT:
        raise ValueError("not a kinecast model")
    version = data.pop("version", None)
    if version != VERSION:
        raise ValueError(f"model version {version}; this kinecast reads version {VERSION}")
    names = {f.name for f in dataclasses.fields(ModelCard)}
    if not {"method", "frames", "steps", "rate"} <= set(data) <= names:
        raise ValueError(f"card with entries {sorted(data)}; expected {sorted(names)}")
    card: ModelCard = _from_entries(ModelCard, data)
    if card.joints != ARM_JOINTS:
        raise ValueError(f"a model of the joints {card.joints}; this kinecast predicts {ARM_JOINTS}")
    if not (2 <= card.frames <= 1000 and 1 <= card.steps <= 1000 and 0 < card.rate <= 1000):
        raise ValueError(
            f"frames {card.frames}, steps {card.steps}, rate {card.rate}; allowed are 2..1000, 1..1000 and (0, 1000] Hz"
        )
    if not 0 <= card.noise <= 1:
        raise ValueError(f"noise {card.noise} m is outside 0..1")
    return card


def _from_entries(kind: Any, entries: Any, within: str = "") -> Any:
    """A dataclass of these entries, each of the type that its field states."""
    found = dict(entries)
    for f in dataclasses.fields(kind):
        if f.name not in entries:
            continue
        name, value, nested = within + f.name, entries[f.name], NESTED.get(f.type)
        if f.type == "tuple[str, ...]":
            found[f.name] = tuple(map(str, value))
        else:
            kinds = (dict,) if nested else PLAIN[f.type]
            if not isinstance(value, kinds) or isinstance(value, bool):
                raise ValueError(f"{name} is {value!r}; expected {' or '.join(kind.__name__ for kind in kinds)}")
            if nested:
                found[f.name] = _from_entries(nested, value, f"{f.name}." if nested is AngleLimit else "")
    return kind(**found)


def write_model_file(path: Path, card: ModelCard, arrays: Mapping[str, np.ndarray]) -> None:
    """Writes a model whole or not at all: under another name first, then moved into place; ModelError if it cannot."""
    stored = {CARD: np.frombuffer(card.to_json().encode(), np.uint8), **arrays}
    try:
        with draft(path.parent, path.name) as folder:
            partial = folder / "part"
            with partial.open("wb") as file:
                np.savez_compressed(file, allow_pickle=False, **stored)
            partial.replace(path)
    except OSError as error:
        raise ModelError(f"{path}: cannot write ({error.strerror})") from None


def read_model_file(path: Path) -> tuple[ModelCard, dict[str, np.ndarray]]:
    """The card and arrays of a model file.

    Raises:
        ModelError: unreadable, not a kinecast model, too large, or with arrays that are not plain finite numbers.
    """
    try:
        if path.stat().st_size > LARGEST:
            raise ModelError(f"{path}: {path.stat().st_size} bytes; allowed are {LARGEST}")
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            size = sum(member.file_size for member in members)
        if size > LARGEST or len(members) > MOST_ARRAYS:
            raise ModelError(f"{path}: {size} bytes in {len(members)} arrays; allowed are {LARGEST} in {MOST_ARRAYS}")
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: np.asarray(file[name]) for name in file.files}
    except ModelError:
        raise
    except Exception as error:
        # A foreign file can fail in any way: bad zip, encrypted, unknown compression, a header that asks for terabytes.
        raise ModelError(f"{path}: not a readable model file ({error})") from None
    if CARD not in arrays or arrays[CARD].dtype != np.uint8:
        raise ModelError(f"{path}: not a kinecast model (it has no card)")
    card = ModelCard.from_json(arrays.pop(CARD).tobytes().decode(errors="replace"), path)
    for name, array in arrays.items():
        if array.dtype.kind not in "fiub" or not np.isfinite(array).all():
            raise ModelError(f"{path}: array {name} holds something other than finite numbers")
    return card, arrays


def shaped(arrays: Mapping[str, np.ndarray], name: str, *shape: int) -> np.ndarray:
    """An array of floats by its name; ModelError where it is missing or of another shape."""
    array = np.ascontiguousarray(_present(arrays, name), dtype=float)
    if array.shape != shape:
        raise ModelError(f"array {name} of shape {array.shape}; expected {shape}")
    return array


def _present(arrays: Mapping[str, np.ndarray], name: str) -> np.ndarray:
    if name not in arrays:
        raise ModelError(f"array {name} is missing; present are {sorted(arrays)}")
    return arrays[name]
