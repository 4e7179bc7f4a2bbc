"""Torso frame: axes, the chain of sources, what is held when joints are lost."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from kinecast.body.torso_frame import UpSource, torso_frame, up_source
from kinecast.errors import DatasetError

JOINTS = (
    "left_shoulder", "right_shoulder", "pelvis", "left_hip", "right_hip", "spine", "chest", "neck", "head",
)  # fmt: skip
STANDING = np.array([
    [0.0, 0.2, 1.4], [0.0, -0.2, 1.4], [0.0, 0.0, 0.9], [0.0, 0.1, 0.9], [0.0, -0.1, 0.9],
    [0.0, 0.0, 1.1], [0.0, 0.0, 1.25], [0.0, 0.0, 1.5], [0.05, 0.0, 1.65],
])  # fmt: skip
SHOULDERS = JOINTS[:2]


def turn(angle: float, axis: int) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    rotation = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    rotation[[i, i, j, j], [i, j, i, j]] = c, -s, s, c
    return rotation


def without(*names: str, body: np.ndarray = STANDING) -> np.ndarray:
    positions = body.copy()
    positions[[JOINTS.index(name) for name in names]] = np.nan
    return positions


def test_standing_upright_is_the_identity_between_the_shoulders() -> None:
    torso = torso_frame(JOINTS, STANDING)
    expected = np.eye(4)
    expected[:3, 3] = [0.0, 0.0, 1.4]
    np.testing.assert_allclose(torso.T_world_torso, expected, atol=1e-15)
    assert torso.source is UpSource.PELVIS
    assert float(torso.lean) == 0.0


def test_the_frame_moves_with_the_body() -> None:
    rotation = turn(2.5, 2) @ turn(0.6, 1) @ turn(-0.3, 0)
    body = STANDING @ rotation.T + np.array([3.0, -1.0, 0.2])
    T = torso_frame(JOINTS, body).T_world_torso
    np.testing.assert_allclose(T[:3, :3], rotation, atol=1e-14)
    np.testing.assert_allclose(T[:3, 3], body[:2].mean(axis=0), atol=1e-15)


def test_bowing_forward_is_a_positive_lean() -> None:
    body = STANDING @ turn(0.4, 1).T
    assert float(torso_frame(JOINTS, body).lean) == pytest.approx(0.4, abs=1e-14)


@pytest.mark.parametrize(
    ("lost", "source"),
    [
        ((), UpSource.PELVIS),
        (("pelvis",), UpSource.HIPS),
        (("pelvis", "left_hip"), UpSource.SPINE),
        (("pelvis", "left_hip", "spine"), UpSource.CHEST),
        (("pelvis", "left_hip", "spine", "chest"), UpSource.NECK),
        (("pelvis", "left_hip", "spine", "chest", "neck"), UpSource.HEAD),
        (("pelvis", "left_hip", "spine", "chest", "neck", "head"), UpSource.WORLD),
    ],
)
def test_sources_follow_one_another(lost: tuple[str, ...], source: UpSource) -> None:
    body = without(*lost)
    torso = torso_frame(JOINTS, body)
    assert torso.source is source
    assert np.isfinite(torso.T_world_torso).all()
    kept = [name for name in JOINTS if name not in lost]
    alone = torso_frame(kept, STANDING[[JOINTS.index(name) for name in kept]])
    assert alone.source is source
    np.testing.assert_array_equal(alone.T_world_torso, torso.T_world_torso)


def test_a_source_along_the_shoulder_line_or_at_the_shoulders_falls_to_the_next() -> None:
    body = STANDING.copy()
    body[JOINTS.index("pelvis")] = [0.0, 0.9, 1.39]
    assert torso_frame(JOINTS, body).source is UpSource.HIPS
    body[JOINTS.index("pelvis")] = [0.0, 0.0, 1.38]
    assert torso_frame(JOINTS, body).source is UpSource.HIPS


def test_neck_and_head_count_only_clearly_above_the_shoulders() -> None:
    lost = without("pelvis", "left_hip", "spine", "chest")
    lost[JOINTS.index("neck")] = [0.12, 0.0, 1.42]
    assert torso_frame(JOINTS, lost).source is UpSource.HEAD
    lost[JOINTS.index("head")] = [0.3, 0.0, 1.5]
    assert torso_frame(JOINTS, lost).source is UpSource.WORLD


def test_a_recording_keeps_one_source_and_holds_the_lean_where_it_is_lost() -> None:
    recording = np.array([STANDING @ (turn(0.3 * i, 2) @ turn(0.5, 1)).T for i in range(6)])
    whole = torso_frame(JOINTS, recording)
    recording[2:4, 2] = np.nan
    torso = torso_frame(JOINTS, recording)
    assert torso.source is UpSource.PELVIS
    # The shoulders turned meanwhile: the held lean turned with them.
    np.testing.assert_allclose(torso.T_world_torso, whole.T_world_torso, atol=1e-14)


def test_a_source_seen_in_less_than_half_of_the_frames_is_not_chosen() -> None:
    recording = np.tile(STANDING, (10, 1, 1))
    recording[:5, 2] = np.nan
    assert up_source(JOINTS, recording) is UpSource.PELVIS
    recording[5, 2] = np.nan
    assert up_source(JOINTS, recording) is UpSource.HIPS
    recording[:, 0] = np.nan
    assert up_source(JOINTS, recording) is UpSource.WORLD


def test_one_frame_after_another_equals_the_whole_recording() -> None:
    rng = np.random.default_rng(3)
    recording = STANDING + 0.05 * rng.standard_normal((20, *STANDING.shape))
    recording[rng.random(20) < 0.4, 2] = np.nan
    whole = torso_frame(JOINTS, recording, UpSource.PELVIS, lean=0.1)
    lean = 0.1
    for i, frame in enumerate(recording):
        torso = torso_frame(JOINTS, frame, UpSource.PELVIS, lean)
        np.testing.assert_array_equal(torso.T_world_torso, whole.T_world_torso[i])
        lean = float(torso.lean)


def test_a_lost_shoulder_is_nan_there_alone() -> None:
    recording = np.tile(STANDING, (3, 1, 1))
    recording[1, 0, 2] = np.nan
    torso = torso_frame(JOINTS, recording)
    np.testing.assert_array_equal(np.isnan(torso.T_world_torso).all(axis=(1, 2)), [False, True, False])
    np.testing.assert_array_equal(np.isnan(torso.T_world_torso).any(axis=(1, 2)), [False, True, False])


@pytest.mark.parametrize(
    "shoulders",
    [
        [[0.0, 0.0, 1.6], [0.0, 0.0, 1.2]],  # lying on the side, world up alone
        [[0.0, 0.0, 1.2], [0.0, 0.0, 1.6]],
        [[0.3, 0.3, 1.4], [0.3, 0.3, 1.4]],  # on one spot
    ],
)
def test_world_up_along_the_shoulders_still_gives_a_frame(shoulders: list[list[float]]) -> None:
    T = torso_frame(SHOULDERS, np.array(shoulders)).T_world_torso
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)


def test_lying_on_the_side_follows_the_spine() -> None:
    rotation = turn(np.pi / 2, 0)
    T = torso_frame(JOINTS, STANDING @ rotation.T).T_world_torso
    np.testing.assert_allclose(T[:3, :3], rotation, atol=1e-14)


@settings(max_examples=200)
@given(
    arrays(
        np.float64,
        (4, len(JOINTS), 3),
        elements=st.floats(-2, 2) | st.sampled_from([0.0, 1.0, np.nan, 1e-9]),
    )
)
def test_every_frame_with_two_shoulders_is_a_rotation(positions: np.ndarray) -> None:
    torso = torso_frame(JOINTS, positions)
    tracked = np.isfinite(positions[:, :2]).all(axis=(1, 2))
    T = torso.T_world_torso
    assert np.isnan(T[~tracked]).all()
    R = T[tracked, :3, :3]
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.broadcast_to(np.eye(3), R.shape), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-9)
    across = positions[tracked, 0] - positions[tracked, 1]
    width = np.linalg.norm(across, axis=-1)
    clear = width > 1e-3
    np.testing.assert_allclose(R[clear, :, 1], across[clear] / width[clear, None], atol=1e-9)


def test_a_skeleton_without_a_shoulder_is_refused_by_name() -> None:
    with pytest.raises(DatasetError, match="right_shoulder"):
        torso_frame(("left_shoulder", "pelvis"), STANDING[:2])


def test_no_frames_give_no_frames() -> None:
    torso = torso_frame(JOINTS, np.empty((0, len(JOINTS), 3)))
    assert torso.T_world_torso.shape == (0, 4, 4)


def test_a_real_person_at_a_table_leans_little_and_faces_one_way(data_root: Path) -> None:
    file = data_root / "ha4m_features_demo" / "UpSkel" / "IDU001V002.npy"
    camera = np.load(file, allow_pickle=False).reshape(3, 23, -1).transpose(2, 1, 0) / 1000.0
    world = np.stack([camera[..., 2], -camera[..., 0], -camera[..., 1]], axis=-1)
    torso = torso_frame(("spine", "left_shoulder", "right_shoulder"), world[:, [0, 4, 11]])
    assert torso.source is UpSource.SPINE
    assert np.degrees(np.quantile(np.abs(torso.lean), 0.99)) < 60.0
    wrists = world[:, [6, 13]].mean(axis=1) - torso.T_world_torso[:, :3, 3]
    forward = np.einsum("ni,ni->n", wrists, torso.T_world_torso[:, :3, 0])
    assert (forward > 0.0).mean() > 0.99
