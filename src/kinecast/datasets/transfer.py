"""One file over HTTP: resumed where it broke off, never larger than announced."""

from __future__ import annotations

import http.client
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote, urlsplit

from kinecast.errors import DownloadError

__all__ = ["RemoteFile", "ResumableTransfer", "open_url"]

TIMEOUT = 30.0
"""Seconds without a byte after which a connection counts as broken."""

ATTEMPTS = 5
"""Broken connections in a row without any progress before giving up."""

CHUNK = 1 << 16


@dataclass(frozen=True)
class RemoteFile:
    """A file somewhere else.

    Attributes:
        name: relative path it is stored under, with `/`.
        url: where it is.
        checksum: `sha256:…` or `md5:…` of its bytes.
        size: in bytes.
    """

    name: str
    url: str
    checksum: str
    size: int


class ResumableTransfer:
    """A downloader for pooch: appends to a `.part` file until it is whole, also across runs.

    Args:
        remote: what to download.
        part: where the bytes gather; hands over to pooch, which checks the checksum.
        on_progress: called with the bytes there so far.
        patience: seconds to wait before the second attempt; doubles with each.
    """

    def __init__(
        self, remote: RemoteFile, part: Path, on_progress: Callable[[int], None], patience: float = 1.0
    ) -> None:
        self._remote = remote
        self._part = part
        self._on_progress = on_progress
        self._patience = patience

    def __call__(self, url: str, output_file: str, pooch: object) -> None:  # noqa: ARG002
        """Download to output_file.

        Raises:
            DownloadError: the server refuses, sends too much, or breaks off again and again.
        """
        failures = 0
        while self._present() != self._remote.size:
            before = self._present()
            try:
                self._fetch_rest(url)
            except (OSError, http.client.HTTPException) as error:
                if isinstance(error, DownloadError):
                    raise
                problem = str(getattr(error, "reason", None) or error) or type(error).__name__
            else:
                problem = f"connection closed after {self._present()} of {self._remote.size} bytes"
            if self._present() == self._remote.size:
                break
            failures = 1 if self._present() > before else failures + 1
            if failures >= ATTEMPTS:
                raise DownloadError(
                    f"{self._remote.name}: {problem} ({url}). {self._present()} of {self._remote.size} bytes"
                    " are kept: the same command continues there."
                )
            time.sleep(self._patience * 2 ** (failures - 1))
        self._part.touch()  # an empty file was never opened
        self._part.replace(output_file)

    def _present(self) -> int:
        """Bytes there so far."""
        return self._part.stat().st_size if self._part.exists() else 0

    def _fetch_rest(self, url: str) -> None:
        """One connection: append what is missing, from the start if the server cannot resume."""
        have = self._present()
        if have > self._remote.size:
            self._part.unlink()
            have = 0
        headers = {"Range": f"bytes={have}-"} if have else {}
        try:
            response = open_url(url, headers)
        except urllib.error.HTTPError as error:
            with error:
                if error.code == 416:  # what is there does not fit the file: start again
                    self._part.unlink(missing_ok=True)
                    return
                if error.code < 500 and error.code != 429:
                    raise DownloadError(
                        f"{self._remote.name}: the server answers {error.code} {error.reason} for {url}"
                    ) from None
                raise
        with response:
            resumed = response.status == 206 and response.headers.get("Content-Range", "").startswith(f"bytes {have}-")
            if not resumed:
                have = 0
            with self._part.open("ab" if resumed else "wb") as file:
                while have <= self._remote.size and (chunk := response.read(CHUNK)):
                    have += len(chunk)
                    file.write(chunk)
                    self._on_progress(have)
        if have > self._remote.size:
            self._part.unlink()
            raise DownloadError(
                f"{self._remote.name}: the server sends more than the file's {self._remote.size} bytes"
                f" ({url}); nothing of it is kept"
            )


def open_url(url: str, headers: dict[str, str] | None = None) -> http.client.HTTPResponse:
    """An open HTTP connection.

    Raises:
        DownloadError: not an http(s) address.
        OSError: the connection fails, as urllib raises it.
    """
    try:
        scheme = urlsplit(url).scheme
    except ValueError as error:
        raise DownloadError(f"{url[:200]}: not an address: {error}") from None
    if scheme not in ("http", "https"):
        raise DownloadError(f"{url[:200]}: only http and https addresses are downloaded")
    written_out = quote(url, safe="%/:?#[]@!$&'()*+,;=~")  # some listings leave blanks and umlauts as they are
    # no compression on the way: sizes, ranges and checksums are those of the file
    request = urllib.request.Request(written_out, headers={"Accept-Encoding": "identity", **(headers or {})})
    response: http.client.HTTPResponse = urllib.request.urlopen(request, timeout=TIMEOUT)
    return response
