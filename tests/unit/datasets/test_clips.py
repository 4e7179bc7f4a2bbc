"""The recordings that come with kinecast: what they hold, their size, and that they are the source's own numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import kinecast
from kinecast.body.skeleton import ARM_JOINTS
from kinecast.datasets.loading import CLIPS, load, shipped_clips
from kinecast.datasets.resampling import resample

FOLDER = Path(kinecast.__file__).parent / "data" / "clips"
TAKES = ("PickPlaceCloseHuman/0", "HumanRobotHandover/0")


def test_two_people_at_work() -> None:
    clips = shipped_clips()
    assert tuple(clip.name for clip in clips) == TAKES
    assert [(len(clip.stamps), clip.rate) for clip in clips] == [(600, 30.0), (436, 30.0)]
    for clip in clips:
        assert set(clip.joints) == {*ARM_JOINTS, "collar", "head", "pelvis"}
        assert clip.source is None  # no folder of the machine it was cut on
        assert np.isfinite(clip.positions).mean() > 0.99
        np.testing.assert_allclose(np.diff(clip.stamps), 1 / 30)
        np.testing.assert_allclose(clip.positions, clip.positions.round(4), rtol=0, atol=1e-12)
    speed = np.linalg.norm(np.diff(clips[0].joint("right_wrist"), axis=0), axis=-1) * clips[0].rate
    assert np.nanmedian(speed) > 0.5


def test_they_are_small_and_their_licence_is_beside_them() -> None:
    assert sorted(path.name for path in FOLDER.iterdir()) == sorted(
        ["LICENSE", "SOURCE.txt", *(f"{name}.csv.xz" for name in CLIPS)]
    )
    assert sum(path.stat().st_size for path in FOLDER.iterdir()) < 300_000
    assert "Copyright (c) 2023 Jakob Thumm" in (FOLDER / "LICENSE").read_text(encoding="utf-8")
    source = (FOLDER / "SOURCE.txt").read_text(encoding="utf-8")
    assert all(f"{name}.csv.xz" in source for name in CLIPS)


@pytest.mark.parametrize("take", TAKES)
def test_they_are_the_sources_numbers(data_root: Path, take: str) -> None:
    clip = shipped_clips()[TAKES.index(take)]
    (recording,) = load(data_root / "human_robot_animations" / f"{take}.csv.xz")
    expected = resample(recording, 30.0).select(slice(len(clip.stamps)))
    assert clip.joints == expected.joints
    np.testing.assert_array_equal(clip.stamps, expected.stamps)
    np.testing.assert_array_equal(clip.positions, expected.positions.round(4))
