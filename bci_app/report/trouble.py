"""What went wrong in a run, and how good its signals were: as rows."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from bci_app.moves import electrodes
from bci_app.one_clock import on_one_clock, sender
from bci_app.protocol import (
    Continued,
    LateFrame,
    Link,
    Note,
    Pause,
    Resume,
    Returned,
    Role,
    SessionEnd,
    Status,
    Truth,
)
from bci_app.recording import Recording
from bci_app.report import Row, count
from decoder.timeline import piece_edges

Event = tuple[float | None, str, str, str, str]
"""Stamp (s), kind, level, role, text."""


def event_rows(
    recording: Recording, sidecar: Mapping[str, Any], went_on: tuple[str, str] | None = None, **where: object
) -> list[Row]:
    """All that a reader must know, in order: notes, pauses, restarts, links that were lost, late frames, gaps, damage,
    and how the run ended. ``time_s`` counts from the first message, on the recorder's clock; None for what belongs to
    no moment, or to one of a clock that isn't known.

    Parameters
    ----------
    went_on : names of this recording and of the one that goes on from it, if one does: then its early end is a note.
    """
    placed, unknown = on_one_clock(recording)
    first = next((item.stamp for item in placed.messages if sender(item.message) not in unknown), 0.0)
    events = (*_said(placed), *_ended(placed, went_on))
    said = sorted(((None if event[3] in unknown else event[0], *event[1:]) for event in events), key=_moment)
    rows = []
    for stamp, kind, level, role, text in (*_of_file(recording, sidecar), *_of_clocks(unknown), *said):
        time = None if stamp is None else stamp - first
        rows.append({**where, "time_s": time, "kind": kind, "level": level, "role": role, "text": text})
    return rows


def _moment(event: Event) -> float:
    return -np.inf if event[0] is None else event[0]


def _of_file(recording: Recording, sidecar: Mapping[str, Any]) -> Iterator[Event]:
    for sentence in recording.damage:
        yield None, "damage", "error", "", sentence
    for sentence in sidecar.get("missing") or []:
        yield None, "damage", "error", "", str(sentence)
    if not sidecar:
        yield None, "file", "warning", "", "There is no sidecar: settings, decoder, policy and speed aren't known."
    elif sidecar.get("state") not in ("closed", None):
        yield None, "file", "error", "session", f"The run was never closed: its sidecar says {sidecar['state']}."
    if not recording.of(Truth):
        yield None, "file", "warning", "", "There is no truth: verdicts can't be compared with anything."
    edges = piece_edges(recording.times)
    gaps = np.diff(recording.times)[edges[1:-1] - 1]
    if len(gaps):
        yield (
            None,
            "gap",
            "warning",
            "",
            f"The EEG has {count(len(gaps), 'gap')} of a second or more, {gaps[gaps > 0].sum():.1f} s together.",
        )


def _of_clocks(unknown: frozenset[Role]) -> Iterator[Event]:
    for role in sorted(unknown):
        text = (
            f"The {role} ran on another machine, and how far apart the clocks were isn't recorded: the times of what "
        )
        yield None, "file", "warning", "", f"{text}it said, and latencies from and to it, are left out."


def _said(recording: Recording) -> Iterator[Event]:
    for stamp, note in recording.of(Note):
        yield stamp, "note", note.level, note.role, note.text
    yield from _pauses(recording)
    yield from _restarts(recording)
    for stamp, failed in recording.of(Status):
        if failed.state == "failed":
            yield stamp, "failed", "error", failed.role, failed.text
            break
    yield from _links(recording)
    late = [frame for _, frame in recording.of(LateFrame)]
    if late:
        jumps = sum(frame.step is not None for frame in late)
        worst = max(frame.late_ms for frame in late)
        text = f"{count(len(late), 'frame')} came late, {jumps} of them with a jump; the worst by {worst:.1f} ms."
        yield None, "late frame", "warning", "stimulus", text


def _ended(recording: Recording, went_on: tuple[str, str] | None) -> Iterator[Event]:
    """That the run didn't end as it should; a note where another recording went on from it."""
    found = recording.of(SessionEnd)
    stamp, end = found[-1] if found else (None, None)
    if end is not None and end.reason == "complete":
        return
    if went_on is not None:
        how = f"was {end.reason}: {end.text}" if end else "was broken off, or its recorder was."
        role = "stimulus" if end else ""
        yield stamp, "end", "info", role, f"{went_on[0][0].upper()}{went_on[0][1:]} {how} It went on in {went_on[1]}."
    elif end is None:
        yield None, "end", "error", "", "The recording has no end: the run was broken off, or its recorder was."
    else:
        yield stamp, "end", "error", "stimulus", f"The run was {end.reason}: {end.text}"


