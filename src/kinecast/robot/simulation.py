"""The cell in simulation: arm, cubes, people and camera, one control step after another, the same for the same seed."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from jaxtyping import Float

from kinecast.robot.async_planner import AsyncPlanner, Solve
from kinecast.robot.body import TRUE_BODY, body_capsules
from kinecast.robot.cell import Cell, Cube
from kinecast.robot.choice import Chooser
from kinecast.robot.episode import Episode, Outcome, SceneSnapshot, Tick, outcome_of
from kinecast.robot.people import occupied
from kinecast.robot.pick_place import nearest, postures
from kinecast.robot.separation import Moving, Separation, SeparationOptions, moving, separation
from kinecast.robot.simulated_person import Camera, Person, ReactivePerson
from kinecast.robot.supervisor import Command, Supervisor
from kinecast.robot.ur5 import UR5
from kinecast.types import Prediction, SkeletonFrame

Predict = Callable[[SkeletonFrame, float], Prediction | None]
"""Takes a frame and the present time; None where nothing is predicted."""

MOMENT = 0.01  # a person's true speed is taken over this time [s]
SHOWN = 60  # samples kept for pictures
TRUTH = SeparationOptions(reaction=1e-3, least_speed=0.0, person_error=0.0, robot_error=0.0, across=0.0)
"""Monitoring that knows everything."""
UPRIGHT = np.array([-0.9, -1.5, -1.6, -1.6, 1.57, 0.0])
"""The arm begins as near to this as it can rest: elbow up, over the table's side [rad]."""
HOLDS = 0.04  # a cube is held when its centre is this near to where the fingers close [m]


class SimulatedDriver:
    """A kinematic arm with a gripper among cubes: goes where it is told, as fast as its joints can.

    kinecast.robot.ur_driver, which is called alike, moves a real one.

    Args:
        arm: its kinematics.
        cell: with the cubes.
        q: (6,) where it starts [rad].
        dt: time between two steps [s].

    Attributes:
        q: (6,) where it is [rad]; gripped: whether the gripper is closed; held: the cube in it.
        cubes: where each is [m].
    """

    def __init__(self, arm: UR5, cell: Cell, q: Float[np.ndarray, "6"], dt: float = 0.008) -> None:
        self.arm, self.dt, self.q = arm, dt, np.array(q, dtype=np.float64)
        self.cubes = {cube.name: cube.position.copy() for cube in cell.cubes}
        self.held: str | None = None
        self.gripped = False
        self._below = Cube.size / 2 - cell.grip

    def move(self, q: Float[np.ndarray, "6"]) -> Float[np.ndarray, "6"]:
        """Goes there, or as far as the joints' speeds allow, and takes a cube that is held with it."""
        furthest = self.arm.max_speed * self.dt
        self.q = self.q + np.clip(q - self.q, -furthest, furthest)
        if self.held is not None:
            self.cubes[self.held] = self._between_fingers()
        return self.q

    def grip(self, closed: bool) -> None:
        """Closing takes the cube between the fingers, if there is one; opening leaves it where it is."""
        self.gripped, self.held = closed, None
        if closed:
            here = self._between_fingers()
            away, name = min((float(np.linalg.norm(place - here)), name) for name, place in self.cubes.items())
            self.held = name if away < HOLDS else None

    def _between_fingers(self) -> Float[np.ndarray, " 3"]:
        T = self.arm.forward_kinematics(self.q)
        return np.asarray(T[:3, 3] + self._below * T[:3, 2])


