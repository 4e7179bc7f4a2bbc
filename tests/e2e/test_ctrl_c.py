"""Ctrl-C ends every command at any instant: soon, with one line, no process left behind and no half of a result."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import psutil
import pytest

START = """
import os, signal, sys, time, types
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore Ctrl-C
import kinecast.cli
from kinecast.cli import main
assert "numpy" not in sys.modules
"""
BEGUN = """
class Begun:
    def find_spec(self, name, *_):
        sys.meta_path.remove(self)
        print("begun", flush=True)
sys.meta_path.insert(0, Begun())
main()
"""
"""Says so at the first import of the command, when it hears Ctrl-C."""
SCORE = "evaluate --model {model} --test {recording} --stride 1 --repeats 1000 --samples 5000 --out out"
COMMANDS = {
    "info": ("info {recording}", 14, 3.0),
    "train": ("train {recording} --method mixer --out model.npz", 6, 5.0),
    "predict": ("predict {recording} --model {model} --out predictions.csv", 10, 4.0),
    "live": ("live --source {recording} --sink jsonl:live.jsonl", 10, 4.0),
    "evaluate": (SCORE, 5, 5.0),
    "cluster": (SCORE + " --cluster local:2", 5, 8.0),
}
"""Command, how often it is interrupted with KINECAST_LONG=1, 50 times in all, else half as often, and how late at most
[s]: most often what costs least."""
AT_ONCE = 4
LONG = 60.0
"""Of a wait for the end, on however busy a machine [s]; most take less than a second."""


def left(group: int) -> list[psutil.Process]:
    """Processes of a process group that are still there."""
    found = []
    for process in psutil.process_iter(["status"]):
        try:
            if os.getpgid(process.pid) == group and process.info["status"] != psutil.STATUS_ZOMBIE:
                found.append(process)
        except ProcessLookupError:
            pass
    return found


def interrupted(command: list[str], folder: Path, delay: float) -> tuple[int, str]:
    """Exit code and standard error of a command interrupted so long after its beginning."""
    folder.mkdir()
    process = subprocess.Popen(
        [sys.executable, "-c", START + BEGUN, *command], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, start_new_session=True,
    )  # fmt: skip
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "begun\n"
        try:
            process.wait(delay)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to this process and to its workers
        _, said = process.communicate(timeout=LONG)
        psutil.wait_procs(left(process.pid), timeout=LONG)
        assert left(process.pid) == []
    finally:
        for each in left(process.pid):
            each.kill()
    return process.returncode, said


EARLY = """
class Finder:
    def find_spec(self, name, *_):
        if name == "numba":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
main()
"""
SWALLOWED = """
class Bomb:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
def run(_):
    Bomb()
    time.sleep(100)
"""
CHANGED = """
def run(_):
    try:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(100)
    except KeyboardInterrupt:
        raise ImportError("half of a module")
"""
DEAF = """
def run(_):
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    os.kill(os.getpid(), signal.SIGINT)
    while True:
        try:
            time.sleep(100)
        except KeyboardInterrupt:
            pass
"""


COMPILED = """
import jax
def run(_):
    def interrupt(x):
        os.kill(os.getpid(), signal.SIGINT)
        return x
    jax.pure_callback(interrupt, jax.ShapeDtypeStruct((), "float32"), 1.0)
    time.sleep(100)
"""
LATE = """
class Bomb:
    def __del__(self, kill=os.kill, process=os.getpid(), number=signal.SIGINT):
        kill(process, number)
def run(_):
    sys.bomb = Bomb()
"""
"""While the interpreter takes itself apart, when handlers are gone."""
RUN = """
kinecast.cli.PATIENCE = 0.3
sys.modules["kinecast.cli.commands"] = types.SimpleNamespace(run=run)  # not what takes long to import
main()
"""


def test_ctrl_c_after_a_command_is_done_changes_nothing(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", START + LATE + RUN], cwd=tmp_path, capture_output=True, timeout=LONG)
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")


@pytest.mark.parametrize(
    "script",
    [EARLY, SWALLOWED + RUN, CHANGED + RUN, DEAF + RUN, COMPILED + RUN],
    ids=["import", "destructor", "other exception", "deaf", "compiled"],
)
def test_ctrl_c_is_one_line_wherever_it_comes(script: str, tmp_path: Path) -> None:
    command = [sys.executable, "-c", START + script]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=LONG)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "kinecast: interrupted\n")


STOPPED = """
def run(_):
    try:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(100)
    finally:
        print("the arm stands", flush=True)
"""


@pytest.mark.parametrize(("script", "out"), [(STOPPED, "the arm stands\n"), (SWALLOWED, "")])
def test_an_arm_is_stopped_first_and_the_command_ends_even_where_that_is_lost(script: str, out: str) -> None:
    command = [sys.executable, "-c", START + script + RUN, "robot"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=LONG)
    assert (done.returncode, done.stdout) == (130, out)
    assert done.stderr.endswith("kinecast: interrupted\n")


@pytest.mark.parametrize("name", COMMANDS)
def test_commands_end_whenever_they_are_interrupted(
    name: str, tables: tuple[Path, Path], model: Path, tmp_path: Path
) -> None:
    line, count, latest = COMMANDS[name]
    count = count if "KINECAST_LONG" in os.environ else count // 2
    command = line.format(recording=tables[1], model=model).split()
    delays = np.random.default_rng(sum(name.encode())).uniform(0.0, latest, count)
    with ThreadPoolExecutor(AT_ONCE) as pool:
        runs = [pool.submit(interrupted, command, tmp_path / str(k), delay) for k, delay in enumerate(delays.tolist())]
        for k, run in enumerate(runs):
            code, said = run.result()
            place = (delays[k], said)
            assert code in (0, 130), place
            assert "Traceback" not in said, place
            assert said.count("kinecast: interrupted\n") == (code == 130), place
            drafts = [path for path in (tmp_path / str(k)).rglob("*") if path.name.startswith(".")]
            assert drafts == [], place
            if code == 130 and name in ("evaluate", "cluster"):
                assert list((tmp_path / str(k)).iterdir()) == [], place
