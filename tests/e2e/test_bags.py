"""`kinecast live` from bags and into bags, and what is said where ROS or an option is missing."""

from __future__ import annotations

import re
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

HAS_ROS_2 = find_spec("rclpy") is not None
MODEL = Path(__file__).resolve().parents[2] / "src" / "kinecast" / "data" / "models" / "zero_velocity.npz"


def test_a_bag_is_played_into_bags_of_both_generations(
    kinecast: Callable[..., Any], tables: tuple[Path, Path], tmp_path: Path
) -> None:
    take, first, second = tmp_path / "take.bag", tmp_path / "first.bag", tmp_path / "second"
    assert kinecast("convert", tables[0], take).code == 0
    sinks = ("--sink", f"bag:{first}", "--sink", f"bag:{second}?distro=humble&storage=sqlite3&outputs=prediction,poses")
    done = kinecast(
        "live", "--source", f"bag:{take}?speed=5", "--model", MODEL, "--horizon", 0.5, "--samples", 20, *sinks
    )
    assert done.code == 0, done.err
    frames, stale = map(int, re.findall(r"ended\s+(\d+)\s+(\d+)", done.out)[0])
    assert frames == 150
    counts = re.findall(r"^bag:\S*(?:first|second)\S*\s+(\d+)\s+(\d+)", done.out, re.MULTILINE)
    assert [int(published) + int(dropped) for published, dropped in counts] == [frames - stale] * 2
    again = kinecast(
        "live", "--source", f"bag:{second}?joints=COCO 17", "--model", MODEL, "--sink", f"bag:{tmp_path / 'third.bag'}"
    )
    # Six joints at each of fifteen steps, or at those that are still to come where the machine is busy.
    assert re.search(r"no skeleton in /kinecast/person_0/poses: \d+ rows for 17 joints", again.err)
    refused = kinecast("live", "--source", f"bag:{take}", "--model", MODEL, "--sink", f"bag:{first}")
    assert (refused.code, "a bag is never replaced" in refused.err) == (2, True)
    assert not (tmp_path / "third.bag").exists()


@pytest.mark.parametrize(
    ("source", "sink", "problem"),
    [
        ("dds:/arms", "dds:", "say of which type"),
        ("dds:/arms?type=Image", "dds:", "type 'Image': skeletons are read from"),
        ("dds:/arms?type=PoseArray", "dds:", "joints=COCO 17"),
        ("dds:arms?type=MarkerArray", "dds:", "a topic such as /skeletons"),
        ("dds:/arms?type=JointState&height=tall", "dds:", "height 'tall', expected 0.5..2.5"),
        ("dds:/tf?domain=999", "dds:", "domain 999 is outside 0..232"),
        ("dds:/tf?domain=one", "dds:", "domain one is outside 0..232"),
        ("dds:/arms?type=MarkerArray&camera=left", "dds:", "a camera needs --rig"),
        ("dds:/tf?distro=noetic", "dds:", "distro 'noetic', expected humble or jazzy"),
        ("dds:/tf?network=a b", "dds:", "network 'a b', expected the name or address of an interface"),
        ("ros1:/tf?domain=1", "ros1:", "domain unknown; allowed are camera, type, joints"),
        pytest.param("ros2:/tf", "ros2:", "no rclpy here", marks=pytest.mark.skipif(HAS_ROS_2, reason="there is one")),
        ("dds:/tf", "dds:kinecast", "'kinecast' is no ROS name"),
        ("dds:/tf", "dds:/a?outputs=tubes", "output tubes: expected some of"),
        ("dds:/tf", "dds:/a?parts=1.5", "parts '1.5', expected a whole number in 1..8"),
        ("dds:/tf", "bag:out?storage=tape", "storage 'tape'"),
        ("bag:nowhere.bag", "bag:out.bag", "nowhere.bag: no bag that can be read"),
    ],
)
def test_what_is_wrong_is_said(
    kinecast: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, source: str, sink: str, problem: str
) -> None:
    monkeypatch.chdir(tmp_path)
    outcome = kinecast("live", "--source", source, "--sink", sink, "--model", MODEL)
    assert outcome.code == 2
    assert problem in " ".join(outcome.err.split())
    assert not list(tmp_path.iterdir())
