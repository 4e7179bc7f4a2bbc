"""Several cameras into one skeleton, on people whose place is known."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from kinecast.cameras.fused_source import FusedSource
from kinecast.cameras.fusion.fusion import ELSEWHERE, Fusion
from kinecast.cameras.fusion.measurement import skin_depths
from kinecast.cameras.fusion.person import CONFIRMED, SHOWN
from kinecast.cameras.pinhole import Intrinsics, PinholeCamera
from kinecast.cameras.rig import Rig
from kinecast.errors import OptionError
from kinecast.geometry.transforms import apply, transform
from kinecast.live.detection import Detection
from kinecast.live.mailbox import Mailbox
from kinecast.live.sender_guard import SenderGuard
from kinecast.types import SkeletonFrame

JOINTS = ("left_shoulder", "left_elbow", "left_wrist", "right_shoulder", "right_elbow", "right_wrist", "neck", "pelvis")
REST = np.array(
    [[0, 0.2, 1.4], [0, 0.25, 1.1], [0.2, 0.2, 1.0], [0, -0.2, 1.4], [0, -0.25, 1.1], [0.2, -0.2, 1.0], [0, 0, 1.5],
     [0, 0, 0.95]]
)  # fmt: skip
PERIOD = 1 / 30
Motion = Callable[[float], np.ndarray]


def camera(name: str, azimuth: float) -> PinholeCamera:
    """One that looks at the middle from 3 m away."""
    a = np.radians(azimuth)
    place = np.array([3 * np.cos(a), 3 * np.sin(a), 1.9])
    forward = (np.array([0, 0, 1.1]) - place) / np.linalg.norm(np.array([0, 0, 1.1]) - place)
    right = np.cross(forward, [0, 0, 1]) / np.linalg.norm(np.cross(forward, [0, 0, 1]))
    R = np.stack([right, np.cross(forward, right), forward], axis=1)
    return PinholeCamera(
        name, Intrinsics(1280, 720, 910.0, 910.0, 640.0, 360.0, (0.1, -0.2, 0.0, 0.0)), transform(R, place)
    )


RIG = Rig({name: camera(name, azimuth) for name, azimuth in (("a", -60.0), ("b", 45.0), ("c", 170.0))}, "cell")


def look(
    name: str, place: np.ndarray, rng: np.random.Generator | None = None, pixel_std: float = 3.0, deep: bool = True
) -> Detection:
    """What a camera sees of a person, exactly or with noise."""
    of = RIG.cameras[name]
    pixels, depth = of.project(place)
    along = of.rays(pixels) @ of.T_world_camera[:3, 2]
    surface = depth - skin_depths(JOINTS) * along
    depth_std = 0.0024 * depth**2
    if rng is not None:
        pixels = pixels + rng.normal(0, pixel_std, pixels.shape)
        surface = surface + rng.normal(0, depth_std)
    if not deep:
        surface = np.full(len(place), np.nan)
    return Detection(0.0, name, JOINTS, pixels, np.full(len(place), pixel_std), surface, depth_std, np.ones(len(place)))


def still(_: float) -> np.ndarray:
    return REST


def play(
    fusion: Fusion,
    motion: Motion | Sequence[Motion],
    seconds: float = 1.0,
    cameras: Sequence[str] = ("a", "b", "c"),
    change: Callable[[str, float, list[Detection]], list[Detection]] = lambda _name, _time, views: views,
    **how: object,
) -> list[SkeletonFrame]:
    """Every frame that comes out while people move before cameras that are not synchronised."""
    motions = [motion] if callable(motion) else motion
    frames = []
    for k in range(int(seconds / PERIOD)):
        for index, name in enumerate(cameras):
            stamp = k * PERIOD + index * PERIOD / 3
            views = [look(name, each(stamp), **how) for each in motions]  # type: ignore[arg-type]
            frames += fusion.add(name, stamp, change(name, stamp, views))
    return frames


def error(frame: SkeletonFrame, motion: Motion) -> np.ndarray:
    """(J,) distance of each joint from where it is [m]."""
    order = [frame.joints.index(joint) for joint in JOINTS]
    return np.linalg.norm(frame.positions[order] - motion(frame.stamp), axis=1)


@pytest.mark.parametrize(
    ("cameras", "deep"), [(("a", "b", "c"), True), (("a", "b", "c"), False), (("a", "b"), False), (("c",), True)]
)
def test_exact_views_give_the_person_back(cameras: Sequence[str], deep: bool) -> None:
    frames = play(Fusion(RIG), still, cameras=cameras, deep=deep)
    assert len(frames) >= 25
    assert {(frame.person, frame.frame_id) for frame in frames} == {("1", "cell")}
    assert max(error(frame, still).max() for frame in frames) < 1e-3


def test_one_camera_without_depth_sees_nobody() -> None:
    assert not play(Fusion(RIG), still, cameras=("a",), deep=False)


def test_nobody_is_somebody_at_first_sight() -> None:
    assert len(play(Fusion(RIG), still, seconds=(CONFIRMED + 2) * PERIOD)) <= 3


def test_views_of_different_instants_are_moved_to_one() -> None:
    def walk(time: float) -> np.ndarray:
        return REST + np.array([1.2 * time - 0.6, 0, 0])

    late = play(Fusion(RIG), walk)[-15:]
    # the oldest view in a round is 22 ms older than the newest, in which a person walks 27 mm
    assert max(error(frame, walk).max() for frame in late) < 5e-3


def test_noise_is_averaged_and_its_size_is_told() -> None:
    rng = np.random.default_rng(0)
    frames = play(Fusion(RIG), still, 2.0, rng=rng, pixel_std=10.0)[15:]
    alone = play(Fusion(RIG), still, 2.0, ("a",), rng=rng, pixel_std=10.0)[15:]
    fused = np.mean([error(frame, still) for frame in frames])
    assert fused < 0.8 * np.mean([error(frame, still) for frame in alone])
    for frame in frames:
        assert frame.covariance is not None
        assert frame.std is not None
        np.testing.assert_allclose(frame.std**2, np.trace(frame.covariance, axis1=1, axis2=2) / 3)
    told = np.mean([frame.std for frame in frames])
    assert 0.4 * told < fused < 2.0 * told  # errors are told as if four fifths of the variance stayed: they do not here


def test_a_view_that_is_wrong_is_thrown_out() -> None:
    fusion = Fusion(RIG)

    def push(name: str, time: float, views: list[Detection]) -> list[Detection]:
        return (
            [replace(v, pixels=v.pixels + np.array([90.0, 0.0])) for v in views]
            if name == "b" and 0.5 < time < 1.0
            else views
        )

    frames = play(fusion, still, 1.2, change=push)
    assert max(error(frame, still).max() for frame in frames) < 2e-3
    assert {frame.person for frame in frames} == {"1"}
    assert fusion.used["b"] < fusion.used["a"] - 10


def test_one_wrong_joint_and_one_wrong_depth_are_left_out() -> None:
    def spoil(name: str, _time: float, views: list[Detection]) -> list[Detection]:
        pixels, depth = views[0].pixels.copy(), views[0].depth.copy()
        if name == "a":
            pixels[2] += (120, -40)
        if name == "c":
            depth[5] += 0.7  # the wall behind the wrist
        return [replace(views[0], pixels=pixels, depth=depth)]

    frames = play(Fusion(RIG), still, change=spoil)[5:]
    assert max(error(frame, still).max() for frame in frames) < 2e-3


def test_a_hidden_joint_is_given_while_anybody_sees_it_and_not_for_long_after() -> None:
    def hide(name: str, time: float, views: list[Detection]) -> list[Detection]:
        pixels = views[0].pixels.copy()
        if time > 0.3 and (name == "a" or time > 0.6):
            pixels[2] = np.nan
        return [replace(views[0], pixels=pixels)]

    frames = play(Fusion(RIG), still, 1.3, change=hide)
    for frame in frames:
        seen = bool(np.isfinite(frame.positions[frame.joints.index("left_wrist")]).all())
        assert seen == (frame.stamp < 0.6 + SHOWN) or abs(frame.stamp - 0.6 - SHOWN) < 2 * PERIOD
    assert max(np.nanmax(error(frame, still)) for frame in frames) < 2e-3


def test_two_who_cross_keep_their_names_though_cameras_swap_them() -> None:
    def east(time: float) -> np.ndarray:
        return REST + np.array([1.2 * time - 0.9, 0.3, 0])

    def west(time: float) -> np.ndarray:
        return REST * (-1, -1, 1) + np.array([0.9 - 1.2 * time, -0.3, 0])

    def by_place(_name: str, _time: float, views: list[Detection]) -> list[Detection]:
        return sorted(views, key=lambda view: float(view.pixels[:, 0].mean()))

    fusion = Fusion(RIG)
    frames = play(fusion, [east, west], 1.5, change=by_place)
    names = {}
    for frame in frames:
        mine, other = error(frame, east).mean(), error(frame, west).mean()
        names.setdefault(frame.person, set()).add("east" if mine < other else "west")
        assert min(mine, other) < 0.01
    assert sorted(map(sorted, names.values())) == [["east"], ["west"]]


def test_skeletons_in_a_cameras_own_axes_join_in() -> None:
    fusion, frames = Fusion(RIG), []
    for k in range(30):
        stamp = k * PERIOD
        frames += fusion.add("a", stamp, [look("a", REST, deep=False)])
        positions = apply(RIG.cameras["b"].T_camera_world, REST)
        frames += fusion.add("b", stamp, [SkeletonFrame(0.0, JOINTS, positions)])
    assert len(frames) > 20
    assert max(error(frame, still).max() for frame in frames) < 1e-3


def test_a_swing_is_followed_without_lag() -> None:
    def swing(time: float) -> np.ndarray:
        moved = REST.copy()
        moved[2] += np.array([0.0, 0.25 * np.sin(2 * np.pi * 0.8 * time), 0.0])
        return moved

    frames = play(Fusion(RIG), swing, 3.0, rng=np.random.default_rng(1))[10:]
    seen = np.array([frame.positions[frame.joints.index("left_wrist"), 1] for frame in frames]) - REST[2, 1]
    stamps = np.array([frame.stamp for frame in frames])
    shifts = np.arange(-0.03, 0.061, 0.001)
    fits = [seen @ np.sin(2 * np.pi * 0.8 * (stamps - shift)) for shift in shifts]
    assert abs(shifts[int(np.argmax(fits))]) < 0.012


def test_whoever_leaves_is_forgotten_and_comes_back_as_another() -> None:
    fusion = Fusion(RIG)

    def gone(_name: str, time: float, views: list[Detection]) -> list[Detection]:
        return [] if 0.4 < time < 1.6 else views

    frames = play(fusion, still, 2.0, change=gone)
    assert {frame.person for frame in frames if frame.stamp < 1.0} == {"1"}
    assert {frame.person for frame in frames if frame.stamp > 1.0} == {"2"}


def test_a_camera_that_falls_silent_is_not_waited_for() -> None:
    fusion = Fusion(RIG)
    play(fusion, still)
    frames = []
    for k in range(30, 60):
        for name in ("a", "b"):
            frames += fusion.add(name, k * PERIOD, [look(name, REST)])
    assert len(frames) >= 28


def test_time_that_is_set_back_is_followed() -> None:
    fusion = Fusion(RIG)
    play(fusion, still)
    frames = [f for k in range(ELSEWHERE + 10) for f in fusion.add("a", k * PERIOD - 1e6, [look("a", REST)])]
    assert len(frames) >= 5
    assert not fusion.add("nobody's", 1.0, [look("a", REST)])
    assert not fusion.add("a", float("nan"), [look("a", REST)])


def test_nothing_that_views_say_raises() -> None:
    rng, fusion = np.random.default_rng(0), Fusion(RIG)
    absurd = np.array([np.nan, np.inf, -np.inf, 0.0, -1.0, 1e-300, 1e300, -1e300, 1e5, 0.3])
    stamp = 0.0
    for k in range(120):
        name = ("a", "b", "c", "who")[rng.integers(4)]
        stamp += rng.choice([0.0, 0.01, 0.033, -0.05, 0.4, 5.0, 1e6], p=[0.1, 0.3, 0.3, 0.2, 0.06, 0.03, 0.01])
        people: list[Detection | SkeletonFrame] = []
        for _ in range(rng.integers(0, 4)):
            view = look("abc"[rng.integers(3)], REST + rng.normal(0, 0.5, 3))
            parts = {}
            for field in ("pixels", "pixel_std", "depth", "depth_std", "confidence"):
                value = getattr(view, field).copy()
                spoilt = rng.random(value.shape) < rng.choice([0.0, 0.1, 1.0])
                value[spoilt] = rng.choice(absurd, spoilt.sum())
                parts[field] = value
            view = replace(view, **parts)
            if rng.random() < 0.1:
                view = replace(view, joints=("tail", "left_wrist", *JOINTS[2:]))
            if rng.random() < 0.2:
                positions = rng.choice(absurd, (len(JOINTS), 3))
                std = rng.choice(absurd, len(JOINTS)) if rng.random() < 0.5 else None
                people.append(SkeletonFrame(0.0, JOINTS, positions, std=std))
            people.append(view)
        for frame in fusion.add(name, float(stamp), people):
            known = np.isfinite(frame.positions).all(axis=1)
            assert np.isfinite(frame.std[known]).all(), k  # type: ignore[index]


def test_cameras_of_a_rig_are_one_source_that_ends_when_they_all_have() -> None:
    mailbox = Mailbox()
    source = FusedSource(RIG, mailbox.feed("fusion"))
    feeds = {name: mailbox.feed(name) for name in RIG.cameras}
    deliver = {name: source.handler(name, feed) for name, feed in feeds.items()}
    with pytest.raises(OptionError, match="camera 'd' is not in the rig, which has a, b, c"):
        source.handler("d", feeds["a"])
    source.start()
    frames: list[SkeletonFrame] = []
    begun = time.monotonic()
    for k in range(600):
        for name in RIG.cameras:
            deliver[name](float(k), [look(name, REST)], begun + k * PERIOD)
        while (arrival := mailbox.take(PERIOD)) is not None:
            frames.append(arrival.frame)
            assert time.time() - arrival.frame.stamp >= 0
            assert arrival.acquired == pytest.approx(arrival.frame.stamp - time.time() + time.monotonic(), abs=1.0)
        if len(frames) >= 10:
            break
    for feed in feeds.values():
        feed.end()
    close_at_end(mailbox, source)
    assert len(frames) >= 10
    assert max(error(frame, still).max() for frame in frames) < 1e-3
    assert all(feed.received == k + 1 for feed in feeds.values())


def close_at_end(mailbox: Mailbox, source: FusedSource) -> None:
    """Waits a minute at the most until every feed has ended."""
    for _ in range(600):
        if mailbox.finished:
            break
        mailbox.take(0.1)
    assert mailbox.finished
    source.close()


def test_a_rig_of_which_nothing_can_come_does_not_keep_the_others_waiting() -> None:
    mailbox = Mailbox()
    source = FusedSource(RIG, mailbox.feed("fusion"))
    source.start()
    close_at_end(mailbox, source)


def test_messages_of_pixels_and_of_a_cameras_own_skeletons_reach_the_fusion() -> None:
    mailbox = Mailbox()
    source, feed = FusedSource(RIG, mailbox.feed("fusion")), mailbox.feed("ws")
    guard, lone = SenderGuard(feed, source), SenderGuard(feed)
    source.expect(feed)
    source.start()
    own = apply(RIG.cameras["b"].T_camera_world, REST)
    found: SkeletonFrame | None = None
    begun = time.monotonic()
    for k in range(600):
        common = {"stamp": k * PERIOD, "joints": JOINTS}
        view = look("a", REST)
        seen = {"camera": "a", "pixels": view.pixels.tolist(), "depth": view.depth.tolist()}
        for content in (common | seen, common | {"frame_id": "b", "positions": own.tolist()}):
            guard.take(json.dumps(content), "sender", max(begun + k * PERIOD, begun))
        if (arrival := mailbox.take(PERIOD)) is not None:
            found = arrival.frame
            break
    assert found is not None
    assert error(found, still).max() < 0.02
    refused = feed.refused
    guard.take(json.dumps(common | seen | {"camera": "d"}), "sender", time.monotonic())
    lone.take(json.dumps(common | seen), "sender", time.monotonic())
    SenderGuard(feed, source, "b").take(json.dumps(common | seen), "sender", time.monotonic())
    assert feed.refused == refused + 3
    guard.take(json.dumps(common | {"positions": REST.tolist()}), "sender", time.monotonic())  # in the world
    arrivals = (mailbox.take(1.0) for _ in range(60))
    assert any(each is not None and each.feed is feed for each in arrivals)
    source.close()
