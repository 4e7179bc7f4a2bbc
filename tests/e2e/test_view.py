"""`kinecast simulate --view` and `kinecast live --sink view://…` in headless Chromium: what is drawn, and controls."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from .browser import LONG, SCENE, Page, wait_for

pytestmark = pytest.mark.timeout(900)  # programs of the system may have to be installed first

COMMAND = (
    sys.executable,
    "-c",
    "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); from kinecast.cli import main; main()",
    "simulate",
)
"""Ctrl-C means something to it even where the tests run in the background."""


@pytest.fixture
def view(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The command, and the address it prints."""
    arguments = ("--view", "--port", "0", "--scenario", "avoid", "--predictor", "zero_velocity", "--samples", "60")
    process = subprocess.Popen(
        (*COMMAND, *arguments), cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    assert process.stdout is not None
    late = threading.Timer(LONG, process.kill)
    late.start()
    for line in process.stdout:
        if found := re.match(r"view: (http://127\.0\.0\.1:\d+) ", line):
            break
    else:
        pytest.fail(f"it ended with {process.wait(LONG)} and no address")
    late.cancel()
    yield process, found[1]
    if process.poll() is None:
        process.kill()
    process.communicate(timeout=LONG)


@pytest.fixture(scope="module")
def page(chromium: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """Of one browser for all tests."""
    opened = Page(chromium, tmp_path_factory.mktemp("profile"))
    yield opened
    opened.close()


def coloured(picture: np.ndarray, strong: int, weak: tuple[int, ...], contrast: int) -> int:
    """Pixels of the scene in which one channel outshines others by a contrast."""
    scene = picture[:, :SCENE]
    return int(np.all([scene[..., strong] - scene[..., other] > contrast for other in weak], axis=0).sum())


def test_the_cell_is_seen_played_and_scrubbed(
    page: Page, view: tuple[subprocess.Popen[str], str], tmp_path: Path
) -> None:
    process, url = view
    page.open(url)
    wait_for("moments of the simulation", lambda: page.stamp > 0.6)
    page.press("Pause")
    page.go_to(0.5)
    wait_for("half a second after the beginning", lambda: 0.4 < page.stamp <= 0.5)

    def drawn() -> bool:
        picture = page.picture()
        red, blue = coloured(picture, 0, (1, 2), 90), coloured(picture, 2, (0, 1), 50)  # cubes, the arm's joints
        skin = coloured(picture, 0, (2,), 45)
        return red > 50 and blue > 250 and skin > 700

    wait_for("cubes, arm and person", drawn)
    stamp, words, before = page.stamp, page.text("state") + page.text("figures"), page.picture()
    assert "%" in words
    assert page.text("decisions")

    page.go_to(0.1)
    wait_for("the first moments", lambda: 0 <= page.stamp <= 0.1)
    page.go_to(0.5)
    wait_for("the moment of before", lambda: page.stamp == stamp)
    wait_for("its words", lambda: page.text("state") + page.text("figures") == words)
    wait_for("its picture", lambda: np.mean(np.abs(page.picture() - before)[:, :SCENE] > 30) < 0.02)

    page.press("Play")
    wait_for("what comes later", lambda: page.stamp > stamp)
    page.open()
    process.send_signal(signal.SIGINT)
    rest, _ = process.communicate(timeout=LONG)
    assert process.returncode == 0, rest
    assert "Traceback" not in rest
    assert list(tmp_path.iterdir()) == []  # it writes nothing it was not told to


def test_people_and_their_predictions_are_seen_in_a_browser(
    page: Page, start: Callable[..., Any], tables: tuple[Path, Path]
) -> None:
    running = start("--source", f"recording:{tables[0]}?repeat=100&speed=0.2", "--sink", "view://127.0.0.1:0")
    page.open(running.sinks[0])
    shown = "document.getElementById('live')?.innerText"
    wait_for("a prediction of the recording", lambda: str(tables[0]) in (page.run(shown) or ""))

    def drawn() -> bool:
        scene = page.picture()[:, :SCENE]
        skin = np.all([scene[..., 0] - scene[..., 2] > 45, scene[..., 0] > 150], axis=0)
        shirt = np.all([scene[..., 2] - scene[..., 0] > 20, scene[..., 2] > 80], axis=0)
        return bool(skin.sum() > 500 and shirt.sum() > 500)

    wait_for("a person", drawn)
    page.open()
    said = running.end()
    assert running.sinks[0] in said


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--port", 70000), "--port 70000: allowed is 0"),
        (("--host", "no host"), "--host no host"),
        (("--predictor", "stars"), "--predictor stars: allowed are kinecast"),
    ],
)
def test_bad_options_are_named(arguments: tuple[object, ...], words: str, kinecast: Callable[..., Any]) -> None:
    done = kinecast("simulate", "--view", "--port", 0, *arguments)
    assert done.code == 2
    assert words in " ".join(done.err.split())


def test_without_viser_the_command_says_what_to_install(
    kinecast: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in list(sys.modules):
        if name.startswith("kinecast.view"):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "viser", None)
    done = kinecast("simulate", "--view")
    assert done.code == 2
    assert "pip install 'kinecast[view]'" in " ".join(done.err.split())
