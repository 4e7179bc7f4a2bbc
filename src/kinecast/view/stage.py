"""The cell in the browser: what stands still is sent once, what moves with every moment."""

from __future__ import annotations

import numpy as np
from viser import InitialCameraConfig, SceneApi

from kinecast.robot.cell import TABLE_HEIGHT, TABLE_TOP, Cell
from kinecast.robot.colours import INK, MUTED, cube_colour
from kinecast.robot.episode import SceneSnapshot
from kinecast.robot.ur5 import LINKS, UR5
from kinecast.types import RobotState
from kinecast.view.scene_nodes import CapsulesNode, People, ahead, draw_floor, tubes

TABLE, LEG = (224, 203, 165), (150, 136, 112)
PARTS = {
    "bones": ((205, 211, 218), ("upper_arm", "forearm")),
    "joints": ((92, 142, 190), ("shoulder", "elbow", "wrist_1", "wrist_2", "wrist_3")),
    "gripper": ((72, 80, 90), ("palm", "left_finger", "right_finger")),
}
"""Colours of the arm's links."""


def look(camera: InitialCameraConfig) -> None:
    """From the arm's right and above: the arm on the left, the person on the right."""
    camera.look_at = (0.55, -0.02, 0.13)
    camera.position = (-0.37, -2.3, 1.55)
    camera.up = (0.0, 0.0, 1.0)
    camera.fov = 0.75


class Stage:
    """Everything that is seen.

    Attributes:
        layers: what can be hidden: predicted wrists, occupied space, planned path.
    """

    def __init__(self, scene: SceneApi, cell: Cell) -> None:
        self.arm = UR5()
        self.layers = {"samples": True, "region": True, "path": True}
        _draw_furniture(scene, cell)
        CapsulesNode(scene, "/robot/base", PARTS["gripper"][0]).show(self.arm.pedestal[None])
        self.links = {name: CapsulesNode(scene, f"/robot/{name}", colour) for name, (colour, _) in PARTS.items()}
        self.cubes = {
            cube.name: scene.add_box(f"/cubes/{cube.name}", cube_colour(cube.name), (cube.size,) * 3)
            for cube in cell.cubes
        }
        self.people = People(scene)
        self.tubes = tubes(scene)
        self.cloud = scene.add_point_cloud(
            "/region/samples", np.zeros((0, 3)), np.zeros((0, 3), dtype=np.uint8), point_size=0.006,
            point_shape="circle", point_shading="flat", precision="float32",
        )  # fmt: skip
        self.way = scene.add_line_segments("/plan/way", np.zeros((0, 2, 3)), INK, thickness=0.012)
        self.tip = scene.add_arrows(
            "/plan/tip", np.zeros((0, 2, 3)), INK, shaft_radius=0.006, head_radius=0.024, head_length=0.06
        )

    def show(self, moment: SceneSnapshot) -> None:
        """Puts everything where it is at a moment."""
        rows = self.arm.capsules(moment.q)
        for name, (_, links) in PARTS.items():
            self.links[name].show(rows[[LINKS.index(link) for link in links]])
        for name, cube in self.cubes.items():
            cube.position = moment.cubes[name]
        self.people.show(moment.people)
        self.tubes.show(moment.tube if self.layers["region"] else np.empty((0, 7)))
        self.cloud.visible = self.layers["samples"] and moment.region.size > 0
        if self.cloud.visible:
            steps = moment.region.swapaxes(0, 1)
            self.cloud.points, self.cloud.colors = steps.reshape(-1, 3), ahead(steps).reshape(-1, 3)
        self._show_plan(moment)

    def _show_plan(self, moment: SceneSnapshot) -> None:
        way = moment.way
        moved = len(way) > 1 and bool(np.linalg.norm(way[-1] - way[0]) > 0.03)
        self.way.visible = self.tip.visible = self.layers["path"] and moved
        if not self.way.visible:
            return
        leaves = moment.decision.state is RobotState.REPLANNING  # what is shown is still the path before
        colour = np.array(MUTED if leaves else cube_colour(moment.decision.target), dtype=np.uint8)
        way = way[np.append(True, np.linalg.norm(np.diff(way, axis=0), axis=1) > 1e-3)].astype(np.float32)
        heading = (way[-1] - way[-2]) / np.linalg.norm(way[-1] - way[-2])
        self.way.points, self.way.colors = np.stack([way[:-1], way[1:]], axis=1), colour
        self.tip.points, self.tip.colors = np.stack([way[-1], way[-1] + 0.07 * heading])[None], colour


def _draw_furniture(scene: SceneApi, cell: Cell) -> None:
    """Floor, table, and where each cube is to stand: a plate with a coloured rim."""
    table, floor = cell.table, TABLE_TOP - TABLE_HEIGHT
    draw_floor(scene, (0.5, 0.0, floor))
    scene.add_box("/table/top", TABLE, table.size, position=table.center)
    bottom = float(table.center[2] - table.size[2] / 2)
    for k, side in enumerate(([1, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0])):
        place = table.center + np.array(side) * (table.size / 2 - 0.06)
        place[2] = (bottom + floor) / 2
        scene.add_box(f"/table/leg{k}", LEG, (0.06, 0.06, bottom - floor), position=place)
    for cube in cell.cubes:
        ground, wide = cube.place - [0.0, 0.0, cube.size / 2], cube.size * 1.5
        scene.add_box(f"/places/{cube.name}/rim", cube_colour(cube.name), (wide, wide, 0.003), position=ground)
        scene.add_box(f"/places/{cube.name}/plate", (255, 255, 255), (0.84 * wide, 0.84 * wide, 0.005), position=ground)
