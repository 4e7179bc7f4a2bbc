"""`kinecast live --sink view://…` in headless Chromium."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from .browser import SCENE, Page, wait_for

pytestmark = pytest.mark.timeout(900)  # programs of the system may have to be installed first


def test_people_and_their_predictions_are_seen_in_a_browser(
    chromium: str, start: Callable[..., Any], tables: tuple[Path, Path], tmp_path: Path
) -> None:
    running = start("--source", f"recording:{tables[0]}?repeat=100", "--sink", "view://127.0.0.1:0")
    page = Page(chromium, tmp_path / "profile", running.sinks[0])
    try:
        shown = "document.getElementById('live')?.innerText"
        wait_for("a prediction of the recording", lambda: str(tables[0]) in (page.run(shown) or ""))

        def drawn() -> bool:
            scene = page.picture()[:, :SCENE]
            skin = np.all([scene[..., 0] - scene[..., 2] > 45, scene[..., 0] > 150], axis=0)
            shirt = np.all([scene[..., 2] - scene[..., 0] > 20, scene[..., 2] > 80], axis=0)
            return bool(skin.sum() > 500 and shirt.sum() > 500)

        wait_for("a person", drawn)
    finally:
        page.close()
    said = running.end()
    assert running.sinks[0] in said
