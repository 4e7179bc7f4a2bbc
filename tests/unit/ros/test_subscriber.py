"""Skeletons from PoseArray, MarkerArray, ZED cameras, TF and joint states, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.errors import OptionError
from kinecast.geometry.transforms import rotation_z, to_quaternion
from kinecast.live.message import MessageError
from kinecast.live.settings import read_settings
from kinecast.ros.messages import Distribution, messages_of
from kinecast.ros.ros4hri import body_joints
from kinecast.ros.subscriber import INPUTS, InputOptions, SkeletonSubscriber, input_type
from kinecast.types import SkeletonFrame

REST = np.array([[0, 0.2, 1.4], [0, 0.25, 1.1], [0.2, 0.2, 1.0], [0, -0.2, 1.4], [0, -0.25, 1.1], [0.2, -0.2, 1.0]])
NOW = 1_760_000_000.0
ARM_FRAMES = ("l_shoulder", "l_elbow", "l_wrist", "r_shoulder", "r_elbow", "r_wrist")


def point(values: Any) -> dict[str, float]:
    return dict(zip("xyz", map(float, values), strict=True))


def header(stamp: float = NOW, frame: str = "camera") -> dict[str, Any]:
    return {"stamp": stamp, "frame_id": frame}


def read(
    subscriber: SkeletonSubscriber, topic: str, fields: dict[str, Any], distribution: Distribution = Distribution.JAZZY
) -> list[SkeletonFrame | MessageError]:
    """From bytes, as every node has them."""
    messages = messages_of(distribution)
    return list(subscriber.read(messages, topic, messages.encode(subscriber.topics[topic], fields)))


def frames(found: list[SkeletonFrame | MessageError]) -> list[SkeletonFrame]:
    assert not [each for each in found if isinstance(each, MessageError)]
    return [each for each in found if isinstance(each, SkeletonFrame)]


def problem(found: list[SkeletonFrame | MessageError]) -> str:
    (only,) = found
    assert isinstance(only, MessageError)
    return str(only)


def tf(places: dict[str, tuple[str, Any]], stamp: float = NOW, yaw: float = 0.0) -> dict[str, Any]:
    """A TFMessage: child → (parent, place); all are turned about z."""
    turn = dict(zip("wxyz", to_quaternion(rotation_z(yaw)).tolist(), strict=True))
    return {
        "transforms": [
            {
                "header": header(stamp, parent),
                "child_frame_id": child,
                "transform": {"translation": point(place), "rotation": turn},
            }
            for child, (parent, place) in places.items()
        ]
    }


def body(name: str, arms: np.ndarray = REST, parent: str = "camera") -> dict[str, tuple[str, Any]]:
    return {f"{frame}_{name}": (parent, place) for frame, place in zip(ARM_FRAMES, arms, strict=True)}


@pytest.mark.parametrize("distribution", Distribution)
def test_poses_are_of_the_joints_that_were_stated(distribution: Distribution) -> None:
    positions = np.random.default_rng(0).normal(size=(17, 3))
    subscriber = SkeletonSubscriber("/p", "geometry_msgs/PoseArray", InputOptions(joints="COCO 17", person="anna"))
    fields = {"header": header(), "poses": [{"position": point(each)} for each in positions]}
    (frame,) = frames(read(subscriber, "/p", fields, distribution))
    assert (frame.stamp, frame.person, frame.frame_id) == (NOW, "anna", "camera")
    assert frame.joints[5:7] == ("left_shoulder", "right_shoulder")
    np.testing.assert_array_equal(frame.positions, positions)
    fields["poses"] = fields["poses"][:-1]
    assert "16 rows for 17 joints" in problem(read(subscriber, "/p", fields, distribution))


def test_a_pose_that_is_not_seen_is_nan() -> None:
    subscriber = SkeletonSubscriber(
        "/p", "geometry_msgs/PoseArray", InputOptions(joints=f"{','.join(ARM_JOINTS)},belly button")
    )
    arms = np.vstack((REST, [[9.0, 9.0, 9.0]]))
    arms[2] = np.nan
    fields = {"header": header(frame=""), "poses": [{"position": point(each)} for each in arms]}
    (frame,) = frames(read(subscriber, "/p", fields))
    assert (frame.joints, frame.frame_id) == (ARM_JOINTS, "world")
    assert frame.valid.tolist() == [True, True, False, True, True, True]


def marker(place: int, xyz: Any, **fields: Any) -> dict[str, Any]:
    return {"header": header(), "id": place, "type": 2, "pose": {"position": point(xyz)}} | fields


@pytest.mark.parametrize("distribution", Distribution)
def test_markers_of_several_persons_in_every_convention(distribution: Distribution) -> None:
    order = InputOptions(joints=",".join(ARM_JOINTS))
    subscriber = SkeletonSubscriber("/m", "visualization_msgs/MarkerArray", order)
    named = [marker(k + 40, xyz, ns="named", text=ARM_JOINTS[k]) for k, xyz in enumerate(REST)]
    placed = [marker(k, xyz, ns="placed", type=1) for k, xyz in enumerate(REST + 1.0) if k != 4]
    kinect = [marker(700 + k, xyz) for k, xyz in enumerate(REST + 2.0)]
    listed = {"header": header(), "ns": "listed", "type": 7, "points": [point(each) for each in REST + 3.0]}
    others = [marker(0, REST[0], ns="line", type=5), marker(0, REST[0], ns="gone", action=2)]
    fields = {"markers": [*named, *placed, *kinect, listed, *others]}
    found = {each.person: each for each in frames(read(subscriber, "/m", fields, distribution))}
    assert set(found) == {"named", "placed", "7", "listed"}
    np.testing.assert_array_equal(found["named"].positions, REST)
    np.testing.assert_array_equal(found["placed"].positions, np.where(np.arange(6)[:, None] == 4, np.nan, REST + 1.0))
    np.testing.assert_array_equal(found["7"].positions, REST + 2.0)
    np.testing.assert_array_equal(found["listed"].positions, REST + 3.0)


def test_markers_say_which_joint_they_are() -> None:
    subscriber = SkeletonSubscriber("/m", "visualization_msgs/MarkerArray", InputOptions())
    assert "nothing says which joint" in problem(read(subscriber, "/m", {"markers": [marker(0, REST[0], ns="a")]}))
    torn = [marker(k, REST[k], ns="a", text=ARM_JOINTS[k], header=header(frame=f"f{k}")) for k in range(2)]
    assert "in several frames" in problem(read(subscriber, "/m", {"markers": torn}))
    one = [marker(0, REST[0], ns="a", text="left_shoulder")]
    (frame,) = frames(read(subscriber, "/m", {"markers": one}))  # the other five are not seen
    assert frame.valid.sum() == 1


@pytest.mark.parametrize(
    ("distribution", "type_", "form", "keypoints", "shoulder"),
    [
        (Distribution.NOETIC, "zed_interfaces/ObjectsStamped", None, 18, 5),
        (Distribution.HUMBLE, "zed_interfaces/ObjectsStamped", 0, 70, 5),
        (Distribution.HUMBLE, "zed_msgs/ObjectsStamped", 1, 70, 5),
        (Distribution.JAZZY, "zed_msgs/ObjectsStamped", 2, 70, 12),
    ],
)
def test_zed_skeletons_of_every_format(
    distribution: Distribution, type_: str, form: int | None, keypoints: int, shoulder: int
) -> None:
    points = np.random.default_rng(1).normal(size=(keypoints, 3)).astype(np.float32)
    points[shoulder] = (1.0, 2.0, 3.0)
    person = {
        "label_id": 12, "tracking_state": 1, "skeleton_available": True,
        "skeleton_3d": {"keypoints": [{"kp": each} for each in points]},
    } | ({} if form is None else {"body_format": form})  # fmt: skip
    fields = {
        "header": header(),
        "objects": [person, person | {"tracking_state": 0}, {"label_id": 3, "tracking_state": 1}],
    }
    subscriber = SkeletonSubscriber("/z", type_, InputOptions())
    (frame,) = frames(read(subscriber, "/z", fields, distribution))
    assert frame.person == "12"
    assert len(frame.joints) == {None: 18, 0: 18, 1: 34, 2: 34}[form]
    np.testing.assert_array_equal(frame.positions[frame.joints.index("left_shoulder")], [1.0, 2.0, 3.0])
    if form is not None:
        fields["objects"] = [person | {"body_format": 3}]
        assert "body format 3" in problem(read(subscriber, "/z", fields, distribution))


def test_a_body_of_tf_is_read_once_it_is_complete() -> None:
    subscriber = SkeletonSubscriber("/tf", "tf2_msgs/TFMessage", InputOptions(frame="world"))
    assert read(subscriber, "/tf_static", tf({"camera": ("world", (1.0, 0.0, 0.5))}, 0.0, yaw=np.pi / 2)) == []
    parts = list(body("x1").items())
    for k in range(3):
        stamp = NOW + k / 30
        assert read(subscriber, "/tf", tf(dict(parts[:4]), stamp)) == []
        (frame,) = frames(read(subscriber, "/tf", tf(dict(parts[4:]), stamp)))
        assert (frame.stamp, frame.person, frame.frame_id) == (stamp, "x1", "world")
        expected = REST @ rotation_z(np.pi / 2).T + [1.0, 0.0, 0.5]
        places = [frame.joints.index(each) for each in ARM_JOINTS]
        np.testing.assert_allclose(frame.positions[places], expected, atol=1e-12)
    lost = {name: place for name, place in parts if name != "l_wrist_x1"}
    assert read(subscriber, "/tf", tf(lost, NOW + 1.0)) == []
    (frame,) = frames(read(subscriber, "/tf", tf(lost, NOW + 1.1)))  # the one before, whose wrist is old
    assert frame.stamp == NOW + 1.0
    assert [joint for joint, seen in zip(frame.joints, frame.valid, strict=True) if not seen] == ["left_wrist"]


def test_joint_states_hang_from_the_bodys_frame() -> None:
    subscriber = SkeletonSubscriber("/j", "sensor_msgs/JointState", InputOptions(height=1.5))
    angles = {f"{side}_{each}_b7": 0.0 for side in "lr" for each in ("y_shoulder", "p_shoulder", "r_shoulder", "elbow")}
    angles["l_elbow_b7"] = np.pi / 2
    state = {"header": header(frame=""), "name": list(angles), "position": list(angles.values())}
    assert "TF does not say" in problem(read(subscriber, "/j", state))
    assert read(subscriber, "/tf", tf({"body_b7": ("camera", (0.0, 0.0, 1.0))}, NOW - 0.1, yaw=np.pi / 2)) == []
    (frame,) = frames(read(subscriber, "/j", state))
    assert (frame.person, frame.frame_id, frame.stamp) == ("b7", "camera", NOW)
    expected = [[-0.16, 0.0, 1.55], [-0.16, 0.0, 1.23], [-0.16, 0.2, 1.23], [0.16, 0.0, 1.55], [0.16, 0.0, 1.23]]
    places = [frame.joints.index(each) for each in ARM_JOINTS[:5]]
    np.testing.assert_allclose(frame.positions[places], expected, atol=1e-9)
    assert "TF does not say" in problem(read(subscriber, "/j", state | {"header": header(NOW + 0.6, "")}))
    halved = {"name": list(angles)[:4], "position": list(angles.values())[:4]}
    assert "joint states without 'r_y_shoulder'" in problem(read(subscriber, "/j", state | halved))
    assert "of one body" in problem(read(subscriber, "/j", state | {"position": [0.0]}))


@pytest.mark.parametrize("joint", ["y_shoulder", "p_shoulder", "r_shoulder", "elbow"])
def test_no_angle_changes_a_bones_length_and_sides_mirror(joint: str) -> None:
    rest = {f"{side}_{each}": 0.3 for side in "lr" for each in ("y_shoulder", "p_shoulder", "r_shoulder", "elbow")}
    for angle in (-1.0, 0.0, 2.0):
        joints = body_joints(rest | {f"l_{joint}": angle, f"r_{joint}": angle, "waist": 0.2}, 1.65)
        for side in ("left", "right"):
            shoulder, elbow, wrist = (joints[f"{side}_{each}"] for each in ("shoulder", "elbow", "wrist"))
            assert np.linalg.norm(elbow - shoulder) == pytest.approx(1.6 * 0.22)
            assert np.linalg.norm(wrist - elbow) == pytest.approx(0.22)
        np.testing.assert_allclose(joints["left_wrist"] * [1, -1, 1], joints["right_wrist"], atol=1e-12)


def test_positions_are_carried_into_the_frame_that_was_asked_for() -> None:
    options = InputOptions(joints=",".join(ARM_JOINTS), frame="robot")
    subscriber = SkeletonSubscriber("/p", "geometry_msgs/PoseArray", options)
    fields = {"header": header(), "poses": [{"position": point(each)} for each in REST]}
    assert "where 'camera' is in 'robot'" in problem(read(subscriber, "/p", fields))
    read(subscriber, "/tf", tf({"camera": ("cell", (0.0, 0.0, 1.0)), "robot": ("cell", (0.0, 1.0, 0.0))}))
    (frame,) = frames(read(subscriber, "/p", fields))
    assert frame.frame_id == "robot"
    np.testing.assert_allclose(frame.positions, REST + np.array([0.0, -1.0, 1.0]))
    assert "in 'robot': it said so 0.6 s before" in problem(
        read(subscriber, "/p", fields | {"header": header(NOW + 0.6)})
    )


@pytest.mark.parametrize(
    ("places", "words"),
    [
        ({"a": ("b", (0, 0, 0)), "b": ("a", (0, 0, 0))}, "or a circle"),
        ({"a": ("b", (np.nan, 0, 0))}, "the transform of 'a'"),
        ({"": ("b", (0, 0, 0))}, "frame '': 1 to 64 printable characters"),
        ({f"f{k}": ("b", (0, 0, 0)) for k in range(1025)}, "more than 1024 coordinate frames"),
    ],
)
def test_frames_that_are_none_are_refused(places: dict[str, Any], words: str) -> None:
    subscriber = SkeletonSubscriber("/tf", "tf2_msgs/TFMessage", InputOptions())
    found = read(subscriber, "/tf", tf(places))
    found += read(subscriber, "/tf", tf(body("x", parent="a")))
    assert words in problem(found[:1])


def test_no_message_raises(random_fields: Any) -> None:
    rng = np.random.default_rng(9)
    options = InputOptions(joints=",".join(ARM_JOINTS), frame="world")
    for distribution in Distribution:
        messages = messages_of(distribution)
        for type_ in INPUTS[:-1]:  # zed_msgs are not of ROS 1
            subscriber = SkeletonSubscriber("/x", type_, options)
            for _ in range(40):
                bytes_ = bytearray(messages.encode(type_, random_fields(messages, type_, rng)))
                bytes_[rng.integers(len(bytes_))] = int(rng.integers(256))
                found = list(subscriber.read(messages, "/x", bytes(bytes_)))
                assert all(isinstance(each, MessageError | SkeletonFrame) for each in found)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: input_type("/p", "sensor_msgs/Image"), "skeletons are read from"),
        (lambda: SkeletonSubscriber("/p", "geometry_msgs/PoseArray", InputOptions()), "joints=COCO 17"),
        (
            lambda: SkeletonSubscriber("/p", "geometry_msgs/PoseArray", InputOptions(joints="COCO 18")),
            "expected a skeleton",
        ),
        (lambda: read_settings(InputOptions, "height=20", "dds:/j"), r"height '20', expected 0\.5\.\.2\.5"),
    ],
)
def test_options_name_what_is_wrong(make: Any, words: str) -> None:
    with pytest.raises(OptionError, match=words):
        make()


def test_types_may_be_written_in_short() -> None:
    for text in ("PoseArray", "geometry_msgs/PoseArray", "geometry_msgs/msg/PoseArray"):
        assert input_type("/p", text) == "geometry_msgs/PoseArray"
    assert input_type("/tf", "") == input_type("/a", "tf") == input_type("/a", "TFMessage") == "tf2_msgs/TFMessage"
    assert input_type("/z", "ObjectsStamped") == "zed_interfaces/ObjectsStamped"
