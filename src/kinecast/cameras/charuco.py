"""A ChArUco board: a chessboard with markers in its white squares, so that a part of it is enough."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from kinecast.errors import MissingExtraError, OptionError

try:
    import cv2
except ImportError as error:  # pragma: no cover - the tests install it
    raise MissingExtraError("calibration", "camera") from error

MARKER = 0.74  # side of a marker, of a square's: white around it as wide as one of its own fields
DOTS_PER_METRE = 300 / 0.0254
MARGIN = 0.01  # white around the board [m]
HEADER = 8 + 25  # bytes of a PNG's signature and first chunk
LEAST_CORNERS = 6


@dataclass(frozen=True)
class Corners:
    """What is seen of a board in one picture."""

    points: Float[np.ndarray, "K 3"]  # on the board [m]: x to the right, y down, as printed
    pixels: Float[np.ndarray, "K 2"]  # where they are seen [px]


@dataclass(frozen=True)
class CharucoBoard:
    """A printed board."""

    columns: int = 5  # squares along, 3 to 20
    rows: int = 4  # and across
    square: float = 0.070  # side of a square [m]

    def __post_init__(self) -> None:
        if not (3 <= self.columns <= 20 and 3 <= self.rows <= 20):
            raise OptionError(f"a board of {self.columns}x{self.rows} squares: 3 to 20 a side are allowed")
        if not 0.005 <= self.square <= 0.5:
            raise OptionError(f"squares of {self.square:g} m are outside 0.005..0.5 m")

    @property
    def height(self) -> float:
        """Length of the shorter direction [m], with `rows` squares."""
        return self.rows * self.square

    @cached_property
    def pattern(self) -> Any:
        """OpenCV's board."""
        kind = cv2.aruco.DICT_4X4_50 if self.columns * self.rows <= 101 else cv2.aruco.DICT_4X4_250
        dictionary = cv2.aruco.getPredefinedDictionary(kind)
        return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square, MARKER * self.square, dictionary)

    def picture(self) -> bytes:
        """A PNG that prints at its true size."""
        per_square, margin = round(self.square * DOTS_PER_METRE), round(MARGIN * DOTS_PER_METRE)
        inner = self.pattern.generateImage((self.columns * per_square, self.rows * per_square), marginSize=0)
        page = np.pad(inner, ((margin, 2 * margin), (margin, margin)), constant_values=255)
        words = f"kinecast {self.columns}x{self.rows}, squares of {1e3 * self.square:g} mm: print at 100 %, keep flat"
        place = (margin, page.shape[0] - margin // 2)
        cv2.putText(page, words, place, cv2.FONT_HERSHEY_SIMPLEX, margin / 90, 0, max(margin // 50, 1), cv2.LINE_AA)
        png, per_metre = cv2.imencode(".png", page)[1].tobytes(), round(per_square / self.square)
        size = b"pHYs" + struct.pack(">IIB", per_metre, per_metre, 1)  # viewers print it at that size
        return png[:HEADER] + struct.pack(">I", 9) + size + struct.pack(">I", zlib.crc32(size)) + png[HEADER:]

    def corners(self, picture: UInt8[np.ndarray, "H W"]) -> Corners | None:
        """The board's inner corners in a grey picture; None where fewer than six are seen, or all in one row."""
        found, ids, _, _ = self._detector.detectBoard(picture)
        if found is None or ids is None or len(ids) < LEAST_CORNERS:
            return None
        points = np.asarray(self.pattern.getChessboardCorners(), dtype=np.float64)[np.ravel(ids)]
        if np.linalg.svd(points[:, :2] - points[:, :2].mean(axis=0), compute_uv=False)[-1] < self.square / 2:
            return None
        return Corners(points, np.asarray(found, dtype=np.float64).reshape(-1, 2))

    @cached_property
    def _detector(self) -> Any:
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        return cv2.aruco.CharucoDetector(self.pattern, detectorParams=parameters)
