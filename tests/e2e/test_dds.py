"""`kinecast live` between topics of ROS 2, by DDS on the loopback, with CycloneDDS's own types at the other end."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.ros.dds import idl_type, participant
from kinecast.ros.messages import Distribution, messages_of

pytestmark = pytest.mark.timeout(900)  # programs of the system may have to be installed first

LONG = 240.0
"""Of a wait for another process, on however busy a machine [s]; most take a second."""
REST = np.array([[0, 0.2, 1.4], [0, 0.25, 1.1], [0.2, 0.2, 1.0], [0, -0.2, 1.4], [0, -0.25, 1.1], [0.2, -0.2, 1.0]])
ADD, REMOVE, MOVE = 0, 1, 3
QOS = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(50))
"""As a ROS 2 node's by default."""


@pytest.fixture(scope="module")
def domain() -> int:
    """One that no other test uses."""
    return 1 + os.getpid() % 200


@pytest.fixture(scope="module")
def other(domain: int) -> DomainParticipant:
    """A participant of this process."""
    return participant(str(domain), "")


def test_poses_in_and_everything_out(start: Callable[..., Any], domain: int, other: DomainParticipant) -> None:
    """Humble's messages and Jazzy's, each on topics of their own, through one command."""
    arguments: list[str] = []
    for name in ("humble", "jazzy"):
        settings = f"domain={domain}&distro={name}"
        joints = ",".join(ARM_JOINTS)
        arguments += ["--source", f"dds:/{name}/arms?type=PoseArray&person={name}&joints={joints}&{settings}"]
        arguments += ["--sink", f"dds:/{name}/robot?planning_scene=/{name}/scene&{settings}"]
    live = start(*arguments)
    for distribution in (Distribution.HUMBLE, Distribution.JAZZY):
        both_ways(live.process, other, distribution)
    live.end()


def both_ways(process: subprocess.Popen[str], other: DomainParticipant, distribution: Distribution) -> None:
    name = distribution.value
    messages = messages_of(distribution)
    known: dict[str, Any] = {}

    def topic(ros_name: str, type_: str) -> Topic:
        class_ = idl_type(messages, type_, known)
        assert class_.__idl_typename__.replace(".", "::") == "{}::msg::dds_::{}_".format(*type_.split("/"))
        return Topic(other, f"rt/{name}{ros_name}", class_)

    arms = DataWriter(other, topic("/arms", "geometry_msgs/PoseArray"), qos=QOS)
    told = DataReader(other, topic("/robot/prediction", "kinecast_msgs/PredictedDistribution"), qos=QOS)
    drawn = DataReader(other, topic("/robot/markers", "visualization_msgs/MarkerArray"), qos=QOS)
    scene = DataReader(other, topic("/scene", "moveit_msgs/PlanningScene"), qos=QOS)
    wrist = DataReader(
        other, topic(f"/robot/person_{name}/left_wrist", "geometry_msgs/PoseWithCovarianceStamped"), qos=QOS
    )
    sent: dict[tuple[int, int], np.ndarray] = {}
    begun = int(time.time())

    def frame() -> None:
        count = len(sent)
        at = begun + count // 20, count % 20 * 50_000_000
        stamp = known["builtin_interfaces/msg/Time"](sec=at[0], nanosec=at[1])
        sent[at] = REST + 0.001 * count
        point, pose = known["geometry_msgs/msg/Point"], known["geometry_msgs/msg/Pose"]
        turn = known["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
        header = known["std_msgs/msg/Header"](stamp=stamp, frame_id="camera")
        places = [pose(position=point(x=x, y=y, z=z), orientation=turn) for x, y, z in sent[at].tolist()]
        arms.write(known["geometry_msgs/msg/PoseArray"](header=header, poses=places))

    def wait(reader: DataReader, wanted: Callable[[Any], bool] = bool, again: Callable[[], None] | None = frame) -> Any:
        end = time.monotonic() + LONG
        while time.monotonic() < end:
            assert process.poll() is None, process.communicate()[0]
            if again:
                again()
            for message in reader.take(50):
                if message.sample_info.valid_data and wanted(message):
                    return message
            time.sleep(0.05)
        pytest.fail("what was waited for did not come")

    message = wait(told, lambda message: message.person == name and bool(message.steps))
    assert message.header.frame_id == "camera"
    assert len(message.steps) <= 30  # those that had passed are left out
    observed = [[each.x, each.y, each.z] for each in message.observed]
    np.testing.assert_array_equal(observed, sent[message.header.stamp.sec, round(message.header.stamp.nanosec, -3)])
    assert len(wait(drawn).markers) == 3
    assert np.reshape(wait(wrist).pose.covariance, (6, 6))[0, 0] > 0

    def operation(kind: int) -> Callable[[Any], bool]:
        return lambda message: any(each.operation == kind for each in message.world.collision_objects)

    added = wait(scene, operation(ADD))
    assert added.is_diff
    assert added.robot_state.is_diff
    wait(scene, operation(MOVE))
    wait(scene, operation(REMOVE), None)  # nobody is seen any more
