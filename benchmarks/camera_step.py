"""What one picture costs beside the networks: crop, keypoints, depths and the lifted skeleton, for one person.

python -m benchmarks.camera_step [--model ONNX] [--pictures N] [--out JSON]

Colour and depth are of 848 x 480 pixels: a person of noise 2 m away in front of a wall. Without --model the network is
one that gives the same 26 keypoints whatever it sees, in a moment. Times are of the processor in one thread, but for
the network's, which are by the clock.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from benchmarks.machine import facts, milliseconds, save
from kinecast.cameras.depth import DepthImage, lifted, stereo_noise
from kinecast.cameras.pinhole import Intrinsics, PinholeCamera, level_pose
from kinecast.cameras.pose_estimator import PoseEstimator

SIZE = (848, 480)
INPUT = (192, 256)
"""Of RTMPose, width and height [px]."""
FOCAL = 615.0


def main() -> None:
    """Runs, prints, writes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", type=Path)
    parser.add_argument("--pictures", type=int, default=500)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    before = facts()
    result = run(arguments.model, arguments.pictures)
    if arguments.out:
        save("camera_step", result, arguments.out, before)
    print(json.dumps(result, indent=1))


def run(model: Path | None, pictures: int) -> dict[str, Any]:
    """Times of so many pictures.

    Args:
        model: a pose estimator; None for one that needs no time.
        pictures: how many.

    Returns:
        Milliseconds: of the network, of the estimator without it, of depths and skeleton.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = model or constant_network(Path(folder) / "pose.onnx")
        estimator = PoseEstimator(path)
    network = TimedRun(estimator)
    cv2.setNumThreads(1)
    rng = np.random.default_rng(0)
    colour = rng.integers(0, 255, (SIZE[1], SIZE[0], 3), dtype=np.uint8)
    depth = np.full((SIZE[1], SIZE[0]), 3500.0)
    depth[40:460, 330:520] = 2000.0
    values = (depth + rng.normal(0, 15, depth.shape)).astype(np.uint16)
    camera = PinholeCamera("camera", Intrinsics(*SIZE, FOCAL, FOCAL, 423.5, 239.5), level_pose())
    box = np.array([330.0, 40.0, 520.0, 460.0])
    estimates, lifts = [], []
    for _ in range(pictures):
        begun = time.thread_time()
        seen = estimator.estimate(colour, box)
        estimated = time.thread_time()
        image = DepthImage(values, 0.001, FOCAL, stereo_noise())
        lifted(image.added(seen), camera)
        lifts.append(time.thread_time() - estimated)
        estimates.append(estimated - begun - network.here[-1])
    return {
        "network": milliseconds(network.seconds),
        "estimate_without_network": milliseconds(estimates),
        "depths_and_skeleton": milliseconds(lifts),
        "together_without_network_p50_ms": 1e3 * float(np.median(np.add(estimates, lifts))),
    }


class TimedRun:
    """Notes how long an estimator's network takes.

    Attributes:
        seconds: of each run.
        here: of each run, of the processor in this thread.
    """

    def __init__(self, estimator: PoseEstimator) -> None:
        self.seconds: list[float] = []
        self.here: list[float] = []
        self._run = estimator.model.run
        estimator.model.run = self  # type: ignore[method-assign]

    def __call__(self, image: np.ndarray) -> list[np.ndarray]:
        begun, here = time.perf_counter(), time.thread_time()
        outputs = self._run(image)
        self.seconds.append(time.perf_counter() - begun)
        self.here.append(time.thread_time() - here)
        return outputs


def constant_network(path: Path) -> Path:
    """Writes a network of RTMPose's form that sees 26 keypoints down the middle of whatever it is shown."""
    width, height = INPUT
    x, y = np.zeros((1, 26, 2 * width), np.float32), np.zeros((1, 26, 2 * height), np.float32)
    x[0, :, width], y[0, np.arange(26), np.linspace(60, 2 * height - 60, 26).astype(int)] = 1.0, 1.0
    outputs = {"simcc_x": x, "simcc_y": y}
    graph = helper.make_graph(
        [helper.make_node("Identity", [f"{name}_always"], [name]) for name in outputs],
        "constant",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, (1, 3, height, width))],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, value.shape) for name, value in outputs.items()],
        [numpy_helper.from_array(value, f"{name}_always") for name, value in outputs.items()],
    )
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
    return path


if __name__ == "__main__":
    main()
