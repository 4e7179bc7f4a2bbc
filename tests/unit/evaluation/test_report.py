"""The report is one page with everything in it, whatever recordings are called and whatever is missing."""

from __future__ import annotations

import base64
import itertools
import os
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinecast.evaluation.report import format_table, write_report

HOSTILE = "<script>alert('1')</script>\"><img src=x onerror=alert(2)>&amp;.npy"
METHODS = ("zero_velocity", "ridge", "kinecast", "own<b>model</b>")


def metrics() -> dict[str, Any]:
    coverage = {"0.5": 0.52, "0.8": 0.79, "0.9": 0.9, "0.95": 0.93, "0.99": 0.98}
    methods: dict[str, Any] = {}
    for k, name in enumerate(METHODS):
        recording = {"mpjpe_mm": 40.0 - k, "crps_mm": 20.0, "nll": -3.0, "coverage": coverage}
        methods[name] = {
            "mpjpe_mm": 48.2 - k, "mpjpe_mm_by_step": [10.0, 20.0, None], "mpjpe_mm_stderr": 2.04,
            "moving_mpjpe_mm": 70.0, "wrist_final_mm": 111.0 + k, "nll": -2.5, "nll_stderr": 0.1,
            "kde_nll": 1.0, "crps_mm": 19.0, "energy_score_mm": 33.0,
            "coverage": coverage, "coverage_by_step": {"0.9": [0.9, 0.8, 0.7]},
            "calibrated_region_litres": {"0.9": {"typical": 0.4}},
            "violations": {"position": 0.0, "speed": 0.00001, "scene": 0.25},
            "accepted_fraction": 0.9, "effective_sample_size": 900.0, "latency_ms": {"p50": 3.0, "p99": 7.0},
            "moving": {"mpjpe_mm": 71.0, "crps_mm": 25.0, "nll": -1.0},
            "recordings": {"V002.npy": {"windows": 527, **recording}, HOSTILE: {"windows": 3, **recording}},
        }  # fmt: skip
    return {
        "settings": {"horizon": 0.5, "test": ["V002.npy", HOSTILE], "scene": None, HOSTILE: {"a": 1}},
        "ground_truth_violations": {"position": 0.02, "speed": 0.03, "scene": None},
        "methods": methods,
    }


def histograms() -> dict[str, np.ndarray]:
    return {name: np.random.default_rng(k).standard_normal(25) for k, name in enumerate(METHODS)}


class Page(HTMLParser):
    """Tags with attributes, and the text between them."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.text = ""
        self.feed(path.read_text("utf-8"))
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    picture = folder / "a_prediction_<b>.png"
    picture.write_bytes(b"\x89PNG not really")
    path = write_report(metrics(), histograms(), folder / "out", [picture])
    assert os.listdir(folder / "out") == ["report.html"]
    return path


@pytest.fixture(scope="module")
def page(path: Path) -> Page:
    return Page(path)


def test_the_page_is_whole_and_its_tags_close(page: Page) -> None:
    assert page.open == []
    assert page.tags[0][0] == "html"


def test_every_method_and_recording_is_in_it(page: Page) -> None:
    for name in (*METHODS, "V002.npy", HOSTILE):
        assert page.text.count(name) >= 2
    for heading in ("Error over the horizon", "Negative log", "Coverage", "Limits", "Recordings", "Settings"):
        assert heading in page.text
    assert sum(tag == "svg" for tag, _ in page.tags) == 5
    assert "530 windows" in page.text


def test_names_are_text_not_markup(page: Page) -> None:
    tags = [tag for tag, _ in page.tags]
    assert "script" not in tags
    assert "b" not in tags
    assert tags.count("img") == 1
    assert not any(name.startswith("on") for _, attributes in page.tags for name in attributes)


def test_the_page_needs_nothing_else(page: Page, path: Path) -> None:
    for tag, attributes in page.tags:
        for name in ("src", "href", "xlink:href", "data"):
            value = attributes.get(name) or "#"
            assert value.startswith(("data:image/png;base64,", "#")), (tag, value)
        assert tag != "link"
    text = path.read_text("utf-8")
    assert all(match.startswith("#") for match in re.findall(r"url\(([^)]*)\)", text))
    assert "@import" not in text
    assert "default-src 'none'" in text


def test_pictures_are_inlined(page: Page) -> None:
    (image,) = (attributes for tag, attributes in page.tags if tag == "img")
    assert base64.b64decode((image["src"] or "").split(",")[1]) == b"\x89PNG not really"
    assert image["alt"] == "a prediction <b>"


def test_the_numbers_are_there(page: Page, path: Path) -> None:
    for shown in ("48.2", "± 2.0", "−2.50", "90.0", "25.00", "< 0.01"):
        assert shown in page.text, shown
    text = path.read_text("utf-8")
    assert '<span class="best">45.2</span>' in text
    assert '<span class="best">48.2</span>' not in text
    assert '<span class="best">19.0</span>' not in text  # all the same: none is best


def test_any_value_may_be_missing(tmp_path: Path) -> None:
    gaps = itertools.cycle([None, float("nan"), float("inf")])

    def blank(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: item if key == "windows" else blank(item) for key, item in value.items()}
        return [next(gaps) for _ in value] if isinstance(value, list) else next(gaps)

    blanked = metrics()
    blanked["methods"] = {name: blank(each) for name, each in blanked["methods"].items()}
    blanked["ground_truth_violations"] = blank(blanked["ground_truth_violations"])
    page = Page(write_report(blanked, {}, tmp_path))
    assert METHODS[0] in page.text
    assert not re.search(r"\b(nan|inf|None)\b", page.text)
    assert METHODS[0] in format_table(blanked)


def test_without_its_picture_nothing_is_written(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        write_report(metrics(), histograms(), tmp_path / "out", [tmp_path / "missing.png"])
    assert not (tmp_path / "out").exists()


def test_the_terminal_table() -> None:
    changed = metrics()
    changed["methods"]["[red]x[/red]"] = changed["methods"].pop("ridge")
    lines = format_table(changed).splitlines()
    assert len(lines) == 4 + len(METHODS)
    assert max(map(len, lines)) < 140
    text = "\n".join(lines)
    for name in ("zero_velocity", "[red]x[/red]", "kinecast", METHODS[-1]):
        assert name in text
    assert "48.2 ± 2.0" in text
    assert "\x1b" not in text
