"""A recorded run through the same functions once more: every verdict and every action must come out the same.

What is decided about the electrodes, and verdicts, are recomputed from the recorded samples and onsets; actions from
the recorded moves and the recomputed verdicts, so a difference anywhere in the chain shows.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from time import perf_counter
from typing import Any

from bci_app.config import Config, validated
from bci_app.errors import SetupError
from bci_app.gridworld import GridWorld, compile_map
from bci_app.moves import cut_moves, electrodes, judges
from bci_app.progress import Progress
from bci_app.protocol import Action, Electrodes, EpisodeEnd, EpisodeStart, MoveOnset, SessionStart, Verdict
from bci_app.recording import Recording, read_run
from bci_app.runs import checksum, sidecar_of
from bci_app.told import Told

Key = tuple[int, int]


@dataclass(frozen=True)
class Compared:
    """Two messages that should be equal, and whether they are to the bit. One alone, at a broken end, needn't be."""

    key: Key
    recorded: Verdict | Action | Electrodes | None
    replayed: Verdict | Action | Electrodes | None
    must_be_equal: bool = True

    @property
    def equal(self) -> bool:
        """Whether all fields but the latency agree, floats to the bit."""
        if self.recorded is None or self.replayed is None:
            return False
        return _timeless(self.recorded) == _timeless(self.replayed)

    @property
    def taken_over(self) -> bool:
        """Whether nothing was made anew: the file doesn't hold what it depended on, such as when a sample came."""
        return self.recorded is self.replayed


def replay(
    path: Path, model: Path | None, policy: Path | None, allow_damage: bool, progress: Progress
) -> dict[str, Any]:
    """Replay a recording and compare.

    Returns ``replay``, of ``electrodes``, ``verdicts`` and ``actions`` how many there are, how many are equal
    (``..._equal``) and how many of these were taken over (``..._taken_over``), ``seconds``, ``notes``, how much of a
    damaged run wasn't replayed, and ``differences``, the first few in words.

    Raises SetupError for an unusable recording, or a model or policy that isn't the run's.
    """
    started = perf_counter()
    progress("reading the recording", 0, 3)
    recording, opening, sidecar = read_run(path, allow_damage)
    progress("replaying verdicts", 1, 3)
    config = validated(sidecar.get("config", {}), f"the sidecar of {recording.path}")
    decisions = list(_electrodes(recording))
    all_verdicts = list(_verdicts(recording, sidecar, config, model, decisions))
    verdicts = [pair for pair in all_verdicts if pair.must_be_equal]
    progress("replaying actions", 2, 3)
    is_online = opening.task == "online"
    told = sidecar.get("told") or _told_by(_file_of_run(path, sidecar, "model", model))
    actions = list(_actions(recording, sidecar, policy, told, opening, all_verdicts)) if is_online else []
    progress("done", 3, 3)
    differences = [_sentence(pair) for pair in chain(decisions, verdicts, actions) if not pair.equal]
    notes = _left_out(sidecar, len(verdicts), len(actions)) if recording.damage else []
    return {
        "replay": _counts("electrodes", decisions) | _counts("verdicts", verdicts) | _counts("actions", actions),
        "seconds": perf_counter() - started,
        "notes": notes,
        "differences": differences[:10],
    }


def _counts(what: str, pairs: list[Compared]) -> dict[str, int]:
    return {
        what: len(pairs),
        f"{what}_equal": sum(pair.equal for pair in pairs),
        f"{what}_taken_over": sum(pair.taken_over for pair in pairs),
    }


def _left_out(sidecar: dict[str, Any], n_verdicts: int, n_actions: int) -> list[str]:
    """How much of a damaged run was not replayed: what is equal is only what is left of it."""
    verdicts, actions = sidecar.get("verdicts"), sidecar.get("actions")
    if not isinstance(verdicts, dict) or not isinstance(actions, int):
        return [
            f"The recording is damaged: {n_verdicts} verdicts and {n_actions} actions were replayed. How many there "
            "were isn't known: no sidecar of a run that was closed tells."
        ]
    all_verdicts = sum(n for n in verdicts.values() if isinstance(n, int))
    return [
        f"The recording is damaged: {n_verdicts} of its {all_verdicts} verdicts and {n_actions} of its {actions} "
        "actions were replayed. The others are lost, or what they depended on is."
    ]


def is_equal(result: dict[str, Any]) -> bool:
    """Whether a replay's result says that everything agrees."""
    counts = result["replay"]
    return all(counts[what] == counts[f"{what}_equal"] for what in ("electrodes", "verdicts", "actions"))


def _electrodes(recording: Recording) -> Iterator[Compared]:
    from decoder.electrodes import Examiner

    recorded = electrodes(recording)
    if not recorded:
        return
    eeg = recording.eeg
    examiner = Examiner(next(iter(recorded.values())).session, eeg.picked, eeg.sfreq)
    microvolts = eeg.in_microvolts(recording.samples)
    for key, decision in recorded.items():
        yield Compared(key, decision, examiner.again(decision, microvolts, recording.times))


