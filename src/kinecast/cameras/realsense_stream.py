"""Pictures of a RealSense camera or of a recording of one: colour, and depth laid over it, by librealsense."""

from __future__ import annotations

import ctypes
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
from jaxtyping import UInt8, UInt16

from kinecast.cameras.camera import Intrinsics
from kinecast.cameras.depth import StereoNoise
from kinecast.errors import MissingExtraError, OptionError

__all__ = ["FILES", "Picture", "RealSenseStream", "intrinsics_of", "rs"]

FILES = (".bag", ".db3")
"""Endings of recordings; librealsense wrote .bag before it wrote .db3."""
SILENT = 5.0
"""After so long without a picture [s] the camera is opened anew."""
WAIT = 200
"""Longest wait for a picture before looking whether to end [ms]."""


def _library() -> ModuleType:
    """pyrealsense2, which needs a libusb that a wheel can bring too.

    Raises:
        MissingExtraError: it is not installed.
        OptionError: it cannot be loaded.
    """
    try:
        try:
            import pyrealsense2
        except ImportError as error:
            if "libusb" not in str(error):
                raise
            import libusb_package

            ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
            import pyrealsense2
    except ModuleNotFoundError as error:
        raise MissingExtraError("RealSense cameras", "camera") from error
    except (ImportError, OSError) as error:
        raise OptionError(f"pyrealsense2 cannot be loaded: {error}") from None
    return pyrealsense2


rs = _library()
"""pyrealsense2."""


@dataclass(frozen=True)
class Picture:
    """Colour and depth of one instant.

    Attributes:
        stamp: when it was taken [s], on the camera's clock.
        colour: red, green, blue.
        depth: by pixel of the colour image, in units; 0 where nothing was measured.
    """

    stamp: float
    colour: UInt8[np.ndarray, "h w 3"]
    depth: UInt16[np.ndarray, "h w"]


class RealSenseStream:
    """A camera, or a recording played at its pace.

    Args:
        place: a serial number, the path of a recording (see `FILES`), or nothing for whatever camera there is.
        size: width and height of both images [px].
        rate: pictures in a second.

    Attributes:
        recorded: whether it is a recording.
        intrinsics: of the colour image.
        unit: of a depth [m].
        noise: of the depths.

    Raises:
        OptionError: there is no such camera or recording, or it gives no colour and depth.
    """

    def __init__(self, place: str, size: tuple[int, int] = (848, 480), rate: int = 30) -> None:
        self.recorded = place.endswith(FILES)
        if self.recorded and not Path(place).is_file():
            raise OptionError(f"{place}: no such file")
        self._config = rs.config()
        if self.recorded:
            self._config.enable_device_from_file(place, repeat_playback=False)
        else:
            if place:
                self._config.enable_device(place)
            self._config.enable_stream(rs.stream.depth, *size, rs.format.z16, rate)
            self._config.enable_stream(rs.stream.color, *size, rs.format.rgb8, rate)
        try:
            self._read(self._config.resolve(rs.pipeline_wrapper(rs.pipeline())))
        except RuntimeError as error:
            what = place or "RealSense camera"
            raise OptionError(f"{what}: librealsense finds no colour and depth ({error})") from None

    def pictures(self, stop: threading.Event) -> Iterator[Picture]:
        """Pictures as they come, the newest first to be had; ends when told to, or with the recording.

        Raises:
            RuntimeError: the camera fails, or is silent for `SILENT`.
        """
        pipeline, align = rs.pipeline(), rs.align(rs.stream.color)
        device = pipeline.start(self._config).get_device()
        try:
            heard = time.monotonic()
            while not stop.is_set():
                came, frames = pipeline.try_wait_for_frames(WAIT)
                if came:
                    heard = time.monotonic()
                    aligned = align.process(frames)
                    colour, depth = aligned.get_color_frame(), aligned.get_depth_frame()
                    if colour and depth:
                        yield Picture(colour.get_timestamp() / 1000, self._colours(colour), _array(depth))
                elif self.recorded and device.as_playback().current_status() == rs.playback_status.stopped:
                    return
                elif time.monotonic() - heard > SILENT:
                    raise RuntimeError(f"no picture for {SILENT:g} s")
        finally:
            pipeline.stop()

    def _read(self, profile: object) -> None:
        sensor = profile.get_device().first_depth_sensor()  # type: ignore[attr-defined]
        colour, depth = (
            profile.get_stream(kind).as_video_stream_profile()  # type: ignore[attr-defined]
            for kind in (rs.stream.color, rs.stream.depth)
        )
        self._format = colour.format()
        if self._format not in (rs.format.rgb8, rs.format.bgr8):
            raise RuntimeError(f"its colours are {self._format}, expected rgb8 or bgr8")
        self.unit = float(sensor.get_depth_scale())
        self.intrinsics = intrinsics_of(colour.get_intrinsics())
        self.noise = StereoNoise(focal=float(depth.get_intrinsics().fx))
        if sensor.supports(rs.option.stereo_baseline):
            self.noise = StereoNoise(self.noise.focal, float(sensor.get_option(rs.option.stereo_baseline)) / 1000)

    def _colours(self, frame: object) -> UInt8[np.ndarray, "h w 3"]:
        pixels = _array(frame)
        return pixels if self._format == rs.format.rgb8 else np.ascontiguousarray(pixels[..., ::-1])


def intrinsics_of(found: object) -> Intrinsics:
    """librealsense's intrinsics as OpenCV's.

    Its inverse distortion leads from pixels to directions with the coefficients that OpenCV has for the other way:
    OpenCV's five that lead back best are found by least squares.

    Args:
        found: an rs.intrinsics.

    Raises:
        RuntimeError: librealsense cannot tell the direction of a pixel.
    """
    width, height, fx, fy, cx, cy = (getattr(found, name) for name in ("width", "height", "fx", "fy", "ppx", "ppy"))
    if not any(found.coeffs):  # type: ignore[attr-defined]
        return Intrinsics(width, height, fx, fy, cx, cy)
    pixels = np.stack(np.meshgrid(np.linspace(0, width - 1, 16), np.linspace(0, height - 1, 12)), -1).reshape(-1, 2)
    x, y = np.array([rs.rs2_deproject_pixel_to_point(found, list(pixel), 1.0)[:2] for pixel in pixels]).T
    r2 = x * x + y * y
    to_x = np.stack([x * r2, x * r2**2, 2 * x * y, r2 + 2 * x * x, x * r2**3], axis=1)
    to_y = np.stack([y * r2, y * r2**2, r2 + 2 * y * y, 2 * x * y, y * r2**3], axis=1)
    wanted = (pixels - (cx, cy)) / (fx, fy)
    off = np.concatenate([wanted[:, 0] - x, wanted[:, 1] - y])
    coefficients, *_ = np.linalg.lstsq(np.concatenate([to_x, to_y]), off, rcond=None)
    return Intrinsics(width, height, fx, fy, cx, cy, tuple(map(float, coefficients)))


def _array(frame: object) -> np.ndarray:
    return np.asanyarray(frame.get_data())  # type: ignore[attr-defined]
