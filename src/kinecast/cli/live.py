"""`kinecast live`: skeletons come in at the camera's pace, predictions go out."""

from __future__ import annotations

import gc
import logging
import os
import signal
import sys
import threading
import webbrowser
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rich.logging import RichHandler
from tyro.conf import UseAppendAction, arg

from kinecast.cameras.rig import Rig
from kinecast.cli.options import ModelFile, OptionalFile, check_seed, read_predictor
from kinecast.cli.progress import CONSOLE
from kinecast.errors import OptionError
from kinecast.geometry.scene import Scene
from kinecast.predictor import Predictor, PredictorOptions

if TYPE_CHECKING:
    from kinecast.cli.endpoint import Endpoint

_ONCE_OR_MORE = "(once or more)"
Texts = UseAppendAction[tuple[str, ...]]
Sources = Annotated[Texts, arg(name="source", metavar="SOURCE", help_behavior_hint=_ONCE_OR_MORE)]
Sinks = Annotated[Texts, arg(name="sink", metavar="SINK", help_behavior_hint=_ONCE_OR_MORE)]
MovieFile = Annotated[Path | None, arg(metavar="FILE.mp4", help_behavior_hint="(default: none)")]
RigFile = Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: no fusion)")]


def live(
    sources: Sources,
    sinks: Sinks = (),
    record: MovieFile = None,
    model: ModelFile = None,
    scene: OptionalFile = None,
    rig: RigFile = None,
    samples: int = 1000,
    level: float = 0.95,
    seed: int = 0,
) -> None:
    """Predicts from skeletons as they come, and sends each prediction on, until the sources end or Ctrl-C.

    Args:
        sources: a recording's path, recording:PATH?speed=2&repeat=1 to play it faster or again, ws://HOST:PORT or
            udp://HOST:PORT to listen for skeletons (docs/live.md), xsens://HOST:9763?person=0 for Xsens MVN
            (docs/mocap.md); without a HOST only this machine is heard. camera:0 is a webcam, camera:FILE a video and
            camera:FOLDER pictures; realsense:SERIAL?model=FILE is a camera with depth
            (docs/cameras.md); ros1:, ros2: or dds:/TOPIC?type=PoseArray and bag:PATH are ROS (docs/ros.md).
        sinks: view://HOST:PORT to see it in a browser, ws://HOST:PORT to send predictions to all who connect, mcap:FILE
            for Foxglove, jsonl:FILE, ros1:, ros2: or dds:/NAMESPACE, bag:PATH. Without any, camera: opens view://.
        record: a video of the camera's picture with what is predicted drawn in it.
        model: a model file, or MODULE:FUNCTION that gives your own method (docs/predictor.md).
        scene: obstacles and goals, a YAML file.
        rig: cameras at their places, as kinecast calibrate writes it: what they see is fused (docs/cameras.md).
        samples: motions drawn per prediction.
        level: probability that each tube holds.
        seed: of the draws.
    """
    from kinecast.cli.endpoint import opened, read_sink, read_source  # here, since network and MCAP are an extra
    from kinecast.cli.live_display import shown, summary
    from kinecast.live.loop import Live

    check_seed(seed)
    if not 0 < level < 1:
        raise OptionError(f"--level {level} is outside 0..1")
    inputs = [read_source(each) for each in _once("--source", sources)]
    outputs = [read_sink(each) for each in _once("--sink", _with_defaults(sinks, record, inputs))]
    obstacles = None if scene is None else Scene.load(scene)
    cameras = None if rig is None else Rig.load(rig)
    options = PredictorOptions(samples=samples, seed=seed)
    first = read_predictor(model, obstacles, options)
    with ExitStack() as last, _logged(), opened(inputs, outputs, cameras, obstacles) as (mailbox, comes, goes):
        loop = Live(mailbox, lambda: Predictor(first.method, first.noise, obstacles, options), goes, level)
        stop = last.enter_context(_until_told())  # until here, Ctrl-C ends it in the middle of what it opens
        said = [f"source: {source.address}" for source in comes] + [f"sink: {sink.address}" for sink in goes]
        print("\n".join([*said, "Ctrl-C ends it"]), flush=True)
        gc.collect()
        gc.freeze()  # what is there by now stays: looking through all of it would hold everything up for 0.1 s
        last.callback(gc.unfreeze)
        if not sinks and record is None:
            _open_browser(goes[0].address)
        with shown(loop):
            for source in comes:
                source.start()
            loop.run(stop)
    print(summary(loop))
    if failures := [sink.counters.failure for sink in goes if sink.counters.failure is not None]:
        raise OSError("; ".join(failures))


def _with_defaults(sinks: Sequence[str], record: Path | None, inputs: Sequence[Endpoint]) -> Sequence[str]:
    """The sinks, with the video that is to be recorded; a camera without any has the view."""
    cameras = sum(each.kind == "camera" for each in inputs)
    wanted = (*sinks, *(() if record is None else (f"mp4:{record}",)))
    film = next((each for each in wanted if each.startswith("mp4:")), None)
    if film is not None and cameras != 1:
        raise OptionError(f"{film}: records one --source camera:, and there are {cameras}")
    return wanted or (("view://",) if cameras else ())


def _open_browser(address: str) -> None:
    """Shows a page where there is a screen to show it on."""
    if sys.platform != "linux" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")):
        webbrowser.open(address)


def _once(option: str, texts: Sequence[str]) -> Sequence[str]:
    """The same; OptionError unless there is at least one, and each once."""
    if not texts:
        raise OptionError(f"{option}: at least one is needed")
    again = next((text for text in texts if texts.count(text) > 1 and not text.endswith(":0")), None)
    if again is not None:
        raise OptionError(f"{option} {again}: is there twice")
    return texts


@contextmanager
def _until_told() -> Iterator[threading.Event]:
    """An event that Ctrl-C or SIGTERM sets instead of ending the program in the middle of something; a second does."""
    stop = threading.Event()

    def tell(*_: object) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()

    before = {number: signal.signal(number, tell) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _logged() -> Iterator[None]:
    """What is logged goes to the terminal, above the table."""
    handler = RichHandler(console=CONSOLE, show_path=False)
    logger = logging.getLogger("kinecast")
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
