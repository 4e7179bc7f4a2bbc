"""Loading: formats found by content, folders searched, and recordings checked."""

from __future__ import annotations

import gzip
import lzma
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kinecast.body.skeleton import ARM_JOINTS, HA4M_UPPER_23, LEGO_6, VICON
from kinecast.datasets import table
from kinecast.datasets.loading import FORMATS, check, load
from kinecast.datasets.recording import Recording
from kinecast.errors import DatasetError, OptionError


@pytest.fixture
def recording(motion: Callable[..., np.ndarray]) -> Recording:
    return Recording("made", ARM_JOINTS, np.arange(8) / 30.0, motion(ARM_JOINTS, 8), 30.0)


@pytest.fixture
def mixed(
    tmp_path: Path,
    recording: Recording,
    motion: Callable[..., np.ndarray],
    vicon_text: Callable[..., str],
    mvnx_text: Callable[..., str],
    write_ha4m: Callable[..., np.ndarray],
) -> Path:
    """A folder with recordings of many formats, under endings that say little, and other files."""
    root = tmp_path / "mixed"
    for folder in ("Stack", "deep/er", "features/GroundTruth", ".hidden"):
        (root / folder).mkdir(parents=True)
    for take in (2, 10):
        (root / "Stack" / f"{take}.csv.xz").write_bytes(lzma.compress(vicon_text().encode()))
    (root / "deep" / "er" / "suit.gz").write_bytes(gzip.compress(mvnx_text().encode()))
    table.write(root / "deep" / "made.parquet", [recording])
    points = motion(HA4M_UPPER_23.joints, 8) * 1000.0
    np.save(root / "features" / "clip.npy", np.concatenate([points[..., 0].T, -points[..., 2].T, points[..., 1].T]))
    (root / "features" / "GroundTruth" / "other.txt").write_text("0\n1\n")
    np.savetxt(root / "arms.txt", motion(LEGO_6.joints, 8).reshape(8, 18))
    write_ha4m(root / "IDU001V001")
    (root / "README.md").write_text("# Recordings\n")
    (root / "LICENSE").write_text("MIT\n")
    (root / ".hidden" / "0.csv").write_text("Objects\nbroken")
    return root


def test_a_folder_is_searched_and_formats_are_found_by_content(mixed: Path) -> None:
    found = {recording.name: recording.format for recording in load(mixed)}
    assert found == {
        "IDU001V001": "ha4m", "Stack/2": "vicon", "Stack/10": "vicon", "arms": "lego",
        "made": "generated", "suit": "mvnx", "clip": "ha4m-features",
    }  # fmt: skip
    assert list(found).index("Stack/2") < list(found).index("Stack/10")
    assert [recording.name for recording in load(str(mixed))] == list(found)


def test_a_stated_format_takes_only_its_own(mixed: Path) -> None:
    assert [recording.name for recording in load(mixed, "vicon")] == ["Stack/2", "Stack/10"]
    with pytest.raises(DatasetError, match="no recording found; formats tried: bvh"):
        load(mixed, "bvh")


def test_a_stated_format_explains_what_does_not_match(mixed: Path) -> None:
    with pytest.raises(DatasetError, match=r"arms\.txt, line 2: rate is"):
        load(mixed / "arms.txt", "vicon")
    with pytest.raises(DatasetError, match=r"suit\.gz: no suit\.labels\.csv beside it"):
        load(mixed / "deep" / "er" / "suit.gz", "andy")


def test_an_unknown_file_names_the_formats_tried(mixed: Path) -> None:
    with pytest.raises(
        DatasetError, match=r"README\.md: no recording found; formats tried: kth-handover, ha4m, .*lego"
    ):
        load(mixed / "README.md")


def test_an_unknown_format_names_the_known() -> None:
    with pytest.raises(OptionError, match="format is 'c3d', expected one of andy, bvh, ha4m"):
        load(Path("a.csv"), "c3d")
    assert set(FORMATS) == {
        "vicon", "ha4m", "ha4m-features", "mvnx", "andy", "lego", "kth-handover", "bvh", "table"
    }  # fmt: skip


@pytest.mark.parametrize("name", ["none.csv", "none"])
def test_a_missing_path_is_named(tmp_path: Path, name: str) -> None:
    with pytest.raises(DatasetError, match=f"{name}: no such file or folder"):
        load(tmp_path / name)


def test_empty_folders_and_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="no recording found"):
        load(tmp_path)
    (tmp_path / "0.csv").touch()
    for path in (tmp_path, tmp_path / "0.csv"):
        with pytest.raises(DatasetError, match=r"0\.csv: empty file"):
            load(path)


def test_one_broken_take_stops_a_folder(mixed: Path) -> None:
    take = mixed / "Stack" / "2.csv.xz"
    take.write_bytes(take.read_bytes()[:-30])
    with pytest.raises(DatasetError, match=r"2\.csv\.xz: truncated or damaged"):
        load(mixed)


