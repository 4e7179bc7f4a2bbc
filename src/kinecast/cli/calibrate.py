"""`kinecast calibrate`: where cameras stand, from pictures of a printed board."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np
from rich.text import Text
from tyro.conf import Positional, arg

from kinecast.cameras.pinhole import Intrinsics, PinholeCamera
from kinecast.cameras.rig import Rig
from kinecast.cli.options import File, OptionalFile, check_file
from kinecast.cli.progress import columns, note, plain
from kinecast.errors import DatasetError, OptionError
from kinecast.output import write_atomically

if TYPE_CHECKING:
    from kinecast.cameras.calibration import CharucoBoard, Corners, Extrinsics

ENDINGS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
MOST_PICTURES = 500
BAD = 1.5  # corners so far from where they should be [px] on the average say that something is wrong
VAGUE = 0.003  # of the picture's width: an uncertainty of the lens that moves a joint at 3 m by a centimetre

Cameras = Annotated[tuple[str, ...], arg(metavar="NAME=FOLDER [NAME=FOLDER ...]", help_behavior_hint="")]
Origin = Annotated[str | None, arg(metavar="PICTURE", help_behavior_hint="(default: the first picture)")]


def calibrate(
    cameras: Positional[Cameras] = (),
    out: File = Path("rig.yaml"),
    squares: str = "5x4",
    square: float = 0.070,
    origin: Origin = None,
    height: float = 0.0,
    intrinsics: OptionalFile = None,
    board: OptionalFile = None,
) -> None:
    """Finds where cameras stand from pictures of a ChArUco board, and writes a rig file for kinecast live --rig.

    Pictures of the same name in several folders are of the same moment, with the board at rest.

    Args:
        cameras: a name for each camera, and the folder of its pictures.
        out: the rig file.
        squares: of the board, along x across.
        square: side of a square as it was printed [m]: measure it.
        origin: name of the picture in which the board lies where the world begins, face up.
        height: of the board above the world's zero then [m].
        intrinsics: a rig file whose lenses are taken as they are; others are found from the pictures.
        board: writes a board to print, a PNG, and ends.
    """
    from kinecast.cameras.calibration import CharucoBoard, find_extrinsics  # here, since OpenCV is an extra

    match = re.fullmatch(r"(\d{1,2})x(\d{1,2})", squares)
    if match is None:
        raise OptionError(f"--squares {squares}: expected two numbers such as 5x4")
    printed = CharucoBoard(int(match[1]), int(match[2]), square)
    if board is not None:
        check_file(board, (".png",), "--board")
        write_atomically(board, printed.picture())
        print(f"board: {board}, {printed.columns}x{printed.rows} squares of {1e3 * square:g} mm")
        return
    if not -10 <= height <= 10:
        raise OptionError(f"--height {height:g} m is outside -10..10")
    check_file(out, (".yaml", ".yml"), "--out")
    known = {} if intrinsics is None else Rig.load(intrinsics).cameras
    views = {name: _views(name, folder, printed, known.get(name)) for name, folder in _folders(cameras).items()}
    corners = {name: each.corners for name, each in views.items()}
    lenses = {name: each.lens for name, each in views.items()}
    first = origin or min(moment for each in corners.values() for moment in each)
    T_world_board = np.diag([1.0, -1.0, -1.0, 1.0])  # out of the printed face is up
    T_world_board[:3, 3] = (0.0, printed.height, height)
    found = find_extrinsics(lenses, corners, Path(first).stem, T_world_board)
    rig = Rig({name: PinholeCamera(name, lens, found.T_world_camera[name]) for name, lens in lenses.items()})
    write_atomically(out, rig.to_yaml().encode())
    print(_table(rig, views, found))
    print("± is against the first camera; how level the world is, is how level the board lay.")
    print(f"rig: {out}")
    for name, error in found.error.items():
        if error > BAD:
            note(f"{name}: corners are {error:.1f} px off: was the board bent, or moving?", "yellow")


class _Views(NamedTuple):
    """What one camera saw of the board."""

    corners: Mapping[str, Corners]  # by the name of the picture
    pictures: int  # how many there are, also without a board
    lens: Intrinsics
    error: str  # of the lens, as the table says it


def _folders(texts: tuple[str, ...]) -> dict[str, Path]:
    """Folders by name."""
    if not texts:
        raise OptionError("NAME=FOLDER: at least one camera is needed, or --board FILE for a board to print")
    folders: dict[str, Path] = {}
    for text in texts:
        name, _, folder = text.partition("=")
        if not name or not folder:
            raise OptionError(f"{text}: expected NAME=FOLDER")
        if name in folders:
            raise OptionError(f"{name}: is there twice")
        folders[name] = Path(folder)
        if not folders[name].is_dir():
            raise DatasetError(folder, "no such folder")
    return folders


def _views(name: str, folder: Path, board: CharucoBoard, known: PinholeCamera | None) -> _Views:
    """What a camera saw of the board in the pictures of a folder, and its lens, found from them unless it is known."""
    import cv2

    from kinecast.cameras.calibration import find_intrinsics

    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in ENDINGS)
    if not 0 < len(paths) <= MOST_PICTURES:
        raise DatasetError(folder, f"{len(paths)} pictures ({', '.join(ENDINGS)}), 1 to {MOST_PICTURES} are taken")
    found: dict[str, Corners] = {}
    size: tuple[int, int] | None = None if known is None else (known.intrinsics.width, known.intrinsics.height)
    for path in paths:
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if picture is None:
            raise DatasetError(path, "no picture can be read from it")
        mine = picture.shape[1], picture.shape[0]
        size = size or mine
        if mine != size:
            others = "those before have" if known is None else "the lens is of"
            raise DatasetError(path, "{}x{} pixels, but {} {}x{}".format(*mine, others, *size))
        if (corners := board.corners(picture)) is not None:
            found[path.stem] = corners
    if not found or size is None:
        squares = f"{board.columns}x{board.rows}"
        raise DatasetError(folder, f"a board of {squares} squares is seen in none of {len(paths)} pictures")
    if known is not None:
        return _Views(found, len(paths), known.intrinsics, "given")
    lens, error, std = find_intrinsics(name, found, size)
    if std > VAGUE * size[0]:
        advice = "take more pictures of a tilted board that fills much of the picture, in all its corners"
        note(f"{name}: its lens is known to {std:.0f} px only; {advice}", "yellow")
    return _Views(found, len(paths), lens, f"{error:.2f} px")


def _table(rig: Rig, views: Mapping[str, _Views], extrinsics: Extrinsics) -> str:
    """A row for each camera."""
    table = columns("camera", numbers="pictures,used,lens,place,x [m],y [m],z [m],± [mm],± [°]")
    for name, camera in rig.cameras.items():
        seen, (shift, turn) = views[name], extrinsics.std[name]
        used = len(seen.corners) - len(extrinsics.left_out[name])
        place = (f"{each:.3f}" for each in camera.T_world_camera[:3, 3])
        spread = (f"{1e3 * shift:.1f}", f"{np.degrees(turn):.2f}") if shift else ("–", "–")
        error = f"{extrinsics.error[name]:.2f} px"
        table.add_row(Text(name), str(seen.pictures), str(used), seen.error, error, *place, *spread)
    return plain(table)
