"""Where several cameras stand, from a board that they see together, again and again.

It is a ChArUco board: a chessboard with markers in its white squares, so that a part of it is enough.
Each picture gives the board's place before its camera; two cameras with a picture of the same moment are tied by it.
All cameras and all places of the board are then adjusted together so that the corners appear where they were seen,
with Huber's loss: a corner found wrongly pulls no harder than one a pixel off (Triggs et al. 2000, Bundle adjustment).
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from scipy.optimize import least_squares

from kinecast.cameras.opencv import cv2
from kinecast.cameras.pinhole import Intrinsics
from kinecast.errors import DatasetError, OptionError
from kinecast.geometry.transforms import apply, from_rotation_vector, inverse, rotation_vector, transform

MARKER = 0.74  # side of a marker, of a square's: white around it as wide as one of its own fields
DOTS_PER_METRE = 300 / 0.0254
MARGIN = 0.01  # white around the board [m]
HEADER = 8 + 25  # bytes of a PNG's signature and first chunk
LEAST_CORNERS = 6

FEWEST_PICTURES = 6  # for the intrinsics of a camera
HUBER = 1.0  # pixels
WRONG = 4.0  # a picture whose corners are off by so many times the median picture's is left out, the worst first
WRONG_LEAST = 1.0  # but not one that is off by less [px]
ATTEMPTS = 30  # all but one of them leave out a picture
STEP = 1e-6  # for differences [rad], [m]
NEAREST = 1e-3  # depth of a corner that is behind its camera [m]: far off, and no division by zero
ANGLE_WEIGHT = 1.0  # metres that a radian counts for where transforms are compared

Poses = dict[str, Float[np.ndarray, "4 4"]]


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
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        found, ids, _, _ = cv2.aruco.CharucoDetector(self.pattern, detectorParams=parameters).detectBoard(picture)
        if found is None or ids is None or len(ids) < LEAST_CORNERS:
            return None
        points = np.asarray(self.pattern.getChessboardCorners(), dtype=np.float64)[np.ravel(ids)]
        if np.linalg.svd(points[:, :2] - points[:, :2].mean(axis=0), compute_uv=False)[-1] < self.square / 2:
            return None
        return Corners(points, np.asarray(found, dtype=np.float64).reshape(-1, 2))


Views = Mapping[str, Mapping[str, Corners]]  # per camera, per moment, what is seen of the board


@dataclass(frozen=True)
class Extrinsics:
    """Where cameras stand; everything per camera."""

    T_world_camera: Poses
    error: dict[str, float]  # root mean square distance of corners from where they should appear [px]
    std: dict[str, tuple[float, float]]  # of place [m] and direction [rad] against the first camera
    left_out: dict[str, list[str]]  # moments whose picture was left out


def find_intrinsics(name: str, views: Mapping[str, Corners], size: tuple[int, int]) -> tuple[Intrinsics, float, float]:
    """The lens of a camera of this name from what it sees in pictures of this size; distortion is k1 and k2.

    Beside it the root mean square distance of corners from where they should appear [px], and the standard deviation of
    focal length and principal point, the largest of the four [px]. A DatasetError for too few pictures.
    """
    if len(views) < FEWEST_PICTURES:
        enough = f"at least {FEWEST_PICTURES} are needed for its lens"
        raise DatasetError(name, f"the board is seen in {len(views)} pictures, {enough}")
    points, pixels = zip(*((c.points.astype("f4"), c.pixels.astype("f4")) for c in views.values()), strict=True)
    flags = cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST  # what few pictures tell, and lenses of today have
    error, matrix, found, _, _, std, *_ = cv2.calibrateCameraExtended(
        points, pixels, size, np.eye(3), np.zeros(5), flags=flags
    )
    fx, fy, cx, cy = (float(matrix[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    distortion = tuple(map(float, np.ravel(found)[:5]))
    return Intrinsics(*size, fx, fy, cx, cy, distortion), float(error), float(np.ravel(std)[:4].max())


def find_extrinsics(
    lenses: Mapping[str, Intrinsics], views: Views, origin: str, T_world_board: Float[np.ndarray, "4 4"]
) -> Extrinsics:
    """Where cameras stand in the world, from their lenses and what each sees.

    The board lies at T_world_board (4, 4) in the moment `origin`. A DatasetError where a camera shares no moment with
    the others, or none saw the board at the origin.
    """
    T_camera_board: dict[str, Poses] = {name: {} for name in lenses}
    for name, lens in lenses.items():
        for moment, corners in views[name].items():  # of the two ways a plane can lie, the one that fits better
            flat, plane = lens.directions(corners.pixels), cv2.SOLVEPNP_IPPE
            _, turn, shift = cv2.solvePnP(corners.points, flat, np.eye(3), None, flags=plane)
            T_camera_board[name][moment] = transform(from_rotation_vector(np.ravel(turn)), np.ravel(shift))
    if not any(origin in each for each in T_camera_board.values()):
        where = "in which it should lie where the world begins"
        raise DatasetError(origin, f"the board is not seen in this picture, {where}")
    cameras, boards = _placed(T_camera_board)
    left_out: dict[str, list[str]] = {name: [] for name in lenses}
    for attempt in range(ATTEMPTS):
        kept = {name: {m: c for m, c in views[name].items() if m not in left_out[name]} for name in lenses}
        cameras, boards, std, errors = _adjusted(lenses, kept, cameras, boards)
        limit = max(WRONG * float(np.median(list(errors.values()))), WRONG_LEAST)
        worst = max(errors, key=lambda picture: errors[picture])
        if errors[worst] <= limit or attempt == ATTEMPTS - 1:
            break
        left_out[worst[0]].append(worst[1])
    if not any(moment == origin for _, moment in errors):
        badly = "so badly in this picture that it cannot say where the world begins"
        raise DatasetError(origin, f"the board is seen {badly}")
    T_world = T_world_board @ inverse(boards[origin])
    error = {name: float(np.sqrt(np.mean([e**2 for (c, _), e in errors.items() if c == name]))) for name in lenses}
    return Extrinsics({name: T_world @ T for name, T in cameras.items()}, error, std, left_out)


def _placed(T_camera_board: Mapping[str, Poses]) -> tuple[Poses, Poses]:
    """T_first_camera and T_first_board as far as single pictures tell, camera by camera, the best tied first."""
    names = list(T_camera_board)
    cameras: Poses = {names[0]: np.eye(4)}
    while True:
        seen: dict[str, list[np.ndarray]] = {}
        for name, T_first in cameras.items():
            for moment, T in T_camera_board[name].items():
                seen.setdefault(moment, []).append(T_first @ T)
        boards = {moment: _medoid(poses) for moment, poses in seen.items()}
        left = [name for name in names if name not in cameras]
        if not left:
            return {name: cameras[name] for name in names}, boards
        name = max(left, key=lambda name: len(T_camera_board[name].keys() & boards))
        if not T_camera_board[name].keys() & boards:
            problem = f"no picture of the board at a moment that {' or '.join(cameras)} saw too (of the same name)"
            raise DatasetError(", ".join(left), problem)
        cameras[name] = _medoid([boards[m] @ inverse(T) for m, T in T_camera_board[name].items() if m in boards])


def _medoid(transforms: list[np.ndarray]) -> np.ndarray:
    """Of several transforms the one that is nearest to all others: a few wrong ones do not matter."""
    T = np.stack(transforms)
    between = inverse(T)[:, None] @ T
    angle = np.linalg.norm(rotation_vector(between[..., :3, :3]), axis=-1)
    away = np.linalg.norm(between[..., :3, 3], axis=-1) + ANGLE_WEIGHT * angle
    return T[int(np.argmin(away.sum(axis=1)))]


def _adjusted(
    lenses: Mapping[str, Intrinsics], views: Views, cameras: Poses, boards: Poses
) -> tuple[Poses, Poses, dict[str, tuple[float, float]], dict[tuple[str, str], float]]:
    """Bundle adjustment over the poses of all cameras but the first, and of all boards.

    Gives per camera T_first_camera, per moment T_first_board, per camera its standard deviation [m], [rad], and per
    picture the root mean square distance of its corners from where they should appear [px].
    """
    names, moments = list(cameras), list(boards)
    pictures = [(name, moment, corners) for name in names for moment, corners in views[name].items()]
    counts = [len(corners.points) for _, _, corners in pictures]
    camera = np.repeat([names.index(name) for name, _, _ in pictures], counts)
    board = np.repeat([len(names) + moments.index(moment) for _, moment, _ in pictures], counts)
    points, pixels = (np.concatenate([getattr(c, part) for *_, c in pictures]) for part in ("points", "pixels"))

    def poses(x: Float[np.ndarray, " P"]) -> Float[np.ndarray, "M 4 4"]:
        """T_camera_first of all cameras, T_first_board of all boards."""
        rows = x.reshape(-1, 6)
        return np.concatenate([np.eye(4)[None], transform(from_rotation_vector(rows[:, :3]), rows[:, 3:])])

    def residuals(x: Float[np.ndarray, " P"]) -> Float[np.ndarray, " R"]:
        T = poses(x)
        local = apply(T[camera], apply(T[board], points))
        directions = local[:, :2] / np.maximum(local[:, 2:], NEAREST)
        shown = [lenses[name].pixels(directions[camera == k]) for k, name in enumerate(names)]
        return (np.concatenate(shown) - pixels).ravel()

    def jacobian(x: Float[np.ndarray, " P"]) -> Float[np.ndarray, "R P"]:
        """By central differences: a corner moves with one camera and one board, so all of them at once."""
        J = np.zeros((2 * len(points), 6 * (len(names) + len(moments))))
        for of, part in ((camera, slice(len(names))), (board, slice(len(names), None))):
            for k in range(6):
                step = np.zeros((len(names) + len(moments), 6))
                step[part, k] = STEP
                moved = residuals(x + step[1:].ravel()) - residuals(x - step[1:].ravel())
                J[np.arange(len(J)), np.repeat(6 * of + k, 2)] = moved / (2 * STEP)
        return J[:, 6:]

    start = np.stack([*(inverse(T) for T in cameras.values()), *boards.values()])[1:]
    x = np.concatenate([rotation_vector(start[:, :3, :3]), start[:, :3, 3]], axis=1).ravel()
    found = least_squares(residuals, x, jacobian, loss="huber", f_scale=HUBER, x_scale="jac")
    T, J = poses(found.x), np.asarray(found.jac)
    freedom = max(2 * len(points) - len(x), 1)
    variance = np.diag(np.linalg.pinv(J.T @ J)) * 2 * found.cost / freedom
    std = np.sqrt(np.maximum(variance, 0).reshape(-1, 2, 3).sum(axis=2))[: len(names) - 1]  # turn, shift
    square = (residuals(found.x) ** 2).reshape(-1, 2).sum(axis=1)
    parts = np.split(square, np.cumsum(counts)[:-1])
    return (
        {name: inverse(pose) for name, pose in zip(names, T, strict=False)},
        dict(zip(moments, T[len(names) :], strict=True)),
        {names[0]: (0.0, 0.0), **{name: (float(s), float(t)) for name, (t, s) in zip(names[1:], std, strict=True)}},
        {(name, moment): float(np.sqrt(part.mean())) for (name, moment, _), part in zip(pictures, parts, strict=True)},
    )
