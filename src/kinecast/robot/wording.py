"""States and reasons in words."""

from __future__ import annotations

from kinecast.robot.pick_place import Step, TaskSequence
from kinecast.robot.speed_limit import Level, LimitReason, SpeedHysteresis
from kinecast.types import Reaction, RobotState

__all__ = ["reason_of", "state_of"]


def state_of(step: Step, finished: bool, has_path: bool, searching: bool, going: SpeedHysteresis) -> RobotState:
    """The state's name: in a step, or finished with all of them; with a path to follow, or searching for another."""
    held = has_path and going.level is Level.HELD
    if going.reason in (LimitReason.SILENCE, LimitReason.UNSEEN) or (held and going.reason is LimitReason.SEPARATION):
        return RobotState.STOPPED
    if finished:
        return RobotState.DONE
    if searching:
        return RobotState.REPLANNING
    if step.grasping and not held:
        return RobotState.GRASPING
    if step.placing and not held:
        return RobotState.PLACING
    if held or not has_path:
        return RobotState.WAITING
    return RobotState.SLOWED if going.level is Level.SLOW else RobotState.MOVING


def reason_of(
    state: RobotState,
    step: Step,
    target: str | None,
    reaction: Reaction | None,
    cause: LimitReason,
    sequence: TaskSequence,
    trouble: str,
) -> str:
    """Why, in a sentence."""
    errand = f"{step.value} ({target})" if target else step.value
    taken = [name for name in sequence.remaining if sequence.is_taken(name)]
    if reaction is Reaction.GO_AROUND:
        return f"The way {errand} was about to be blocked: another way around."
    if reaction is not None:
        instead = f"{target} first" if target else "back up"
        return f"The person reaches for {' and '.join(taken) or 'the cube'}: {instead}."
    if state is RobotState.STOPPED:
        return cause.value
    if state is RobotState.DONE:
        missing = f", without {' and '.join(sequence.given_up)}: no way there" if sequence.given_up else ""
        return f"Every cube is in its place{missing}."
    if trouble:
        return trouble
    if state is RobotState.WAITING:
        return f"A path is sought {errand}."
    if state is RobotState.REPLANNING:
        return f"Another path is sought {errand}; meanwhile it slows down."
    if state is RobotState.SLOWED:
        return f"On the way {errand}, slowly: {cause.value if cause is LimitReason.DOUBT else 'a person is near'}."
    return f"{errand[0].upper()}{errand[1:]}."
