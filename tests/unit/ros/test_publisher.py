"""What predictions become: a distribution, markers, poses, and a planning scene that adds, moves and removes."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest

from kinecast.errors import OptionError
from kinecast.geometry.transforms import from_quaternion
from kinecast.live.settings import read_settings
from kinecast.ros.messages import Distribution, messages_of
from kinecast.ros.publisher import OutputOptions, Posting, PredictionPublisher
from kinecast.types import LIMBS, Status

SCENE_ONLY = "planning_scene"
ADD, REMOVE, MOVE = 0, 1, 3
ROS_NOW = 1_760_000_000.0
RAISED = np.array([0.0, 0.0, 0.001])
"""A slow motion, from frame to frame [m]."""


def decoded(postings: Iterable[Posting], distribution: Distribution = Distribution.NOETIC) -> dict[str, Any]:
    """Each topic's message, as a receiver reads it from its bytes."""
    messages = messages_of(distribution)
    return {each.topic: messages.decode(each.type_, messages.encode(each.type_, each.fields)) for each in postings}


class World:
    """A planning scene kept as MoveIt does: ADD replaces, MOVE changes poses alone, REMOVE takes away."""

    def __init__(self) -> None:
        self.objects: dict[str, list[tuple[Any, Any]]] = {}
        self.operations: list[int] = []

    def apply(self, postings: Iterable[Posting]) -> None:
        for scene in decoded(postings).values():
            assert scene.is_diff
            assert scene.robot_state.is_diff
            for each in scene.world.collision_objects:
                self.operations.append(each.operation)
                assert each.pose.orientation.w == (0.0 if each.operation == REMOVE else 1.0)
                if each.operation == ADD:
                    self.objects[each.id] = list(zip(each.primitives, each.primitive_poses, strict=True))
                elif each.operation == MOVE:
                    assert not each.primitives
                    shapes = [shape for shape, _ in self.objects[each.id]]
                    self.objects[each.id] = list(zip(shapes, each.primitive_poses, strict=True))
                else:
                    del self.objects[each.id]

    def holds(self, limb: str, points: np.ndarray, slack: float) -> np.ndarray:
        """(N,) whether points lie in a limb's objects, at least `slack` below the surface [m]."""
        inside = np.zeros(len(points), dtype=bool)
        for name, parts in self.objects.items():
            if limb in name:
                for shape, pose in parts:
                    q, p = pose.orientation, pose.position
                    turn = from_quaternion(np.array([q.w, q.x, q.y, q.z]))
                    local = (points - [p.x, p.y, p.z]) @ turn
                    if shape.type == 2:
                        inside |= np.linalg.norm(local, axis=1) <= shape.dimensions[0] - slack
                    else:
                        height, radius = shape.dimensions
                        within = np.linalg.norm(local[:, :2], axis=1) <= radius - slack
                        inside |= within & (np.abs(local[:, 2]) <= height / 2)
        return inside


def test_a_scene_adds_moves_and_removes(publish: Any) -> None:
    publisher, world = PredictionPublisher(OutputOptions(outputs=SCENE_ONLY)), World()
    rng = np.random.default_rng(0)
    for k in range(40):
        publication = publish(RAISED * k + _rest(), k / 30)
        world.apply(publisher.tell(publication, k / 30, ROS_NOW))
        tubes = publication.tubes
        for limb, name in enumerate(("left_upper_arm", "left_forearm", "right_upper_arm", "right_forearm")):
            assert {f"kinecast_person_0_{name}_{part}" for part in range(3)} <= world.objects.keys()
            along, step = rng.random((200, 1)), rng.integers(0, 15, 200)
            direction = rng.normal(size=(200, 3))
            direction /= np.linalg.norm(direction, axis=1, keepdims=True)
            axis = tubes.start[step, limb] * (1 - along) + tubes.end[step, limb] * along
            surface = axis + direction * tubes.radius[step, limb, None]
            assert world.holds(name, surface, 0.05 - 1e-9).all()  # each tube, and the limb's thickness around it
            now = publication.frame.positions[list(LIMBS[limb])]
            assert world.holds(name, now, 0.05 - 1e-9).all()
    first = world.operations[:12]
    assert first == [ADD] * 12
    assert world.operations.count(MOVE) > len(world.operations) / 3
    assert REMOVE not in world.operations
    world.apply(publisher.take_back(39 / 30 + 0.4))
    assert len(world.objects) == 12
    world.apply(publisher.take_back(39 / 30 + 0.6))  # the last predicted instant has passed
    assert not world.objects
    assert world.operations[-12:] == [REMOVE] * 12
    assert not list(publisher.take_back(math.inf))


