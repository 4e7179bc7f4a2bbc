"""A RealSense camera, or a recording of one, as a source: librealsense's colour and depth to people's joints."""

from __future__ import annotations

import ctypes
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import UInt8, UInt16

from kinecast.cameras.depth import DepthImage, lifted, stereo_noise
from kinecast.cameras.people_tracker import PeopleTracker, PersonDetector
from kinecast.cameras.pinhole import Intrinsics, PinholeCamera, level_pose
from kinecast.cameras.pose_estimator import PoseEstimator
from kinecast.datasets.remote_file import cached_model
from kinecast.errors import MissingExtraError, OptionError
from kinecast.live.clock import SourceClock
from kinecast.live.detection import Detection, DetectionHandler
from kinecast.live.mailbox import Feed
from kinecast.live.settings import Meta, Size, width_height

with suppress(ImportError, OSError):  # pyrealsense2 needs a libusb, which a wheel can bring too
    import libusb_package

    ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
try:
    import pyrealsense2 as rs
except ModuleNotFoundError as error:
    raise MissingExtraError("RealSense cameras", "camera") from error
except ImportError as error:
    raise OptionError(f"pyrealsense2 cannot be loaded: {error}") from None

Colour = UInt8[np.ndarray, "h w 3"]
Depth = UInt16[np.ndarray, "h w"]
RECORDINGS = (".bag", ".db3")  # endings of recordings; librealsense wrote .bag before it wrote .db3
SILENT = 5.0  # after so long without a frame [s] the camera is opened anew
RETRY = 1.0  # before a camera that failed is opened anew [s]
WAIT = 200  # longest wait for a frame before looking whether to end [ms]
CLOSING = 5.0  # longest wait for the end [s]


