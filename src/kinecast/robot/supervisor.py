"""The arm's foreman: what it does next, how fast, and why. It decides at every control step and never waits.

    NONE → REACH → DESCEND → CLOSE → LIFT → CARRY → LOWER → OPEN → RISE → NONE      one cube (kinecast.robot.errand)

Predictions change the way (GO_AROUND) or the cube (TAKE_ANOTHER, CHANGE_CUBE) and hold the arm back early, so that it
can stop before it is where a person may be. Above that, speed and separation monitoring looks at measured positions
alone (kinecast.robot.pace).
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from kinecast.robot.camera import Shot
from kinecast.robot.cell import Cell
from kinecast.robot.conduct import Conduct
from kinecast.robot.errand import Places, Step, straight
from kinecast.robot.execution import Executor
from kinecast.robot.occupancy import Occupancy, OccupancyOptions
from kinecast.robot.outlook import Outlook
from kinecast.robot.pace import Pace, PaceOptions, Restraint, allowed_pace
from kinecast.robot.planning_desk import Answer, Desk, Request
from kinecast.robot.separation import Separation
from kinecast.robot.task_sequence import SequenceOptions, TaskSequence
from kinecast.robot.trajectory import Trajectory
from kinecast.robot.ur5 import UR5
from kinecast.robot.wording import reason_of, state_of
from kinecast.types import Decision, Prediction, Reaction, RobotState

__all__ = ["Command", "Supervisor", "SupervisorOptions"]

log = logging.getLogger(__name__)

HELD = 0.1
"""Share of the planned speed below which it does not get anywhere."""
AFTER_PLACING = {Step.OPEN, Step.RISE}


@dataclass(frozen=True)
class SupervisorOptions:
    """How the foreman decides.

    Attributes:
        around: probability of overlap from which another path is sought.
        better: a path is changed only for one whose probability is lower by this.
        again: between two searches for another path [s].
        retry: after a search that failed [s].
        attempts: so often a place is tried that cannot be reached.
        touch: a limb that comes this near to a cube's middle may take it [m].
        evade: held back for this long by somebody who comes to where it stands, the arm draws back [s].
        vertical: greatest speed of the straight ways down and up [m/s].
        dwell: time the gripper takes [s].
        settle: going faster, or another cause of going slowly, is a new state only after so long [s].
        rise: how fast the speed may rise again [1/s].
        pace, occupancy, sequence: see there.
    """

    around: float = 0.15
    better: float = 0.1
    again: float = 0.3
    retry: float = 0.5
    attempts: int = 3
    touch: float = 0.06
    evade: float = 0.3
    vertical: float = 0.5
    dwell: float = 0.25
    settle: float = 0.15
    rise: float = 3.0
    pace: PaceOptions = field(default_factory=PaceOptions)
    occupancy: OccupancyOptions = field(default_factory=OccupancyOptions)
    sequence: SequenceOptions = field(default_factory=SequenceOptions)


@dataclass(frozen=True, eq=False)
class Command:
    """What the arm is to do in the next control step.

    Attributes:
        q: (6,) [rad].
        closed: whether the gripper is to be.
        decision: the one in force.
        news: whether it was taken just now.
    """

    q: Float[np.ndarray, "6"]
    closed: bool
    decision: Decision
    news: bool


class Supervisor:
    """Decides.

    Args:
        arm: its kinematics.
        cell: what is to be done, and where.
        executor: follows paths; stands where the arm stands.
        desk: where plans are asked for.
        options: see SupervisorOptions.
    """

    def __init__(
        self, arm: UR5, cell: Cell, executor: Executor, desk: Desk, options: SupervisorOptions | None = None
    ) -> None:
        self.arm, self.cell, self.executor, self.desk = arm, cell, executor, desk
        self.options = options or SupervisorOptions()
        self.outlook = Outlook(arm, cell, self.options.occupancy, self.options.touch)
        self.sequence = TaskSequence(cell.order, self.options.sequence)
        self.step = Step.NONE
        self.target: str | None = None
        self.replans = 0
        self._places = Places(arm, cell)
        self._trajectory: Trajectory | None = None  # None: the arm is to stand
        self._goals = np.empty((0, 6))
        self._around_people = True  # whether the path keeps clear of people, or they left none that does
        self._then = Step.NONE  # after a rest that is a retreat
        self._closed, self._since = False, 0.0
        self._asked = self._not_before = -np.inf
        self._failures, self._trouble, self._overlap = 0, "", 0.0
        self._held_since: float | None = None
        self._reaction: Reaction | None = None
        self._pace = Pace(0.0, Restraint.SILENCE, Separation(), 1.0)
        self._conduct = Conduct(self.options.rise, self.options.settle)
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
        return self._trajectory.at(end - self.executor.remaining + seconds)[0]

    def see(self, shot: Shot, predictions: Sequence[Prediction], now: float) -> None:
        """Takes in a shot and what is predicted from it, one prediction a person; none means: nothing is predicted."""
        try:
            self.outlook.see(shot, predictions, now)
            self._foresee(now)
        except Exception:
            # The arm is controlled on, whatever is wrong: a camera that says nothing of use is silent.
            log.exception("what was seen at %r cannot be used", shot.stamp)
            self.outlook.watch.newest = -np.inf

    def control(self, now: float) -> Command:
        """The next control step; never raises, never waits."""
        try:
            self.outlook.refresh(now)
            self._take_answer(now)
            self._advance(now)
            self._pace = allowed_pace(
                self.outlook, self.executor.q, self.executor.qd, self.ahead, self._decision.speed, now,
                self.options.pace,
            )  # fmt: skip
            self._evade(now)
            decision = self._decide(now)
        except Exception as error:
            log.exception("control failed at %r", now)
            decision = Decision(now, RobotState.STOPPED, f"Its control failed: {error}.", self.target, speed=0.0)
        q, _, _ = self.executor.step(decision.speed)
        last = self._decision
        news = decision.reaction is not None or (decision.state, decision.target, decision.reason) != (
            last.state, last.target, last.reason,
        )  # fmt: skip
        self._decision = decision
        return Command(q, self._closed, decision, news)

    # Reactions

    def _foresee(self, now: float) -> None:
        """Looks at what is predicted, and changes cube or path where that is called for."""
        held = self._closed or self.step in AFTER_PLACING
        names = [name for name in self.sequence.remaining if not (held and name == self.target)]
        self.sequence.update(now, self.outlook.taken(names, now))
        self._overlap = self.outlook.overlap(self.ahead, now)
        if self.step in (Step.REACH, Step.DESCEND) and self.target and self.sequence.is_taken(self.target):
            self._leave(now)
        elif self._trajectory is not None and self.step.planned and self.desk.pending is None:
            blocked = self._overlap >= self.options.around
            hopeful = not self._around_people and self._pace.predicted < 1.0 and bool(self.outlook.trusted(now))
            if (blocked or hopeful) and now - self._asked >= self.options.again:
                self._ask("around", now)

    def _leave(self, now: float) -> None:
        """The cube it is after is the person's: to another, or back."""
        if self.step is Step.DESCEND:
            if self._go_straight(self.cell.hover, Step.BACK_UP, now):
                self._reaction = Reaction.CHANGE_CUBE
            return
        other = self.sequence.next()
        if other is None:
            self._stand(Step.NONE)
            self.target = None
        else:
            self._reach(other, now, Reaction.CHANGE_CUBE)

    def _evade(self, now: float) -> None:
        """Draws back when it is held where somebody comes."""
        held = self._pace.speed < HELD and self._pace.restraint in (Restraint.PREDICTION, Restraint.SEPARATION)
        if not (held and self.step in (Step.REACH, Step.CARRY)):
            self._held_since = None
        elif self._held_since is None:
            self._held_since = now
        elif now - self._held_since >= self.options.evade and self._trajectory is not None:
            self._held_since = None
            self._then = self.step
            self._travel(Step.REST, self._places.rest(self.executor.q), now)

    # Steps

    def _advance(self, now: float) -> None:
        """The next step where one has ended."""
        step, o = self.step, self.options
        arrived = self._trajectory is not None and self.executor.done
        if step is Step.NONE or (step is Step.REST and self._then is Step.NONE and self.sequence.next() is not None):
            self._choose(now)
        elif step in (Step.CLOSE, Step.OPEN):
            if now - self._since >= o.dwell:
                self._go_straight(self.cell.hover, Step.LIFT if step is Step.CLOSE else Step.RISE, now)
        elif self._trajectory is None:
            if self.desk.pending is None and now >= self._not_before:
                self._ask("people" if self._around_people else "no people", now)
        elif arrived and step is Step.REACH:
            self._go_straight(0.0, Step.DESCEND, now)
        elif arrived and step is Step.DESCEND:
            self._grip(True, Step.CLOSE, now)
        elif arrived and step is Step.LIFT:
            self._carry(now)
        elif arrived and step is Step.CARRY:
            self._go_straight(0.0, Step.LOWER, now)
        elif arrived and step is Step.LOWER:
            self._grip(False, Step.OPEN, now)
        elif arrived and step in (Step.RISE, Step.BACK_UP):
            if step is Step.RISE and self.target is not None:
                self.sequence.finish(self.target)
                self.target = None
            self._stand(Step.NONE)
            self._choose(now)
        elif arrived and step is Step.REST:
            self._stand(Step.REST)
            again, self._then = self._then, Step.NONE
            if again is Step.CARRY:
                self._carry(now)
            elif again is Step.REACH:
                self._stand(Step.NONE)
                self._choose(now)

    def _choose(self, now: float) -> None:
        """The next cube; to rest where there is none."""
        name = self.sequence.next()
        if name is not None:
            first = name == self.sequence.remaining[0]
            changed = self.target is not None and name != self.target
            self._reach(name, now, None if first else Reaction.CHANGE_CUBE if changed else Reaction.TAKE_ANOTHER)
            return
        self.target = None
        rest = self._places.rest(self.executor.q)
        if len(rest) and self.step is not Step.REST and np.abs(rest - self.executor.q).max(axis=1).min() > 0.05:
            self._then = Step.NONE
            self._travel(Step.REST, rest, now)
        else:
            self.step = Step.REST

    def _reach(self, name: str, now: float, reaction: Reaction | None) -> None:
        """Sets out for a cube."""
        if reaction is not None and name != self.target:
            self._reaction = reaction
            self.replans += 1
        self.target = name
        self._travel(Step.REACH, self._places.above(self.cell.cube(name).position, self.executor.q), now)

    def _carry(self, now: float) -> None:
        """Sets out for the place of the cube it holds."""
        assert self.target is not None
        self._travel(Step.CARRY, self._places.above(self.cell.cube(self.target).place, self.executor.q), now)

    def _travel(self, step: Step, goals: Float[np.ndarray, "G 6"], now: float) -> None:
        """Sets out for configurations; keeps to the path it is on until there is one."""
        self.step, self._goals = step, goals
        self._failures, self._trouble, self._around_people = 0, "", True
        if self._trajectory is not None and self.executor.done:
            self._trajectory = None
        self._ask("people", now)

    def _go_straight(self, above: float, step: Step, now: float) -> bool:
        """Down to a cube or its place, or up again; stays where the arm cannot."""
        assert self.target is not None
        cube = self.cell.cube(self.target)
        placing = step in (Step.LOWER, Step.RISE)
        to = self.cell.grasp(cube.place if placing else cube.position, above)[:3, 3]
        way = straight(self.arm, self.executor.q, to, self.options.vertical, now)
        if way is None:
            self._trouble = f"There is no straight way for {step.value}."
            return False
        self.step = step
        self._follow(way)
        return True

    def _grip(self, closed: bool, step: Step, now: float) -> None:
        self._closed, self.step, self._since = closed, step, now
        self._trajectory = None

    def _stand(self, step: Step) -> None:
        self.step, self._trajectory = step, None

    def _follow(self, trajectory: Trajectory) -> None:
        self._trajectory = trajectory
        self._conduct.begin(at_rest=not self.executor.qd.any())
        self.executor.follow(trajectory)

    # Plans

    def _ask(self, why: str, now: float) -> None:
        """Asks for a path from where the arm will be when it can be had."""
        if len(self._goals) == 0:
            self._no_way("out of reach", now)
            return
        self._asked = now
        # From where it comes to rest if it brakes now, as it does: from there every way is open.
        q, seconds = self.executor.stopping()
        start_time = now + max(self.desk.latency, seconds)
        people = self.outlook.to_plan_around()
        if why == "people" and self.outlook.within(q, people, start_time):
            why, self._around_people = "no people", False  # no way begins there: not worth asking
        people = Occupancy.empty(now) if why == "no people" else people
        self.desk.ask(Request(why, q, self._goals, people, start_time), now)

    def _take_answer(self, now: float) -> None:
        answer = self.desk.answer(now)
        if answer is None:
            pass
        elif answer.plan is not None:
            self._adopt(answer, answer.plan.trajectory, now)
        elif answer.request.what == "around":
            self._asked = now + self.options.retry  # none around: it goes on, as slowly as it must
        elif answer.crashed:
            self._trouble, self._not_before = f"No path: {answer.reason}.", now + self.options.retry
        elif answer.request.what == "people":
            self._around_people = False
            self._ask("no people", now)
        else:
            self._no_way(answer.reason, now)

    def _adopt(self, answer: Answer, trajectory: Trajectory, now: float) -> None:
        """Follows a new path, unless it is another way to the same place and no better."""
        self._failures, self._trouble = 0, ""
        if answer.request.what == "around":
            chance = self.outlook.overlap(lambda seconds: trajectory.at(now + seconds)[0], now)
            if chance > self._overlap - self.options.better and self._around_people:
                return
            self._reaction = Reaction.GO_AROUND
            self.replans += 1
        self._around_people = answer.request.what != "no people"
        self._follow(trajectory)
        self._overlap = self.outlook.overlap(self.ahead, now)

    def _no_way(self, reason: str, now: float) -> None:
        """Nobody is in the way, and still there is no path: tries again, then gives the cube up."""
        self._failures += 1
        self._trouble, self._not_before = f"No path: {reason}.", now + self.options.retry
        self._around_people = True
        if self._failures >= self.options.attempts or len(self._goals) == 0:
            if self.step is Step.REACH and self.target is not None:
                self.sequence.give_up(self.target)
                self.target = None
            if self.step in (Step.REACH, Step.REST):
                self._stand(Step.NONE if self.step is Step.REACH else Step.REST)

    # Decision

    def _decide(self, now: float) -> Decision:
        """State, speed and reason from all of the above."""
        has_path, conduct = self._trajectory is not None, self._conduct
        searching = has_path and self.desk.pending is not None
        conduct.update(self._pace, self._pace.speed if has_path and not searching else 0.0, now)
        finished = not self.sequence.remaining and self.step is Step.REST and not has_path
        state = state_of(self.step, finished, has_path, searching, conduct)
        reaction, self._reaction = self._reaction, None
        return Decision(
            stamp=now,
            state=state,
            reason=reason_of(state, self.step, self.target, reaction, conduct.cause, self.sequence, self._trouble),
            target=self.target,
            reaction=reaction,
            speed=conduct.speed,
            distance=self._pace.separation.distance,
            separation=self._pace.separation.required,
            overlap=self._overlap,
            taken=dict(self.sequence.probabilities),
            basis=self.outlook.basis,
        )