def test_one_person_leaves_and_another_stays(publish: Any) -> None:
    publisher, world = PredictionPublisher(OutputOptions(outputs=SCENE_ONLY)), World()
    world.apply(publisher.tell(publish(_rest(), 0.0, "a"), 0.0, ROS_NOW))
    world.apply(publisher.tell(publish(_rest(), 0.4, "b"), 0.4, ROS_NOW))
    assert len(world.objects) == 24
    world.apply(publisher.tell(publish(_rest(), 0.6, "b"), 0.6, ROS_NOW))  # a was last seen 0.6 s ago
    assert len(world.objects) == 12
    assert all("person_b" in name for name in world.objects)
    world.apply(publisher.take_back(math.inf))
    assert not world.objects


def test_an_arm_that_is_lost_stays_until_its_prediction_has_passed(publish: Any) -> None:
    publisher, world = PredictionPublisher(OutputOptions(outputs=SCENE_ONLY)), World()
    world.apply(publisher.tell(publish(_rest(), 0.0), 0.0, ROS_NOW))
    lost = np.where(np.arange(6)[:, None] < 3, np.nan, _rest())
    fresh = publish(lost, 0.3, "other")  # of whom nothing was known before: no left arm at all
    assert np.isnan(fresh.tubes.radius[:, :2]).all()
    world.apply(publisher.tell(fresh, 0.3, ROS_NOW))
    assert sum("other_left" in name for name in world.objects) == 0
    assert sum("other_right" in name for name in world.objects) == 6
    assert sum("person_0_left" in name for name in world.objects) == 6


def test_objects_are_added_anew_for_those_who_came_later(publish: Any) -> None:
    publisher, late = PredictionPublisher(OutputOptions(outputs=SCENE_ONLY)), World()
    for k in range(45):
        postings = list(publisher.tell(publish(_rest(), k / 30), k / 30, ROS_NOW))
        if k >= 10:
            late.objects |= {
                each["id"]: [] for posting in postings for each in posting.fields["world"]["collision_objects"]
                if each["operation"] == ADD
            }  # fmt: skip
    assert len(late.objects) == 12


@pytest.mark.parametrize("distribution", Distribution)
def test_a_distribution_says_what_the_prediction_says(publish: Any, distribution: Distribution) -> None:
    publication = publish(_rest(), 2.0, "anna b")
    told = decoded(PredictionPublisher(OutputOptions()).tell(publication, 2.01, ROS_NOW), distribution)
    message, prediction = told["/kinecast/prediction"], publication.prediction
    assert (message.person, message.source, message.header.frame_id) == ("anna b", "camera", "cell")
    assert list(Status)[message.status] is prediction.status
    assert getattr(message, prediction.status.name) == message.status
    assert message.advice == prediction.status.advice
    assert message.joints == list(prediction.joints)
    assert len(message.steps) == len(prediction.times) == 15
    for k, step in enumerate(message.steps):
        assert step.after == pytest.approx(prediction.times[k] - 2.0)
        np.testing.assert_array_equal([[p.x, p.y, p.z] for p in step.mean], prediction.mean[k])
        np.testing.assert_array_equal(
            step.covariance.reshape(6, 6)[:, [0, 3, 5]], np.diagonal(prediction.covariance[k], axis1=1, axis2=2)
        )
        np.testing.assert_array_equal([tube.radius for tube in step.tubes], publication.tubes.radius[k])
    stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
    assert stamp == pytest.approx(ROS_NOW - 0.01, abs=1e-6)  # acquired 10 ms before, on the ROS clock
    assert set(told) == {
        "/kinecast/prediction", "/kinecast/markers", "/kinecast/planning_scene",
        *(f"/kinecast/person_anna_b/{each}" for each in ("poses", *prediction.joints)),
    }  # fmt: skip
    wrist = told["/kinecast/person_anna_b/left_wrist"]
    assert wrist.header.stamp.sec + 1e-9 * wrist.header.stamp.nanosec == pytest.approx(
        stamp + prediction.times[-1] - 2.0
    )
    np.testing.assert_array_equal(wrist.pose.covariance.reshape(6, 6)[:3, :3], prediction.covariance[-1, 2])
    poses = [
        [each.position.x, each.position.y, each.position.z] for each in told["/kinecast/person_anna_b/poses"].poses
    ]
    np.testing.assert_array_equal(np.reshape(poses, (15, 6, 3)), prediction.mean)


