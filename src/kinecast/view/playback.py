"""Where in a film one is: plays, pauses, and goes to any time in it."""

from __future__ import annotations

import threading

from kinecast.errors import OptionError
from kinecast.view.film import Film

__all__ = ["Playback"]


class Playback:
    """A position in a film. It plays until the newest moment, and waits there while the film is still being made.

    Args:
        film: to begin with.
    """

    def __init__(self, film: Film) -> None:
        self._lock = threading.Lock()
        self._film, self._position, self._playing, self._rate = film, 0.0, True, 1.0

    @property
    def film(self) -> Film:
        """What is played."""
        return self._film

    @property
    def position(self) -> float:
        """Where in the film [s]."""
        return self._position

    @property
    def playing(self) -> bool:
        """Whether time goes on."""
        return self._playing

    def load(self, film: Film) -> None:
        """Another film, from its beginning."""
        with self._lock:
            self._film, self._position, self._playing = film, 0.0, True

    def toggle(self) -> None:
        """Pauses what plays; plays what does not, from the beginning where it has come to its end."""
        with self._lock:
            self._playing = not self._playing
            if self._playing and self._film.finished and self._position >= self._film.end:
                self._position = 0.0

    def seek(self, time: float) -> None:
        """Goes to a time [s], or as near as there is, and stands there."""
        with self._lock:
            self._playing = False
            self._position = min(max(time, 0.0), self._film.end)

    def pace(self, rate: float) -> None:
        """How fast it plays; 1 as it happened.

        Raises:
            OptionError: a rate that is not above 0.
        """
        if not 0 < rate < float("inf"):
            raise OptionError(f"rate {rate} must be above 0")
        self._rate = rate

    def advance(self, seconds: float) -> None:
        """Time has gone by, on the viewer's clock [s]."""
        with self._lock:
            if not self._playing:
                return
            end = self._film.end
            self._position = min(self._position + self._rate * seconds, end)
            if self._position >= end and self._film.finished:
                self._playing = False
