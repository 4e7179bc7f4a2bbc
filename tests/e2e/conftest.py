"""Generated recordings and a model in files, and the command line run inside this process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from kinecast.cli import main
from kinecast.datasets import table
from kinecast.datasets.synthetic import SyntheticOptions, generate

PEOPLE = SyntheticOptions(subjects=2, recordings=1, duration=5.0, jumps=0.0)


@dataclass(frozen=True)
class Outcome:
    """What a command left behind: exit code, standard output, standard error."""

    code: int
    out: str
    err: str


Kinecast = Callable[..., Outcome]


@pytest.fixture
def kinecast(capsys: pytest.CaptureFixture[str]) -> Kinecast:
    """kinecast("info", path) → Outcome."""

    def run(*arguments: object) -> Outcome:
        capsys.readouterr()
        try:
            main([str(argument) for argument in arguments])
            code = 0
        except SystemExit as exit_:
            code = int(exit_.code or 0)
        return Outcome(code, *capsys.readouterr())

    return run


@pytest.fixture(scope="session")
def tables(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two files, each with five seconds of another person moving cubes on a table."""
    folder = tmp_path_factory.mktemp("recordings")
    first, second = generate(PEOPLE, seed=3)
    for name, recording in (("first", first), ("second", second)):
        table.write(folder / f"{name}.parquet", [recording])
    return folder / "first.parquet", folder / "second.parquet"


@pytest.fixture
def no_drawing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Evaluations write their scores, and empty files for the rest: fast."""
    from kinecast.evaluation import run

    def draw(path: Path, *_: object) -> None:
        path.touch()

    def write(_metrics: object, _histograms: object, folder: Path, _pictures: object) -> None:
        (folder / "report.html").touch()

    monkeypatch.setattr(run, "draw_prediction", draw)
    monkeypatch.setattr(run, "animate_prediction", draw)
    monkeypatch.setattr(run, "write_report", write)


@pytest.fixture(scope="session")
def scene_file() -> Path:
    """The table of the generated people."""
    return Path(__file__).parents[2] / "examples" / "scenes" / "generated_table.yaml"


@pytest.fixture(scope="session")
def model(tables: tuple[Path, Path], scene_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small constrained model of the first person at the table."""
    path = tmp_path_factory.mktemp("models") / "kalman.npz"
    options = ["--method", "kalman_constrained", "--scene", str(scene_file), "--out", str(path)]
    main(["train", str(tables[0]), *options])
    return path