def test_stamps_of_the_ros_clock_go_out_as_they_came(publish: Any) -> None:
    told = decoded(
        PredictionPublisher(OutputOptions(outputs="prediction")).tell(publish(_rest(), ROS_NOW - 2.0), 5.0, ROS_NOW)
    )
    assert told["/kinecast/prediction"].header.stamp.sec == ROS_NOW - 2


def test_markers_fade_and_are_deleted(publish: Any) -> None:
    publisher = PredictionPublisher(OutputOptions(outputs="markers"), "/cell/arms")
    (message,) = decoded(publisher.tell(publish(_rest(), 0.0, "a"), 0.0, ROS_NOW)).values()
    seen, mean, words = message.markers
    assert (len(seen.points), len(mean.points), len(mean.colors)) == (8, 15 * 8, 15 * 8)
    opacities = [colour.a for colour in mean.colors[::8]]
    assert opacities == sorted(opacities, reverse=True)
    assert words.text == "a: WARMING_UP"
    assert mean.lifetime.nanosec == pytest.approx(0.5e9, abs=1e7)
    (deleted,) = decoded(publisher.take_back(1.0)).values()
    assert [(each.ns, each.id, each.action) for each in deleted.markers] == [(seen.ns, id_, 2) for id_ in range(3)]
    nothing = publish(np.full((6, 3), np.nan), 0.0, "b")
    (message,) = decoded(publisher.tell(nothing, 0.0, ROS_NOW)).values()
    assert not message.markers[0].points


def test_names_of_persons_become_topics_that_differ(publish: Any) -> None:
    publisher = PredictionPublisher(OutputOptions(outputs="poses"))
    topics = [
        next(iter(publisher.tell(publish(_rest(), 0.0, person), 0.0, ROS_NOW))).topic
        for person in ("7", "a b", "a/b", "__", "a b")
    ]
    names = ["person_7", "person_a_b", "person_a_b_2", "person_0", "person_a_b"]
    assert topics == [f"/kinecast/{name}/poses" for name in names]
    crowd = [len(list(publisher.tell(publish(_rest(), 0.0, f"p{k}"), 0.0, ROS_NOW))) for k in range(70)]
    assert crowd[0] == 7
    assert crowd[-1] == 0


@pytest.mark.parametrize(
    ("make", "problem"),
    [
        (lambda: PredictionPublisher(OutputOptions(), "kinecast"), "no ROS name"),
        (lambda: PredictionPublisher(OutputOptions(planning_scene="/a-b")), "no ROS name"),
        (lambda: PredictionPublisher(OutputOptions(outputs="tubes")), "tubes: expected some of"),
        (lambda: read_settings(OutputOptions, "parts=0", "ros1:"), r"parts '0', expected a whole number in 1\.\.8"),
        (lambda: read_settings(OutputOptions, "thickness=2", "ros1:"), r"thickness '2', expected 0\.\.0\.5"),
    ],
)
def test_options_name_what_is_wrong(make: Any, problem: str) -> None:
    with pytest.raises(OptionError, match=problem):
        make()


def _rest() -> np.ndarray:
    return np.array([[0, 0.2, 1.4], [0, 0.25, 1.1], [0.2, 0.2, 1.0], [0, -0.2, 1.4], [0, -0.25, 1.1], [0.2, -0.2, 1.0]])
