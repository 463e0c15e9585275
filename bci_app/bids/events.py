"""The events of a recorded run as the rows of ``events.tsv``: one a move, with all that became of it."""

from bisect import bisect_right
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bci_app.bids.clocks import Clocks
from bci_app.bids.columns import hed
from bci_app.bids.grid import Gap, gaps, rows
from bci_app.moves import Key, electrodes
from bci_app.one_clock import sender
from bci_app.protocol import (
    Action,
    BlockEnd,
    BlockStart,
    Continued,
    Electrodes,
    EpisodeEnd,
    EpisodeGoal,
    EpisodeStart,
    LateFrame,
    Message,
    MoveOnset,
    Note,
    Pause,
    Resume,
    Screen,
    SessionEnd,
    SessionStart,
    Truth,
    Verdict,
    marker_code,
)
from bci_app.recording import Recording
from decoder.epochs import Shape
from decoder.timeline import MAX_JITTER

Row = dict[str, Any]
_TRUTH = {True: "error", False: "correct", None: None}


@dataclass(frozen=True)
class Events:
    """A run's events.

    Attributes
    ----------
    rows : by column, in order of their samples; what is unknown is left out.
    gaps : places at which samples are missing.
    n_epochs, n_same : verdicts with an epoch, and those whose first sample is the one found here again.
    """

    rows: tuple[Row, ...]
    gaps: tuple[Gap, ...]
    n_epochs: int
    n_same: int


def events(recording: Recording, shape: Shape) -> Events:
    """All events of a recording, placed as an epoch of this shape is."""
    found = list(_moves(recording)) + list(_others(recording))
    times, sfreq = recording.times, recording.eeg.sfreq
    newest = [row.pop("last_time", None) for row in found]
    own = [row["stamp"] + row["clock_offset"] for row in found]
    stamps = [stamp if last is None else last for stamp, last in zip(own, newest, strict=True)]
    samples = rows(times, stamps, shape)
    n_epochs = n_same = 0
    for row, stamp, last, sample in zip(found, stamps, newest, samples, strict=True):
        exact = None if last is None else _row_stamped(recording, last, sample)
        row["sample"] = sample if exact is None else exact
        if "action" in row and abs(times[sample] - stamp) > MAX_JITTER + 0.5 / sfreq:
            row["trial_type"] = "move/unseen"
        first = row.pop("first_time", None)
        if first is not None:
            start = _row_stamped(recording, first, sample - shape.n_before)
            n_epochs, n_same = n_epochs + 1, n_same + (start == sample - shape.n_before)
            row["epoch_start"] = None if start is None else start / sfreq
    lost = gaps(times, sfreq)
    found += [row for gap in lost for row in _of_gap(gap, recording)]
    found.sort(key=lambda row: (row["sample"], row["stamp"]))
    for row in found:
        row |= {"onset": row["sample"] / sfreq, "HED": hed(row["trial_type"], row["stamp"])}
        row.setdefault("duration", 0)
    return Events(tuple(found), tuple(lost), n_epochs, n_same)


def _row_stamped(recording: Recording, stamp: float, likely: int) -> int | None:
    """The row of the sample with exactly this stamp, the `likely` one if it is."""
    times = recording.times
    if 0 <= likely < len(times) and times[likely] == stamp:
        return likely
    same = np.flatnonzero(times == stamp)
    return int(same[0]) if len(same) else None


def _moves(recording: Recording) -> Iterator[Row]:
    verdicts, truth = recording.verdicts, {_key(message): message for _, message in recording.of(Truth)}
    said = {(verdict.episode, verdict.step): stamp for stamp, verdict in recording.of(Verdict)}
    actions = {_key(message): message for _, message in recording.of(Action)}
    late = {_key(message): message.late_ms for _, message in recording.of(LateFrame) if message.step is not None}
    goals = {goal.episode: goal.goal for _, goal in recording.of(EpisodeGoal)}
    decided = electrodes(recording)
    clocks = Clocks(recording)
    block, one_clock = _Blocks(recording, clocks), clocks.is_the_stimulus_s("decoder")
    seen: set[Key] = set()
    for stamp, move in recording.of(MoveOnset):
        key = _key(move)
        if key in seen:
            continue
        seen.add(key)
        error = truth[key].error if key in truth else None
        offset = clocks.offset("stimulus", stamp)
        row = {
            "trial_type": f"move/{_TRUTH[error] or 'unknown'}",
            "stamp": stamp,
            "clock_offset": offset,
            "block": block.at(stamp + offset),
            "action": move.action,
            "truth": _TRUTH[error],
            "distance": truth[key].distance if key in truth else None,
            "late": late.get(key),
            "bad_channels": _bad(decided, key),
            **_where(move, goals),
        }
        yield row | _of_verdict(verdicts.get(key), said.get(key), row, one_clock) | _of_actions(actions, key)