class RealSenseStream:
    """A camera, or a recording played at its pace; size [px] and rate [1/s] are of both images.

    Its place is a serial number, the path of a recording (see `RECORDINGS`), or nothing for whatever camera there is.
    An OptionError where there is none, or it gives no colour and depth.
    """

    def __init__(self, place: str, size: tuple[int, int] = (848, 480), rate: int = 30) -> None:
        self.recorded = place.endswith(RECORDINGS)
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
            profile = self._config.resolve(rs.pipeline_wrapper(rs.pipeline()))
            sensor = profile.get_device().first_depth_sensor()
            colour = profile.get_stream(rs.stream.color).as_video_stream_profile()
            depth = profile.get_stream(rs.stream.depth).as_video_stream_profile()
            self._format = colour.format()
            if self._format not in (rs.format.rgb8, rs.format.bgr8):
                raise RuntimeError(f"its colours are {self._format}, expected rgb8 or bgr8")
            self.unit = float(sensor.get_depth_scale())
            self.intrinsics = intrinsics_of(colour.get_intrinsics())
            known = sensor.supports(rs.option.stereo_baseline)
            baseline = float(sensor.get_option(rs.option.stereo_baseline)) / 1000 if known else 0.050
            self.noise = stereo_noise(float(depth.get_intrinsics().fx), baseline)
        except RuntimeError as error:
            what = place or "RealSense camera"
            raise OptionError(f"{what}: librealsense finds no colour and depth ({error})") from None

    def frames(self, stop: threading.Event) -> Iterator[tuple[float, Colour, Depth]]:
        """Frames as they come, the newest first to be had; ends when told to, or with the recording.

        Their stamps [s] are on the camera's clock, their depths by pixel of the colour image (RGB), in units, 0 where
        nothing was measured. A RuntimeError where the camera fails, or is silent for `SILENT`.
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
                        pixels = np.asanyarray(colour.get_data())
                        rgb = pixels if self._format == rs.format.rgb8 else np.ascontiguousarray(pixels[..., ::-1])
                        yield colour.get_timestamp() / 1000, rgb, np.asanyarray(depth.get_data())
                elif self.recorded and device.as_playback().current_status() == rs.playback_status.stopped:
                    return
                elif time.monotonic() - heard > SILENT:
                    raise RuntimeError(f"no picture for {SILENT:g} s")
        finally:
            pipeline.stop()


def intrinsics_of(found: Any) -> Intrinsics:
    """librealsense's intrinsics as OpenCV's.

    Its inverse distortion leads from pixels to directions with the coefficients that OpenCV has for the other way:
    OpenCV's five that lead back best are found by least squares.
    """
    width, height, fx, fy, cx, cy = (getattr(found, name) for name in ("width", "height", "fx", "fy", "ppx", "ppy"))
    if not any(found.coeffs):
        return Intrinsics(width, height, fx, fy, cx, cy)
    pixels = np.stack(np.meshgrid(np.linspace(0, width - 1, 16), np.linspace(0, height - 1, 12)), -1).reshape(-1, 2)
    x, y = np.array([rs.rs2_deproject_pixel_to_point(found, list(pixel), 1.0)[:2] for pixel in pixels]).T
    r2 = x * x + y * y
    to_x = np.stack([x * r2, x * r2**2, 2 * x * y, r2 + 2 * x * x, x * r2**3], axis=1)
    to_y = np.stack([y * r2, y * r2**2, r2 + 2 * y * y, 2 * x * y, y * r2**3], axis=1)
    u, v = ((pixels - (cx, cy)) / (fx, fy)).T
    coefficients, *_ = np.linalg.lstsq(np.concatenate([to_x, to_y]), np.concatenate([u - x, v - y]), rcond=None)
    return Intrinsics(width, height, fx, fy, cx, cy, tuple(map(float, coefficients)))


@dataclass(frozen=True)
class RealSenseOptions:
    """How a camera is used."""

    model: Path | None = None  # the pose estimator's ONNX file; None for the one that was downloaded
    detector: Path | None = None  # the person detector's; None to follow one person without
    size: Size = "848x480"  # of both images
    rate: Annotated[int, Meta(ge=1, le=300)] = 30  # frames in a second
    tilt: Annotated[float, Meta(ge=-90, le=90)] = 0.0  # by how much the camera looks down [deg]
    height: Annotated[float, Meta(ge=-10, le=10)] = 0.0  # of the camera above the world's origin [m]
    camera: str = ""  # of the rig


class RealSenseSource:
    """Estimates everybody's pose in each frame, in a thread of its own; a camera that fails is opened anew.

    The handler takes what is seen; without, skeletons from this camera alone go to the feed, in a world that begins
    below it. An OptionError where there is no such camera (see RealSenseStream), a ModelError for a bad network.
    """

    def __init__(
        self, name: str, feed: Feed, place: str, options: RealSenseOptions, handler: DetectionHandler | None = None
    ) -> None:
        detector = None if options.detector is None else PersonDetector(options.detector)
        self._people = PeopleTracker(PoseEstimator(options.model or cached_model("rtmpose-m")), detector)
        self.stream = RealSenseStream(place, width_height(options.size), options.rate)
        self.address, self.intrinsics = name, self.stream.intrinsics
        self._camera = PinholeCamera(name, self.intrinsics, level_pose(options.height, float(np.radians(options.tilt))))
        self._feed = feed
        self._handler = handler or self._lift
        self._clock = SourceClock()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        self._thread = threading.Thread(target=self._run, name=self.address, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        if self._thread:
            self._thread.join(CLOSING)

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                for stamp, colour, depth in self.stream.frames(self._stop):
                    self._detect(stamp, colour, depth, time.monotonic())
            except Exception as problem:  # of librealsense, onnxruntime, the camera: none may end the others
                self._feed.refuse(f"{type(problem).__name__}: {problem}")
            else:
                break
            if self.stream.recorded or self._stop.wait(RETRY):
                break
        self._feed.end()

    def _detect(self, stamp: float, colour: Colour, depth: Depth, arrived: float) -> None:
        found = self._people.update(colour)
        depths = DepthImage(depth, self.stream.unit, self.intrinsics.fx, self.stream.noise)
        people = [
            replace(depths.added(each), stamp=stamp, camera=self.address, person=name) for name, each in found.items()
        ]
        jumps = self._clock.jumps
        acquired = self._clock.acquired(stamp, arrived)
        self._feed.clock_jumps += self._clock.jumps - jumps
        self._feed.difference = self._clock.difference
        self._handler(stamp, people, acquired)

    def _lift(self, _stamp: float, people: Sequence[Detection], acquired: float) -> None:
        for person in people:
            self._feed.put(lifted(person, self._camera), acquired)
