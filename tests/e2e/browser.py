"""A page of headless Chromium."""

from __future__ import annotations

import base64
import io
import itertools
import json
import subprocess
import time
import urllib.request
from collections.abc import Callable
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
SCALE = 0.5
"""Pixels that are rendered for one of the page, along each side: without a graphics card each takes the processor."""
SELDOM = "const next = requestAnimationFrame; requestAnimationFrame = draw => setTimeout(() => next(draw), 150);"
"""Makes pages draw six pictures in a second, not sixty, for the same reason."""
POLL = 0.2
"""Between two looks [s]."""


def wait_for(what: str, look: Callable[[], Any]) -> Any:
    """The first look that is something."""
    end = time.monotonic() + LONG
    while time.monotonic() < end:
        if found := look():
            return found
        time.sleep(POLL)
    pytest.fail(f"{what}: not within {LONG:.0f} s")


class Page:
    """One page of a browser, driven through the DevTools protocol."""

    def __init__(self, program: str, folder: Path) -> None:
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
        self.call("Emulation.setDeviceMetricsOverride", width=WIDE, height=HIGH, deviceScaleFactor=SCALE, mobile=False)
        self.call("Page.enable")
        self.call("Page.addScriptToEvaluateOnNewDocument", source=SELDOM)

    def open(self, url: str = "about:blank") -> None:
        """Leaves what it showed."""
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
        picture = Image.open(io.BytesIO(content)).convert("RGB").resize((WIDE, HIGH), Image.Resampling.NEAREST)
        return np.asarray(picture, dtype=np.int16)

    def close(self) -> None:
        self._socket.close()
        self._process.terminate()
        self._process.wait(LONG)
