"""A person before one camera: where a shape stands so that it is seen there, how large, how unsure, no lag."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kinecast.cameras.landmarker import JOINTS, Landmarks
from kinecast.cameras.pinhole import Intrinsics, PinholeCamera, level_pose
from kinecast.cameras.single_view import BODY, ScaleOptions, SingleView, height_of, translation, turn_towards
from kinecast.geometry.transforms import apply

CAMERA = PinholeCamera("c", Intrinsics(640, 480, 500.0, 500.0, 319.5, 239.5), level_pose(1.5, np.radians(8.0)))
HEIGHT = 1.8
_SIDE = {
    "shoulder": (0.18, 0.818), "elbow": (0.20, 0.632), "wrist": (0.22, 0.486), "hip": (0.10, 0.530),
    "knee": (0.10, 0.285), "ankle": (0.10, 0.039), "heel": (0.10, 0.0167), "foot": (0.10, 0.0167),
}  # fmt: skip
"""How far to the side a joint is [m], and how high as a share of the body's height."""


def standing(place: tuple[float, float]) -> np.ndarray:
    """(33, 3) of somebody 1.8 m tall who looks at the camera [m]; NaN for other landmarks."""
    points = np.full((33, 3), np.nan)
    for name, (aside, high) in _SIDE.items():
        for side, sign in (("left", 1), ("right", -1)):
            points[JOINTS.index(f"{side}_{name}")] = place[0] + sign * aside, place[1], HEIGHT * high
    points[JOINTS.index("nose")] = place[0], place[1] - 0.1, 0.93 * HEIGHT
    return points


def looked_at(points: np.ndarray, size: float = 1.0) -> Landmarks:
    """What a network without errors says of them, but for the size of its shape."""
    local = apply(CAMERA.T_camera_world, points)
    middle = local[[JOINTS.index("left_hip"), JOINTS.index("right_hip")]].mean(axis=0)
    shape = (local - middle) @ turn_towards(middle[:2] / middle[2]) / size
    return Landmarks(CAMERA.project(points)[0], shape, np.isfinite(points).all(axis=1).astype(float))


ROWS = [JOINTS.index(joint) for joint in BODY]


@pytest.mark.parametrize("place", [(0.0, 1.8), (0.8, 2.5), (-1.5, 4.0)])
def test_without_errors_everybody_is_where_they_are(place: tuple[float, float]) -> None:
    points = standing(place)
    frame = SingleView(CAMERA, ScaleOptions()).update(0.0, looked_at(points))
    assert frame is not None
    np.testing.assert_allclose(frame.positions, points[ROWS], atol=1e-6)


@pytest.mark.parametrize("options", [ScaleOptions(body=HEIGHT), ScaleOptions(feet_on_floor=True)])
def test_a_stated_height_or_the_floor_corrects_the_scale(options: ScaleOptions) -> None:
    points = standing((0.5, 3.0))
    person = looked_at(points, size=1.12)
    wrong = SingleView(CAMERA, ScaleOptions()).update(0.0, person)
    frame = SingleView(CAMERA, options).update(0.0, person)
    assert wrong is not None
    assert frame is not None
    assert np.linalg.norm(wrong.positions - points[ROWS], axis=1).mean() > 0.25
    assert np.linalg.norm(frame.positions - points[ROWS], axis=1).mean() < 0.05


def test_depth_is_least_sure_along_the_ray_and_more_is_known_of_it_with_a_scale() -> None:
    person = looked_at(standing((0.0, 3.0)))
    sigma = {}
    for name, options in (("none", ScaleOptions(focal_std=0.1)), ("body", ScaleOptions(body=HEIGHT))):
        frame = SingleView(CAMERA, options).update(0.0, person)
        assert frame is not None
        assert frame.covariance is not None
        assert frame.std is not None
        values, axes = np.linalg.eigh(frame.covariance[0])
        ray = frame.positions[0] - CAMERA.T_world_camera[:3, 3]
        assert abs(axes[:, -1] @ ray) / np.linalg.norm(ray) > 0.99
        sigma[name] = float(np.sqrt(values[-1]))
        assert np.sqrt(values[0]) < 0.05
        assert frame.std.max() < 0.1  # what stays for the whole person widens no prediction
    assert sigma["none"] == pytest.approx(3.0 * np.hypot(0.08, 0.1), rel=0.25)
    assert sigma["body"] < 0.5 * sigma["none"]


def test_smoothing_takes_jitter_and_does_not_lag() -> None:
    """A wrist that swings 0.3 m at 1 Hz, with the network's jitter."""
    rng, view = np.random.default_rng(2), SingleView(CAMERA, ScaleOptions())
    wrist, truth, found, raw = JOINTS.index("right_wrist"), [], [], []
    for k in range(150):
        points = standing((0.0, 2.5))
        points[wrist] += [0.3 * np.sin(2 * np.pi * k / 30), -0.2, 0.3]
        person = looked_at(points)
        shape = person.shape + rng.normal(0, [0, 0, 0.01], person.shape.shape)
        person = replace(person, pixels=person.pixels + rng.normal(0, 1.5, person.pixels.shape), shape=shape)
        frame = view.update(k / 30, person)
        plain = SingleView(CAMERA, ScaleOptions()).update(k / 30, person)
        assert frame is not None
        assert plain is not None
        row = BODY.index("right_wrist")
        truth.append(points[wrist]), found.append(frame.positions[row]), raw.append(plain.positions[row])
    truth, found, raw = np.array(truth)[30:], np.array(found)[30:], np.array(raw)[30:]
    k = np.arange(len(truth))
    lags = np.arange(-1.0, 2.0, 0.05)
    lag = lags[np.argmin([((np.interp(k - each, k, truth[:, 0]) - found[:, 0])[5:-5] ** 2).mean() for each in lags])]
    assert abs(lag) < 0.25  # pictures: 8 ms
    jitter = [np.diff(each - truth, n=2, axis=0).std() / np.sqrt(6) for each in (raw, found)]
    assert jitter[1] < 0.6 * jitter[0]


def test_who_is_hardly_seen_is_not_placed_and_hidden_joints_are_left_out() -> None:
    view = SingleView(CAMERA, ScaleOptions())
    person = looked_at(standing((0.0, 2.5)))
    confidence = person.confidence.copy()
    confidence[JOINTS.index("left_wrist")] = 0.1
    frame = view.update(0.0, replace(person, confidence=confidence))
    assert frame is not None
    assert not frame.valid[BODY.index("left_wrist")]
    assert frame.valid.sum() == len(BODY) - 1
    assert view.update(0.1, replace(person, confidence=0.1 * confidence)) is None
    assert view.update(0.2, replace(person, pixels=np.full((33, 2), np.nan))) is None


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
