"""`kinecast live` between topics of ROS 1: a real roscore, and a node of Debian's own packages at the other end."""

from __future__ import annotations

import json
import os
import queue
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinecast.body.skeleton import ARM_JOINTS

pytestmark = pytest.mark.timeout(900)  # programs of the system may have to be installed first

LONG = 240.0
"""Of a wait for another process, on however busy a machine [s]; most take a second."""
PYTHON = "/usr/bin/python3"
PACKAGES = (
    "python3-roslaunch",
    "python3-rospy",
    "python3-geometry-msgs",
    "python3-sensor-msgs",
    "python3-tf2-msgs",
    "python3-visualization-msgs",
)
NEEDED = "import rospy, roslaunch, geometry_msgs.msg, sensor_msgs.msg, tf2_msgs.msg, visualization_msgs.msg"
REST = np.array([[0, 0.2, 1.4], [0, 0.25, 1.1], [0.2, 0.2, 1.0], [0, -0.2, 1.4], [0, -0.25, 1.1], [0.2, -0.2, 1.0]])
ADD, REMOVE, MOVE = 0, 1, 3
"""Operations of moveit_msgs/CollisionObject."""


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


@pytest.fixture(scope="module")
def ros(debian: Callable[..., None], tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """The environment of nodes beside a running roscore."""

    def missing() -> bool:
        if not shutil.which("roscore") or not Path(PYTHON).exists():
            return True
        return subprocess.run((PYTHON, "-c", NEEDED), capture_output=True, timeout=LONG, check=False).returncode != 0

    if missing():
        debian(*PACKAGES)
    if missing():
        pytest.skip("no ROS 1, and Debian's packages could not be installed with apt-get")
    importing = (sys.executable, "-c", "import sys; sys.path.append('/usr/lib/python3/dist-packages'); import rospy")
    done = subprocess.run(importing, capture_output=True, text=True, timeout=LONG, check=False)
    if done.returncode != 0:
        pytest.skip(f"the system's rospy is not of this Python: {done.stderr.splitlines()[-1]}")
    home, port = tmp_path_factory.mktemp("ros"), free_port()
    environment = {
        "ROS_MASTER_URI": f"http://localhost:{port}",
        "ROS_HOSTNAME": "localhost",
        "ROS_HOME": str(home),
        "PATH": "/usr/bin:/bin",
    }
    core = subprocess.Popen(
        ("roscore", "-p", str(port)), env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        end = time.monotonic() + LONG
        while True:
            try:
                socket.create_connection(("localhost", port), timeout=1).close()
                break
            except OSError:
                assert core.poll() is None
                assert time.monotonic() < end
                time.sleep(0.1)
        yield {name: value for name, value in environment.items() if name != "PATH"}
    finally:
        core.terminate()
        try:
            core.wait(60.0)
        except subprocess.TimeoutExpired:
            core.kill()
            core.wait(LONG)


class Peer:
    """The node at the other end; see ros1_peer.py."""

    def __init__(self, environment: dict[str, str]) -> None:
        self._process = subprocess.Popen(
            (PYTHON, str(Path(__file__).with_name("ros1_peer.py"))),
            env=environment | {"PATH": "/usr/bin:/bin"}, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        self._heard: queue.Queue[Any] = queue.Queue()
        self.beside: subprocess.Popen[str] | None = None
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()
        assert self._heard.get(timeout=LONG) == "ready"

    def tell(self, topic: str, message: dict[str, Any]) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps({"topic": topic, "message": message}) + "\n")
        self._process.stdin.flush()

    def wait(self, wanted: Callable[[dict[str, Any]], bool], again: Callable[[], None] | None = None) -> Any:
        """The first message that is wanted; until it comes, `again` is called every now and then."""
        end = time.monotonic() + LONG
        while time.monotonic() < end:
            assert self.beside is None or self.beside.poll() is None, self.beside.communicate()[0]
            if again:
                again()
            soon = time.monotonic() + (0.1 if again else 1.0)
            while (left := soon - time.monotonic()) > 0:
                with suppress(queue.Empty):
                    if wanted(heard := self._heard.get(timeout=left)):
                        return heard["message"]
        pytest.fail("what was waited for did not come")

    def close(self) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        try:
            self._process.wait(60.0)
        finally:
            self._process.kill()
        self._listener.join(LONG)
        self._process.stdout.close()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._heard.put(json.loads(line))


@pytest.fixture
def peer(ros: dict[str, str]) -> Iterator[Peer]:
    peer = Peer(ros)
    yield peer
    peer.close()


def header(stamp: float, frame: str = "camera") -> dict[str, Any]:
    return {"stamp": {"secs": int(stamp), "nsecs": round(stamp % 1 * 1e9)}, "frame_id": frame}


def vector(values: Any) -> dict[str, float]:
    return dict(zip("xyz", map(float, values), strict=True))


def array(points: list[dict[str, float]]) -> np.ndarray:
    return np.array([[each["x"], each["y"], each["z"]] for each in points])


def test_skeletons_in_and_predictions_out(start: Callable[..., Any], ros: dict[str, str], peer: Peer) -> None:
    """One camera's poses, markers, frames and joint states; the last three are carried into the world."""
    sources = (
        f"ros1:/skeletons?type=PoseArray&person=anna&joints={','.join(ARM_JOINTS)}",
        "ros1:/spheres?type=MarkerArray&frame=world",
        "ros1:/tf?frame=world",
        "ros1:/angles?type=JointState&height=1.5&frame=world",
    )
    arguments = [each for source in sources for each in ("--source", source)]
    live = start(*arguments, "--sink", "ros1:/robot", environment=ros)
    peer.beside = live.process
    sent: dict[float, np.ndarray] = {}

    def frame() -> None:
        stamp = round(time.time(), 3)
        sent[stamp] = REST + np.array([0.0, 0.0, 0.002 * len(sent)])
        peer.tell(
            "/skeletons",
            {"header": header(stamp), "poses": [{"position": vector(each)} for each in sent[stamp]]},
        )

    def about(topic: str) -> Callable[[dict[str, Any]], bool]:
        return lambda heard: heard["topic"] == topic

    told = peer.wait(lambda heard: about("/robot/prediction")(heard) and bool(heard["message"]["steps"]), frame)
    stamp = round(told["header"]["stamp"], 3)
    assert (told["person"], told["header"]["frame_id"], told["joints"]) == ("anna", "camera", list(ARM_JOINTS))
    np.testing.assert_allclose(array(told["observed"]), sent[stamp])
    assert len(told["steps"]) <= 30  # those that had passed are left out
    assert [each["after"] for each in told["steps"]] == sorted(each["after"] for each in told["steps"])
    assert {len(each["covariance"]) for each in told["steps"]} == {36}
    assert all(tube["radius"] > 0 for each in told["steps"] for tube in each["tubes"])

    drawn = peer.wait(about("/robot/markers"), frame)
    assert [each["ns"].endswith("/anna") for each in drawn["markers"]] == [True] * 3
    poses = peer.wait(about("/robot/person_anna/poses"), frame)
    assert len(poses["poses"]) in range(6, 30 * 6 + 1, 6)
    wrist = peer.wait(about("/robot/person_anna/left_wrist"), frame)
    covariance = np.array(wrist["pose"]["covariance"]).reshape(6, 6)
    assert (np.linalg.eigvalsh(covariance) > 0).all()

    def operation(kind: int) -> Callable[[dict[str, Any]], bool]:
        return lambda heard: (
            heard["topic"] == "/robot/planning_scene"
            and heard["md5"] == "acfc50bcfd6c7b978066bfa7c786002c"  # of moveit_msgs/PlanningScene in Noetic
            and any(each["operation"] == kind for each in heard["message"]["world"]["collision_objects"])
        )

    added = peer.wait(operation(ADD), frame)
    assert added["is_diff"]
    assert added["robot_state"]["is_diff"]
    ids = {each["id"] for each in added["world"]["collision_objects"]}
    moved = peer.wait(operation(MOVE), frame)
    assert ids >= {each["id"] for each in moved["world"]["collision_objects"]}
    removed = peer.wait(operation(REMOVE))  # nobody is seen any more
    assert {each["id"] for each in removed["world"]["collision_objects"]} <= ids

    def moment() -> None:
        """One camera in the world; a body there is told by TF, one by its angles, one by markers."""
        now = header(time.time())
        frames = {"camera": ("world", [1.0, 2.0, 0.0]), "body_d2": ("camera", [0.0, 0.0, 1.0])}
        frames |= {
            name: ("camera", place)
            for name, place in zip(
                ("l_shoulder_c1", "l_elbow_c1", "l_wrist_c1", "r_shoulder_c1", "r_elbow_c1", "r_wrist_c1"),
                REST.tolist(),
                strict=True,
            )
        }
        transforms = [
            {
                "header": now | {"frame_id": parent},
                "child_frame_id": child,
                "transform": {"translation": vector(place), "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}},
            }
            for child, (parent, place) in frames.items()
        ]
        peer.tell("/tf", {"transforms": transforms})
        angles = {
            f"{side}_{joint}_d2": 0.0 for side in "lr" for joint in ("y_shoulder", "p_shoulder", "r_shoulder", "elbow")
        }
        peer.tell("/angles", {"header": now, "name": list(angles), "position": list(angles.values())})
        spheres = [
            {"header": now, "ns": "b", "id": place, "type": 2, "text": joint, "pose": {"position": vector(REST[place])}}
            for place, joint in enumerate(ARM_JOINTS)
        ]
        peer.tell("/spheres", {"markers": spheres})

    hanging = np.array([[0.0, side * 0.16, height] for side in (1, -1) for height in (1.55, 1.23, 1.03)])
    for person, topic, place in (("b", "/spheres", REST), ("c1", "/tf", REST), ("d2", "/angles", hanging)):

        def of(heard: dict[str, Any], person: str = person, topic: str = topic) -> bool:
            """TF shows d2's pelvis too, and no arms."""
            return heard["message"].get("person") == person and f":{topic}" in heard["message"]["source"]

        told = peer.wait(of, moment)
        assert told["header"]["frame_id"] == "world"
        np.testing.assert_allclose(array(told["observed"]), place + np.array([1.0, 2.0, 0.0]), atol=1e-9)
    live.end()


def test_without_a_master_it_says_so(ros: dict[str, str]) -> None:
    environment = os.environ | ros | {"ROS_MASTER_URI": f"http://localhost:{free_port()}"}
    opening = "from kinecast.ros.nodes import Ros1Transport; Ros1Transport()"
    done = subprocess.run(
        (sys.executable, "-c", opening), env=environment, capture_output=True, text=True, timeout=LONG, check=False
    )
    assert "OptionError: ros1: no master answers" in done.stderr
