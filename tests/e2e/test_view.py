"""`kinecast simulate --view` in headless Chromium: what is drawn, and what the controls do."""

from __future__ import annotations

import base64
import io
import itertools
import json
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from websockets.sync.client import connect

LONG = 240.0
"""Of a wait for another process, on however busy a machine [s]; most take a second."""
WIDE, HIGH, SCENE = 960, 600, 560
"""Of the page; the cell is drawn left of the panel [pixels]."""
POLL = 0.2
"""Between two looks [s]."""
COMMAND = (
    sys.executable,
    "-c",
    "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); from kinecast.cli import main; main()",
    "simulate",
)
"""Ctrl-C means something to it even where the tests run in the background."""


def wait_for(what: str, look: Callable[[], Any]) -> Any:
    """The first look that is something."""
    end = time.monotonic() + LONG
    while time.monotonic() < end:
        if found := look():
            return found
        time.sleep(POLL)
    pytest.fail(f"{what}: not within {LONG:.0f} s")


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


class Page:
    """One page of a browser, driven through the DevTools protocol."""

    def __init__(self, program: str, folder: Path, url: str) -> None:
        switches = (
            "--headless=new", "--no-sandbox", "--no-first-run",
            "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-dev-shm-usage",
            "--remote-debugging-port=0", f"--user-data-dir={folder}",
        )  # fmt: skip
        self._process = subprocess.Popen(
            (program, *switches, "about:blank"), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        port_file = folder / "DevToolsActivePort"
        port = wait_for("the browser's port", lambda: port_file.exists() and port_file.read_text().split()[:1])[0]
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json", timeout=LONG) as answer:
            target = next(each for each in json.load(answer) if each["type"] == "page")
        self._socket = connect(target["webSocketDebuggerUrl"], max_size=None, proxy=None, open_timeout=LONG)
        self._numbers = itertools.count(1)
        self.call("Emulation.setDeviceMetricsOverride", width=WIDE, height=HIGH, deviceScaleFactor=1, mobile=False)
        self.call("Page.navigate", url=url)

    def call(self, method: str, **parameters: object) -> Any:
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=LONG))
            if answer.get("id") == number:
                assert "error" not in answer, answer
                return answer["result"]

    def run(self, script: str) -> Any:
        """A JavaScript expression's value; None where it fails, as before the page is there."""
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True)
        return None if "exceptionDetails" in answer else answer["result"].get("value")

    def text(self, name: str) -> str:
        """What a part of the panel says."""
        return self.run(f"document.getElementById({json.dumps(name)}).innerText") or ""

    def press(self, label: str) -> None:
        """Clicks the button of this label, once it is there."""
        button = f"[...document.querySelectorAll('button')].find(each => each.innerText.trim() === {json.dumps(label)})"
        wait_for(f"the button {label}", lambda: self.run(f"({button}.click(), true)"))

    @property
    def stamp(self) -> float:
        """Of the moment that is shown [s]; -1 without one."""
        return float(self.run("document.getElementById('state').dataset.stamp") or -1)

    def go_to(self, seconds: float) -> None:
        """Types a time beside the slider."""
        self.run(
            "(() => { const field = document.querySelector('input.mantine-NumberInput-input');"
            "const set = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set;"
            f"field.focus(); set.call(field, '{seconds}');"
            "field.dispatchEvent(new Event('input', {bubbles: true})); field.blur(); })()"
        )

    def picture(self) -> np.ndarray:
        """(HIGH, WIDE, 3) what is on the screen, 0..255."""
        content = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return np.asarray(Image.open(io.BytesIO(content)).convert("RGB"), dtype=np.int16)

    def close(self) -> None:
        self._socket.close()
        self._process.terminate()
        self._process.wait(LONG)


@pytest.fixture
def view(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The command, and the address it prints."""
    arguments = ("--view", "--port", "0", "--scenario", "avoid", "--predictor", "zero_velocity", "--samples", "60")
    process = subprocess.Popen(
        (*COMMAND, *arguments), cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    assert process.stdout is not None
    for line in process.stdout:
        if found := re.match(r"view: (http://127\.0\.0\.1:\d+) ", line):
            break
    else:
        pytest.fail(f"it ended with {process.wait(LONG)} and no address")
    yield process, found[1]
    if process.poll() is None:
        process.kill()
    process.communicate(timeout=LONG)


def coloured(picture: np.ndarray, strong: int, weak: tuple[int, ...], contrast: int) -> int:
    """Pixels of the scene in which one channel outshines others by a contrast."""
    scene = picture[:, :SCENE]
    return int(np.all([scene[..., strong] - scene[..., other] > contrast for other in weak], axis=0).sum())


def test_the_cell_is_seen_played_and_scrubbed(
    chromium: str, view: tuple[subprocess.Popen[str], str], tmp_path: Path
) -> None:
    process, url = view
    page = Page(chromium, tmp_path / "profile", url)
    try:
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
    finally:
        page.close()
    process.send_signal(signal.SIGINT)
    assert process.stdout is not None
    rest = process.stdout.read()
    assert process.wait(LONG) == 0, rest
    assert "Traceback" not in rest
    assert list(tmp_path.iterdir()) == [tmp_path / "profile"]  # it writes nothing it was not told to


def test_a_port_that_is_taken_is_named(kinecast: Callable[..., Any]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        done = kinecast("simulate", "--view", "--port", port)
    assert done.code == 2
    assert f"--port {port}: nothing can listen there" in " ".join(done.err.split())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--port", 70000), "--port 70000: allowed is 0"),
        (("--host", "no host"), "--host no host"),
        (("--predictor", "stars"), "--predictor stars: allowed are kinecast"),
        (("--scenario", "dance"), "--scenario dance: allowed are avoid"),
        (("--person", "/nowhere.csv"), "nowhere.csv"),
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
        if name.startswith(("kinecast.service", "kinecast.cli.view")):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "viser", None)
    done = kinecast("simulate", "--view")
    assert done.code == 2
    assert "pip install 'kinecast[view]'" in " ".join(done.err.split())
