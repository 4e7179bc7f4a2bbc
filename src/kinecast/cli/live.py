"""`kinecast live`: skeletons come in at the camera's pace, predictions go out."""

from __future__ import annotations

import gc
import logging
import os
import signal
import sys
import threading
import time
import webbrowser
from collections.abc import Sequence
from contextlib import ExitStack, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rich.console import Group
from rich.live import Live as Screen
from rich.logging import RichHandler
from rich.text import Text
from tyro.conf import UseAppendAction, arg

from kinecast.cameras.rig import Rig
from kinecast.cli.options import SHIPPED_HORIZON, ModelFile, OptionalFile, check_seed, read_predictor
from kinecast.cli.progress import CONSOLE, columns, plain, status_lines
from kinecast.errors import OptionError
from kinecast.geometry.scene import Scene
from kinecast.interrupts import answered
from kinecast.predictor import Predictor, PredictorOptions
from kinecast.types import Status

if TYPE_CHECKING:
    from kinecast.cli.endpoint import Endpoint
    from kinecast.live.loop import Live
    from kinecast.live.mailbox import Feed
    from kinecast.live.sources import Source

SILENT = 0.5  # after so long without a frame [s] a source is said to be silent
PER_SECOND = 4  # the table in the terminal is drawn so often

_ONCE_OR_MORE = "(once or more)"
Texts = UseAppendAction[tuple[str, ...]]
Sources = Annotated[Texts, arg(name="source", metavar="SOURCE", help_behavior_hint=_ONCE_OR_MORE)]
Sinks = Annotated[Texts, arg(name="sink", metavar="SINK", help_behavior_hint=_ONCE_OR_MORE)]
MovieFile = Annotated[Path | None, arg(metavar="FILE.mp4", help_behavior_hint="(default: none)")]
_HALF = f"(default: {SHIPPED_HORIZON} of the shipped model, all of another)"
LiveHorizon = Annotated[float | None, arg(metavar="SECONDS", help_behavior_hint=_HALF)]
RigFile = Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: no fusion)")]


