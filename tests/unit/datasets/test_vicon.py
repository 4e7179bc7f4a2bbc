"""Vicon Tracker csv."""

from __future__ import annotations

import lzma
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kinecast.body.skeleton import VICON
from kinecast.datasets import vicon
from kinecast.errors import DatasetError


@pytest.fixture
def take(tmp_path: Path) -> Path:
    path = tmp_path / "Stacking" / "3.csv"
    path.parent.mkdir()
    return path


def test_positions_names_and_missing_cells(
    take: Path, vicon_text: Callable[..., str], motion: Callable[..., np.ndarray]
) -> None:
    objects = ["hip", "right_hand", *(name for name in VICON.aliases if name not in ("hip", "right_hand"))]
    positions = motion([VICON.aliases[name] for name in objects], 8)
    positions[2:4, 1] = np.nan
    take.write_text(vicon_text(objects, positions), encoding="utf-8")
    assert vicon.matches(take)
    (recording,) = vicon.load(take)
    assert recording.name == "Stacking/3"
    assert recording.task == "Stacking"
    assert recording.format == "vicon"
    assert recording.rate == 100.0
    assert recording.joints[:2] == ("pelvis", "right_wrist")
    np.testing.assert_allclose(recording.positions, positions, atol=1e-12)
    np.testing.assert_array_equal(
        np.isfinite(recording.positions[:, 1, 0]), [True, True, False, False, True, True, True, True]
    )
    np.testing.assert_allclose(recording.stamps, np.arange(8) / 100.0)


def test_a_compressed_take_is_the_same(take: Path, vicon_text: Callable[..., str]) -> None:
    take.write_text(vicon_text(), encoding="utf-8")
    packed = take.with_suffix(".csv.xz")
    packed.write_bytes(lzma.compress(take.read_bytes()))
    (plain,), (compressed,) = vicon.load(take), vicon.load(packed)
    assert compressed.name == plain.name
    np.testing.assert_array_equal(compressed.positions, plain.positions)


def test_other_objects_are_left_out_and_noted(take: Path, vicon_text: Callable[..., str]) -> None:
    take.write_text(vicon_text(["hammer", *VICON.aliases]), encoding="utf-8")
    (recording,) = vicon.load(take)
    assert set(recording.joints) == set(VICON.joints)
    assert recording.notes == ("objects left out: hammer",)


def test_stamps_follow_the_frame_numbers(take: Path, vicon_text: Callable[..., str]) -> None:
    lines = vicon_text().splitlines()
    del lines[7]  # frame 3
    take.write_text("\n".join(lines), encoding="utf-8")
    (recording,) = vicon.load(take)
    np.testing.assert_allclose(recording.stamps, np.array([0, 1, 3, 4, 5, 6, 7]) / 100.0)


def change(line: int, old: str, new: str) -> Callable[[list[str]], list[str]]:
    def changed(lines: list[str]) -> list[str]:
        assert old in lines[line - 1]
        return [*lines[: line - 1], lines[line - 1].replace(old, new, 1), *lines[line:]]

    return changed


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (change(2, "100", "fast"), r"3\.csv, line 2: rate is 'fast'"),
        (change(2, "100", "0"), r"3\.csv, line 2: rate 0.0 Hz, expected more than 0"),
        (change(3, "Global Angle", "Local Angle"), r"3\.csv, line 3: header is"),
        (change(4, "RX", "QX"), r"3\.csv, line 4: header is .* expected 'Frame,Sub Frame,RX"),
        (change(5, "mm", "cm"), r"3\.csv, line 5: header is .* expected ',,rad,rad,rad,mm"),
        (change(7, "0.100000", "bad"), r"3\.csv, line 7: column 3 is 'bad'"),
        (change(9, ",0.100000", ""), r"3\.csv, line 9: 55 columns, expected 56"),
        (change(8, "3,0", "1,0"), r"3\.csv, line 8: frame number 1.0 does not increase"),
        (change(8, "3,0", ",0"), r"3\.csv, line 8: frame number nan does not increase"),
        (lambda lines: lines[:5], r"3\.csv: no data from line 6 on"),
        (lambda lines: lines[:3], r"3\.csv: ends after line 3"),
        (lambda lines: [*lines[:-1], lines[-1][:100]], r"3\.csv, line 13: 1\d columns, expected 56"),
    ],
)
def test_a_spoilt_file_is_refused_with_its_line(
    take: Path, vicon_text: Callable[..., str], spoil: Callable[[list[str]], list[str]], message: str
) -> None:
    take.write_text("\n".join(spoil(vicon_text().split("\n")[:-1])) + "\n", encoding="utf-8")
    with pytest.raises(DatasetError, match=message):
        vicon.load(take)


def test_real_take(data_root: Path) -> None:
    (recording,) = vicon.load(data_root / "human_robot_animations" / "PickPlaceCloseHuman" / "0.csv.xz")
    assert recording.name == "PickPlaceCloseHuman/0"
    assert recording.positions.shape == (2155, 9, 3)
    # First row of the file, collar: 381.101990, -804.783630, 552.918335 mm.
    np.testing.assert_allclose(recording.joint("collar")[0], [0.381101990, -0.804783630, 0.552918335], atol=1e-12)
    assert np.nanmedian(recording.joint("head")[:, 2] - recording.joint("pelvis")[:, 2]) > 0.4
