"""Model files: what is written is read back, and whatever else is put in their place is refused, harmlessly."""

from __future__ import annotations

import io
import json
import math
import pickle
import struct
import tracemalloc
import zipfile
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinecast.body.limits import AngleLimit, JointLimits
from kinecast.errors import KinecastError, ModelError
from kinecast.prediction import model_file
from kinecast.prediction.method import Method, forecast_in_scene
from kinecast.prediction.methods import card_of, read_method, save_method
from kinecast.prediction.model_file import ModelCard, read_model_file, write_model_file
from kinecast.prediction.observation import Observation
from kinecast.prediction.training_windows import TrainingWindows

CARD = ModelCard("zero_velocity", 6, 3, 30.0)
LIMITS = JointLimits(elbow=AngleLimit(0.1, 2.0, math.inf), wrist_speed=1.5)


@pytest.fixture
def arrays(trained: dict[str, Method[Any]]) -> dict[str, np.ndarray]:
    """Those of the simplest method."""
    return trained["zero_velocity"].to_arrays()


def packed(path: Path, members: dict[str, bytes]) -> Path:
    """A zip of raw members."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


def npy(array: np.ndarray, allow_pickle: bool = False) -> bytes:
    file = io.BytesIO()
    np.save(file, array, allow_pickle=allow_pickle)
    return file.getvalue()


def with_card(path: Path, arrays: dict[str, np.ndarray], **changes: object) -> Path:
    """A model file whose card has other entries, or lacks those that are None."""
    entries = json.loads(CARD.to_json()) | changes
    text = json.dumps({name: value for name, value in entries.items() if value is not None})
    np.savez(path, card=np.frombuffer(text.encode(), np.uint8), **arrays)
    return path


def test_every_method_forecasts_the_same_once_read_back(
    trained: dict[str, Method[Any]],
    windows: TrainingWindows,
    observation: Observation,
    tmp_path: Path,
) -> None:
    truth = windows.future[60]
    for name, method in trained.items():
        card = card_of(name, method, windows, "reaching", ["a", "b"], ["MIT"])
        path = tmp_path / f"{name}.npz"
        save_method(path, card, method)
        read, again = read_method(path)
        assert read == card, name
        before, after = (
            forecast_in_scene(each, each.init_state(), observation, np.random.default_rng(0), 25, None)
            for each in (method, again)
        )
        np.testing.assert_allclose(after.samples, before.samples, atol=1e-12, err_msg=name)
        np.testing.assert_allclose(after.density.log_prob(truth), before.density.log_prob(truth), atol=1e-9)


def test_a_card_keeps_everything(tmp_path: Path, arrays: dict[str, np.ndarray]) -> None:
    card = ModelCard("kalman", 6, 15, 25.0, limits=LIMITS, noise=0.002, trained_on=("ä", "b/0"), windows=9, label="x",
                     seed=4, notes=("CC-BY",))  # fmt: skip
    write_model_file(tmp_path / "m.npz", card, arrays)
    read, back = read_model_file(tmp_path / "m.npz")
    assert read == card
    assert set(back) == set(arrays)
    for name in arrays:
        np.testing.assert_array_equal(back[name], arrays[name])


def test_nothing_is_half_written(
    tmp_path: Path, arrays: dict[str, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "m.npz"
    write_model_file(path, CARD, arrays)
    before = path.read_bytes()

    def full(file: io.BufferedWriter, **_: object) -> None:
        file.write(b"some of it")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(model_file.np, "savez_compressed", full)
    with pytest.raises(ModelError, match="No space left"):
        write_model_file(path, replace(CARD, seed=1), arrays)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["m.npz"]

    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(model_file.np, "savez_compressed", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_model_file(path, CARD, arrays)
    assert [file.name for file in tmp_path.iterdir()] == ["m.npz"]


def test_places_that_cannot_be_written(tmp_path: Path, arrays: dict[str, np.ndarray]) -> None:
    with pytest.raises(ModelError, match="cannot write"):
        write_model_file(tmp_path / "missing" / "m.npz", CARD, arrays)
    (tmp_path / "folder.npz").mkdir()
    with pytest.raises(ModelError, match="cannot write"):
        write_model_file(tmp_path / "folder.npz", CARD, arrays)
    assert [file.name for file in tmp_path.iterdir()] == ["folder.npz"]


def test_objects_are_not_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="Object arrays"):
        write_model_file(tmp_path / "m.npz", CARD, {"x": np.array([{}], dtype=object)})
    assert not list(tmp_path.iterdir())


class Bomb:
    """Goes off when unpickled."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return (exec, ("raise SystemExit('unpickled')",))


