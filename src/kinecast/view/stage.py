"""The cell in the browser: what stands still is sent once, what moves with every moment."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from kinecast.errors import MissingExtraError
from kinecast.geometry.transforms import to_quaternion
from kinecast.robot.cell import TABLE_HEIGHT, TABLE_TOP, Cell, Cube
from kinecast.robot.episode import Scenery
from kinecast.robot.ur5 import LINKS, UR5
from kinecast.types import RobotState
from kinecast.view.colours import INK, MUTED, cube_colour
from kinecast.view.nodes import LATE, OPACITY, REGION, SOON, CapsulesNode, People
from kinecast.view.solids import capsule_faces, capsule_vertices, facing

try:
    from viser import InitialCameraConfig, SceneApi
except ImportError as error:  # pragma: no cover - the tests install it
    raise MissingExtraError("the browser view", "view") from error

__all__ = ["Stage", "look"]

LINK, JOINT, GRIPPER = (205, 211, 218), (92, 142, 190), (72, 80, 90)
TABLE, LEG = (224, 203, 165), (150, 136, 112)
JOINTS = {"shoulder", "elbow", "wrist_1", "wrist_2", "wrist_3"}


def look(camera: InitialCameraConfig) -> None:
    """From the arm's right and above: the arm on the left, the person on the right."""
    camera.look_at = (0.55, -0.02, 0.13)
    camera.position = (-0.37, -2.3, 1.55)
    camera.up = (0.0, 0.0, 1.0)
    camera.fov = 0.75


