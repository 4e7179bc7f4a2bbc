"""The arm's foreman: what it does next, how fast, and why. It decides at every control step and never waits.

    NONE → REACH → DESCEND → CLOSE → LIFT → CARRY → LOWER → OPEN → RISE → NONE      one cube (kinecast.robot.errand)

Predictions change the way (GO_AROUND) or the cube (TAKE_ANOTHER, CHANGE_CUBE) where the expected time says so
(kinecast.robot.choice). Above that, speed and separation monitoring looks at measured positions alone
(kinecast.robot.pace).
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from kinecast.robot.body import OccupancyOptions
from kinecast.robot.camera import Shot
from kinecast.robot.cell import Cell
from kinecast.robot.choice import Choice, ChoiceOptions, Option, Request
from kinecast.robot.conduct import Conduct
from kinecast.robot.errand import Places, Step, straight
from kinecast.robot.execution import Executor
from kinecast.robot.expected_time import RISE, TravelTime
from kinecast.robot.motions import STEP
from kinecast.robot.outlook import Outlook
from kinecast.robot.pace import Pace, PaceOptions, Restraint, allowed_pace
from kinecast.robot.planner import SPEED
from kinecast.robot.planning_desk import Desk
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
NEAR_ENOUGH = 0.05
"""A path is followed from where the arm stands if it begins no farther away than this [rad]."""
AFTER_EVADING = {
    Step.REACH: Step.REACH, Step.DESCEND: Step.REACH, Step.LIFT: Step.CARRY, Step.CARRY: Step.CARRY,
    Step.LOWER: Step.CARRY,
}  # fmt: skip
"""What a step that was held becomes."""
AFTER_PLACING = {Step.OPEN, Step.RISE}


@dataclass(frozen=True)
class SupervisorOptions:
    """How the foreman decides.

    Attributes:
        again: between two looks for something better [s].
        retry: after a search that failed [s].
        attempts: so often a place is tried that cannot be reached.
        touch: a limb that comes this near to a cube's middle may take it [m].
        evade: held back for this long by somebody who comes to where it stands, the arm draws back [s].
        settle: going faster, or another cause of going slowly, is a new state only after so long [s].
        rise: how fast the speed may rise again [1/s].
        pace, occupancy, sequence, choice: see there.
    """

    again: float = 0.3
    retry: float = 0.5
    attempts: int = 3
    touch: float = 0.06
    evade: float = 2.0
    settle: float = 0.15
    rise: float = RISE
    pace: PaceOptions = field(default_factory=PaceOptions)
    occupancy: OccupancyOptions = field(default_factory=OccupancyOptions)
    sequence: SequenceOptions = field(default_factory=SequenceOptions)
    choice: ChoiceOptions = field(default_factory=ChoiceOptions)


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
        self.forecasts: list[tuple[float, TravelTime]] = []
        """How long each way to the end of a grasp or a placing took [s], and how long it was to take when begun."""
        self._places = Places(arm, cell)
        self._trajectory: Trajectory | None = None  # None: the arm is to stand
        self._choice: Choice | None = None  # behind the path
        self._purpose = Step.NONE  # of the path
        self._foretold: tuple[float, TravelTime] | None = None  # when its time was foretold, if it is being kept
        self._next: Choice | None = None  # to be followed as soon as the arm stands
        self._then = Step.NONE  # after a rest that is a retreat
        self._closed, self._since = False, 0.0
        self._asked = self._not_before = -np.inf
        self._failures, self._trouble = 0, ""
        self._taken = self._alarm = False  # whether the person was about to take its cube; and nothing was asked since
        self._held_since: float | None = None
        self._reaction: Reaction | None = None
        self._pace = Pace(0.0, Restraint.SILENCE, Separation())
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
        taken = self.target is not None and self.sequence.is_taken(self.target)
        self._alarm = taken and (self._alarm or not self._taken)
        self._taken = taken
        due = (self._alarm and self.step is Step.REACH) or now - self._asked >= self.options.again
        under_way = self._trajectory is not None and self.step in (Step.REACH, Step.CARRY) and not self.busy
        if under_way and due and self.outlook.predictions:
            self._alarm = False
            self._ask("better", now)

    @property
    def busy(self) -> bool:
        """Whether an answer is waited for, or followed as soon as the arm stands."""
        return self.desk.pending is not None or self._next is not None

    def _evade(self, now: float) -> None:
        """Draws back where it is held for long, and takes its step up again from there."""
        held = self._pace.speed < HELD and self._pace.restraint in (Restraint.DOUBT, Restraint.SEPARATION)
        if not held or self.step not in AFTER_EVADING:
            self._held_since = None
        elif self._held_since is None:
            self._held_since = now
        elif now - self._held_since >= self.options.evade and self._trajectory is not None:
            self._held_since, self._foretold = None, None
            self._then = AFTER_EVADING[self.step]
            self._travel(Step.REST, now)

    # Steps

    def _advance(self, now: float) -> None:
        """The next step where one has ended."""
        step, o = self.step, self.options
        arrived = self._trajectory is not None and self.executor.done
        if arrived and self._purpose is not step:  # the end of a way that was given up
            arrived, self._trajectory = False, None
        if step is Step.NONE or (step is Step.REST and self._then is Step.NONE and self.sequence.remaining):
            self._choose(now)
        elif step in (Step.CLOSE, Step.OPEN):
            if now - self._since >= o.choice.dwell:
                self._go_straight(self.cell.hover, Step.LIFT if step is Step.CLOSE else Step.RISE, now)
        elif self._trajectory is None:
            if not self.busy and now >= self._not_before:
                self._ask("path", now)
        elif arrived and step is Step.REACH:
            self._go_straight(0.0, Step.DESCEND, now)
        elif arrived and step is Step.DESCEND:
            self._grip(True, Step.CLOSE, now)
        elif arrived and step is Step.LIFT:
            self._arrived_as_foretold(now)
            self._travel(Step.CARRY, now)
        elif arrived and step is Step.CARRY:
            self._go_straight(0.0, Step.LOWER, now)
        elif arrived and step is Step.LOWER:
            self._grip(False, Step.OPEN, now)
        elif arrived and step is Step.RISE:
            assert self.target is not None
            self._arrived_as_foretold(now)
            self.sequence.finish(self.target)
            self.target = None
            self._stand(Step.NONE)
            self._choose(now)
        elif arrived and step is Step.REST:
            self._stand(Step.REST)
            again, self._then = self._then, Step.NONE
            if again is Step.CARRY:
                self._travel(Step.CARRY, now)
            elif again is Step.REACH:
                self._stand(Step.NONE)
                self._choose(now)

    def _arrived_as_foretold(self, now: float) -> None:
        """Notes how long it took, to be compared."""
        if self._foretold is not None:
            self.forecasts.append((now - self._foretold[0], self._foretold[1]))
            self._foretold = None

    def _choose(self, now: float) -> None:
        """The next cube; to rest where there is none."""
        if self.sequence.remaining:
            self._travel(Step.REACH, now)
            return
        self.target = None
        rest = self._places.rest(self.executor.q)
        if len(rest) and self.step is not Step.REST and np.abs(rest - self.executor.q).max(axis=1).min() > 0.05:
            self._then = Step.NONE
            self._travel(Step.REST, now)
        else:
            self.step = Step.REST

    def _travel(self, step: Step, now: float) -> None:
        """Sets out; keeps to the path it is on until there is another."""
        self.step = step
        self._failures, self._trouble = 0, ""
        if self._trajectory is not None and self.executor.done:
            self._trajectory = None
        self._ask("path", now)

    def _go_straight(self, above: float, step: Step, now: float) -> None:
        """Down to a cube or its place, or up again; stays where the arm cannot."""
        assert self.target is not None
        cube = self.cell.cube(self.target)
        placing = step in (Step.LOWER, Step.RISE)
        to = self.cell.grasp(cube.place if placing else cube.position, above)[:3, 3]
        way = straight(self.arm, self.executor.q, to, self.options.choice.vertical, now)
        if way is None:
            self._trouble = f"There is no straight way for {step.value}."
            return
        self.step = step
        self._follow(way)

    def _grip(self, closed: bool, step: Step, now: float) -> None:
        self._closed, self.step, self._since = closed, step, now
        self._trajectory = None

    def _stand(self, step: Step) -> None:
        self.step, self._trajectory, self._next = step, None, None

    def _follow(self, trajectory: Trajectory) -> None:
        self._trajectory, self._purpose, self._next = trajectory, self.step, None
        self._conduct.begin(at_rest=not self.executor.qd.any())
        self.executor.follow(trajectory)

    # Plans

    def _ask(self, why: str, now: float) -> None:
        """Asks for the best way from where the arm will stand if it brakes when the answer is there.

        Args:
            why: `better` than what it does, or a `path` for the step it is in.
            now: [s].
        """
        options = self._options()
        if not any(len(option.goals) for option in options):
            self._no_way("out of reach", now)
            return
        self._asked = now
        q, seconds = self.executor.stopping(self.desk.latency)
        start_time = now + max(self.desk.latency, seconds)
        present = self._present() if why == "better" else None
        motions = None if self.step is Step.REST else self.outlook.motions(now)
        self.desk.ask(Request(options, q, start_time, start_time - now, motions, present, why), now)

    def _options(self) -> tuple[Option, ...]:
        """What may be done in this step, what it does now first."""
        q = self.executor.q
        if self.step is Step.REST:
            return (Option(Step.REST, self.target, self._places.rest(q), None),)
        if self.step is Step.CARRY:
            assert self.target is not None
            place = self.cell.cube(self.target).place
            return (Option(Step.CARRY, self.target, self._places.above(place, q), place),)
        names, options = self.sequence.remaining, []
        for name in sorted(names, key=lambda name: name != self.target):
            place = self.cell.cube(name).position
            price = 0.0 if name == names[0] else self.options.choice.order
            price += self.options.choice.taken if self.sequence.is_taken(name) else 0.0
            usual = self._places.usual(place, SPEED)
            options.append(Option(Step.REACH, name, self._places.above(place, q), place, usual, price))
        return tuple(options)

    def _present(self) -> Float[np.ndarray, "W 6"] | None:
        """Configurations `STEP` apart in which it goes on as it does, to the end of what it is about to do [rad]."""
        if self._choice is None or self._trajectory is None:
            return None
        rows = self._choice.rows
        passed = max(self._trajectory.duration - self.executor.remaining, 0.0) / STEP
        places = np.append(np.arange(passed, len(rows) - 1), len(rows) - 1)
        return np.stack([np.interp(places, np.arange(len(rows)), column) for column in rows.T], axis=1)

    def _take_answer(self, now: float) -> None:
        if self._next is not None and self.executor.at_rest:
            choice, self._next = self._next, None
            assert choice.plan is not None  # as it was looked at before it was kept
            if np.abs(self.executor.q - choice.plan.trajectory.q[0]).max() < NEAR_ENOUGH:
                self._adopt(choice, now)
            else:  # it was held on the way and came to rest elsewhere
                self._stand(self.step)
                self._ask("path", now)
        answer = self.desk.answer(now)
        if answer is None:
            return
        if answer.choice is not None:
            if answer.choice.option.step is not self.step:
                return  # it comes too late
            self._failures, self._trouble = 0, ""
            if answer.choice.plan is not None:
                self._take_up(answer.choice, now)
        elif answer.request.why == "better":
            self._asked = now + self.options.retry
        elif answer.crashed:
            self._trouble, self._not_before = f"No path: {answer.reason}.", now + self.options.retry
        else:
            self._no_way(answer.reason, now)

    def _take_up(self, choice: Choice, now: float) -> None:
        """Does something else from now on: at once if it stands, or brakes for it."""
        option, under_way = choice.option, self._trajectory is not None
        if option.step is Step.REACH and option.target != self.target:
            if self.target is not None or option.target != self.sequence.remaining[0]:
                self._reaction = Reaction.TAKE_ANOTHER if self.target is None else Reaction.CHANGE_CUBE
                self.replans += 1
            self.target = option.target
        elif under_way and self._purpose is self.step and self.step is not Step.REST:
            self._reaction = Reaction.GO_AROUND
            self.replans += 1
        if self.executor.at_rest:
            self._adopt(choice, now)
        else:
            self._next = choice

    def _adopt(self, choice: Choice, now: float) -> None:
        """Follows a new path."""
        assert choice.plan is not None
        self._choice, self._foretold = choice, (now - choice.wait, choice.time)
        self._follow(choice.plan.trajectory)

    def _no_way(self, reason: str, now: float) -> None:
        """Nobody is in the way, and still there is no path: tries again, then gives the cube up."""
        self._failures += 1
        self._trouble, self._not_before = f"No path: {reason}.", now + self.options.retry
        if self._failures >= self.options.attempts:
            if self.step is Step.REACH:
                for name in tuple(self.sequence.remaining):
                    self.sequence.give_up(name)
                self.target = None
            if self.step in (Step.REACH, Step.REST):
                self._stand(Step.NONE if self.step is Step.REACH else Step.REST)

    # Decision

    def _decide(self, now: float) -> Decision:
        """State, speed and reason from all of the above."""
        has_path, conduct = self._trajectory is not None, self._conduct
        searching = has_path and self._next is not None
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
            taken=dict(self.sequence.probabilities),
            basis=self.outlook.basis,
        )
