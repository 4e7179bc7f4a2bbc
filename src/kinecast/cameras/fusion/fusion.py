"""Several cameras into one skeleton for each person.

Images are gathered into rounds: one of each camera that is alive. A round is of the instant of its newest image; the
others are moved there by each joint's motion. Then everything that is said of a joint, and what was known before, goes
into one weighted least squares.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import count

import numpy as np

from kinecast.cameras.fusion.assignment import LIMIT, assign, distance
from kinecast.cameras.fusion.reach import Reach
from kinecast.cameras.fusion.sighting import FUSED_JOINTS, Sighter, Sighting
from kinecast.cameras.fusion.track import PersonTrack
from kinecast.cameras.rig import Rig
from kinecast.live.detection import View
from kinecast.types import SkeletonFrame

__all__ = ["Fusion"]

ALIVE = 0.5
"""A camera that was silent for so long [s] is not waited for."""
OLDEST = 0.15
"""An image so much older than the newest round [s] is not used: its people have moved too far."""
ELSEWHERE = 20
"""So many such images in a row, and time has been set back."""
FORGET = 1.0
"""Nobody was seen for so long [s]: they have left."""
FORGET_DOUBTFUL = 0.2
"""The same of somebody not seen often enough to be somebody."""
ALONE, APART = 0.6, 0.25
"""Least mean distance from every known person at which one camera, or several together, see a new one [m]."""
DOUBLE = 0.12
"""Two persons nearer than this [m] are one."""
MOST_PEOPLE = 16
"""In one image, and known at once."""
MOST_TRIALS = 12
"""Ways to put strangers together in one round."""


class Fusion:
    """Takes images in the order they come and gives skeletons; never raises, whatever the images say.

    Args:
        rig: the cameras. Frames carry its frame_id.
        joints: those that are fused.

    Attributes:
        late: images that came too late to be used.
        thrown_out: per camera, views that disagreed with the others in most joints, or were of nobody.
        used: per camera, views that went in.
    """

    def __init__(self, rig: Rig, joints: Sequence[str] = FUSED_JOINTS) -> None:
        self.rig = rig
        self.joints = tuple(joints)
        self.late = 0
        self.thrown_out = dict.fromkeys(rig.cameras, 0)
        self.used = dict.fromkeys(rig.cameras, 0)
        self._sighters = {name: Sighter(camera, joints) for name, camera in rig.cameras.items()}
        self._reach = Reach(self.joints)
        self._round: dict[str, list[Sighting]] = {}
        self._opened = -math.inf
        self._heard: dict[str, float] = {}
        self._stamp = -math.inf
        self._late_in_a_row = 0
        self._tracks: list[PersonTrack] = []
        self._names = count(1)

    def add(self, camera: str, stamp: float, people: Sequence[View | SkeletonFrame]) -> list[SkeletonFrame]:
        """One image.

        Args:
            camera: whose; an unknown one is passed over.
            stamp: when it was taken [s], on one clock for all cameras; stamps of the views themselves do not matter.
            people: everybody in it, as views or as skeletons in the camera's own axes.

        Returns:
            Frames of everybody that a finished round has seen; mostly none: a round takes an image of each camera.
        """
        if camera not in self._sighters or not math.isfinite(stamp):
            return []
        if stamp < self._stamp - OLDEST:
            self.late += 1
            self._late_in_a_row += 1
            if self._late_in_a_row < ELSEWHERE:
                return []
            self._start_anew()
        self._late_in_a_row = 0
        frames = self.finish() if self._closes(camera, stamp) else []
        sighter = self._sighters[camera]
        seen = [
            sighter.of_view(each, stamp) if isinstance(each, View) else sighter.of_positions(each, stamp)
            for each in people[:MOST_PEOPLE]
        ]
        self._round.setdefault(camera, []).extend(each for each in seen if each.seen.any())
        self._heard[camera] = stamp
        newest = max(self._heard.values())
        if all(name in self._round for name, last in self._heard.items() if newest - last < ALIVE):
            frames += self.finish()
        return frames

    def finish(self) -> list[SkeletonFrame]:
        """Ends a round before every camera is in it, for one that has waited long enough."""
        if not self._round:
            return []
        images, self._round = self._round, {}
        newest = max(self._heard[camera] for camera in images)
        images = {name: [s for s in seen if s.stamp >= newest - OLDEST] for name, seen in images.items()}
        last, self._stamp = self._stamp, max(newest, self._stamp)
        self._tracks = [track for track in self._tracks if self._stamp - track.seen_at < _patience(track)]
        for track in self._tracks:
            track.states.advance(self._stamp)
        mine: dict[PersonTrack, list[Sighting]] = {track: [] for track in self._tracks}
        strangers = self._recognise(images, mine)
        for track, sightings in mine.items():
            if sightings:
                self._see(track, sightings)
        self._welcome(strangers)
        self._drop_doubles()
        if self._stamp <= last:
            return []
        shown = [track for track in self._tracks if track.confirmed and track.seen_at == self._stamp]
        for track in shown:
            track.person = track.person or str(next(self._names))
        return [track.frame(self.rig.frame_id) for track in shown]

    @property
    def waiting(self) -> bool:
        """Whether a round is open that some cameras are not in yet."""
        return bool(self._round)

    def _closes(self, camera: str, stamp: float) -> bool:
        """Whether an image cannot be in the same round as those before."""
        return camera in self._round and bool(stamp != self._heard[camera])

    def _recognise(
        self, images: dict[str, list[Sighting]], mine: dict[PersonTrack, list[Sighting]]
    ) -> dict[str, list[Sighting]]:
        """Gives each person their sightings; those that are of nobody known are returned."""
        strangers = {}
        groups = [t for t in self._tracks if t.confirmed], [t for t in self._tracks if not t.confirmed]
        for camera, sightings in images.items():
            left = sightings
            for group in groups:
                found = assign(left, [track.states for track in group])
                for sighting, place in zip(left, found, strict=True):
                    if place is not None:
                        mine[group[place]].append(sighting)
                left = [s for s, place in zip(left, found, strict=True) if place is None]
            strangers[camera] = left
        return strangers

    def _see(self, track: PersonTrack, sightings: list[Sighting]) -> None:
        track.see(sightings)
        for sighting in sightings:
            counted = self.thrown_out if sighting.camera in track.blamed else self.used
            counted[sighting.camera] += 1

    def _welcome(self, strangers: dict[str, list[Sighting]]) -> None:
        """Sightings of nobody known: people who came, if they are far enough from everybody."""
        waiting = [sighting for sightings in strangers.values() for sighting in sightings]
        nobodies = list(waiting)
        trials = MOST_TRIALS
        while waiting and trials > 0 and len(self._tracks) < MOST_PEOPLE:
            first, others = waiting[0], waiting[1:]
            best: tuple[PersonTrack, list[Sighting]] | None = None
            for partner in [None, *(other for other in others if other.camera != first.camera)][:trials]:
                trials -= 1
                track = PersonTrack(self.joints, self._stamp, self._reach)
                track.see([first] if partner is None else [first, partner])
                fitting = _fitting(waiting, track)
                if first in fitting and (best is None or len(fitting) > len(best[1])):
                    best = track, fitting
            waiting = others
            if best is None:
                continue
            track, fitting = PersonTrack(self.joints, self._stamp, self._reach), best[1]
            alive = sum(self._stamp - last < ALIVE for last in self._heard.values())
            room = APART if len(fitting) > 1 or alive < 2 else ALONE
            if all(best[0].apart(other) > room for other in self._tracks):
                self._tracks.append(track)
                self._see(track, fitting)
                waiting = [sighting for sighting in waiting if sighting not in fitting]
                nobodies = [sighting for sighting in nobodies if sighting not in fitting]
        for sighting in nobodies:
            self.thrown_out[sighting.camera] += 1

    def _drop_doubles(self) -> None:
        """Of two who stand in one another, who was seen in fewer rounds is nobody."""
        kept: list[PersonTrack] = []
        for track in sorted(self._tracks, key=lambda track: -track.rounds):
            if all(track.apart(other) > DOUBLE for other in kept):
                kept.append(track)
        self._tracks = [track for track in self._tracks if track in kept]

    def _start_anew(self) -> None:
        """Forgets everything but the count of names."""
        self._round, self._heard, self._tracks, self._stamp = {}, {}, [], -math.inf


def _patience(track: PersonTrack) -> float:
    return FORGET if track.confirmed else FORGET_DOUBTFUL


def _fitting(sightings: list[Sighting], track: PersonTrack) -> list[Sighting]:
    """Of each camera the sighting that is nearest to a person, if it is near."""
    best: dict[str, tuple[float, Sighting]] = {}
    for sighting in sightings:
        away = distance(sighting, track.states)
        if away < LIMIT and away < best.get(sighting.camera, (np.inf, None))[0]:
            best[sighting.camera] = away, sighting
    return [sighting for _, sighting in best.values()]
