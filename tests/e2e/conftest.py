"""Generated recordings and a model in files, and the command line run inside this process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from kinecast.cli import main
from kinecast.datasets import table
from kinecast.datasets.synthetic import SyntheticOptions, generate, table_scene
from kinecast.geometry.shapes import Box

PEOPLE = SyntheticOptions(subjects=2, recordings=1, duration=12.0)


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
    """Two files, each with twelve seconds of another person moving cubes on a table."""
    folder = tmp_path_factory.mktemp("recordings")
    first, second = generate(PEOPLE, seed=3)
    for name, recording in (("first", first), ("second", second)):
        table.write(folder / f"{name}.parquet", [recording])
    return folder / "first.parquet", folder / "second.parquet"


@pytest.fixture(scope="session")
def scene_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The table of the generated people as a scene file."""
    (top,) = table_scene(PEOPLE).obstacles
    assert isinstance(top, Box)
    x, y, thickness = top.size.tolist()
    path = tmp_path_factory.mktemp("scenes") / "table.yaml"
    path.write_text(
        f"table:\n  height: {PEOPLE.table_height}\n  center: {top.center[:2].tolist()}\n"
        f"  extent: {[x, y]}\n  thickness: {thickness}\n"
    )
    return path


@pytest.fixture(scope="session")
def model(tables: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small constrained model of the first person."""
    path = tmp_path_factory.mktemp("models") / "ridge.npz"
    main(["train", str(tables[0]), "--method", "ridge_constrained", "--out", str(path)])
    return path
