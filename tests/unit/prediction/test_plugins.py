"""Methods named MODULE:FUNCTION: taken where they do what a method must do, refused by name where not."""

from __future__ import annotations

from pathlib import Path

import jaxtyping
import pytest

from kinecast.cli.evaluate import method_names
from kinecast.errors import ModelError, OptionError
from kinecast.prediction.methods import read_method
from kinecast.prediction.plugins import is_plugin, load_plugin, train_plugin
from kinecast.prediction.training_windows import TrainingWindows

MODULE = """
import numpy as np
from dataclasses import dataclass, replace
from kinecast.prediction.linear import zero_velocity
from kinecast.prediction.gaussian import PositionGaussian
from kinecast.prediction.method import Memoryless

good = PositionGaussian(6, 3, 1 / 30, zero_velocity(6, 3), 0.1 * np.eye(54))

@dataclass(frozen=True)
class Wrong(Memoryless):
    how: object
    frames: int = 6
    steps: int = 3
    dt: float = 1 / 30
    def forecast(self, state, observation, rng, samples):
        return self.how(good.forecast(state, observation, rng, samples))
    def to_arrays(self):
        return {}

def fit(windows): return replace(good, frames=windows.shape[0])
def trained(): return good
def long(windows): return replace(good, steps=4)
def nothing(): return None
def string(): return Wrong(lambda _: "a forecast")
def shapes(): return Wrong(lambda made: replace(made, samples=made.samples[:, :2]))
def infinite(): return Wrong(lambda made: replace(made, mean=made.mean + np.inf))
def random(): return Wrong(lambda made: replace(made, samples=made.samples + np.random.default_rng().random()))
number = 7
"""


@pytest.fixture(scope="module", autouse=True)
def elsewhere(tmp_path_factory: pytest.TempPathFactory) -> None:
    """The working folder, with the module above in it."""
    folder = tmp_path_factory.mktemp("own")
    (folder / "their_methods.py").write_text(MODULE)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        yield


def test_names_with_a_colon_are_functions_unless_they_are_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert is_plugin("own.methods:fit")
    assert not any(map(is_plugin, ["ridge", "a/b.npz", "C:\\models\\a.npz", "a:b:c", "a:"]))
    Path("model:one").touch()
    assert not is_plugin("model:one")
    assert method_names("ridge, a.b:fit") == ["ridge", "a.b:fit"]
    assert method_names("a.b:fit") == ["a.b:fit"]
    with pytest.raises(OptionError, match="unknown method ridges;"):
        method_names("ridges,a.b:fit")


def test_methods_are_taken(windows: TrainingWindows) -> None:
    assert train_plugin("their_methods:fit", windows).steps == 3
    card, method = read_method(Path("their_methods:trained"))
    assert (card.method, card.frames, card.steps) == ("their_methods:trained", method.frames, method.steps)
    assert card.rate == pytest.approx(30.0)


@pytest.mark.parametrize(
    ("name", "error", "problem"),
    [
        ("no_such_module:fit", OptionError, "No module named 'no_such_module'"),
        ("their_methods:missing", OptionError, "their_methods has no function missing"),
        ("their_methods:number", OptionError, "has no function number"),
        ("their_methods:nothing", ModelError, "gave NoneType, which lacks one of frames, steps, dt"),
        ("their_methods:string", ModelError, "forecast gave str"),
        ("their_methods:shapes", ModelError, r"samples of shape \(8, 2, 6, 3\), expected \(8, 3, 6, 3\)"),
        ("their_methods:infinite", ModelError, r"mean of shape \(3, 6, 3\), .* all of it finite"),
        ("their_methods:random", ModelError, "equal generators give unequal samples"),
    ],
)
def test_what_breaks_the_contract_is_named(
    name: str, error: type[Exception], problem: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)  # users have no type checks at run time
    with pytest.raises(error, match=f"^{name}: .*{problem}"):
        load_plugin(name)


def test_another_horizon_is_named(windows: TrainingWindows) -> None:
    with pytest.raises(ModelError, match=r"is for 6 frames, 4 steps, 0\.0333333 s; trained on 6 frames, 3 steps"):
        train_plugin("their_methods:long", windows)
