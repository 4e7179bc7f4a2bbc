"""Where a shape stands so that it is seen where it is."""

from __future__ import annotations

import numpy as np
import pytest

from kinecast.cameras.perspective import height_of, translation, turn_towards

RNG = np.random.default_rng(5)
SHAPE = RNG.normal(0.0, [0.25, 0.5, 0.15], (13, 3))
PLACE = np.array([0.4, -0.2, 2.6])


def seen(shape: np.ndarray, place: np.ndarray) -> np.ndarray:
    return (shape + place)[:, :2] / (shape + place)[:, 2:]


@pytest.mark.parametrize("direction", [(0.0, 0.0), (0.6, -0.3), (-2.0, 1.0)])
def test_the_axis_is_turned_onto_the_ray(direction: tuple[float, float]) -> None:
    turn = turn_towards(np.array(direction))
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    ray = turn @ [0.0, 0.0, 1.0]
    np.testing.assert_allclose(ray[:2] / ray[2], direction, atol=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1.0)


def test_without_errors_the_place_is_exact() -> None:
    found = translation(SHAPE, seen(SHAPE, PLACE), np.full(13, 0.01))
    assert found is not None
    np.testing.assert_allclose(found[0], PLACE, atol=1e-9)


def test_errors_are_as_large_as_the_covariance_says() -> None:
    std, square = np.full(13, 0.01), []
    for _ in range(400):
        found = translation(SHAPE, seen(SHAPE, PLACE) + RNG.normal(0, 0.01, (13, 2)), std)
        assert found is not None
        off, covariance = found[0] - PLACE, found[1]
        square.append(off @ np.linalg.solve(covariance, off))
    # mean of χ² with 3 degrees of freedom: 3 ± √(6/400); Huber's weights and the model's bend cost some of it
    assert np.mean(square) == pytest.approx(3.0, abs=5 * np.sqrt(6 / 400) + 0.3)
    assert covariance[2, 2] > 4 * covariance[0, 0]  # along the ray it is least sure


def test_one_joint_somewhere_else_hardly_moves_the_person() -> None:
    directions = seen(SHAPE, PLACE)
    directions[4] += 0.4
    found = translation(SHAPE, directions, np.full(13, 0.01))
    assert found is not None
    assert np.linalg.norm(found[0] - PLACE) < 0.1
    plain = np.linalg.lstsq(
        np.concatenate([np.column_stack([np.eye(2), -each]) for each in directions]),
        (directions * SHAPE[:, 2:] - SHAPE[:, :2]).ravel(),
        rcond=None,
    )[0]
    assert np.linalg.norm(plain - PLACE) > 0.3


@pytest.mark.parametrize(
    ("shape", "directions"),
    [
        (SHAPE[:3], seen(SHAPE, PLACE)[:3]),
        (SHAPE, np.zeros((13, 2))),  # all in one point: infinitely far
        (SHAPE, seen(SHAPE, -PLACE)),  # behind the camera
        (np.zeros((13, 3)), np.zeros((13, 2))),
        (SHAPE, np.full((13, 2), np.nan)),
    ],
)
def test_what_cannot_be_placed_is_not(shape: np.ndarray, directions: np.ndarray) -> None:
    found = translation(shape, directions, np.full(len(shape), 0.01))
    assert found is None or found[0][2] > 100


def test_a_bodys_height_comes_from_its_bones() -> None:
    joints = tuple(
        f"{side}_{name}"
        for side in ("left", "right")
        for name in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
    )
    shape = np.zeros((12, 3))
    for start in (0, 6):
        shape[start : start + 3, 0] = np.cumsum([0.0, 0.186, 0.146])
        shape[start + 3 : start + 6, 1] = 0.288 + np.cumsum([0.0, 0.245, 0.246])
    whole = np.ones(12, dtype=bool)
    assert height_of(joints, 1.8 * shape, whole) == pytest.approx(1.8)
    arms = np.array([joint.endswith(("shoulder", "elbow", "wrist")) for joint in joints])
    assert height_of(joints, 1.8 * shape, arms) == pytest.approx(1.8)
    assert np.isnan(height_of(joints, shape, ~whole))
