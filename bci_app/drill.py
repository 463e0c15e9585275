"""Faults against live simulated sessions: what dies, hangs or drops out, what was survived, and how long it took.

A session survives a fault when it is complete, everything that was heard is in its recording, and every action is the
one the replay finds, which knows nothing of the fault. One without its recorder survives when it ends by itself, at a
rest, and what was recorded until then is readable.
"""

import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from random import Random
from typing import Any

from rich.console import Console
from rich.table import Table

from bci_app import fitting, verbs
from bci_app import replay as replaying
from bci_app.config import Config, SimulationConfig, changed
from bci_app.errors import LinkLost, SetupError
from bci_app.gridworld import ACTIONS, compile_map
from bci_app.lsl import local_clock
from bci_app.moves import cut_moves
from bci_app.plan import Stage
from bci_app.progress import Progress, named
from bci_app.protocol import Action, EpisodeStart, MoveOnset, Role, SessionStart
from bci_app.recorder import Recorder
from bci_app.recording import Recording, read

PARTICIPANT = "DRILL"
SHORT: dict[str, Any] = {
    "calibration": {"n_blocks": 2, "moves_per_block": 20, "break_s": 1.0},
    "online": {"distances": [2, 8]},
    "simulation": {"dead": ["C3"]},
}
"""A session of a drill: some 40 moves, with an electrode that must be repaired."""
DROP_OUT_S = (0.1, 30.0)
"""Shortest and longest real seconds for which an amplifier drops out, even in their logarithm."""
TRIES = 5
"""Sessions until one is given up in which the fault doesn't strike."""
EARLY, EARLY_S = 0.1, 8.0
"""Share of deaths before the first move, and real seconds of them: processes take five to be ready (decided)."""
JUMP_S = (60.0, 200_000.0)
"""Smallest and largest session seconds by which a clock jumps, even in their logarithm."""
RECORDED_S = 1.0
"""Real seconds before the end of its recorder of which a session may miss what was said."""


@dataclass(frozen=True)
class Fault:
    """Something that goes wrong at a random moment.

    Attributes
    ----------
    act : what is done then; None where the simulated amplifier does it by itself.
    settings : of that amplifier, from a generator of chance and the moment.
    ends_run : whether the run can't go on.
    may_be_early : whether it may strike before the first move.
    """

    act: Callable[[Stage], None] | None = None
    settings: Callable[[Random, float], dict[str, Any]] = lambda _rng, _at: {}
    ends_run: bool = False
    may_be_early: bool = False


def _kill(role: Role) -> Fault:
    return Fault(lambda stage: stage.crew.kill(role), may_be_early=True)


def _hang(role: Role) -> Fault:
    return Fault(lambda stage: stage.crew.stop(role))


def _recorder(stage: Stage) -> Recorder:
    assert stage.recorder is not None, "strikes only once the run has begun"
    return stage.recorder


def _gone(rng: Random) -> float:
    low, high = DROP_OUT_S
    return float(low * (high / low) ** rng.random())


def _jump(rng: Random) -> float:
    low, high = JUMP_S
    return float(rng.choice((-1, 1)) * low * (high / low) ** rng.random())


FAULTS: dict[str, Fault] = {
    "stimulus killed": _kill("stimulus"),
    "decoder killed": _kill("decoder"),
    "policy killed": _kill("policy"),
    "amplifier killed": _kill("amplifier"),
    "stimulus hangs": _hang("stimulus"),
    "decoder hangs": _hang("decoder"),
    "policy hangs": _hang("policy"),
    "amplifier drops out": Fault(settings=lambda rng, at: {"drop_outs": [[at, _gone(rng)]]}),
    "amplifier disconnects": Fault(settings=lambda rng, at: {"disconnects": [[at, _gone(rng)]]}),
    "amplifier's clock jumps": Fault(settings=lambda rng, at: {"clock_jumps": [[at, _gone(rng), _jump(rng)]]}),
    "1 % of packets lost": Fault(settings=lambda _rng, _at: {"packet_loss": 0.01}),
    "5 % of packets lost": Fault(settings=lambda _rng, _at: {"packet_loss": 0.05}),
    "recorder killed": Fault(lambda stage: _recorder(stage).kill(), ends_run=True),
    "recorder hangs": Fault(lambda stage: _recorder(stage).hang(), ends_run=True),
}


