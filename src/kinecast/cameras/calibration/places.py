"""Where several cameras stand, from a board that they see together, again and again.

Each picture gives the board's place before its camera; two cameras with a picture of the same moment are tied by it.
All cameras and all places of the board are then adjusted together so that the corners appear where they were seen,
with Huber's loss: a corner found wrongly pulls no harder than one a pixel off (Triggs et al. 2000, Bundle adjustment).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from kinecast.cameras.calibration.board import Corners
from kinecast.cameras.camera import Intrinsics
from kinecast.errors import DatasetError, MissingExtraError
from kinecast.geometry.transforms import apply, from_rotation_vector, inverse, transform

try:
    import cv2
except ImportError as error:  # pragma: no cover - the tests install it
    raise MissingExtraError("calibration", "camera") from error

__all__ = ["Lens", "Places", "lens_of", "place_cameras"]

FEWEST_PICTURES = 6
"""For the intrinsics of a camera."""
HUBER = 1.0
"""Pixels."""
WRONG = 4.0
"""A picture whose corners are off by so many times the median picture's is left out, the worst first."""
WRONG_LEAST = 1.0
"""But not one that is off by less [px]."""
ATTEMPTS = 30
"""All but one of them leave out a picture."""
MOST_STEPS, SETTLED = 50, 1e-8
"""Steps of the adjustment, and the share by which the last one lowers its cost."""
NEAREST = 1e-3
"""Depth of a corner that is behind its camera [m]: far off, and no division by zero."""
ANGLE_WEIGHT = 1.0
"""Metres that a radian counts for where transforms are compared."""

Shots = Mapping[str, Mapping[str, Corners]]
"""Per camera, per moment, what is seen of the board."""


@dataclass(frozen=True)
class Places:
    """Where cameras stand.

    Attributes:
        T_world_camera: per camera.
        error: per camera the root mean square distance of corners from where they should appear [px].
        spread: per camera the standard deviation of its place [m] and direction [rad] against the first camera.
        left_out: per camera the moments whose picture was left out.
    """

    T_world_camera: Mapping[str, Float[np.ndarray, "4 4"]]
    error: Mapping[str, float]
    spread: Mapping[str, tuple[float, float]]
    left_out: Mapping[str, tuple[str, ...]]


@dataclass(frozen=True)
class Lens:
    """How a camera maps directions to pixels, as found.

    Attributes:
        intrinsics: of the camera; distortion is k1 and k2.
        error: root mean square distance of corners from where they should appear [px].
        spread: standard deviation of focal length and principal point together [px].
    """

    intrinsics: Intrinsics
    error: float
    spread: float


