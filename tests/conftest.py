"""Fixtures shared by every test."""

from __future__ import annotations

import hashlib
import itertools
import json
import os
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import unquote

import jaxtyping
import numpy as np
import pytest
from hypothesis import settings

REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Unit tests check the shape of every array that a function takes; the others run as fast as users do."""
    jaxtyping.config.update("jaxtyping_disable", "unit" not in item.path.parts)


settings.register_profile("kinecast", deadline=None, derandomize=True)
settings.load_profile("kinecast")


@pytest.fixture(scope="session")
def data_root() -> Path:
    """Folder of real recordings: $KINECAST_DATA, else ../shared/data beside the checkout."""
    root = Path(os.environ.get("KINECAST_DATA", REPOSITORY.parent / "shared" / "data"))
    if not root.is_dir():
        pytest.skip(f"no recordings: {root.name} not found; set KINECAST_DATA to the folder of recordings")
    return root


@pytest.fixture(scope="session")
def model_root() -> Path:
    """Folder of pose models: $KINECAST_MODELS, else ../shared/models beside the checkout."""
    root = Path(os.environ.get("KINECAST_MODELS", REPOSITORY.parent / "shared" / "models"))
    if not (root / "pose_landmarker_full.task").is_file():
        pytest.skip("no pose model: set KINECAST_MODELS to the folder of pose_landmarker_full.task")
    return root


def colours(count: int) -> np.ndarray:
    """(count, 3) red, green, blue that differ by half the range or more, none black; at most 26."""
    return np.array([rgb for rgb in itertools.product((0, 128, 255), repeat=3) if any(rgb)][:count], dtype=np.float32)


@pytest.fixture(scope="session")
def blob_network(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """blob_network(keypoints, heatmaps=False) → an ONNX file whose answer is known: keypoint k is where colour k is."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    def make(keypoints: int, heatmaps: bool = False, width: int = 96, height: int = 128) -> Path:
        mean, scale = np.array([123.675, 116.28, 103.53]), np.array([58.395, 57.12, 57.375])
        c = (colours(keypoints) - mean) / scale
        near = 1.5  # squared distance of colours, in ImageNet's standard deviations, up to which one is that colour
        bell = np.exp(-(np.arange(-3, 4) ** 2) / 2)
        constants = {
            "twice": 2 * c[:, :, None, None],
            "bias": near - (c * c).sum(axis=1),
            "round": np.tile(np.outer(bell, bell) / 6, (keypoints, 1, 1, 1)),
            "tall": np.array(0.4),
        }
        nodes = [
            helper.make_node("Mul", ["image", "image"], ["squares"]),
            helper.make_node("ReduceSum", ["squares", "channels"], ["norm"]),
            helper.make_node("Conv", ["image", "twice", "bias"], ["likeness"]),
            helper.make_node("Sub", ["likeness", "norm"], ["signed"]),
            helper.make_node("Relu", ["signed"], ["flat"]),
            helper.make_node("Conv", ["flat", "round"], ["maps"], group=keypoints, pads=[3, 3, 3, 3]),
        ]
        outputs = {"maps": (1, keypoints, height, width)}
        axes = {"channels": np.array([1]), "rows": np.array([2]), "columns": np.array([3])}
        if not heatmaps:
            outputs = {"simcc_x": (1, keypoints, 2 * width), "simcc_y": (1, keypoints, 2 * height)}
            for name, across, size in (("x", "rows", width), ("y", "columns", height)):
                bins = np.exp(-((np.arange(2 * size) / 2 - np.arange(size)[:, None]) ** 2) / 2)
                constants[f"bins_{name}"] = bins / bins.sum(axis=1, keepdims=True) * 2
                nodes += [
                    helper.make_node("ReduceSum", ["maps", across], [f"profile_{name}"], keepdims=0),
                    helper.make_node("MatMul", [f"profile_{name}", f"bins_{name}"], [f"smooth_{name}"]),
                    helper.make_node("Mul", [f"smooth_{name}", "tall"], [f"simcc_{name}"]),
                ]
        graph = helper.make_graph(
            nodes,
            "blobs",
            [helper.make_tensor_value_info("image", TensorProto.FLOAT, (1, 3, height, width))],
            [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in outputs.items()],
            [numpy_helper.from_array(value.astype(np.float32), name) for name, value in constants.items()]
            + [numpy_helper.from_array(value, name) for name, value in axes.items()],
        )
        path = tmp_path_factory.mktemp("networks") / f"blobs{keypoints}.onnx"
        onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
        return path

    return make


@pytest.fixture(scope="session")
def blobs() -> Callable[..., np.ndarray]:
    """blobs(image, pixels, radius) → the image (h, w, 3) with a disc of colour k at pixel k, where there is one."""
    import cv2

    def draw(image: np.ndarray, pixels: np.ndarray, radius: float = 6.0) -> np.ndarray:
        for pixel, colour in zip(pixels, colours(len(pixels)), strict=True):
            if np.isfinite(pixel).all():
                place = [round(16 * float(value)) for value in pixel]
                cv2.circle(image, place, round(16 * radius), colour.tolist(), cv2.FILLED, shift=4)
        return image

    return draw


class Server(ThreadingHTTPServer):
    """Serves `files` on loopback; a test may make it misbehave."""

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.files: dict[str, bytes] = {}
        self.ranges = True  # understands Range
        self.breaks_after: int | None = None  # closes a connection after so many bytes
        self.busy: dict[str, int] = {}  # answers 503 so often first
        self.requests: list[tuple[str, str | None]] = []

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/"

    def record(self, **files: bytes) -> None:
        """Serve files and a Zenodo record that lists them."""
        self.files.update({f"files/{name}": content for name, content in files.items()})
        self.list_files([self.entry(name, content) for name, content in files.items()])

    def entry(self, name: str, content: bytes) -> dict[str, object]:
        link = {"self": f"{self.url}files/{name}"}
        return {
            "key": name,
            "size": len(content),
            "checksum": f"md5:{hashlib.md5(content).hexdigest()}",
            "links": link,
        }

    def list_files(self, entries: list[dict[str, object]], **metadata: str) -> None:
        self.files["record"] = json.dumps({"metadata": metadata, "files": entries}).encode()


class Handler(BaseHTTPRequestHandler):
    server: Server

    def do_GET(self) -> None:
        server = self.server
        path, wanted = unquote(self.path[1:]), self.headers.get("Range")
        server.requests.append((path, wanted))
        if server.busy.get(path):
            server.busy[path] -= 1
            self.send_error(503)
        elif path not in server.files:
            self.send_error(404)
        else:
            content, start = server.files[path], 0
            if wanted and server.ranges:
                start = int(wanted.removeprefix("bytes=").removesuffix("-"))
                if start >= len(content):
                    self.send_error(416)
                    return
                self.send_response(206)
                self.send_header("Content-Range", f"bytes {start}-{len(content) - 1}/{len(content)}")
            else:
                self.send_response(200)
            self.send_header("Content-Length", str(len(content) - start))
            self.end_headers()
            end = None if server.breaks_after is None or path == "record" else start + server.breaks_after
            self.wfile.write(content[start:end])
            self.close_connection = True

    def log_message(self, *_: object) -> None:
        """Silence."""


@pytest.fixture
def server() -> Iterator[Server]:
    with Server() as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield server
        server.shutdown()
        thread.join()
