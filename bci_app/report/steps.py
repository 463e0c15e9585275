"""A recorded run as rows: one for each move, one for each episode."""

from collections.abc import Sequence

from bci_app.gridworld import ACTIONS, STEP
from bci_app.gridworld import BORDER as BORDER
from bci_app.gridworld import area_of as area_of
from bci_app.metrics import truths
from bci_app.protocol import EpisodeEnd, EpisodeGoal, EpisodeStart, MoveOnset, SessionStart, Truth
from bci_app.recording import Recording
from bci_app.report import Row


def move_rows(recording: Recording) -> list[Row]:
    """One row a move, in order: where it led, whether it was an error, what the verdict was.

    ``error`` is None without a truth; ``errors_in_a_row`` counts the errors of an episode that end with this one, 0 for
    a correct move. The area is that of the cell moved to, which the person looks at.
    """
    known, verdicts = truths(recording), recording.verdicts
    left = {(truth.episode, truth.step): truth.distance for _, truth in recording.of(Truth)}
    layout = _layout(recording)
    rows, in_a_row, last = [], 0, None
    for stamp, move in recording.of(MoveOnset):
        key = move.episode, move.step
        error, verdict = known.get(key), verdicts.get(key)
        # A move nobody knows the truth of, or another episode, ends a row of errors.
        in_a_row = (in_a_row if last == move.episode else 0) + 1 if error else 0
        last = move.episode
        rows.append(
            {
                "episode": move.episode,
                "step": move.step,
                "onset_s": stamp,
                "action": move.action,
                "row": move.position[0],
                "column": move.position[1],
                "area": area_of(move.position, len(layout), len(layout[0])) if layout else None,
                "error": error,
                "errors_in_a_row": in_a_row,
                "distance_left": left.get(key),
                "verdict": verdict.outcome if verdict else None,
                "log_odds": verdict.log_odds if verdict else None,
                "evidence": verdict.evidence if verdict else None,
                "reason": verdict.reason if verdict else None,
            }
        )
    return rows


def episode_rows(recording: Recording) -> list[Row]:
    """One row an episode that ended, in order: from where to where, how many steps, whether the goal was reached.

    Goal and distance are None without a truth. An episode of a calibration may end with its block.
    """
    starts = {start.episode: start.position for _, start in recording.of(EpisodeStart)}
    goals = {goal.episode: goal for _, goal in recording.of(EpisodeGoal)}
    rows = []
    for _, end in recording.of(EpisodeEnd):
        start, goal = starts.get(end.episode), goals.get(end.episode)
        rows.append(
            {
                "episode": end.episode,
                "distance": goal.distance if goal else None,
                "start_row": start[0] if start else None,
                "start_column": start[1] if start else None,
                "goal_row": goal.goal[0] if goal else None,
                "goal_column": goal.goal[1] if goal else None,
                "steps": end.steps,
                "reason": end.reason,
                "success": end.reason == "goal",
            }
        )
    return rows


def way(moves: Sequence[Row]) -> list[tuple[int, int]]:
    """Cells (row, column) of an episode's moves, from its start on."""
    first = moves[0]
    back = STEP[ACTIONS.index(first["action"])]
    start = first["row"] - back[0], first["column"] - back[1]
    return [start, *((move["row"], move["column"]) for move in moves)]


def judged(moves: Sequence[Row]) -> list[Row]:
    """Those with a truth and a verdict on it."""
    return [move for move in moves if move["error"] is not None and move["verdict"] in ("error", "correct")]


def is_right(move: Row) -> bool:
    """Whether the verdict on a judged move agrees with the truth."""
    return bool((move["verdict"] == "error") == move["error"])


def _layout(recording: Recording) -> tuple[str, ...]:
    opening = recording.of(SessionStart)
    return tuple(opening[0][1].layout) if opening else ()