def broken_files(folder: Path, arrays: dict[str, np.ndarray]) -> dict[str, Path]:
    """Files that are no models, each in its own way."""
    whole = folder / "whole.npz"
    write_model_file(whole, CARD, arrays)
    content = whole.read_bytes()
    card = npy(np.frombuffer(CARD.to_json().encode(), np.uint8))
    files = {
        "empty": b"",
        "text": b"method: zero_velocity\n",
        "truncated": content[: len(content) // 2],
        "no directory": content[:-30],
        "flipped": content[:200] + bytes(b ^ 0xFF for b in content[200:260]) + content[260:],
        "pickle": pickle.dumps({"card": 1}),
        "npy": npy(np.zeros(3)),
    }
    paths = {}
    for name, data in files.items():
        paths[name] = folder / f"{name}.npz"
        paths[name].write_bytes(data)
    shape = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }"
    header = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(shape) + 1) + shape + b"\n"
    zips = {
        "no card": {"x.npy": npy(np.zeros(3))},
        "object": {"card.npy": card, "x.npy": npy(np.array([Bomb()], dtype=object), allow_pickle=True)},
        "object card": {"card.npy": npy(np.array([Bomb()], dtype=object), allow_pickle=True)},
        "terabytes": {"card.npy": card, "x.npy": header},
        "nested": {"card.npy": card, "x.npy": header.replace(shape, b"(" * len(shape))},
        "raw": {"card.npy": card, "notes.txt": b"hello"},
        "text array": {"card.npy": card, "x.npy": npy(np.array(["a"]))},
        "complex": {"card.npy": card, "x.npy": npy(np.array([1j]))},
        "nan": {"card.npy": card, "x.npy": npy(np.array([1.0, np.nan]))},
        "infinite": {"card.npy": card, "x.npy": npy(np.array([np.inf]))},
        "float card": {"card.npy": npy(np.zeros(5))},
        "card no text": {"card.npy": npy(np.full(9, 255, np.uint8))},
        "card no object": {"card.npy": npy(np.frombuffer(b"[1, 2]", np.uint8))},
        "card deep": {"card.npy": npy(np.frombuffer(b"[" * 100_000, np.uint8))},
    }
    for name, members in zips.items():
        paths[name] = packed(folder / f"{name}.npz", members)
    paths["folder"] = folder
    paths["missing"] = folder / "missing.npz"
    return paths


def test_whatever_is_no_model_is_refused_by_name(tmp_path: Path, arrays: dict[str, np.ndarray]) -> None:
    for name, path in broken_files(tmp_path, arrays).items():
        with pytest.raises(ModelError) as caught:
            read_method(path)
        assert str(path) in str(caught.value), name
        assert len(str(caught.value)) < 2000, name