@dataclass
class _Saboteur:
    """Acts once, at a moment of a run; remembers what it needs to judge what came of it."""

    fault: Fault
    at: float
    """Real seconds after the run's first message; below 0 after the processes were started."""
    lasts: float = 0.0
    """Real seconds until what was lost is there again by itself."""
    is_clock_off: bool = False
    began: float | None = None
    acted: float | None = None
    stage: Stage | None = None
    """The run; None until it is recorded."""
    _arrived: float | None = None
    _known: list[tuple[float, int]] = field(default_factory=list)  # how many moves were heard of, by real time

    def __call__(self, stage: Stage) -> None:
        now = local_clock()
        self.stage = stage if stage.recorder is not None else None
        self._arrived = self._arrived or now
        if self.at < 0 and self.acted is None and now - self._arrived >= -self.at:
            self._act(stage, now)
        if stage.heard.start is None or stage.heard.end is not None:
            return
        self.began = self.began or now
        self._known.append((now, stage.heard.moves))
        if self.acted is None and now - self.began >= self.at:
            self._act(stage, now)

    def _act(self, stage: Stage, now: float) -> None:
        self.acted = now
        if self.fault.act is not None:
            self.fault.act(stage)

    def n_moves_before(self) -> int:
        """Moves heard of so long before the fault that they must have been recorded."""
        by = self.acted - RECORDED_S if self.acted is not None else float("inf")
        return max((n_moves for when, n_moves in self._known if when <= by), default=0)


@dataclass(frozen=True)
class Outcome:
    """What came of one session.

    Attributes
    ----------
    struck : whether the fault happened at all.
    moves_lost : moves that were heard of and aren't in the recording.
    wrong_actions : actions, and verdicts, that the replay finds otherwise; moves that aren't what was chosen, don't
        follow from the one before, or are missing in a block.
    epochs_lost : whole epochs in the recording that got no verdict.
    recovery_s : real seconds from the fault, or from when what was lost is there again by itself, until the stimulus
        went on; None where it never had to wait.
    text : what went wrong, where something did.
    """

    survived: bool
    struck: bool
    moves_lost: int
    wrong_actions: int
    epochs_lost: int
    recovery_s: float | None
    text: str


def run(
    config: Config,
    names: Sequence[str],
    n_sessions: int,
    speed: float,
    seed: int,
    progress: Progress,
    report: Callable[[dict[str, Any]], None],
) -> list[dict[str, Any]]:
    """Drill each fault in `n_sessions` sessions; a row each, which ``report`` is told as soon as it is known.

    Recordings of sessions that survived are not kept.
    """
    unknown = sorted(set(names) - set(FAULTS))
    if unknown:
        raise SetupError(f"--fault must be one of {', '.join(FAULTS)}; found {', '.join(unknown)}.")
    folder = Path(tempfile.mkdtemp(prefix="bci-app-drill-"))
    short = changed(config, {"recordings": str(folder), "stimulus": {"headless": True}, **SHORT})
    wishes = verbs.Wishes(short, PARTICIPANT, simulate=True, speed=speed, seed=seed)
    model = _decoder(replace(wishes, speed=max(speed, 20.0)), progress)
    rng, rows = Random(seed), []
    for number, name in enumerate(names or FAULTS):
        told = named(progress, f"{number + 1}/{len(names or FAULTS)} {name}")
        outcomes = [_struck(wishes, model, name, rng, told) for _ in range(n_sessions)]
        rows.append(_row(name, outcomes))
        report(rows[-1])
    if all(is_good(row) for row in rows):
        shutil.rmtree(folder)
    else:
        report({"recordings of what wasn't survived": str(folder)})
    return rows


def is_good(row: dict[str, Any]) -> bool:
    """Whether nothing was lost."""
    lost = row["moves_lost"] + row["wrong_actions"]
    # A decoder that dies takes the samples of the move under way with it; an amplifier that is back mustn't cost one.
    lost += row["epochs_lost"] if FAULTS[row["fault"]].act is None else 0
    return bool(row["survived"] == row["sessions"]) and not lost


def _decoder(wishes: verbs.Wishes, progress: Progress) -> Path:
    longer = replace(wishes, config=changed(wishes.config, {"calibration": {"n_blocks": 2, "moves_per_block": 60}}))
    told = verbs.calibrate(longer, named(progress, "calibrating"))
    return Path(fitting.fit([Path(told["recording"])], wishes.config, False, progress)["model"])


def _struck(wishes: verbs.Wishes, model: Path, name: str, rng: Random, progress: Progress) -> Outcome:
    """A session in which the fault struck: one may be over before its moment comes."""
    for _ in range(TRIES):
        outcome = _session(wishes, model, name, rng, progress)
        if outcome.struck or not outcome.survived:
            break
    return outcome


def _session(wishes: verbs.Wishes, model: Path, name: str, rng: Random, progress: Progress) -> Outcome:
    fault = FAULTS[name]
    at = rng.uniform(0.5, 100 / wishes.speed)
    if fault.may_be_early and rng.random() < EARLY:
        at = -rng.uniform(0, EARLY_S)
    settings = changed(wishes.config, {"simulation": fault.settings(rng, at)})
    saboteur = _Saboteur(fault, at, _length(settings.simulation), bool(settings.simulation.clock_jumps))
    wish = replace(wishes, config=settings, seed=rng.randrange(2**31), disturb=saboteur)
    is_calibration = "policy" not in name and rng.random() < 0.5
    ended = ""
    try:
        if is_calibration:
            verbs.calibrate(wish, progress)
        else:
            verbs.online(wish, "open", model, "told", True, progress)
    except LinkLost as error:
        ended = str(error)
    return _judged(saboteur, ended)