def _verdicts(
    recording: Recording, sidecar: dict[str, Any], config: Config, model: Path | None, decisions: list[Compared]
) -> Iterator[Compared]:
    from decoder.judge import judge_with, judge_without
    from decoder.model import load

    path = _file_of_run(recording.path, sidecar, "model", model)
    recorded = recording.verdicts
    session = next(iter(recorded.values())).session if recorded else ""
    unfinished = _unfinished(recording, max(recorded, default=(0, 0)))
    eeg = recording.eeg
    judge = judge_with(load(path), config, eeg, session) if path else judge_without(config, eeg, session)
    bad = {pair.key: pair.replayed for pair in decisions if isinstance(pair.replayed, Electrodes)}
    judge_of = judges(judge, bad)
    for move, result in cut_moves(recording, judge.shape):
        key = move.key
        before = recorded.get(key)
        if before is not None and before.by_time:
            # When the samples came isn't in the file; the decoder said that this was the reason, so it is taken over.
            yield Compared(key, before, before)
            continue
        if recording.is_cut and move.onset + judge.shape.n_after / judge.shape.sfreq > recording.times[-1]:
            yield Compared(key, before, before, must_be_equal=False)  # its last samples were never written
            continue
        verdict = judge_of(key).verdict(key, result, move.clock_offset)
        yield Compared(key, before, verdict, must_be_equal=before is not None or not unfinished(key))


def _actions(
    recording: Recording,
    sidecar: dict[str, Any],
    policy: Path | None,
    told: str | None,
    opening: SessionStart,
    verdicts: list[Compared],
) -> Iterator[Compared]:
    from policy import cards, checkpoint
    from policy.agent import Agent
    from policy.ear import Ear
    from policy.navigator import Navigator, is_without
    from policy.verdicts import Verdicts

    path = _file_of_run(recording.path, sidecar, "policy", policy)
    if path is None:
        where = sidecar_of(recording.path)
        why = (
            f"The sidecar {where} names no policy" if sidecar else f"There is no sidecar {where} that names the policy"
        )
        raise SetupError(
            f"{why}. Put the run's own there, or say by --policy which policy it was, and by --model which decoder."
        )
    network, card = checkpoint.load(path)
    world: GridWorld = compile_map("\n".join(opening.layout), opening.map)
    cards.check_fits(card, world)
    ear = Ear(Verdicts.parse(card.verdicts), Told.parse(told) if told else None)
    navigator = Navigator(Agent(network, ear, world), world, opening.session)
    recorded = {(action.episode, action.step): action for _, action in recording.of(Action)}
    unfinished = _unfinished(recording, max(recorded, default=(0, 0)))
    replayed = {pair.key: pair.replayed for pair in verdicts}
    action: Action | None
    for item in recording.messages:
        match item.message:
            case EpisodeStart() as start:
                action = navigator.begin(start)
            case MoveOnset() as onset:
                key, following = (onset.episode, onset.step), (onset.episode, onset.step + 1)
                verdict = replayed.get(key)
                judged = verdict if isinstance(verdict, Verdict) else None
                went_on = is_without(recorded.get(following))
                action = navigator.again(onset, judged, went_on)
                if following not in recorded and unfinished(key):
                    continue
                if recording.is_cut and judged is None and not went_on:
                    continue  # the verdict it was chosen by was never written
            case _:
                continue
        expected = (item.message.episode, 1 if isinstance(item.message, EpisodeStart) else item.message.step + 1)
        if expected not in recorded and unfinished(expected):
            continue
        if action is not None or expected in recorded:
            yield Compared(expected, recorded.get(expected), action)


def _told_by(model: Path | None) -> str | None:
    """What a policy is told of a decoder, where no sidecar says what it was told."""
    from decoder.model import load

    return str(load(model).info.evidence.told) if model else None


def _unfinished(recording: Recording, newest: Key) -> Callable[[Key], bool]:
    """Of which moves the answer may never have been made, or recorded: the last of an episode that was broken off and,
    where the recording has no end, all after the ``newest`` that has one."""
    aborted = {end.episode for _, end in recording.of(EpisodeEnd) if end.reason == "aborted"}
    last: dict[int, int] = {}
    for _, move in recording.of(MoveOnset):
        last[move.episode] = max(move.step, last.get(move.episode, 0))
    is_cut = recording.is_cut

    def unfinished(key: Key) -> bool:
        return (key[0] in aborted and last.get(key[0]) == key[1]) or (is_cut and key > newest)

    return unfinished


def _file_of_run(recording: Path, sidecar: dict[str, Any], what: str, given: Path | None) -> Path | None:
    """The model or policy a run used: as given, or as the sidecar names it, there or beside the recording."""
    named = sidecar.get(what)
    if not named:
        return given
    if not isinstance(named, dict) or not {"path", "sha256"} <= named.keys():
        raise SetupError(
            f"The sidecar of {recording} should give the {what}'s path and sha256, found {named!r:.60}. Restore it."
        )
    candidates = [given] if given else [Path(named["path"]), recording.with_name(Path(named["path"]).name)]
    for path in candidates:
        if path.exists() and checksum(path) == named["sha256"]:
            return path
    raise SetupError(
        f"{recording} was made with the {what} {named['path']} (SHA-256 {named['sha256'][:12]}...); found neither it "
        f"nor a copy in {', '.join(str(path) for path in candidates)}. Restore the file or name it with --{what}."
    )


def _timeless(message: Verdict | Action | Electrodes) -> dict[str, Any]:
    # Exact comparison: equal floats here are equal bits, for neither zero's sign nor NaN can occur.
    return message.model_dump(exclude={"latency_ms", "protocol"})


def _sentence(pair: Compared) -> str:
    what = type(pair.recorded or pair.replayed).__name__.lower()
    return f"{what} of episode {pair.key[0]}, step {pair.key[1]}: recorded {pair.recorded}, replayed {pair.replayed}"
