"""What the arm does next, how fast, and why. It decides at every control step and never waits.

    NONE → REACH → DESCEND → CLOSE → LIFT → CARRY → LOWER → OPEN → RISE → NONE      one cube (kinecast.robot.pick_place)

Predictions change the way (GO_AROUND) or the cube (TAKE_ANOTHER, CHANGE_CUBE) where the expected time says so
(kinecast.robot.choice). Above that, speed and separation monitoring looks at measured positions alone
(kinecast.robot.speed_limit).
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from kinecast.robot.async_planner import LATENCY, AsyncPlanner
from kinecast.robot.body import interpolated
from kinecast.robot.cell import Cell
from kinecast.robot.choice import Choice, Request, options_for
from kinecast.robot.execution import Executor
from kinecast.robot.expected_time import TravelTime
from kinecast.robot.motions import STEP
from kinecast.robot.people import CameraFrame, PeopleModel
from kinecast.robot.pick_place import DWELL, GraspConfigurations, Step, TaskSequence, straight
from kinecast.robot.separation import Separation
from kinecast.robot.speed_limit import BLIND, HELD, MOMENT, SLOW, LimitReason, SpeedHysteresis, SpeedLimit, speed_limit
from kinecast.robot.trajectory import Trajectory
from kinecast.robot.ur5 import UR5
from kinecast.types import Decision, Prediction, Reaction, RobotState

log = logging.getLogger(__name__)

AGAIN = 0.3  # between two looks for something better [s]
RETRY, ATTEMPTS = 0.5, 3  # after a search that failed [s]; and so often a place is tried that cannot be reached
EVADE = 2.0
"""Held back for this long by somebody who comes to where it stands, the arm draws back [s] (docs/decisions/0028)."""
STUCK = 0.1  # share of the planned speed below which it does not get anywhere
NEAR_ENOUGH = 0.05  # a path is followed from where the arm stands if it begins no farther away than this [rad]
NEXT = dict(pairwise((*tuple(Step)[1:9], Step.NONE))) | {Step.REST: Step.NONE}
"""What follows a step that has ended: from REACH to RISE in their order."""
EVADABLE = (Step.REACH, Step.DESCEND, Step.LIFT, Step.CARRY, Step.LOWER)  # steps in which it may be held
GRASPING, PLACING = (Step.DESCEND, Step.CLOSE, Step.LIFT), (Step.LOWER, Step.OPEN, Step.RISE)


class Command(NamedTuple):
    """What the arm is to do in the next control step."""

    q: Float[np.ndarray, "6"]  # [rad]
    closed: bool  # whether the gripper is to be
    decision: Decision  # in force
    news: bool  # whether it was taken just now


class Supervisor:
    """Decides.

    Args:
        arm: its kinematics.
        cell: what is to be done, and where.
        planner: where plans are asked for.
        q: (6,) where the arm stands [rad].
        dt: of the control steps [s].
    """

    def __init__(self, arm: UR5, cell: Cell, planner: AsyncPlanner, q: Float[np.ndarray, "6"], dt: float) -> None:
        self.arm, self.cell, self.planner, self.executor = arm, cell, planner, Executor(arm, dt, q)
        self.people = PeopleModel()
        self.sequence = TaskSequence(cell.order)
        self.step = Step.NONE
        self.target: str | None = None
        self.forecasts: list[tuple[float, TravelTime]] = []
        """How long each way to the end of a grasp or a placing took [s], and how long it was to take when begun."""
        self._places = GraspConfigurations(arm, cell)
        self._trajectory: Trajectory | None = None  # None: the arm is to stand
        self._choice: Choice | None = None  # behind the path
        self._purpose = Step.NONE  # of the path
        self._foretold: tuple[float, TravelTime] | None = None  # when its time was foretold, if it is being kept
        self._next: Choice | None = None  # to be followed as soon as the arm stands
        self._then = Step.NONE  # after a rest that is a retreat
        self._closed, self._since = False, 0.0
        self._asked = self._not_before = -np.inf
        self._failures, self._trouble = 0, ""
        self._taken = False  # whether the person was about to take its cube
        self._held_since: float | None = None
        self._reaction: Reaction | None = None
        self._limit = SpeedLimit(0.0, LimitReason.SILENCE, Separation())
        self._going = SpeedHysteresis()
        self._decision = Decision(0.0, RobotState.WAITING, "It has not begun.", speed=0.0)

    @property
    def done(self) -> bool:
        """Whether every cube is in its place or given up."""
        return self._decision.state is RobotState.DONE

    def ahead(self, seconds: Float[np.ndarray, " N"]) -> Float[np.ndarray, "N 6"]:
        """(N, 6) where the arm is so long from now at full speed [rad]; where it stands if it has no path."""
        if self._trajectory is None:
            return np.repeat(self.executor.q[None], len(seconds), axis=0)
        end = float(self._trajectory.times[-1])
        return self._trajectory.at(end - self.executor.remaining + seconds)

    def see(self, shot: CameraFrame, predictions: Sequence[Prediction], now: float) -> None:
        """Takes in a shot and what is predicted from it, one prediction a person; none means: nothing is predicted."""
        try:
            self.people.see(shot, predictions)
            self._foresee(now)
        except Exception:
            # The arm is controlled on, whatever is wrong: a camera that says nothing of use is silent.
            log.exception("what was seen at %r cannot be used", shot.stamp)
            self.people.newest = -np.inf

    def control(self, now: float) -> Command:
        """The next control step; never raises, never waits."""
        try:
            self._take_answer(now)
            self._advance(now)
            here, soon = self.ahead(np.array([0.0, MOMENT]))
            velocities = self.executor.qd, (soon - here) / MOMENT
            self._limit = speed_limit(
                self.arm, self.people, self.cell.separation, self.executor.q, velocities, self._decision.speed, now
            )
            self._evade(now)
            decision = self._decide(now)
        except Exception as error:
            log.exception("control failed at %r", now)
            decision = Decision(now, RobotState.STOPPED, f"Its control failed: {error}.", self.target, speed=0.0)
        q = self.executor.step(decision.speed)
        before, after = ((each.state, each.target, each.reason) for each in (self._decision, decision))
        self._decision = decision
        return Command(q, self._closed, decision, decision.reaction is not None or after != before)

    # Reactions

    def _foresee(self, now: float) -> None:
        """Looks at what is predicted, and changes cube or path where that is called for."""
        held = self.target if self._closed or self.step in (Step.OPEN, Step.RISE) else None
        places = {name: self.cell.cube(name).position for name in self.sequence.remaining if name != held}
        self.sequence.update(now, self.people.taken(places, now))
        taken = self.target is not None and self.sequence.is_taken(self.target)
        if taken and not self._taken:
            self._asked = -np.inf  # at once
        self._taken = taken
        under_way = self._trajectory is not None and self.step in (Step.REACH, Step.CARRY) and not self.busy
        if under_way and now - self._asked >= AGAIN and self.people.predictions:
            self._ask(now, better=True)

    @property
    def busy(self) -> bool:
        """Whether an answer is waited for, or followed as soon as the arm stands."""
        return self.planner.pending is not None or self._next is not None

    def _evade(self, now: float) -> None:
        """Draws back where it is held for long, and takes its step up again from there."""
        held = self._limit.speed < STUCK and self._limit.reason in (LimitReason.DOUBT, LimitReason.SEPARATION)
        if not held or self.step not in EVADABLE:
            self._held_since = None
        elif self._held_since is None:
            self._held_since = now
        elif now - self._held_since >= EVADE and self._trajectory is not None:
            self._held_since, self._foretold = None, None
            self._then = Step.CARRY if self._closed else Step.REACH
            self._travel(Step.REST, now)

    # Steps

    def _advance(self, now: float) -> None:
        """The next step where one has ended."""
        if self.executor.done and self._purpose is not self.step:
            self._trajectory = None  # the end of a way that was given up
        if self.step is Step.NONE or (self.step is Step.REST and self._then is Step.NONE and self.sequence.remaining):
            self._choose(now)
        elif self.step in (Step.CLOSE, Step.OPEN):
            if now - self._since >= DWELL:
                self._begin(NEXT[self.step], now)
        elif self._trajectory is None:
            if not self.busy and now >= self._not_before:
                self._ask(now)
        elif self.executor.done:
            if self.step in (Step.LIFT, Step.RISE) and self._foretold is not None:
                self.forecasts.append((now - self._foretold[0], self._foretold[1]))
                self._foretold = None
            self._begin(NEXT[self.step], now)

    def _begin(self, step: Step, now: float) -> None:
        """Sets about a step."""
        if step in (Step.REACH, Step.CARRY, Step.REST):
            self._travel(step, now)
        elif step in (Step.CLOSE, Step.OPEN):
            self._closed, self._since = step is Step.CLOSE, now
            self._stand(step)
        elif step is not Step.NONE:
            self._go_straight(step, now)
        elif self.step is Step.RISE:
            assert self.target is not None
            self.sequence.finish(self.target, now)
            self.target = None
            self._stand(Step.NONE)
            self._choose(now)
        else:  # at rest
            self._stand(Step.REST)
            again, self._then = self._then, Step.NONE
            if again is not Step.NONE:
                self._travel(again, now)

    def _choose(self, now: float) -> None:
        """The next cube; to rest where there is none."""
        if self.sequence.remaining:
            self._travel(Step.REACH, now)
            return
        self.target = None
        rest = self._places.rest(self.executor.q)
        if len(rest) and self.step is not Step.REST and np.abs(rest - self.executor.q).max(axis=1).min() > 0.05:
            self._travel(Step.REST, now)
        else:
            self.step = Step.REST

    def _travel(self, step: Step, now: float) -> None:
        """Sets out; keeps to the path it is on until there is another."""
        self.step = step
        self._failures, self._trouble = 0, ""
        if self.executor.done:
            self._trajectory = None
        self._ask(now)

    def _go_straight(self, step: Step, now: float) -> None:
        """Down to a cube or its place, or up again; stays where the arm cannot."""
        assert self.target is not None
        cube = self.cell.cube(self.target)
        above = self.cell.hover if step in (Step.LIFT, Step.RISE) else 0.0
        to = self.cell.grasp(cube.place if step in (Step.LOWER, Step.RISE) else cube.position, above)[:3, 3]
        way = straight(self.arm, self.executor.q, to, now)
        if way is None:
            self._trouble = f"There is no straight way for {step.value}."
            return
        self.step = step
        self._follow(way)

    def _stand(self, step: Step) -> None:
        self.step, self._trajectory, self._next = step, None, None

    def _follow(self, trajectory: Trajectory) -> None:
        self._trajectory, self._purpose, self._next = trajectory, self.step, None
        self._going.begin()
        self.executor.follow(trajectory)

    # Plans

    def _ask(self, now: float, better: bool = False) -> None:
        """Asks for the best way, or a better one, from where the arm will stand if it brakes at the answer."""
        options = options_for(self.step, self.target, self.sequence, self._places, self.executor.q)
        if not any(len(option.goals) for option in options):
            self._no_way("out of reach", now)
            return
        self._asked = now
        stop, seconds = self.executor.stopping(LATENCY)
        start_time = now + max(LATENCY, seconds)
        present = self._present() if better else None
        motions = None if self.step is Step.REST else self.people.motions(now)
        self.planner.ask(Request(options, stop, start_time, start_time - now, motions, present), now)

    def _present(self) -> Float[np.ndarray, "W 6"] | None:
        """Configurations `STEP` apart in which it goes on as it does, to the end of what it is about to do [rad]."""
        if self._choice is None or self._trajectory is None:
            return None
        rows = self._choice.rows
        passed = max(self._trajectory.duration - self.executor.remaining, 0.0) / STEP
        return interpolated(
            np.append(np.arange(passed, len(rows) - 1), len(rows) - 1), np.arange(float(len(rows))), rows
        )

    def _take_answer(self, now: float) -> None:
        """Takes in an answer, if there is one, and follows what it says as soon as the arm stands."""
        asked, answer = self.planner.pending, self.planner.answer(now)
        if isinstance(answer, Choice):
            if answer.option.step is self.step:  # one to the step before comes too late
                self._failures, self._trouble = 0, ""
                if answer.plan is not None:
                    self._take_up(answer)
        elif answer is not None and asked is not None:
            if asked.present is not None:
                self._asked = now + RETRY
            elif answer.crashed:
                self._trouble, self._not_before = f"No path: {answer.reason}.", now + RETRY
            else:
                self._no_way(answer.reason, now)
        choice = self._next
        if choice is None or choice.plan is None or not self.executor.at_rest:
            return
        if np.abs(self.executor.q - choice.plan.q[0]).max() < NEAR_ENOUGH:
            self._choice, self._foretold = choice, (now - choice.wait, choice.foretold)
            self._follow(choice.plan)
        else:  # it was held on the way and came to rest elsewhere
            self._stand(self.step)
            self._ask(now)

    def _take_up(self, choice: Choice) -> None:
        """Brakes for something else."""
        option = choice.option
        if option.step is Step.REACH and option.target != self.target:
            if self.target is not None or option.target != self.sequence.remaining[0]:
                self._reaction = Reaction.TAKE_ANOTHER if self.target is None else Reaction.CHANGE_CUBE
            self.target = option.target
        elif self._trajectory is not None and self._purpose is self.step and self.step is not Step.REST:
            self._reaction = Reaction.GO_AROUND
        self._next = choice

    def _no_way(self, reason: str, now: float) -> None:
        """Nobody is in the way, and still there is no path: tries again, then gives the cube up."""
        self._failures += 1
        self._trouble, self._not_before = f"No path: {reason}.", now + RETRY
        if self._failures >= ATTEMPTS and self.step in (Step.REACH, Step.REST):
            if self.step is Step.REACH:
                self.sequence.give_up()
                self.target = None
            self._stand(Step.NONE if self.step is Step.REACH else Step.REST)

    # Decision

    def _decide(self, now: float) -> Decision:
        """State, speed and reason from all of the above."""
        free = self._trajectory is not None and self._next is None
        self._going.update(self._limit, self._limit.speed if free else 0.0, now)
        state, reaction = self._state(), self._reaction
        self._reaction = None
        return Decision(
            stamp=now,
            state=state,
            reason=self._reason(state, reaction),
            target=self.target,
            reaction=reaction,
            speed=self._going.speed,
            distance=self._limit.separation.distance,
            separation=self._limit.separation.required,
            taken=dict(self.sequence.probabilities),
            basis=self.people.newest,
        )

    def _state(self) -> RobotState:
        has_path, going = self._trajectory is not None, self._going
        held = has_path and going.level == HELD
        if going.reason in BLIND or (held and going.reason is LimitReason.SEPARATION):
            return RobotState.STOPPED
        if not self.sequence.remaining and self.step is Step.REST and not has_path:
            return RobotState.DONE
        if has_path and self._next is not None:
            return RobotState.REPLANNING
        if self.step in (*GRASPING, *PLACING) and not held:
            return RobotState.GRASPING if self.step in GRASPING else RobotState.PLACING
        if held or not has_path:
            return RobotState.WAITING
        return RobotState.SLOWED if going.level == SLOW else RobotState.MOVING

    def _reason(self, state: RobotState, reaction: Reaction | None) -> str:
        """Why, in a sentence."""
        sequence, cause = self.sequence, self._going.reason
        errand = f"{self.step.value} ({self.target})" if self.target else self.step.value
        if reaction is Reaction.GO_AROUND:
            return f"The way {errand} was about to be blocked: another way around."
        if reaction is not None:
            taken = " and ".join(filter(sequence.is_taken, sequence.remaining)) or "the cube"
            return f"The person reaches for {taken}: {f'{self.target} first' if self.target else 'back up'}."
        if state is RobotState.STOPPED:
            return cause.value
        if state is RobotState.DONE:
            missing = f", without {' and '.join(sequence.given_up)}: no way there" if sequence.given_up else ""
            return f"Every cube is in its place{missing}."
        if self._trouble:
            return self._trouble
        if state is RobotState.WAITING:
            return f"A path is sought {errand}."
        if state is RobotState.REPLANNING:
            return f"Another path is sought {errand}; meanwhile it slows down."
        if state is RobotState.SLOWED:
            return f"On the way {errand}, slowly: {cause.value if cause is LimitReason.DOUBT else 'a person is near'}."
        return f"{errand[0].upper()}{errand[1:]}."
