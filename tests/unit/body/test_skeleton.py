"""Skeleton tables: sizes, orders and aliases against the sources' documentation."""

from __future__ import annotations

import pytest

from kinecast.body import skeleton
from kinecast.body.skeleton import ARM_JOINTS, JOINTS, SKELETONS, Skeleton, require_arms
from kinecast.errors import DatasetError


@pytest.mark.parametrize("table", SKELETONS, ids=lambda table: table.name)
def test_every_table_is_canonical_and_has_both_arms(table: Skeleton) -> None:
    assert set(table.joints) <= set(JOINTS)
    assert len(set(table.joints)) == len(table.joints)
    assert set(table.aliases.values()) == set(table.joints)
    require_arms(table.joints, table.name)


@pytest.mark.parametrize("table", SKELETONS, ids=lambda table: table.name)
def test_left_and_right_mirror_each_other(table: Skeleton) -> None:
    left = {joint.removeprefix("left_") for joint in table.joints if joint.startswith("left_")}
    right = {joint.removeprefix("right_") for joint in table.joints if joint.startswith("right_")}
    assert left == right
    for source, joint in table.aliases.items():
        if "left" in source.lower():
            assert joint.startswith("left_")
        if "right" in source.lower():
            assert joint.startswith("right_")


@pytest.mark.parametrize(
    ("table", "count", "places"),
    [
        (skeleton.AZURE_KINECT_32, 32, {0: "pelvis", 5: "left_shoulder", 14: "right_wrist", 31: "right_ear"}),
        (skeleton.HA4M_UPPER_23, 23, {0: "spine", 4: "left_shoulder", 13: "right_wrist", 17: "head"}),
        (skeleton.HA4M_ARMS_14, 14, {0: "left_clavicle", 3: "left_wrist", 8: "right_shoulder"}),
        (skeleton.XSENS_23, 23, {0: "pelvis", 8: "right_shoulder", 10: "right_wrist", 12: "left_shoulder"}),
        (skeleton.COCO_17, 17, {0: "nose", 5: "left_shoulder", 10: "right_wrist", 16: "right_ankle"}),
        (skeleton.MEDIAPIPE_33, 33, {0: "nose", 11: "left_shoulder", 16: "right_wrist", 32: "right_foot"}),
        (skeleton.ZED_34, 34, {0: "pelvis", 5: "left_shoulder", 14: "right_wrist", 33: "right_heel"}),
        (skeleton.VICON, 9, {}),
        (skeleton.KTH_13, 13, {}),
        (skeleton.LEGO_6, 6, {0: "left_wrist", 1: "right_wrist", 2: "left_elbow", 5: "right_shoulder"}),
    ],
    ids=lambda value: value.name if isinstance(value, Skeleton) else None,
)  # fmt: skip
def test_source_order(table: Skeleton, count: int, places: dict[int, str]) -> None:
    assert len(table.joints) == count
    assert {place: table.joints[place] for place in places} == places


def test_arm_features_are_rows_3_to_16_of_the_upper_ones() -> None:
    assert skeleton.HA4M_ARMS_14.joints == skeleton.HA4M_UPPER_23.joints[3:17]


def test_names_are_found_in_any_case_and_spelling() -> None:
    assert skeleton.XSENS_23.find("RightForearm") == "right_elbow"
    assert skeleton.XSENS_23.find("RIGHT_FOREARM") == "right_elbow"
    assert skeleton.XSENS_23.find("RightShoulder") == "right_clavicle"
    assert skeleton.VICON.find("Left Hand") == "left_wrist"
    assert skeleton.VICON.find("left_foot") is None


def test_canonical_keeps_the_order_given() -> None:
    assert skeleton.VICON.canonical(["right_hand", "hip", "COLLAR"], "a.csv") == (
        "right_wrist",
        "pelvis",
        "collar",
    )


def test_canonical_refuses_unknown_names_and_lists_the_known() -> None:
    with pytest.raises(DatasetError, match=r"a\.csv: joint 'tail' is unknown; .*left_hand"):
        skeleton.VICON.canonical(["hip", "tail"], "a.csv")


def test_canonical_refuses_two_names_of_one_joint() -> None:
    with pytest.raises(DatasetError, match="'LeftForeArm' and 'leftforearm' both mean left_elbow"):
        skeleton.XSENS_23.canonical(["LeftForeArm", "leftforearm"], "a.mvnx")


def test_require_arms_names_what_is_missing_and_what_is_there() -> None:
    joints = [joint for joint in ARM_JOINTS if joint not in ("left_wrist", "right_elbow")]
    with pytest.raises(DatasetError, match=r"a\.csv: left_wrist, right_elbow missing.*joints are left_shoulder"):
        require_arms([*joints, "head"], "a.csv")
    with pytest.raises(DatasetError, match="the joints are no joint"):
        require_arms([], "a.csv")
