"""Charts name every method, keep their look, and survive gaps and hostile names."""

from __future__ import annotations

import importlib
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from kinecast.errors import MissingExtraError
from kinecast.evaluation.plots import (
    INK,
    drawable,
    figure_svg,
    method_style,
    plot_coverage,
    plot_nll_histograms,
    plot_over_horizon,
    plot_violations,
    save_figure,
)

HOSTILE = '<script>alert("1")</script> $\\frac{1}$ \x07 漢'
NAMES = ("zero_velocity", "gp_constrained", HOSTILE, "kinecast")


def charts(names: tuple[str, ...]) -> dict[str, Figure]:
    rng = np.random.default_rng(0)
    steps = {name: [10.0, None, 30.0 + k] for k, name in enumerate(names)}
    return {
        "error": plot_over_horizon(steps, 0.5, "error"),
        "nll": plot_nll_histograms({name: rng.standard_normal(25) - k for k, name in enumerate(names)}, {}),
        "coverage": plot_coverage({name: {"0.5": 0.4, "0.9": None, "0.99": 0.98} for name in names}),
        "coverage by step": plot_over_horizon({name: [80.0, None, 90.0] for name in names}, 0.5, "inside", 90.0),
        "violations": plot_violations(
            {name: {"position": 0.01, "speed": None, "scene": 0.0} for name in names}, {"position": 0.02}
        ),
    }


@pytest.fixture(scope="module")
def drawn() -> dict[str, str]:
    return {kind: figure_svg(figure, f"{kind} of <b> & 'c'") for kind, figure in charts(NAMES).items()}


def test_every_chart_names_every_method_and_is_sound_markup(drawn: dict[str, str]) -> None:
    for kind, svg in drawn.items():
        root = ElementTree.fromstring(svg)
        words = {"".join(node.itertext()) for node in root.iter("{http://www.w3.org/2000/svg}text")}
        assert {drawable(name) for name in NAMES} <= words, kind
        assert "<script" not in svg
        assert root.get("aria-label") == f"{kind} of <b> & 'c'"


def test_svg_takes_the_pages_ink_and_font(drawn: dict[str, str]) -> None:
    svg = drawn["error"]
    assert "currentColor" in svg
    assert INK not in svg
    assert "DejaVu" not in svg
    assert "#ffffff" not in svg


def test_the_same_chart_is_the_same_file(drawn: dict[str, str]) -> None:
    assert figure_svg(charts(NAMES)["nll"], "nll of <b> & 'c'") == drawn["nll"]


def test_png(tmp_path: Path) -> None:
    save_figure(charts(NAMES)["error"], tmp_path / "chart.png")
    with Image.open(tmp_path / "chart.png") as picture:
        pixels = np.asarray(picture.convert("L"))
    assert pixels[0, 0] == 255
    assert 0.01 < np.mean(pixels < 250) < 0.5


def test_nothing_to_draw_is_an_empty_chart() -> None:
    nothing = {"kinecast": np.full(3, np.nan)}
    ElementTree.fromstring(figure_svg(plot_nll_histograms(nothing, {}), "no scores"))
    ElementTree.fromstring(figure_svg(plot_over_horizon({"kinecast": [None]}, 0.5, "error"), "no errors"))


def test_one_value_and_equal_values_have_histograms() -> None:
    figure = plot_nll_histograms({"ridge": np.array([2.0]), "kalman": np.full(5, -1.0)}, {"ridge": np.nan})
    assert "2.00 ± 0.00" in figure_svg(figure, "nll")
    assert figure.axes[1].get_xlim()[1] > 0.005  # not the 1e-16 by which equal numbers differ


def test_looks_are_settled_and_tell_methods_apart() -> None:
    assert method_style("unheard_of") == method_style("unheard_of")
    assert method_style("ridge_constrained").colour == method_style("ridge").colour
    assert method_style("ridge_constrained") != method_style("ridge")
    known = [method_style(name) for name in ("zero_velocity", "constant_velocity", "kalman", "ridge", "kinecast")]
    assert len({(style.colour, style.marker, style.dashes) for style in known}) == len(known)


def test_drawable_keeps_what_the_font_has() -> None:
    assert drawable("Größe ± σ·Δ") == "Größe ± σ·Δ"
    assert drawable("a\nb\x00漢") == "a□b□□"


def test_without_matplotlib_the_error_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in [name for name in sys.modules if name.split(".")[0] == "matplotlib"]:
        monkeypatch.setitem(sys.modules, module, None)
    for module in ("plots", "scenery", "pictures", "report"):
        monkeypatch.delitem(sys.modules, f"kinecast.evaluation.{module}", raising=False)
        with pytest.raises(MissingExtraError, match=r"kinecast\[train\]"):
            importlib.import_module(f"kinecast.evaluation.{module}")