class Simulation:
    """One episode.

    Args:
        people: who comes.
        predict: the predictor.
        camera: what the arm sees of them.
        cell: what is to be done.
        level: probability with which the space shown as occupied holds each limb.
        solve: the planner; the arm's own by default.
        dt: time between two control steps [s].
        limit: when it is over at the latest [s].
    """

    def __init__(
        self,
        people: Sequence[Person],
        predict: Predict,
        camera: Camera | None = None,
        cell: Cell | None = None,
        level: float = 0.95,
        solve: Solve | None = None,
        dt: float = 0.008,
        limit: float = 120.0,
    ) -> None:
        self.arm, self.cell = UR5(), cell or Cell()
        self.people, self.predict, self.limit, self.level = people, predict, limit, level
        self.camera = camera or Camera(delay=self.cell.delay)
        q = nearest(postures(self.arm, self.cell.grasp(self.cell.rest)), UPRIGHT, self.arm.q_range)[0]
        self.driver = SimulatedDriver(self.arm, self.cell, q, dt)
        self.planner = AsyncPlanner(solve or Chooser(self.arm, self.cell).choose)
        self.supervisor = Supervisor(self.arm, self.cell, self.planner, q, dt)
        sequence = self.supervisor.sequence
        self.episode = Episode(forecasts=self.supervisor.forecasts, placed=sequence.placed, given_up=sequence.given_up)

    def outcome(self) -> Outcome:
        """Its figures so far."""
        return outcome_of(self.episode, self.people, self.cell)

    def steps(self) -> Iterator[Command]:
        """Step by step to the end, every cube in its place or out of time; each yields what the arm was told."""
        episode, dt = self.episode, self.driver.dt
        for index in range(round(self.limit / dt)):
            episode.end = index * dt
            yield self._step(episode.end)
            if self.supervisor.done:
                break

    def _step(self, now: float) -> Command:
        episode, supervisor = self.episode, self.supervisor
        shots = self.camera.shots(now, self.people)
        began, planned = time.perf_counter(), self.planner.worked
        for shot in shots:
            predictions = [self.predict(frame, now) for frame in shot.frames]
            supervisor.see(shot, [each for each in predictions if each is not None], now)
        command = supervisor.control(now)
        planning = self.planner.worked - planned
        if shots:
            episode.latencies.append(time.perf_counter() - began - planning)
        if planning > 0:
            episode.plannings.append(planning)
        before = self.driver.q
        if command.closed != self.driver.gripped:
            self.driver.grip(command.closed)
        arm = moving(self.arm.capsules(np.stack([self.driver.move(command.q), before])), -self.driver.dt)
        episode.ticks.append(self._tick(now, arm, command))
        for person in self.people:
            if isinstance(person, ReactivePerson):
                person.mind(arm, now)
        if command.news:
            episode.decisions.append(command.decision)
        if shots:
            episode.scenes.append(self._snapshot(now, command))
        return command

    def _tick(self, now: float, arm: Moving, command: Command) -> Tick:
        """The truth about a step, of the arm after it."""
        decision, found = command.decision, [Separation()]
        for person in self.people:
            body = body_capsules(person.joints, np.stack([person.at(now), person.at(now + MOMENT)]), TRUE_BODY)
            found.append(separation(arm, moving(body, MOMENT), TRUTH))
        worst = min(found, key=lambda each: each.margin)
        return Tick(
            stamp=now,
            state=decision.state,
            speed=decision.speed,
            distance=min(each.distance for each in found),
            required=worst.required,
            margin=worst.margin,
            arm_speed=float(np.linalg.norm(arm.velocity.reshape(-1, 3), axis=-1).max()),
            measured=decision.distance,
            limit=decision.separation,
        )

    def _snapshot(self, now: float, command: Command) -> SceneSnapshot:
        """What a picture of this moment needs."""
        people = self.supervisor.people
        region = np.empty((0, 0, 2, 3))
        if people.predictions:
            samples = people.predictions[0].samples
            region = samples[:: max(1, len(samples) // SHOWN), :, [2, 5]].astype(np.float32)
        ahead = self.supervisor.ahead(np.linspace(0.0, 1.5, 12))
        return SceneSnapshot(
            stamp=now,
            q=self.driver.q,
            people=tuple((person.joints, person.at(now)) for person in self.people),
            cubes={name: place.copy() for name, place in self.driver.cubes.items()},
            region=region,
            tube=occupied(people.predictions, now, now + 0.25, self.level),
            way=self.arm.forward_kinematics(ahead)[:, :3, 3],
            decision=command.decision,
        )
