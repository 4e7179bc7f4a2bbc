"""Networks in ONNX files, run by onnxruntime on two threads of the CPU. A file need not be trusted to be one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float, Shaped, UInt8

from kinecast.cameras.opencv import cv2
from kinecast.errors import MissingExtraError, ModelError

try:
    import onnxruntime
except ImportError as error:  # pragma: no cover - the tests install it
    raise MissingExtraError("cameras", "camera") from error

IMAGENET_MEAN = np.array([123.675, 116.28, 103.53], dtype=np.float32)
IMAGENET_STD = np.array([58.395, 57.12, 57.375], dtype=np.float32)  # of red, green and blue
LARGEST_FILE = 1 << 30  # bytes; the largest RTMPose takes 200 MB
LARGEST_SIDE = 2048  # of the image a network takes [px]
LARGEST_OUTPUT = 1 << 24  # numbers in one output; a YOLOX of 80 classes at 640 px gives 700 000
THREADS = 2


class ImageModel:
    """A network that takes one image: float32 (1, 3, height, width); names of its outputs, and a sample, for zeros.

    Nothing but the file itself is read: a network that keeps its weights in other files is refused by onnxruntime. A
    ModelError where it cannot be read, is none, takes something else, or fails.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            if path.stat().st_size > LARGEST_FILE:
                raise ModelError(f"{path}: {path.stat().st_size} bytes, at most {LARGEST_FILE} are read")
            content = path.read_bytes()
        except OSError as error:
            raise ModelError(f"{path}: {error.strerror}") from None
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads, options.inter_op_num_threads = THREADS, 1
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")  # waiting must not starve predicting
        options.log_severity_level = 4
        try:
            self._session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime has no common class of its own
            raise ModelError(f"{path}: onnxruntime cannot load it ({_line(error)})") from None
        inputs = self._session.get_inputs()
        if len(inputs) != 1 or inputs[0].type != "tensor(float)" or len(inputs[0].shape) != 4:
            found = ", ".join(f"{each.name} {each.type} {each.shape}" for each in inputs)[:200] or "nothing"
            raise ModelError(f"{path}: takes {found}; expected one float image, 1 x 3 x height x width")
        self._input = inputs[0].name
        batch, channels, height, width = inputs[0].shape
        if not all(isinstance(side, int) and 16 <= side <= LARGEST_SIDE for side in (height, width)):
            allowed = f"both must be fixed, 16..{LARGEST_SIDE}"
            raise ModelError(f"{path}: takes images of {width} x {height} pixels; {allowed}")
        if channels != 3 or (isinstance(batch, int) and batch != 1):
            raise ModelError(f"{path}: takes {inputs[0].shape}, expected one image of 3 channels")
        self.height, self.width = height, width
        self.outputs = tuple(each.name for each in self._session.get_outputs())
        self.sample = self.run(np.zeros((height, width, 3), dtype=np.float32))

    def window(
        self, image: UInt8[np.ndarray, "h w 3"], corner: Float[np.ndarray, " 2"], scale: float, outside: int = 0
    ) -> Float[np.ndarray, "h2 w2 3"]:
        """The part of an RGB image that the network is shown, with a value outside.

        Its first pixel is at the corner [px]; `scale` pixels of the image are one of the network's.
        """
        back = np.array([[scale, 0.0, corner[0]], [0.0, scale, corner[1]]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        size = self.width, self.height
        shown: UInt8[np.ndarray, "h2 w2 3"] = cv2.warpAffine(image, back, size, flags=flags, borderValue=(outside,) * 3)
        return shown.astype(np.float32)

    def run(self, content: Float[np.ndarray, "h w 3"]) -> list[Shaped[np.ndarray, "..."]]:
        """Every output for a `window`, in the colours that it was trained on; a ModelError where the network fails."""
        content = np.ascontiguousarray(content.transpose(2, 0, 1))[None]
        try:
            outputs = self._session.run(None, {self._input: content})
        except Exception as error:  # onnxruntime has no common class of its own
            raise ModelError(f"{self.path}: the network fails ({_line(error)})") from None
        if not all(isinstance(each, np.ndarray) and each.size <= LARGEST_OUTPUT for each in outputs):
            raise ModelError(f"{self.path}: gives more than {LARGEST_OUTPUT} numbers, or something else")
        return outputs


def _line(error: Exception) -> str:
    """Fit for a message, whatever a file says."""
    text = str(error).replace("[ONNXRuntimeError] : ", "").splitlines()
    return "".join(letter if letter.isprintable() else "?" for letter in (text[0] if text else "?")[:200])
