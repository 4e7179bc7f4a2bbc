"""`kinecast calibrate`: where cameras stand, from pictures of a printed board."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from tyro.conf import Positional, arg

from kinecast.cameras.pinhole import PinholeCamera
from kinecast.cameras.rig import Rig
from kinecast.cli.output_paths import check_file
from kinecast.cli.progress import note
from kinecast.errors import DatasetError, OptionError
from kinecast.evaluation.output import write_atomically

if TYPE_CHECKING:
    from kinecast.cameras.calibration import Extrinsics
    from kinecast.cameras.charuco import CharucoBoard, Corners

ENDINGS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
MOST_PICTURES = 500
BAD = 1.5  # corners so far from where they should be [px] on the average say that something is wrong
VAGUE = 0.003  # of the picture's width: an uncertainty of the lens that moves a joint at 3 m by a centimetre

Cameras = Annotated[tuple[str, ...], arg(metavar="NAME=FOLDER [NAME=FOLDER ...]", help_behavior_hint="")]
OptionalFile = Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: none)")]
Out = Annotated[Path, arg(metavar="FILE")]
Origin = Annotated[str | None, arg(metavar="PICTURE", help_behavior_hint="(default: the first picture)")]


def calibrate(
    cameras: Positional[Cameras] = (),
    out: Out = Path("rig.yaml"),
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
    from kinecast.cameras.charuco import CharucoBoard  # here, since OpenCV is an extra

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
    known = {} if intrinsics is None else dict(Rig.load(intrinsics).cameras)
    rig, lines = _solved(_folders(cameras), printed, origin, height, known)
    write_atomically(out, rig.to_yaml().encode())
    print("\n".join(lines))
    print(f"rig: {out}")


def _folders(texts: tuple[str, ...]) -> dict[str, Path]:
    """Folders by name."""
    if not texts:
        raise OptionError("NAME=FOLDER: at least one camera is needed, or --board FILE for a board to print")
    folders: dict[str, Path] = {}
    for text in texts:
        name, equals, folder = text.partition("=")
        if not equals or not name or not folder:
            raise OptionError(f"{text}: expected NAME=FOLDER")
        if name in folders:
            raise OptionError(f"{name}: is there twice")
        if not Path(folder).is_dir():
            raise DatasetError(folder, "no such folder")
        folders[name] = Path(folder)
    return folders


def _solved(
    folders: Mapping[str, Path],
    board: CharucoBoard,
    origin: str | None,
    height: float,
    known: Mapping[str, PinholeCamera],
) -> tuple[Rig, list[str]]:
    """The rig, and what to say about it."""
    from kinecast.cameras.calibration import find_extrinsics, find_intrinsics

    views, lenses, counts, lens_errors = {}, {}, {}, {}
    for name, folder in folders.items():
        views[name], size, counts[name] = _pictures(folder, board)
        if not views[name]:
            raise DatasetError(
                folder, f"a board of {board.columns}x{board.rows} squares is seen in none of {counts[name]} pictures"
            )
        if name in known:
            lens = known[name].intrinsics
            if (lens.width, lens.height) != size:
                raise DatasetError(
                    folder, f"pictures of {size[0]}x{size[1]} pixels, but the lens is of {lens.width}x{lens.height}"
                )
            lenses[name], lens_errors[name] = lens, "given"
        else:
            lenses[name], error, std = find_intrinsics(name, views[name], size)
            lens_errors[name] = f"{error:.2f} px"
            if std > VAGUE * size[0]:
                advice = "take more pictures of a tilted board that fills much of the picture, in all its corners"
                note(f"{name}: its lens is known to {std:.0f} px only; {advice}", "yellow")
    first = origin or min(moment for each in views.values() for moment in each)
    T_world_board = np.diag([1.0, -1.0, -1.0, 1.0])  # out of the printed face is up
    T_world_board[:3, 3] = (0.0, board.height, height)
    extrinsics = find_extrinsics(lenses, views, Path(first).stem, T_world_board)
    rig = Rig({name: PinholeCamera(name, lenses[name], extrinsics.T_world_camera[name]) for name in folders})
    return rig, _table(rig, views, counts, lens_errors, extrinsics)


def _pictures(folder: Path, board: CharucoBoard) -> tuple[dict[str, Corners], tuple[int, int], int]:
    """What is seen of the board in each picture of a folder; the pictures' size, and how many there are."""
    import cv2

    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in ENDINGS)
    if not 0 < len(paths) <= MOST_PICTURES:
        raise DatasetError(folder, f"{len(paths)} pictures ({', '.join(ENDINGS)}), 1 to {MOST_PICTURES} are taken")
    found: dict[str, Corners] = {}
    width = height = 0
    for path in paths:
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if picture is None:
            raise DatasetError(path, "no picture can be read from it")
        if width and picture.shape != (height, width):
            mine = f"{picture.shape[1]}x{picture.shape[0]}"
            raise DatasetError(path, f"{mine} pixels, but those before have {width}x{height}")
        height, width = picture.shape
        corners = board.corners(picture)
        if corners is not None:
            found[path.stem] = corners
    return found, (width, height), len(paths)


def _table(
    rig: Rig,
    views: Mapping[str, Mapping[str, Corners]],
    counts: Mapping[str, int],
    lens_errors: Mapping[str, str],
    extrinsics: Extrinsics,
) -> list[str]:
    """One line for each camera."""
    width = max(len("camera"), *map(len, rig.cameras))
    lines = [f"{'camera':{width}}  pictures  used  lens      place     x [m]    y [m]    z [m]   ± [mm]  ± [°]"]
    for name, camera in rig.cameras.items():
        used = len(views[name]) - len(extrinsics.left_out[name])
        x, y, z = camera.T_world_camera[:3, 3]
        shift, turn = extrinsics.std[name]
        spread = f"{1e3 * shift:7.1f}  {np.degrees(turn):5.2f}" if shift else "      –      –"
        lines.append(
            f"{name:{width}}  {counts[name]:8}  {used:4}  {lens_errors[name]:8}  {extrinsics.error[name]:.2f} px  "
            f"{x:7.3f}  {y:7.3f}  {z:7.3f}  {spread}"
        )
        if extrinsics.error[name] > BAD:
            note(f"{name}: corners are {extrinsics.error[name]:.1f} px off: was the board bent, or moving?", "yellow")
    lines.append("± is against the first camera; how level the world is, is how level the board lay.")
    return lines