def lens_of(name: str, shots: Mapping[str, Corners], size: tuple[int, int]) -> Lens:
    """A camera's own lens.

    Args:
        name: of the camera, for messages.
        shots: what it sees of the board at each moment.
        size: width and height of its pictures [px].

    Raises:
        DatasetError: too few pictures.
    """
    if len(shots) < FEWEST_PICTURES:
        raise DatasetError(
            name, f"the board is seen in {len(shots)} pictures, at least {FEWEST_PICTURES} are needed for its lens"
        )
    points = [each.points.astype(np.float32) for each in shots.values()]
    pixels = [each.pixels.astype(np.float32) for each in shots.values()]
    flags = cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST  # what few pictures tell, and lenses of today have
    start = np.eye(3), np.zeros(5)
    error, matrix, found, _, _, spread, *_ = cv2.calibrateCameraExtended(points, pixels, size, *start, flags=flags)
    distortion = tuple(float(value) for value in np.asarray(found).reshape(-1)[:5])
    fx, fy, cx, cy = (float(matrix[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    off = float(np.sqrt((np.asarray(spread).reshape(-1)[:4] ** 2).max()))
    return Lens(Intrinsics(*size, fx, fy, cx, cy, distortion), float(error), off)


def place_cameras(
    lenses: Mapping[str, Intrinsics], shots: Shots, origin: str, T_world_board: Float[np.ndarray, "4 4"]
) -> Places:
    """Where cameras stand in the world.

    Args:
        lenses: per camera.
        shots: what each sees.
        origin: the moment in which the board lies where the world begins.
        T_world_board: how the world lies against the board then.

    Raises:
        DatasetError: a camera shares no moment with the others, or none saw the board at the origin.
    """
    boards = {name: {m: _board_before(lenses[name], c) for m, c in shots[name].items()} for name in lenses}
    if not any(origin in each for each in boards.values()):
        raise DatasetError(
            origin, "the board is not seen in this picture, in which it should lie where the world begins"
        )
    cameras = _chained(boards)
    moments = sorted({moment for each in boards.values() for moment in each})
    start = {}
    for moment in moments:
        seen = [cameras[name] @ boards[name][moment] for name in boards if moment in boards[name]]
        start[moment] = _middle(seen)
    left_out: dict[str, list[str]] = {name: [] for name in lenses}
    for attempt in range(ATTEMPTS):
        problem = _Adjustment(lenses, shots, cameras, start, left_out)
        cameras, start, spread = problem.solved()
        errors = problem.errors(cameras, start)
        limit = max(WRONG * float(np.median(list(errors.values()))), WRONG_LEAST)
        worst = max(errors, key=lambda picture: errors[picture])
        if errors[worst] <= limit or attempt == ATTEMPTS - 1:
            break
        left_out[worst[0]].append(worst[1])
    if not any(moment == origin for _, moment in errors):
        raise DatasetError(
            origin, "the board is seen so badly in this picture that it cannot say where the world begins"
        )
    T_world = T_world_board @ inverse(start[origin])
    per_camera = {name: float(np.sqrt(np.mean([e**2 for (c, _), e in errors.items() if c == name]))) for name in lenses}
    return Places(
        {name: T_world @ T for name, T in cameras.items()},
        per_camera,
        spread,
        {name: tuple(each) for name, each in left_out.items()},
    )


def _board_before(lens: Intrinsics, corners: Corners) -> Float[np.ndarray, "4 4"]:
    """(4, 4) T_camera_board of one picture: of the two ways a plane can lie, the one that fits better."""
    directions = lens.directions(corners.pixels)
    _, turns, shifts, errors = cv2.solvePnPGeneric(corners.points, directions, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    best = int(np.argmin(np.asarray(errors).reshape(-1)))
    return transform(from_rotation_vector(np.asarray(turns[best]).reshape(3)), np.asarray(shifts[best]).reshape(3))


def _chained(boards: Mapping[str, Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Per camera T_first_camera, one after the other by the ties with most moments in common.

    Raises:
        DatasetError: a camera has no moment in common with those tied already.
    """
    names = list(boards)
    found = {names[0]: np.eye(4)}
    while len(found) < len(names):
        ties = [(len(set(boards[a]) & set(boards[b])), a, b) for a in found for b in names if b not in found]
        shared, a, b = max(ties, key=lambda tie: tie[0])
        if not shared:
            missing = ", ".join(name for name in names if name not in found)
            raise DatasetError(
                missing,
                f"no picture of the board at a moment that {' or '.join(found)} saw too (of the same name)",
            )
        common = sorted(set(boards[a]) & set(boards[b]))
        found[b] = found[a] @ _middle([boards[a][moment] @ inverse(boards[b][moment]) for moment in common])
    return {name: found[name] for name in names}


def _middle(transforms: list[np.ndarray]) -> np.ndarray:
    """Of several transforms the one that is nearest to all others: a few wrong ones do not matter."""
    T = np.stack(transforms)
    shift = np.linalg.norm(T[:, None, :3, 3] - T[None, :, :3, 3], axis=-1)
    trace = np.einsum("aij,bij->ab", T[:, :3, :3], T[:, :3, :3])
    angle = np.arccos(np.clip((trace - 1) / 2, -1, 1))
    return T[int(np.argmin((shift + ANGLE_WEIGHT * angle).sum(axis=1)))]


class _Adjustment:
    """Levenberg and Marquardt's method over the places of all cameras but the first, and of all boards."""

    def __init__(
        self,
        lenses: Mapping[str, Intrinsics],
        shots: Shots,
        cameras: Mapping[str, np.ndarray],
        boards: Mapping[str, np.ndarray],
        left_out: Mapping[str, list[str]],
    ) -> None:
        self._lenses = lenses
        self._names, self._moments = list(cameras), list(boards)
        self._pictures = [
            (name, moment, corners)
            for name in self._names
            for moment, corners in shots[name].items()
            if moment not in left_out[name]
        ]
        placed = [*(inverse(T) for T in cameras.values()), *boards.values()]
        self._start = np.stack(placed)  # T_camera_first, then T_first_board

    def solved(self) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], dict[str, tuple[float, float]]]:
        """Per camera T_first_camera, per moment T_first_board, per camera its spread [m], [rad]."""
        T, damping = self._start, 1e-3
        cost, N, n = self._normal(T)
        for _ in range(MOST_STEPS):
            step = np.linalg.solve(N + damping * np.diag(np.diag(N)) + 1e-9 * np.eye(len(N)), n).reshape(-1, 6)
            moved = T.copy()
            moved[1:] = transform(from_rotation_vector(step[:, :3]), step[:, 3:]) @ T[1:]
            better, N_moved, n_moved = self._normal(moved)
            if better > cost:
                damping *= 10
                continue
            done = cost - better < SETTLED * cost
            T, cost, N, n, damping = moved, better, N_moved, n_moved, damping / 3
            if done:
                break
        count = len(self._names)
        cameras = {name: inverse(each) for name, each in zip(self._names, T, strict=False)}
        return cameras, dict(zip(self._moments, T[count:], strict=True)), self._spread(cost, N)

    def errors(
        self, cameras: Mapping[str, np.ndarray], boards: Mapping[str, np.ndarray]
    ) -> dict[tuple[str, str], float]:
        """Per picture the root mean square distance of its corners from where they should appear [px]."""
        result = {}
        for name, moment, corners in self._pictures:
            off = self._off(name, apply(inverse(cameras[name]) @ boards[moment], corners.points), corners)
            result[name, moment] = float(np.sqrt((off**2).sum(axis=1).mean()))
        return result

    def _off(self, name: str, local: Float[np.ndarray, "K 3"], corners: Corners) -> Float[np.ndarray, "K 2"]:
        return corners.pixels - self._lenses[name].pixels(local[:, :2] / np.maximum(local[:, 2:], NEAREST))

    def _normal(self, T: Float[np.ndarray, "M 4 4"]) -> tuple[float, np.ndarray, np.ndarray]:
        """Huber's cost, and the normal equations of a turn [rad] and shift [m] of each place but the first."""
        N, n, cost = np.zeros((len(T), 6, len(T), 6)), np.zeros((len(T), 6)), 0.0
        for name, moment, corners in self._pictures:
            camera, board = self._names.index(name), len(self._names) + self._moments.index(moment)
            first = apply(T[board], corners.points)
            local = apply(T[camera], first)
            off = self._off(name, local, corners)
            size = np.linalg.norm(off, axis=1)
            weight = np.minimum(1.0, HUBER / np.maximum(size, 1e-9))
            cost += float((weight * size * (2 * size - weight * size)).sum())
            slope = self._slope(name, local)
            by_camera = slope @ _moves(local)
            by_board = slope @ T[camera, :3, :3] @ _moves(first)
            for a, A in ((camera, by_camera), (board, by_board)):
                n[a] += np.einsum("kri,kr,k->i", A, off, weight)
                for b, B in ((camera, by_camera), (board, by_board)):
                    N[a, :, b] += np.einsum("kri,krj,k->ij", A, B, weight)
        size = 6 * (len(T) - 1)
        return cost, N[1:, :, 1:].reshape(size, size), n[1:].reshape(size)

    def _slope(self, name: str, local: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "K 2 3"]:
        """(K, 2, 3) of pixels by points in the camera's axes."""
        z = np.maximum(local[:, 2], NEAREST)
        directions = local[:, :2] / z[:, None]
        rows = np.zeros((len(local), 2, 3))
        rows[:, 0, 0] = rows[:, 1, 1] = 1 / z
        rows[:, :, 2] = -directions / z[:, None]
        return self._lenses[name].pixel_slope(directions) @ rows

    def _spread(self, cost: float, N: Float[np.ndarray, "P P"]) -> dict[str, tuple[float, float]]:
        freedom = sum(2 * len(corners.points) for _, _, corners in self._pictures) - len(N)
        variances = np.diag(np.linalg.pinv(N)) * cost / max(freedom, 1)
        spread = np.sqrt(np.maximum(variances, 0).reshape(-1, 2, 3).sum(axis=2))  # turn, shift
        rows = [np.zeros(2), *spread]
        return {name: (float(row[1]), float(row[0])) for name, row in zip(self._names, rows, strict=False)}


def _moves(points: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "K 3 6"]:
    """(K, 3, 6) how points move by a turn about the origin, and by a shift."""
    x, y, z = points.T
    zero = np.zeros_like(x)
    turn = np.array([[zero, z, -y], [-z, zero, x], [y, -x, zero]]).transpose(2, 0, 1)
    return np.concatenate([turn, np.broadcast_to(np.eye(3), (len(points), 3, 3))], axis=2)