def _of_verdict(verdict: Verdict | None, said: float | None, row: Row, one_clock: bool) -> Row:
    if verdict is None or said is None:
        return {}
    return {
        "clock_offset": verdict.clock_offset,
        "verdict": verdict.outcome,
        "log_odds": verdict.log_odds,
        "evidence": verdict.evidence,
        "rejected": verdict.reason,
        "first_time": verdict.first_time,
        "epoch_samples": verdict.n_samples or None,
        "verdict_after": said - row["stamp"] if one_clock else None,
        "verdict_latency": verdict.latency_ms,
    }


def _of_actions(actions: Mapping[Key, Action], key: Key) -> Row:
    """The action that this move is, and how the next one took the verdict on it."""
    chosen, following = actions.get(key), actions.get((key[0], key[1] + 1))
    row: Row = {"policy_took": following.verdict if following else None}
    if chosen is None:
        return row
    names = ("p_north", "p_south", "p_west", "p_east")
    return row | dict(zip(names, chosen.probabilities, strict=True)) | {"action_latency": chosen.latency_ms}


def _others(recording: Recording) -> Iterator[Row]:
    goals = {goal.episode: goal.goal for _, goal in recording.of(EpisodeGoal)}
    distances = {goal.episode: goal.distance for _, goal in recording.of(EpisodeGoal)}
    clocks = Clocks(recording)
    block = _Blocks(recording, clocks)
    for item in recording.messages:
        told = _told(item.message)
        if told is None:
            continue
        name, text = told
        offset = clocks.offset(sender(item.message), item.stamp)
        row = {
            "trial_type": name,
            "text": text,
            "stamp": item.stamp,
            "clock_offset": offset,
            "block": getattr(item.message, "block", block.at(item.stamp + offset)),
            **_where(item.message, goals),
        }
        if isinstance(item.message, EpisodeStart):
            row["distance"] = distances.get(item.message.episode)
        if isinstance(item.message, Electrodes):
            row |= {"bad_channels": _faults(item.message), "last_time": item.message.last_time}
        if isinstance(item.message, LateFrame):
            row["late"] = item.message.late_ms
        yield row


def _told(message: Message) -> tuple[str, str] | None:
    """Name and text of an event; None for what is no event of its own."""
    match message:
        case SessionStart():
            return "session/start", f"{message.task} on map {message.map}"
        case SessionEnd():
            return "session/end", f"{message.reason} {message.text}"
        case BlockStart() | BlockEnd():
            return f"block/{'start' if isinstance(message, BlockStart) else 'end'}", f"{message.n_moves} moves"
        case EpisodeStart():
            return "episode/start", f"at most {message.max_steps} moves"
        case EpisodeEnd():
            return "episode/end", f"{message.reason} after {message.steps} moves"
        case Pause():
            return "pause", message.reason
        case Resume():
            return "resume", ""
        case Continued():
            return "continued", ""
        case Electrodes():
            return "electrodes", f"from {message.n_samples} samples"
        case Screen():
            return "screen", message.name
        case LateFrame(step=None):
            return "late_frame", ""
        case Note():
            return "note", f"{message.level} from {message.role}: {message.text}"
    return None


def _where(message: Message, goals: Mapping[int, tuple[int, int]]) -> Row:
    episode, position = getattr(message, "episode", None), getattr(message, "position", (None, None))
    goal = goals.get(-1 if episode is None else episode, (None, None))
    return {
        "marker": marker_code(message),
        "episode": episode,
        "step": getattr(message, "step", None),
        "row": position[0],
        "column": position[1],
        "goal_row": goal[0],
        "goal_column": goal[1],
    }


def _of_gap(gap: Gap, recording: Recording) -> Iterator[Row]:
    """A gap twice: as MNE knows it, and as EEGLAB does."""
    stamp, before = float(recording.times[gap.row]), float(recording.times[gap.row - 1])
    what = f"{gap.n_lost} samples are missing" if gap.n_lost > 0 else f"time runs back by {-gap.n_lost} samples"
    common = {"clock_offset": 0.0, "text": what}
    duration = 1 / recording.eeg.sfreq
    yield {"trial_type": "BAD_gap", "sample": gap.row - 1, "duration": duration, "stamp": before, **common}
    yield {"trial_type": "boundary", "sample": gap.row, "stamp": stamp, "n_lost": gap.n_lost, **common}


def _bad(decided: Mapping[Key, Electrodes], key: Key) -> str:
    place = bisect_right(keys := sorted(decided), key)
    return _faults(decided[keys[place - 1]]) if place else ""


def _faults(decision: Electrodes) -> str:
    return "; ".join(f"{name}: {', '.join(faults)}" for name, faults in sorted(decision.bad.items()))


def _key(message: Any) -> Key:
    return message.episode, message.step


class _Blocks:
    """The block under way at a time of the EEG's clock."""

    def __init__(self, recording: Recording, clocks: Clocks) -> None:
        starts = recording.of(BlockStart)
        self._times = [stamp + clocks.offset("stimulus", stamp) for stamp, _ in starts]
        self._blocks = [start.block for _, start in starts]

    def at(self, time: float) -> int | None:
        """None before the first."""
        place = bisect_right(self._times, time)
        return self._blocks[place - 1] if place else None