def test_names_are_unique_over_everything_loaded(tmp_path: Path, recording: Recording) -> None:
    paths = [tmp_path / folder / "a.parquet" for folder in ("one", "two")]
    for path in paths:
        path.parent.mkdir()
        table.write(path, [replace(recording, source=path)])
    sourceless = tmp_path / "b.parquet"
    table.write(sourceless, [recording])
    again = tmp_path / "c.parquet"
    table.write(again, [recording])
    names = [each.name for each in load([*paths, sourceless, again])]
    assert names == ["one/made", "two/made", "made", "made#2"]


def test_a_file_given_twice_is_loaded_once(mixed: Path) -> None:
    assert len(load([mixed, mixed / "Stack" / "2.csv.xz", mixed / "Stack"])) == 7


def test_links_to_folders_are_not_followed(mixed: Path) -> None:
    (mixed / "Stack" / "up").symlink_to(mixed)
    assert len(load(mixed)) == 7


def placed(rows: object, columns: object, value: object) -> Callable[[np.ndarray], np.ndarray]:
    """Puts a value into positions."""

    def change(positions: np.ndarray) -> np.ndarray:
        positions[rows, columns] = value
        return positions

    return change


EVERY = slice(None)
BONE = "left_shoulder to left_elbow"
APART = f"{BONE} are never seen together"
FAR = r"a\.csv, frame 5: a position is .* m away, expected at most 10000"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p: 1000.0 * p, rf"a\.csv: {BONE} is .* seems to be in millimetres"),
        (lambda p: 100.0 * p, rf"a\.csv: {BONE} is .* seems to be in centimetres"),
        (lambda p: p / 1000.0, r"is 0.000287. m \(median\), but an arm's bone is 0.1 to 0.6 m$"),
        (lambda p: p + (np.arange(6) == 5)[:, None], "right_elbow to right_wrist is"),
        (placed(EVERY, [1, 4], np.nan), "left_elbow, right_elbow missing in every one of 8 frames"),
        (placed(EVERY, EVERY, np.nan), r"left_shoulder, .*right_wrist missing in every one of 8 frames"),
        (
            lambda p: placed(slice(1, 8, 2), 1, np.nan)(placed(slice(0, 8, 2), 0, np.nan)(p)),
            f"{BONE} are never seen together",
        ),
        *(
            (lambda p, far=far: placed(5, EVERY, np.nan)(placed(4, 2, [0.0, far, 0.0])(p)), FAR)
            for far in (-np.inf, np.inf, 1e300, -1e5)
        ),
    ],
)
def test_positions_that_cannot_be_an_arms_are_refused(
    recording: Recording, change: Callable[[np.ndarray], np.ndarray], message: str
) -> None:
    check(recording, "a.csv")
    with pytest.raises(DatasetError, match=message):
        check(replace(recording, positions=change(recording.positions)), "a.csv")


def test_too_little_is_refused(recording: Recording) -> None:
    armless = replace(recording, joints=recording.joints[:5], positions=recording.positions[:, :5])
    with pytest.raises(DatasetError, match=r"a\.csv: right_wrist missing: both arms are needed"):
        check(armless, "a.csv")
    single = recording.select(slice(0, 1))
    with pytest.raises(DatasetError, match=r"a\.csv: 1 frame; at least 2 are needed"):
        check(single, "a.csv")
    with pytest.raises(DatasetError, match=r"a\.csv, person giver: 1 frame"):
        check(replace(single, person="giver"), "a.csv")


def test_a_few_jumps_are_no_wrong_unit(recording: Recording) -> None:
    recording.positions[:3, 2] += 5.0
    check(recording, "a.csv")


def test_millimetres_read_as_metres_end_to_end(tmp_path: Path, motion: Callable[..., np.ndarray]) -> None:
    path = tmp_path / "trial1.txt"
    np.savetxt(path, motion(LEGO_6.joints, 8).reshape(8, 18) * 1000.0)
    with pytest.raises(DatasetError, match=r"trial1\.txt: .* seems to be in millimetres"):
        load(path)


def test_a_take_without_an_arm_end_to_end(tmp_path: Path, vicon_text: Callable[..., str]) -> None:
    path = tmp_path / "0.csv"
    path.write_text(vicon_text([name for name in VICON.aliases if not name.startswith("left")]), encoding="utf-8")
    with pytest.raises(DatasetError, match=r"0\.csv: left_shoulder, left_elbow, left_wrist missing: both arms"):
        load(path)


def test_real_recordings_of_every_format_at_hand_load(data_root: Path) -> None:
    counts = {"vicon": 6, "ha4m-features": 2, "lego": 14, "kth-handover": 2}
    takes = sorted((data_root / "human_robot_animations").glob("*/0.csv.xz"))
    others = [data_root / name for name in ("ha4m_features_demo", "human_assembly_data", "kth_handover_sample")]
    recordings = load([*takes, *others])
    assert len({recording.name for recording in recordings}) == len(recordings)
    assert Counter(recording.format for recording in recordings) == counts
    for recording in recordings:
        height = np.nanmedian(recording.positions, axis=0)[:, 2]
        if "head" in recording.joints:
            assert height[recording.joints.index("head")] > height[recording.joints.index("left_shoulder")]