def _pauses(recording: Recording) -> Iterator[Event]:
    begun: tuple[float, Pause] | None = None
    for item in recording.messages:
        match item.message:
            case Pause() if begun is None:
                begun = item.stamp, item.message
            case Resume() if begun is not None:
                yield _pause(*begun, item.stamp)
                begun = None
    if begun is not None:
        yield _pause(*begun, None)


def _pause(stamp: float, pause: Pause, until: float | None) -> Event:
    length = "until the end" if until is None else f"for {until - stamp:.1f} s"
    return stamp, "pause", "info" if pause.by_person else "warning", "stimulus", f"Paused {length}: {pause.reason}"


def _restarts(recording: Recording) -> Iterator[Event]:
    """Who was started again says so until it is answered: the first of a few seconds counts."""
    newest: dict[str, float] = {}
    for stamp, back in recording.of(Returned):
        if stamp - newest.get(back.role, -np.inf) > 60:
            yield stamp, "restart", "warning", back.role, f"The {back.role} was started again."
        newest[back.role] = stamp
    for stamp, went_on in recording.of(Continued):
        after = "an episode's end" if went_on.step is None else f"step {went_on.step}"
        text = f"The stimulus went on after {after} of episode {went_on.episode}."
        yield stamp, "restart", "warning", "stimulus", text


def _links(recording: Recording) -> Iterator[Event]:
    """What a process tells of a stream counts from its own beginning: one that was started again counts anew."""
    told: dict[tuple[str, str], list[tuple[float, Link]]] = {}
    for stamp, link in recording.of(Link):
        told.setdefault((link.role, link.stream), []).append((stamp, link))
    for (role, stream), links in told.items():
        gaps = _counted([link.gaps for _, link in links])
        away = _counted([link.reconnects for _, link in links])
        if gaps or away:
            text = f"Stream {stream}: gaps in its samples {gaps}, times it was away {away}."
            yield links[-1][0], "link", "warning", role, text


def _counted(counts: Sequence[int]) -> int:
    """All that was counted by a counter that may begin anew."""
    return sum(before for before, after in pairwise(counts) if after < before) + counts[-1]


def electrode_rows(recording: Recording, moves: Sequence[Row], **where: object) -> list[Row]:
    """Each channel that was found bad: its faults, and the share of moves judged while it was."""
    decisions = electrodes(recording)
    keys = sorted(decisions)
    faults: dict[str, Counter[str]] = {}
    n_bad: Counter[str] = Counter()
    for key in keys:
        for name, found in decisions[key].bad.items():
            faults.setdefault(name, Counter()).update(found)
    places = np.searchsorted(np.array([k[0] * 1e6 + k[1] for k in keys]), [_order(m) for m in moves], side="right")
    for place in places[places > 0]:
        n_bad.update(decisions[keys[place - 1]].bad.keys())
    return [
        {
            **where,
            "channel": name,
            "faults": ", ".join(each for each, _ in found.most_common()),
            "share_of_moves": n_bad[name] / len(moves) if moves else 0.0,
        }
        for name, found in sorted(faults.items())
    ]


def _order(move: Row) -> float:
    return float(move["episode"] * 1e6 + move["step"])


def rejected_rows(moves: Sequence[Row], **where: object) -> list[Row]:
    """How many moves were judged, weren't, and why not."""
    total, outcomes = len(moves), Counter(_outcome(move) for move in moves)
    return [
        {**where, "outcome": outcome, "reason": reason, "n": n, "of": total}
        for (outcome, reason), n in sorted(outcomes.items(), key=lambda item: -item[1])
    ]


def _outcome(move: Row) -> tuple[str, str]:
    verdict = move["verdict"] or "none"
    if verdict == "rejected":
        return verdict, move["reason"] or "not said"
    return {"unjudged": "valid", "error": "judged", "correct": "judged"}.get(verdict, "no verdict"), ""
