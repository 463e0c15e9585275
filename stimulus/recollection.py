"""Bring a fresh course to where a stimulus was whose process died, by what was said in the run so far."""

from collections.abc import Iterable
from dataclasses import dataclass

from bci_app.protocol import (
    Action,
    BlockEnd,
    BlockStart,
    Command,
    Electrodes,
    EpisodeEnd,
    EpisodeStart,
    MoveOnset,
    Pause,
    Resume,
    Said,
    SessionEnd,
    SessionStart,
    Verdict,
)
from stimulus.course import Course
from stimulus.phases import Outgoing, Phase


@dataclass
class Recollection:
    """What is known of the run.

    Attributes
    ----------
    phase : READY before it began, DONE after its end, else PAUSED.
    paused_in : where it goes on: PAGE is its very beginning, instructions and all.
    by_person : whether a person had paused it.
    last_stamp : of the stimulus's own messages.
    last_said : of the episode under way, its start and its last move with goal and truth: who died at once may have
        sent only half of it, or not to all.
    """

    phase: Phase = Phase.READY
    paused_in: Phase = Phase.READY
    by_person: bool = False
    last_stamp: float = float("-inf")
    last_said: tuple[Outgoing, ...] = ()


def relive(course: Course, said: Iterable[Said]) -> Recollection:
    """Go through what was said, and take it into the course.

    Raises SetupError where what was said isn't of this run.
    """
    found = Recollection()
    actions: dict[tuple[int, int], Action] = {}
    for item in said:
        if not isinstance(item.message, Verdict | Action | Electrodes | Command):  # those are of other clocks
            found.last_stamp = max(found.last_stamp, item.stamp)
        match item.message:
            case SessionStart():
                found.phase, found.paused_in = Phase.PAUSED, Phase.PAGE
            case BlockStart() as block:
                found.paused_in = Phase.REST
                course.remember_block(block)
            case EpisodeStart() as start:
                found.paused_in = Phase.REST
                course.remember_start(start)
                goal = Outgoing("truth", course.walk.start_messages()[1], item.stamp)
                found.last_said = goal, Outgoing("stimulus", start, item.stamp)
            case MoveOnset() as onset:
                course.remember_move(onset)
                truth = Outgoing("truth", course.walk.move_messages()[1], item.stamp)
                found.last_said = *found.last_said[:2], truth, Outgoing("stimulus", onset, item.stamp)
            case Verdict() as verdict:
                course.judged(verdict)
            case Action() as action:
                actions[action.episode, action.step] = action
            case EpisodeEnd():
                course.running, found.last_said = False, ()
            case BlockEnd() as block:
                course.block, found.paused_in = block.block + 1, Phase.BREAK
            case Pause() as pause:
                found.by_person = pause.by_person
            case Resume():
                found.by_person = False
            case Command(command="pause", by_person=True):
                found.by_person = True  # it may not have come into effect yet
            case Command(command="resume", by_person=True):
                found.by_person = False
            case Command(command="finish"):
                course.is_enough = True
            case SessionEnd():
                found.phase = Phase.DONE
    if found.phase is Phase.PAUSED:
        action_to_come = actions.get((course.walk.number, course.walk.steps + 1))
        if course.running and action_to_come is not None and not course.end_reason():
            course.take_action(action_to_come)
    return found
