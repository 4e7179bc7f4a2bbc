"""The report of an evaluation: one HTML page that needs no other file, runs no script and loads nothing."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from kinecast.errors import OptionError
from kinecast.evaluation.output import write_atomically
from kinecast.evaluation.plots import (
    Chart,
    figure_svg,
    plot_coverage,
    plot_coverage_by_horizon,
    plot_error_by_horizon,
    plot_nll_histograms,
    plot_violations,
)
from kinecast.evaluation.tables import (
    coverage_table,
    limits_table,
    main_table,
    mapping,
    moving_table,
    number,
    recordings_scores_table,
    recordings_table,
    settings_table,
)

__all__ = ["write_report"]

Metrics = Mapping[str, Any]

PICTURES = {".png": "image/png", ".gif": "image/gif"}


MEANINGS = {
    "MPJPE": "mean distance between predicted and true joints, all joints and steps (Eq. 8), ± its standard "
    "error by block bootstrap; moving: over windows in which a wrist moves faster than 0.3 m/s",
    "NLL": "negative log density of what happened (Eq. 9), exact, per joint",
    "KDE-NLL": "the same from a Gaussian kernel density estimate on the samples, clipped at 20",
    "CRPS, energy": "scores of the whole distribution in millimetres, per coordinate and per joint: the "
    "error of the mean and the width together",
    "coverage": "share of true positions inside the ellipsoid that holds 90 % of the samples; best is 90",
    "region": "volume of that ellipsoid once its radius is multiplied by the one factor with which it covers 90 %, "
    "so that all methods are compared at equal coverage; geometric mean over joints, steps and windows",
    "accepted": "share of samples that the scene leaves; effective: how many of those differ",
    "latency": "of one prediction, median and 99th percentile",
}


def write_report(
    metrics: Metrics,
    histograms: Mapping[str, Float[np.ndarray, "..."]],
    folder: Path,
    pictures: Sequence[Path] = (),
) -> Path:
    """Write `report.html`, a page that shows everything and needs no other file.

    Args:
        metrics: as in metrics.json; any value may be missing or None.
        histograms: NLL per repeat or window, by method.
        folder: for the page; made where missing.
        pictures: PNG and GIF files to show, inlined; their names are the captions.

    Returns:
        The page's path.

    Raises:
        OptionError: a picture that is neither PNG nor GIF.
        OSError: a picture cannot be read or the page not written; then there is no page.
    """
    methods = mapping(metrics, "methods")
    settings = mapping(metrics, "settings")
    names = list(dict.fromkeys(name for each in methods.values() for name in mapping(each, "recordings")))
    horizon = settings.get("horizon")
    horizon = float(horizon) if isinstance(horizon, int | float) and horizon > 0 else None
    windows = _windows(methods)
    body = [
        "<h1>Where arms will be: an evaluation</h1>",
        f'<p class="lead">{_count(len(methods), "method")} on {_count(len(names), "recording")}'
        + (f", {windows} windows" if windows else "")
        + (f", predicted {number(horizon, 2)} s ahead" if horizon else "")
        + ". Errors are means ± standard errors; the best of each column stands out.</p>",
        _scroll(main_table(methods)),
        _meanings(),
        *_pictures(pictures),
        "<h2>Error over the horizon</h2>",
        _figure(
            plot_error_by_horizon(
                {name: each.get("mpjpe_mm_by_step") or [] for name, each in methods.items()},
                horizon,
            ),
            "Mean joint error against time ahead, by method",
        ),
        "<h2>Negative log likelihood</h2>",
        "<p>How probable each method found what then happened. Histograms are over repeated "
        "evaluations with fresh random draws.</p>",
        _figure(
            plot_nll_histograms(histograms, {name: each.get("nll_stderr") for name, each in methods.items()}),
            "Mean negative log likelihood and its histogram, by method",
        ),
        "<h2>Coverage</h2>",
        "<p>A region said to hold 90 % of what can happen should hold it 90 % of the time.</p>",
        '<div class="pair">',
        _figure(
            plot_coverage({name: mapping(each, "coverage") for name, each in methods.items()}),
            "Observed against nominal coverage, by method",
        ),
        _figure(
            plot_coverage_by_horizon(
                {name: mapping(each, "coverage_by_step").get("0.9") or [] for name, each in methods.items()},
                horizon,
            ),
            "Coverage at 90 % against time ahead, by method",
        ),
        "</div>",
        _scroll(coverage_table(methods)),
        "<h2>Limits</h2>",
        "<p>Share of predicted steps outside joint ranges, speed limits and the scene, beside the measured "
        "motion itself, whose violations are mostly noise and jumps of the tracker.</p>",
        _figure(
            plot_violations(
                {name: mapping(each, "violations") for name, each in methods.items()},
                mapping(metrics, "ground_truth_violations"),
            ),
            "Share of steps outside limits, by method and as measured",
        ),
        _scroll(limits_table(metrics, methods)),
        "<h2>Moving windows</h2>",
        _scroll(moving_table(methods)),
        "<h2>Recordings</h2>",
        "<p>MPJPE [mm] of every method on every recording.</p>",
        _scroll(recordings_table(methods, names)),
        "<p>CRPS [mm], NLL [nats] and coverage at 90 % [%].</p>",
        _scroll(recordings_scores_table(methods, names)),
        "<h2>Settings</h2>",
        _scroll(settings_table(settings), "settings"),
    ]
    path = folder / "report.html"
    write_atomically(path, _page("\n".join(body)).encode())
    return path


def _page(body: str) -> str:
    style = resources.files("kinecast").joinpath("data/report.css").read_text("utf-8")
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta http-equiv="Content-Security-Policy" '
        "content=\"default-src 'none'; style-src 'unsafe-inline'; img-src data:\">\n"
        f"<title>kinecast evaluation</title>\n<style>\n{style}</style>\n</head>\n"
        f"<body>\n<main>\n{body}\n</main>\n</body>\n</html>\n"
    )


def _pictures(paths: Sequence[Path]) -> list[str]:
    if not paths:
        return []
    parts = ["<h2>Predictions</h2>"]
    for path in paths:
        kind = PICTURES.get(path.suffix.lower())
        if kind is None:
            raise OptionError(f"picture {path.name}: found {path.suffix or 'no ending'}, expected .png or .gif")
        caption = escape(path.stem.replace("_", " "))
        data = base64.b64encode(path.read_bytes()).decode("ascii")
        parts.append(
            f'<figure><img src="data:{kind};base64,{data}" alt="{caption}"><figcaption>{caption}</figcaption></figure>'
        )
    return parts


def _figure(chart: Chart, title: str) -> str:
    return f"<figure>{figure_svg(chart, title)}</figure>"


def _meanings() -> str:
    items = "".join(f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>" for name, text in MEANINGS.items())
    return f"<dl>{items}</dl>"


def _scroll(table: str, kind: str = "") -> str:
    return f'<div class="scroll {kind}">{table}</div>'


def _windows(methods: Metrics) -> int:
    """Windows scored, of the first method: all see the same."""
    for each in methods.values():
        counts = [entry.get("windows") for entry in mapping(each, "recordings").values()]
        return sum(count for count in counts if isinstance(count, int))
    return 0


def _count(things: int, noun: str) -> str:
    return f"{things} {noun}" if things == 1 else f"{things} {noun}s"