def test_a_zip_bomb_is_refused_before_it_is_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = packed(tmp_path / "bomb.npz", {"x.npy": npy(np.zeros(8_000_000))})
    assert path.stat().st_size < 100_000
    monkeypatch.setattr(model_file, "LARGEST", 10_000_000)
    tracemalloc.start()
    with pytest.raises(ModelError, match="allowed are 10000000"):
        read_model_file(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2_000_000
    monkeypatch.setattr(model_file, "MOST_ARRAYS", 5)
    many = packed(tmp_path / "many.npz", {f"{k}.npy": npy(np.zeros(1)) for k in range(6)})
    with pytest.raises(ModelError, match="6 arrays"):
        read_model_file(many)


def test_a_large_file_is_not_even_opened(tmp_path: Path) -> None:
    path = tmp_path / "large.npz"
    with path.open("wb") as file:
        file.truncate(2 * 2**30)  # sparse: takes no room
    with pytest.raises(ModelError, match="2147483648 bytes"):
        read_model_file(path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "other"}, "not a kinecast model"),
        ({"version": 2}, "version 2; this kinecast reads version 1"),
        ({"method": "lstm"}, "'lstm'; this kinecast knows"),
        ({"method": 3}, "method is 3"),
        ({"joints": ["left_knee"]}, "this kinecast predicts"),
        ({"joints": 5}, "not iterable"),
        ({"frames": 1}, "allowed are 2"),
        ({"frames": 6.5}, "frames is 6.5"),
        ({"frames": True}, "frames is True"),
        ({"steps": 10**6}, "allowed are 2"),
        ({"rate": "fast"}, "rate is 'fast'"),
        ({"rate": 0.0}, "allowed are 2"),
        ({"rate": math.nan}, "allowed are 2"),
        ({"rate": None}, "expected"),
        ({"noise": -1.0}, "noise -1.0"),
        ({"noise": math.nan}, "noise nan"),
        ({"noise": "no"}, "noise is 'no'"),
        ({"seed": "x"}, "seed is 'x'"),
        ({"surprise": 1}, "surprise"),
        ({"limits": [1]}, "limits is [1]; expected dict"),
        ({"limits": {"elbow": {"lower": 2.0, "upper": 1.0, "speed": 1.0}}}, "lower must be below upper"),
        ({"limits": {"elbow": {"lower": "a", "upper": 1.0, "speed": 1.0}}}, "elbow.lower is 'a'"),
        ({"limits": {"knee": {"lower": 0.0, "upper": 1.0, "speed": 1.0}}}, "knee"),
        ({"limits": {"elbow": {"lower": 0.0}}}, "missing"),
        ({"limits": {**asdict(JointLimits()), "wrist_speed": -1.0}}, "wrist_speed"),
    ],
)
def test_cards_that_do_not_fit(
    tmp_path: Path, arrays: dict[str, np.ndarray], changes: dict[str, object], message: str
) -> None:
    path = with_card(tmp_path / "m.npz", arrays, **changes)
    with pytest.raises(ModelError) as caught:
        read_method(path)
    assert str(path) in str(caught.value)
    assert message in str(caught.value)


def test_arrays_that_do_not_fit_their_method(
    trained: dict[str, Method[Any]], windows: TrainingWindows, tmp_path: Path
) -> None:
    path = tmp_path / "m.npz"
    for name in ("kalman", "ridge", "ridge_constrained", "gp_xyz", "gp_constrained"):
        method = trained[name]
        card = card_of(name, method, windows, "", [])
        for array, values in method.to_arrays().items():
            wrong = {"missing": None, "shorter": values[..., :-1], "flat": values.ravel()[:1], "deeper": values[None]}
            for change, replacement in wrong.items():
                changed = {k: v for k, v in method.to_arrays().items() if k != array}
                if replacement is not None:
                    changed[array] = replacement
                write_model_file(path, card, changed)
                with pytest.raises(ModelError, match=r"m\.npz"):
                    read_method(path)
                assert change
        for frames, steps in ((card.frames + 1, card.steps), (card.frames, card.steps + 1)):
            if name == "gp_xyz" and steps != card.steps:
                continue  # one-step processes go as far as they are asked to
            write_model_file(path, replace(card, frames=frames, steps=steps), method.to_arrays())
            with pytest.raises(ModelError, match=r"m\.npz"):
                read_method(path)


@pytest.mark.parametrize(
    ("name", "array"), [("kalman", "cholesky"), ("gp_xyz", "noise"), ("gp_angles", "length_spread")]
)
def test_spreads_that_are_not_above_zero_are_refused(
    trained: dict[str, Method[Any]],
    windows: TrainingWindows,
    tmp_path: Path,
    name: str,
    array: str,
) -> None:
    arrays = trained[name].to_arrays()
    write_model_file(
        tmp_path / "m.npz",
        card_of(name, trained[name], windows, "", []),
        {**arrays, array: 0.0 * arrays[array]},
    )
    with pytest.raises(ModelError, match=array):
        read_method(tmp_path / "m.npz")


def test_refusals_are_kinecasts_own_errors() -> None:
    assert issubclass(ModelError, KinecastError)
    assert issubclass(ModelError, ValueError)