def _length(simulation: SimulationConfig) -> float:
    """Real seconds for which the amplifier is away, or its clock off."""
    times = (*simulation.drop_outs, *simulation.disconnects, *simulation.clock_jumps)
    return times[0][1] if times else 0.0


def _judged(saboteur: _Saboteur, ended: str) -> Outcome:
    if saboteur.stage is None:
        return Outcome(False, False, 0, 0, 0, None, f"The session never began: {ended}")
    fault, heard, path = saboteur.fault, saboteur.stage.heard, _recorder(saboteur.stage).path
    recording = read(path, allow_damage=True)
    complete = heard.end is not None and heard.end.reason == "complete" and not ended
    replayed = replaying.replay(path, None, None, True, lambda *_: None)
    counts = replayed["replay"]
    wrong = sum(counts[what] - counts[f"{what}_equal"] for what in ("electrodes", "verdicts", "actions"))
    wrong += _contradictions(recording, complete)
    expected = saboteur.n_moves_before() if ended else heard.moves
    lost = max(0, expected - len(recording.of(MoveOnset)))
    survived = bool(ended) if fault.ends_run and saboteur.acted else complete
    went_on, acted = saboteur.stage.supervisor.went_on_at, saboteur.acted
    over = acted + saboteur.lasts if acted is not None and saboteur.at >= 0 else None
    recovery = went_on - over if over is not None and went_on > over else None
    text = "; ".join([*replayed["differences"][:1], *([ended] if ended and not fault.ends_run else [])])
    if survived and not lost and not wrong:
        for file in path.parent.glob(f"{path.stem.removesuffix('_eeg')}_*"):
            shutil.rmtree(file) if file.is_dir() else file.unlink()
    # Stamps that left the clock find samples of another time, as whole as any.
    unjudged = 0 if saboteur.is_clock_off else _whole_but_unjudged(recording)
    return Outcome(survived, saboteur.acted is not None, lost, wrong, unjudged, recovery, text)


def _contradictions(recording: Recording, complete: bool) -> int:
    """Moves that aren't what was chosen or don't follow from the one before, and moves a calibration lacks."""
    (_, opening) = recording.of(SessionStart)[0]
    world = compile_map("\n".join(opening.layout), opening.map)
    chosen = {(action.episode, action.step): action.action for _, action in recording.of(Action)}
    where = {(start.episode, 0): start.position for _, start in recording.of(EpisodeStart)}
    found = 0
    for _, move in recording.of(MoveOnset):
        key, before = (move.episode, move.step), where.get((move.episode, move.step - 1))
        where[key] = move.position
        if before is None:
            found += 1
            continue
        cell = int(world.next_cell[world.cell_at(*before), ACTIONS.index(move.action)])
        found += chosen.get(key, move.action) != move.action or cell != world.cell_at(*move.position)
    if complete and opening.n_moves is not None:
        valid = sum(verdict.outcome != "rejected" for verdict in recording.verdicts.values())
        found += valid != opening.n_moves
    return found


def _whole_but_unjudged(recording: Recording) -> int:
    """Moves said to have come too late, or too early, whose epochs are whole in the recording."""
    from decoder.chain import design
    from decoder.epochs import Epoch, Shape

    late = {key for key, verdict in recording.verdicts.items() if verdict.by_time}
    if not late:
        return 0
    chain = design(Config().chain, recording.eeg.sfreq)
    shape = Shape(recording.eeg.sfreq, chain.n_before, chain.n_after)
    return sum(move.key in late and isinstance(found, Epoch) for move, found in cut_moves(recording, shape))


def _row(name: str, outcomes: list[Outcome]) -> dict[str, Any]:
    times = sorted(outcome.recovery_s for outcome in outcomes if outcome.recovery_s is not None)

    def quantile(share: float) -> float | None:
        return round(times[min(len(times) - 1, int(share * len(times)))], 2) if times else None

    return {
        "fault": name,
        "sessions": len(outcomes),
        "survived": sum(outcome.survived for outcome in outcomes),
        "moves_lost": sum(outcome.moves_lost for outcome in outcomes),
        "wrong_actions": sum(outcome.wrong_actions for outcome in outcomes),
        "epochs_lost": sum(outcome.epochs_lost for outcome in outcomes),
        "recovery_p50_s": quantile(0.5),
        "recovery_p99_s": quantile(0.99),
        "texts": [outcome.text for outcome in outcomes if outcome.text],
    }


def show(rows: list[dict[str, Any]], console: Console) -> None:
    """The rows as a table."""
    columns = ("fault", "sessions", "survived", "moves_lost", "wrong_actions", "recovery_p50_s", "recovery_p99_s")
    table = Table(*(name.replace("_", " ") for name in columns), title="What was survived")
    for row in rows:
        table.add_row(*("-" if row[name] is None else str(row[name]) for name in columns))
    console.print(table)
    for row in rows:
        for text in row["texts"]:
            console.print(f"{row['fault']}: {text}", style="red", markup=False, soft_wrap=True)
