"""The benchmark of the fusion on a person who is generated here, so that its figures are known to be figures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.fusion import Shown, figures, lag, one_person
from benchmarks.fusion_views import Body, Faults, images, rig

JOINTS = ("collar", "head", "pelvis", "left_shoulder", "left_elbow", "left_wrist", "right_shoulder", "right_elbow",
          "right_wrist")  # fmt: skip
REST = np.array(
    [[0, 0, 1.45], [0, 0, 1.7], [0, 0, 0.95], [0, 0.2, 1.4], [0.05, 0.28, 1.12], [0.28, 0.25, 1.1], [0, -0.2, 1.4],
     [0.05, -0.28, 1.12], [0.28, -0.25, 1.1]]
)  # fmt: skip


@pytest.fixture(scope="module")
def body() -> Body:
    """Somebody who waves a wrist for three seconds."""
    stamps = np.arange(300) / 100
    positions = np.tile(REST, (300, 1, 1))
    positions[:, 8, 1] += 0.15 * np.sin(2 * np.pi * 0.7 * stamps)
    return Body(stamps, JOINTS, positions)


def test_three_cameras_beat_each_of_them_and_find_what_one_does_not_see(body: Body) -> None:
    found = one_person([body], Faults(hidden=0.3), 0)
    best = min(found[name]["mean_mm"] for name in ("left", "right", "back"))
    assert found["fused"]["mean_mm"] < 0.75 * best
    assert found["fused"]["hidden_within_150mm"] > 0.95
    assert found["average"]["mean_mm"] > found["fused"]["mean_mm"]


def test_figures_are_of_what_is_shown(body: Body) -> None:
    unit = np.tile(np.eye(3) * 0.01**2, (len(JOINTS), 1, 1))
    hidden = np.zeros(len(JOINTS), bool)
    shown = []
    for k in range(80):
        positions = body.at(0.2 + k / 30 - 0.05) + np.array([0.0, 0.0, 0.02])  # 50 ms late, 2 cm too high
        positions[0] = np.nan
        shown.append(Shown(0.2 + k / 30, positions, unit, hidden, "1"))
    found = figures([(body, shown, 100)])
    assert found["median_mm"] == pytest.approx(20.0)
    assert found["given"] == pytest.approx(0.8 * 8 / 9)
    assert found["in_95_percent_region"] > 0.8  # two standard deviations; the wrist is further off
    assert lag([(body, shown)]) == pytest.approx(0.05, abs=0.003)


def test_views_are_what_cameras_would_see(body: Body) -> None:
    seen = images(rig(), [body], Faults(lost=0.0, dropped=0.0, scale=0.0), 0)
    assert {image.camera for image in seen} == {"left", "right", "back"}
    assert len(seen) in range(265, 273)
    for image in seen[::20]:
        exact, depth = rig().cameras[image.camera].project(body.at(image.taken))
        (view,) = image.views
        np.testing.assert_allclose(view.pixels, exact, atol=1e-6)
        assert (view.depth[2:] < depth[2:] + 0.1).all()  # skin, or an arm before it
        assert image.arrived > image.taken + 0.03
    elsewhere = replace(body, positions=body.positions + np.array([0.0, 0.0, 50.0]))
    assert not any(image.views for image in images(rig(), [elsewhere], Faults(), 0))
