"""Generated recordings and a model in files, and the command line run inside this process."""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from benchmarks import generated_people
from benchmarks.generated_people import SyntheticOptions, generate

from kinecast.cli.commands import run
from kinecast.datasets import table

MODEL = Path(__file__).resolve().parents[2] / "src" / "kinecast" / "data" / "models" / "zero_velocity.npz"
LIVE = (
    sys.executable,
    "-c",
    "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); from kinecast.cli import main; main()",
    "live",
    "--model",
    str(MODEL),
    "--samples",
    "50",
)
"""Ctrl-C means something to it even where the tests run in the background."""
LONG = 240.0
"""Of a wait for another process, on however busy a machine [s]; most take a second."""
PEOPLE = SyntheticOptions(subjects=2, recordings=1, duration=5.0)


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

    def outcome(*arguments: object) -> Outcome:
        capsys.readouterr()
        try:
            run([str(argument) for argument in arguments])
            code = 0
        except SystemExit as exit_:
            code = int(exit_.code or 0)
        return Outcome(code, *capsys.readouterr())

    return outcome


@pytest.fixture(scope="session")
def tables(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two files, each with five seconds of another person moving cubes on a table."""
    folder = tmp_path_factory.mktemp("recordings")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(generated_people, "JUMPS", 0.0)
        first, second = generate(PEOPLE, seed=3)
    for name, recording in (("first", first), ("second", second)):
        table.write(folder / f"{name}.parquet", [recording])
    return folder / "first.parquet", folder / "second.parquet"


def leave_undrawn(patch: pytest.MonkeyPatch) -> None:
    """Evaluations write their scores, and empty files for the rest: fast."""
    from kinecast.evaluation import report

    def draw(path: Path, *_: object) -> None:
        path.touch()

    def write(_metrics: object, _histograms: object, folder: Path, _pictures: object) -> None:
        (folder / "report.html").touch()

    patch.setattr(report, "draw_prediction", draw)
    patch.setattr(report, "animate_predictions", draw)
    patch.setattr(report, "write_report", write)


@pytest.fixture
def no_drawing(monkeypatch: pytest.MonkeyPatch) -> None:
    """See `leave_undrawn`."""
    leave_undrawn(monkeypatch)


@pytest.fixture(scope="session")
def scene_file() -> Path:
    """The table of the generated people."""
    return Path(__file__).parents[2] / "examples" / "scenes" / "generated_table.yaml"


@pytest.fixture(scope="session")
def model(tables: tuple[Path, Path], scene_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small constrained model of the first person at the table."""
    path = tmp_path_factory.mktemp("models") / "kalman.npz"
    options = ["--method", "kalman_constrained", "--scene", str(scene_file), "--out", str(path)]
    run(["train", str(tables[0]), *options])
    return path


@dataclass
class Running:
    """`kinecast live`, and the addresses it printed."""

    process: subprocess.Popen[str]
    sources: list[str]
    sinks: list[str]

    def end(self, number: int = signal.SIGINT) -> str:
        """What it prints when it is told to end."""
        self.process.send_signal(number)
        rest, _ = self.process.communicate(timeout=LONG)
        assert self.process.returncode == 0, rest
        assert "Traceback" not in rest
        return rest


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Running]]:
    """start("--source", …) → Running, in the folder of the test; environment={…} adds to that of this process."""
    started: list[subprocess.Popen[str]] = []

    def run(*arguments: str, environment: dict[str, str] | None = None) -> Running:
        process = subprocess.Popen(
            (*LIVE, *arguments), cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            env=os.environ | (environment or {}),
        )  # fmt: skip
        started.append(process)
        found: dict[str, list[str]] = {"source": [], "sink": []}
        said = []
        assert process.stdout is not None
        for line in process.stdout:
            said.append(line)
            if line.startswith("Ctrl-C ends it"):
                return Running(process, found["source"], found["sink"])
            if match := re.match(r"(source|sink): (\S+)", line):
                found[match[1]].append(match[2])
        pytest.fail(f"it ended with {process.wait(LONG)} and no address: {''.join(said)}")

    yield run
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate(timeout=LONG)


@pytest.fixture(scope="session")
def debian() -> Callable[..., None]:
    """debian("chromium") installs packages of Debian where this is root on Debian; elsewhere it does nothing."""

    def install(*packages: str) -> None:
        if os.geteuid() != 0 or shutil.which("apt-get") is None:
            return
        with (Path(tempfile.gettempdir()) / "kinecast-tests-apt.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # tests run in several processes, apt-get does not
            for arguments in (("update",), ("install", "-y", "--no-install-recommends", *packages)):
                subprocess.run(("apt-get", "-q", *arguments), capture_output=True, timeout=LONG, check=False)

    return install


@pytest.fixture(scope="session")
def chromium(debian: Callable[..., None]) -> str:
    """The browser's program: one that is there, else Debian's."""

    def program() -> str | None:
        return next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)

    if program() is None:
        debian("chromium")
    found = program()
    if found is None:
        pytest.skip("no Chromium, and it could not be installed with apt-get")
    return found