class Stage:
    """Everything that is seen.

    Args:
        scene: of the server.
        cell: the table, and where cubes are to go.
        arm: the arm.
    """

    def __init__(self, scene: SceneApi, cell: Cell, arm: UR5) -> None:
        self._scene, self._cell, self._arm = scene, cell, arm
        self._furniture()
        self._links = self._robot()
        self._cubes = {
            cube.name: scene.add_box(
                f"/cubes/{cube.name}", cube_colour(cube.name), (cube.size,) * 3, position=cube.position
            )
            for cube in cell.cubes
        }
        self._people = People(scene)
        self._tubes = CapsulesNode(scene, "/region/tubes", REGION, OPACITY)
        self._cloud = scene.add_point_cloud(
            "/region/samples", np.zeros((0, 3)), np.zeros((0, 3), dtype=np.uint8), point_size=0.006,
            point_shape="circle", point_shading="flat", precision="float32",
        )  # fmt: skip
        self._way = scene.add_line_segments("/plan/way", np.zeros((0, 2, 3)), INK, thickness=0.012)
        self._tip = scene.add_arrows(
            "/plan/tip", np.zeros((0, 2, 3)), INK, shaft_radius=0.006, head_radius=0.024, head_length=0.06
        )
        self.layers = {"samples": True, "region": True, "plan": True}

    def show(self, moment: Scenery) -> None:
        """Puts everything where it is at a moment."""
        self._show_robot(moment.q)
        for name, handle in self._cubes.items():
            handle.visible = name in moment.cubes
            if name in moment.cubes:
                handle.position = moment.cubes[name]
        self._people.show([(person.joints, person.positions) for person in moment.people])
        self._show_region(moment)
        self._show_plan(moment)

    # What stands still

    def _furniture(self) -> None:
        scene, table = self._scene, self._cell.table
        floor = TABLE_TOP - TABLE_HEIGHT
        scene.add_box("/table/top", TABLE, table.size, position=table.center)
        bottom = float(table.center[2] - table.size[2] / 2)
        for k, (x, y) in enumerate([(1, 1), (1, -1), (-1, 1), (-1, -1)]):
            corner = table.center + np.array([x, y, 0.0]) * (table.size / 2 - 0.06)
            place = np.array([corner[0], corner[1], (bottom + floor) / 2])
            scene.add_box(f"/table/leg{k}", LEG, (0.06, 0.06, bottom - floor), position=place)
        scene.add_grid(
            "/floor", 6.0, 6.0, position=(0.5, 0.0, floor), cell_size=0.25, cell_color=(226, 229, 233),
            section_size=1.0, section_color=(208, 213, 219), shadow_opacity=0.12,
        )  # fmt: skip
        for cube in self._cell.cubes:
            self._tray(cube)

    def _tray(self, cube: Cube) -> None:
        """Where a cube is to stand: a plate with a coloured rim."""
        ground = cube.place - [0.0, 0.0, cube.size / 2]
        name = f"/places/{cube.name}"
        wide = cube.size * 1.5
        self._scene.add_box(f"{name}/rim", cube_colour(cube.name), (wide, wide, 0.003), position=ground)
        self._scene.add_box(f"{name}/plate", (255, 255, 255), (0.84 * wide, 0.84 * wide, 0.005), position=ground)

    def _robot(self) -> list[Any]:
        """A node for each link, along z about its middle."""
        start, end, radius = self._arm.pedestal
        ends = start[None], end[None], np.array([radius])
        self._scene.add_mesh_simple("/robot/base", capsule_vertices(*ends), capsule_faces(1), color=GRIPPER)
        capsules = self._arm.capsules(np.zeros((1, 6)))
        half = np.linalg.norm(capsules.end[0] - capsules.start[0], axis=1) / 2
        nodes = []
        for name, h, r in zip(LINKS, half, capsules.radius, strict=True):
            axis = np.array([[0.0, 0.0, h]])
            vertices = capsule_vertices(-axis, axis, np.array([r]))
            colour = JOINT if name in JOINTS else LINK if name in ("upper_arm", "forearm") else GRIPPER
            nodes.append(
                self._scene.add_mesh_simple(f"/robot/{name}", vertices, capsule_faces(1), color=colour, visible=False)
            )
        return nodes

    # What moves

    def _show_robot(self, q: Float[np.ndarray, "6"]) -> None:
        capsules = self._arm.capsules(q[None])
        start, end = capsules.start[0], capsules.end[0]
        for node, middle, turn in zip(self._links, (start + end) / 2, to_quaternion(facing(end - start)), strict=True):
            node.position, node.wxyz, node.visible = middle, turn, True

    def _show_region(self, moment: Scenery) -> None:
        tubes, region = moment.tube, moment.region
        if self.layers["region"] and len(tubes) > 0:
            self._tubes.show(tubes[:, :3], tubes[:, 3:6], tubes[:, 6])
        else:
            self._tubes.hide()
        self._cloud.visible = self.layers["samples"] and region.size > 0
        if self._cloud.visible:
            share = np.linspace(0.0, 1.0, region.shape[1])[None, :, None, None]
            colours = np.broadcast_to(SOON + share * (LATE - SOON), region.shape)
            self._cloud.points = region.reshape(-1, 3).astype(np.float32)
            self._cloud.colors = colours.reshape(-1, 3).astype(np.uint8)

    def _show_plan(self, moment: Scenery) -> None:
        way = moment.way
        moved = len(way) > 1 and float(np.linalg.norm(way[-1] - way[0])) > 0.03
        for node in (self._way, self._tip):
            node.visible = self.layers["plan"] and moved
        if not self._way.visible:
            return
        leaves = moment.decision.state is RobotState.REPLANNING  # what is shown is still the path before
        colour = np.array(MUTED if leaves else cube_colour(moment.decision.target), dtype=np.uint8)
        steps = np.linalg.norm(np.diff(way, axis=0), axis=1)
        way = way[np.concatenate([[True], steps > 1e-3])]
        pieces = np.stack([way[:-1], way[1:]], axis=1).astype(np.float32)
        last = pieces[-1:].copy()
        heading = (last[0, 1] - last[0, 0]) / np.linalg.norm(last[0, 1] - last[0, 0])
        last[0, 0] = last[0, 1]
        last[0, 1] += 0.07 * heading
        self._way.points, self._way.colors = pieces, colour
        self._tip.points, self._tip.colors = last, colour
