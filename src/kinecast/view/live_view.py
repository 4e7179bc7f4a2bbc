"""Predictions as they come, in the browser: a sink of `kinecast live`."""

from __future__ import annotations

import html
import threading
import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from kinecast.geometry.scene import Scene
from kinecast.live.counters import SinkCounters
from kinecast.live.publication import Publication, colour_of
from kinecast.types import LIMBS
from kinecast.view.scene_nodes import People, ahead, draw_floor, draw_scene, tubes
from kinecast.view.server import open_server, stop_server, url_of

if TYPE_CHECKING:
    from kinecast.cameras.overlay import Picture


REST, PATIENCE = 0.025, 0.012
"""Between two pictures [s]; after that the next prediction is drawn as it comes, or, after so long, the last one."""
PICTURE_REST = 0.1  # between two pictures of a camera [s]
GONE = 1.0  # a person without a newer prediction for so long is drawn no more [s]
MOST_SHOWN = 16  # persons; of more, those whose predictions are newest
FROM = np.array([1.9, -1.4, 0.9])  # where the first person is looked at from [m]


class LiveView:
    """Draws the newest prediction of every person about 30 times a second: body, arms at every step, tubes, status.

    The scene, obstacles and goals, is drawn too; port 0 is any that is free, the name is the sink's in messages. An
    OptionError where nothing can listen there.
    """

    def __init__(self, host: str, port: int, scene: Scene | None = None, name: str = "the view") -> None:
        self._server = open_server(host, port, name)
        self.address = url_of(self._server)
        self.counters = SinkCounters(self.address, "drawn")
        scene_api = self._server.scene
        scene_api.set_up_direction("+z")
        self._server.initial_camera.up = (0.0, 0.0, 1.0)
        draw_floor(scene_api)
        if scene is not None:
            draw_scene(scene_api, scene)
        self._people, self._tubes = People(scene_api), tubes(scene_api)
        self._arms = scene_api.add_line_segments("/region/arms", np.zeros((0, 2, 3)), (0, 0, 0), thickness=0.008)
        self._aimed = False
        self.words = self._server.gui.add_html(_words([]))
        self.images: dict[str, Any] = {}  # of each source, as shown
        self._waiting: dict[tuple[str, str], Publication] = {}
        self._shown: dict[tuple[str, str], tuple[Publication, float]] = {}
        self._pictures: dict[str, Picture] = {}  # of each source, until it is shown
        self._pictured = -np.inf  # when a picture was last shown [s]
        self._lock = threading.Lock()
        self._arrived = threading.Event()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=self.address, daemon=True)
        self._thread.start()

    def publish(self, publication: Publication) -> None:
        """See kinecast.live.sinks.Sink; one that a newer replaces before it is drawn counts as dropped."""
        with self._lock:
            self.counters.drop(publication.key in self._waiting)
            self._waiting[publication.key] = publication
        self._arrived.set()

    def take(self, picture: Picture) -> None:
        """A camera's picture: the newest is shown beside, with what is predicted drawn in it; never waits."""
        self._pictures[picture.source] = picture
        self._arrived.set()

    def close(self) -> None:
        """See kinecast.live.sinks.Sink."""
        self._closing.set()
        self._thread.join(5.0)  # the first picture may still be in a compiler's hands
        stop_server(self._server)

    def _run(self) -> None:
        while not self._closing.wait(REST):
            self._arrived.clear()
            self._arrived.wait(PATIENCE)
            with self._lock:
                newest, self._waiting = self._waiting, {}
            if self.counters.attempt(self._refresh, newest, time.monotonic()):
                for publication in newest.values():
                    self.counters.sent(time.monotonic() - publication.acquired)
            else:
                self.counters.drop(len(newest))
                for key in newest:  # else what cannot be drawn would keep others from being drawn
                    self._shown.pop(key, None)
            self.counters.attempt(self._picture, time.monotonic())

    def _picture(self, now: float) -> None:
        """Shows the newest picture of each camera, ten times a second."""
        if self._pictures and now - self._pictured >= PICTURE_REST:
            from kinecast.cameras.overlay import drawn  # here, since OpenCV is another extra

            self._pictured = now
            shown = [publication for publication, _ in self._shown.values()]
            for source in list(self._pictures):
                picture = self._pictures.pop(source)
                image = drawn(picture, [each for each in shown if each.source == source])
                if source not in self.images:
                    add = self._server.gui.add_image
                    self.images[source] = add(image, label=source, format="jpeg", jpeg_quality=80)
                self.images[source].image = image

    def _refresh(self, newest: Mapping[tuple[str, str], Publication], now: float) -> None:
        there = {key: each for key, each in self._shown.items() if now - each[1] <= GONE}
        if not newest and len(there) == len(self._shown):
            return
        there |= {key: (publication, now) for key, publication in newest.items()}
        self._shown = dict(sorted(there.items(), key=lambda each: each[1][1])[-MOST_SHOWN:])
        with self._server.atomic():
            self._draw([publication for publication, _ in self._shown.values()])
        self._server.flush()

    def _draw(self, publications: Sequence[Publication]) -> None:
        """These persons and no others."""
        bodies = [_body(each) for each in publications]
        self._people.show(bodies)
        for _, positions in bodies:
            self._aim(positions)
        known = [each for each in publications if np.isfinite(each.prediction.mean).any()]
        rows = [np.concatenate([each.tubes.start, each.tubes.end, each.tubes.radius[..., None]], axis=-1)[
            [len(each.tubes.radius) // 2, -1]] for each in known]  # fmt: skip
        self._tubes.show(np.array(rows).reshape(-1, 7))
        self._arms.visible = bool(known)
        if known:
            lines = [each.prediction.mean[:, np.array(LIMBS)] for each in known]  # (T, 4, 2, 3)
            points, colours = (np.concatenate([each.reshape(-1, 2, 3) for each in some])
                               for some in (lines, map(ahead, lines)))  # fmt: skip
            seen = np.isfinite(points).all(axis=(1, 2))
            self._arms.points, self._arms.colors = points[seen].astype(np.float32), colours[seen]
        self.words.content = _words(publications)

    def _aim(self, body: np.ndarray) -> None:
        """Looks at the first person, once."""
        seen = body[np.isfinite(body).all(axis=1)]
        if self._aimed or not len(seen):
            return
        self._aimed = True
        middle = np.median(seen, axis=0)
        self._server.initial_camera.position, self._server.initial_camera.look_at = tuple(middle + FROM), tuple(middle)
        for client in self._server.get_clients().values():
            client.camera.position, client.camera.look_at = middle + FROM, middle


def _body(publication: Publication) -> tuple[tuple[str, ...], np.ndarray]:
    frame = publication.frame
    count = min(len(frame.joints), len(frame.positions))
    return frame.joints[:count], frame.positions[:count]


def _words(publications: Sequence[Publication]) -> str:
    """Who is there, and what robots are to make of it; names come from outside and are escaped."""
    if not publications:
        return '<div id="live">Nobody is seen.</div>'
    rows = []
    for each in publications:
        status = each.prediction.status
        colour = " ".join(f"{0.65 * part:.0%}" for part in colour_of(status))  # dark, to be read on white
        rows.append(
            f"<p><b>{html.escape(each.prediction.person)}</b> · {html.escape(each.source)}<br>"
            f'<span style="color:rgb({colour})">{status.name}</span>: {html.escape(status.advice)}</p>'
        )
    return f'<div id="live" style="overflow-wrap:anywhere;padding:0 1em">{"".join(rows)}</div>'
