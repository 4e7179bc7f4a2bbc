"""What a sink tries, and what becomes of it when that fails."""

from __future__ import annotations

import logging
from collections.abc import Callable

__all__ = ["Attempts"]

log = logging.getLogger(__name__)


class Attempts:
    """Tries one thing after another: none raises, and a fault is in the log once.

    Args:
        address: of the sink, for messages.
        done: what becomes of a prediction there: "written", "sent", "drawn".
        fatal: errors after which nothing more is tried; any other costs one prediction.

    Attributes:
        failure: why nothing more is tried, or None.
    """

    def __init__(self, address: str, done: str, *fatal: type[Exception]) -> None:
        self.failure: str | None = None
        self._address = address
        self._done = done
        self._fatal = fatal
        self._complained = False

    def succeeds(self, action: Callable[..., object], *arguments: object) -> bool:
        """Calls it, and says whether that went well."""
        if self.failure is not None:
            return False
        try:
            action(*arguments)
        except self._fatal as error:
            self.fail(error)
        except Exception:
            if not self._complained:
                self._complained = True
                log.exception("%s: a prediction could not be %s", self._address, self._done)
        else:
            return True
        return False

    def fail(self, error: Exception) -> None:
        """Tries nothing more."""
        if self.failure is None:
            self.failure = f"{self._address}: {error}"
            log.error("%s: nothing more is %s", self.failure, self._done)