def live(
    sources: Sources,
    sinks: Sinks = (),
    record: MovieFile = None,
    model: ModelFile = None,
    scene: OptionalFile = None,
    rig: RigFile = None,
    horizon: LiveHorizon = None,
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
        rig: cameras at their places, as kinecast calibrate writes it: what they see is fused (docs/rig.md).
        horizon: how far to predict; a second of the shipped model takes twice the time, and tubes grow large in it.
        samples: motions drawn per prediction.
        level: probability that each tube holds.
        seed: of the draws.
    """
    from kinecast.cli.endpoint import opened, read_sink, read_source  # here, since network and MCAP are an extra
    from kinecast.live.loop import Live

    check_seed(seed)
    if not 0 < level < 1:
        raise OptionError(f"--level {level} is outside 0..1")
    inputs = [read_source(each) for each in _once("--source", sources)]
    outputs = [read_sink(each) for each in _once("--sink", _with_defaults(sinks, record, inputs))]
    obstacles = None if scene is None else Scene.load(scene)
    cameras = None if rig is None else Rig.load(rig)
    options = PredictorOptions(samples, seed, SHIPPED_HORIZON if horizon is None and model is None else horizon)
    first = read_predictor(model, obstacles, options)
    logging.getLogger("kinecast").handlers = [RichHandler(console=CONSOLE, show_path=False)]  # above the table
    with ExitStack() as last, opened(inputs, outputs, cameras, obstacles) as (mailbox, comes, goes):
        predictors = {feed: Predictor(first.method, first.noise, obstacles, options) for feed in mailbox.feeds}
        loop = Live(mailbox, predictors, goes, level)
        _run(loop, comes, last, browser=not sinks and record is None)
    print(plain(tables(loop, running=False)))
    if failures := [sink.counters.failure for sink in goes if sink.counters.failure is not None]:
        raise OSError("; ".join(failures))


def _run(loop: Live, sources: Sequence[Source], last: ExitStack, browser: bool) -> None:
    """Until the sources end, or Ctrl-C or SIGTERM: those end it in the middle of nothing any more; a second does."""
    stop = threading.Event()

    def tell(*_: object) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()

    last.enter_context(answered(tell, signal.SIGINT, signal.SIGTERM))
    said = [f"source: {source.address}" for source in sources] + [f"sink: {sink.address}" for sink in loop.sinks]
    print("\n".join([*said, "Ctrl-C ends it"]), flush=True)
    gc.collect()
    gc.freeze()  # what is there by now stays: looking through all of it would hold everything up for 0.1 s
    last.callback(gc.unfreeze)
    has_screen = sys.platform != "linux" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    if browser and has_screen:
        webbrowser.open(loop.sinks[0].address)
    with shown(loop):
        for source in sources:
            source.start()
        loop.run(stop)


def _with_defaults(sinks: Sequence[str], record: Path | None, inputs: Sequence[Endpoint]) -> Sequence[str]:
    """The sinks, with the video that is to be recorded; a camera without any has the view."""
    cameras = sum(each.kind == "camera" for each in inputs)
    wanted = (*sinks, *(() if record is None else (f"mp4:{record}",)))
    film = next((each for each in wanted if each.startswith("mp4:")), None)
    if film is not None and cameras != 1:
        raise OptionError(f"{film}: records one --source camera:, and there are {cameras}")
    return wanted or (("view://",) if cameras else ())


def _once(option: str, texts: Sequence[str]) -> Sequence[str]:
    """The same; OptionError unless there is at least one, and each once."""
    if not texts:
        raise OptionError(f"{option}: at least one is needed")
    again = next((text for text in texts if texts.count(text) > 1 and not text.endswith(":0")), None)
    if again is not None:
        raise OptionError(f"{option} {again}: is there twice")
    return texts


def shown(loop: Live) -> Screen | nullcontext[None]:
    """A table in the terminal while it runs; nothing where there is no terminal."""
    if not CONSOLE.is_terminal:
        return nullcontext()
    return Screen(get_renderable=lambda: tables(loop), console=CONSOLE, refresh_per_second=PER_SECOND, transient=True)


def tables(loop: Live, running: bool = True) -> Group:
    """One table for what comes, one for what goes, one line for each status."""
    comes = columns("source", "status", numbers="frames,stale,refused,clients,clock [s],set")
    for feed in loop.mailbox.feeds:
        counts = (feed.received, feed.superseded, feed.refused, feed.clients)
        clock = "same" if feed.difference is None else f"{feed.difference:+.3f}"
        comes.add_row(Text(feed.name), _state(loop, feed, running), *map(str, counts), clock, str(feed.clock_jumps))
    goes = columns("sink", numbers="published,dropped,p50 [ms],p99 [ms]")
    for sink in loop.sinks:
        counters = sink.counters
        latencies = (f"{1e3 * counters.latency(share):.1f}" if counters.published else "–" for share in (0.5, 0.99))
        goes.add_row(Text(sink.address), str(counters.published), str(counters.dropped), *latencies)
    lines = map(Text, status_lines(loop.statuses.copy()))
    return Group(comes, Text(), goes, Text(), *lines)


def _state(loop: Live, feed: Feed, running: bool) -> Text:
    """The status of the newest prediction, or why there is none."""
    status = loop.last.get(feed)
    if feed.ended or not running:
        return Text("ended" if feed.ended else "–", "dim")
    if feed.last is None or (status is None and not feed.fused):
        return Text("waiting", "yellow")
    silence = time.monotonic() - feed.last
    if silence > SILENT:
        return Text(f"silent for {silence:.0f} s", "red")
    if status is None:
        return Text("fused", "green")
    return Text(status.name, "green" if status is Status.OK else "yellow")
