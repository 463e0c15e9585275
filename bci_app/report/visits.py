"""From the recordings of one participant's session to tables: each is read once, looked at, and let go."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from bci_app import fitting, metrics
from bci_app.config import Config, validated
from bci_app.errors import SetupError
from bci_app.joining import joined
from bci_app.moves import Key, electrodes, judges
from bci_app.protocol import SessionEnd, SessionStart
from bci_app.recording import NoRun, Recording, never_began, read
from bci_app.report import Row, Tables, areas, calibrations, clusters, erp, in_a_row, ledger, steps, trouble
from bci_app.report.sources import Source, Visit, missing
from bci_app.report.waveforms import Waveforms, together, waveforms
from bci_app.runs import check_untouched, checksum, eeg_type
from decoder.judge import Judge, judge_with, judge_without
from decoder.model import SUFFIX, DecoderModel, load

JudgeOf = Callable[[Key], Judge]


@dataclass
class Seen:
    """What came of a visit.

    Attributes
    ----------
    tables : rows by table.
    figures : the figures that `fit`, `online` and `demo` print, by the same functions: ``calibration`` as `fit` has it,
        ``online`` by map, ``latency``.
    left_out : why recordings aren't looked at. Without any that are, there are no tables.
    """

    tables: Tables = field(default_factory=dict)
    figures: dict[str, Any] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)

    def add(self, **tables: Sequence[Row]) -> None:
        """Put rows into tables."""
        for name, rows in tables.items():
            self.tables.setdefault(name, []).extend(rows)


def see(visit: Visit, allow_damage: bool, progress: Callable[[str], None], named: Collection[Path]) -> Seen:
    """Look at all runs of a visit.

    Raises SetupError for a recording that is damaged (unless `allow_damage`) or that isn't the file that was recorded,
    and for one that isn't ours or whose run never began if it is among those `named`; others are left out. What a run
    doesn't allow, for there is no decoder, no truth or only one kind of move, is said in `events`.
    """
    look = _Look(visit)
    for run in visit.runs:
        progress(f"reading {run[-1].path.name}")
        usable = _usable(run, allow_damage, named, look.seen.left_out)
        if usable:
            look.at([source for source, _ in usable], [recording for _, recording in usable])
    if not look.seen.tables:
        return look.seen
    progress(f"comparing waveforms of {visit.participant}")
    look.waves_together()
    look.figures_together()
    return look.seen


def see_recordings(visit: Visit, recordings: Sequence[Sequence[Recording]]) -> Seen:
    """As `see`, of recordings that are read already: those of each run of the visit."""
    look = _Look(visit)
    for run, mine in zip(visit.runs, recordings, strict=True):
        look.at(run, mine)
    look.waves_together()
    look.figures_together()
    return look.seen


def _usable(
    run: Sequence[Source], allow_damage: bool, named: Collection[Path], left_out: list[str]
) -> list[tuple[Source, Recording]]:
    """The recordings of a run that hold some of it. Why others don't is left in `left_out`, or raised if they were
    named."""
    found: list[tuple[Source, Recording]] = []
    for source in run:
        try:
            recording = _read(source, allow_damage or source is not run[-1])
            if not recording.of(SessionStart):
                raise never_began(source.path)
            found.append((source, recording))
        except NoRun as error:
            if source.path in named:
                raise
            left_out.append(str(error))
    return found


def _read(source: Source, allow_damage: bool) -> Recording:
    recording = read(source.path, allow_damage, eeg_type(source.sidecar))
    if not allow_damage:
        check_untouched(source.path, source.sidecar)
    return recording


class _Look:
    """One visit, as far as it has been looked at."""

    def __init__(self, visit: Visit) -> None:
        self.seen = Seen()
        self._who: Row = {"participant": visit.participant, "visit": visit.visit}
        self._waves: dict[str, list[Waveforms]] = {}
        self._light: dict[str, list[Recording]] = {}
        self._speeds: set[float] = set()

    def at(self, run: Sequence[Source], recordings: Sequence[Recording]) -> None:
        """One run: its recording, or those that go on from each other."""
        last, sidecar = recordings[-1], run[-1].sidecar
        opening = last.of(SessionStart)
        if not opening:
            raise never_began(last.path)
        task, map_name = opening[0][1].task, opening[0][1].map
        where: Row = {**self._who, "run": _name(last.path), "map": map_name}
        self._complain(where, [f"{name} comes before it and wasn't given." for name in missing(run)])
        recording = self._joined(recordings, where)
        speed = float(sidecar.get("speed") or 1.0)
        moves = [{**where, "task": task, **row} for row in steps.move_rows(recording)]
        episodes = [{**where, "task": task, **row} for row in steps.episode_rows(recording)]
        if task == "online":
            self._light.setdefault(map_name, []).extend(map(_light, recordings))
            self._speeds.add(speed)
            self._judged(moves, where)
        self.seen.add(
            runs=[_run_row(where, task, run, recordings, len(moves), speed)],
            moves=moves,
            episodes=episodes,
            latency=ledger.ledger_rows([ledger.samples(each, speed) for each in recordings], **where),
            events=_event_rows(run, recordings, where),
            electrodes=trouble.electrode_rows(recording, moves, **where),
            rejected=trouble.rejected_rows(moves, **where),
            maps=[{"map": map_name, "row": row, "cells": line} for row, line in enumerate(opening[0][1].layout)],
        )
        try:
            recording.eeg.check()
            judge_of, chain = self._judge(recording, run, task, where)
            if any(move["error"] is not None for move in moves):
                self._waves.setdefault(task, []).append(waveforms(recording, chain.chain, judge_of, moves))
        except SetupError as error:
            self._complain(where, [str(error)])

    def _joined(self, recordings: Sequence[Recording], where: Row) -> Recording:
        try:
            return joined(recordings)
        except SetupError as error:
            self._complain(where, [f"Only its last recording is looked at. {error}"])
            return recordings[-1]

    def _judge(self, recording: Recording, run: Sequence[Source], task: str, where: Row) -> tuple[JudgeOf, Config]:
        """How the EEG of a run is looked at: as its decoder did; of a calibration, as `fit` does."""
        config = validated(run[-1].sidecar.get("config", {}), f"the sidecar of {recording.path}")
        model = self._decoder(recording, run[-1], task, where)
        if model is not None:
            config = config.model_copy(update={"chain": model.info.chain, "classifier": model.info.classifier})
        if task == "calibration":
            try:
                found = fitting.analysed(recording, self._who["participant"], config)
                self._calibrated(found, model, where)
                return found.epochs.judge_of, config
            except SetupError as error:
                self._complain(where, [str(error)])
        judge = judge_with(model, config, recording.eeg, "") if model else judge_without(config, recording.eeg, "")
        return judges(judge, electrodes(recording)), config

    def _decoder(self, recording: Recording, source: Source, task: str, where: Row) -> DecoderModel | None:
        """The decoder beside a calibration, the newest, or that of an online run; None, and said, without."""
        path = _newest(recording.path) if task == "calibration" else _used(source)
        if path is None:
            what = "No decoder lies beside it" if task == "calibration" else "Its decoder isn't there"
            self._complain(where, [f"{what}: its EEG is looked at with the settings in its sidecar."])
            return None
        try:
            return load(path)
        except SetupError as error:
            self._complain(where, [str(error)])
            return None

    def _calibrated(self, found: fitting.Analysis, model: DecoderModel | None, where: Row) -> None:
        figures, error = found.figures, found.epochs.error
        if "calibration" in self.seen.figures:
            self._complain(
                where, ["There are several calibrations; the figures of the whole visit are the last one's."]
            )
        self.seen.figures["calibration"] = figures
        if model is not None and not np.array_equal(model.held_out_log_odds, found.result.blocked_log_odds):
            self._complain(
                where,
                ["The decoder's file wasn't fitted with the settings in the sidecar; the figures here are theirs."],
            )
        log_odds = found.result.blocked_log_odds
        for key, source in calibrations.FOLDS.items():
            self.seen.add(
                scores=calibrations.score_rows(figures[key], source, **where),
                confusion=[calibrations.counts_of(figures[key], source, **where)],
            )
        self.seen.add(
            roc=calibrations.roc_rows(log_odds, error, "contiguous", **where),
            reliability=calibrations.reliability_rows(figures["reliability"], "contiguous", **where),
            learning_curve=calibrations.curve_rows(figures["learning_curve"], **where),
        )

    def _judged(self, moves: Sequence[Row], where: Row) -> None:
        """Verdicts given online against the truth."""
        judged = steps.judged(moves)
        self.seen.add(area_accuracy=areas.accuracy_rows(moves, **where), area_test=areas.difference_row(moves, **where))
        scored = [move for move in judged if move["log_odds"] is not None]
        error = np.array([move["error"] for move in scored], dtype=bool)
        log_odds, evidence = (
            np.array([move[name] for move in scored], dtype=np.float64) for name in ("log_odds", "evidence")
        )
        found = calibrations.judged_online(log_odds, evidence, error) if scored else None
        if found is None:
            if any(move["error"] is not None for move in moves):
                self._complain(where, ["There are too few verdicts on moves of both kinds to tell how good they were."])
            return
        source = where["map"]
        self.seen.add(
            scores=calibrations.score_rows(found, source, **where),
            confusion=[calibrations.counts_of(found, source, **where)],
            roc=calibrations.roc_rows(log_odds, error, source, **where),
        )
        if found["reliability"] is not None:
            self.seen.add(reliability=calibrations.reliability_rows(found["reliability"], source, **where))

    def waves_together(self) -> None:
        """Potentials of all runs of a task: the paper's are over both maps."""
        for task, parts in self._waves.items():
            waves, where = together(parts), {**self._who, "source": task}
            if not len(waves.error):
                continue
            area = np.array([move["area"] for move in waves.moves])
            everywhere = erp.mean_rows(waves, np.ones(len(area), bool), **where, area="all")
            self.seen.add(
                erp=everywhere,
                erp_peaks=erp.peak_rows(everywhere, **where),
                erp_maps=erp.map_rows(waves, **where),
                erp_clusters=clusters.cluster_rows(waves, **where),
                errors_in_a_row=in_a_row.level_rows(waves, **where),
                errors_in_a_row_trend=in_a_row.trend_row(waves, **where),
                waveforms=[
                    {**where, "n_error": int(waves.error.sum()), "n_correct": int((~waves.error).sum())}
                    | {"n_without": waves.n_without}
                ],
            )
            for name in areas.AREAS:
                self.seen.add(erp=erp.mean_rows(waves, area == name, **where, area=name))

    def figures_together(self) -> None:
        """The figures of the online runs, as `demo` tells them."""
        self.seen.figures |= self._who
        self.seen.figures["online"] = {name: metrics.online(runs) for name, runs in self._light.items()}
        everything = [recording for runs in self._light.values() for recording in runs]
        if everything and len(self._speeds) == 1:
            self.seen.figures["latency"] = metrics.latencies(everything, self._speeds.pop())

    def _complain(self, where: Row, sentences: Sequence[str]) -> None:
        what = {"time_s": None, "kind": "report", "level": "warning", "role": ""}
        self.seen.add(events=[{**where, **what, "text": text} for text in sentences])


def _light(recording: Recording) -> Recording:
    """A recording without its EEG: half an hour is a quarter of a gigabyte."""
    return replace(recording, samples=recording.samples[:0].copy(), times=recording.times[:0].copy())


def _event_rows(run: Sequence[Source], recordings: Sequence[Recording], where: Row) -> list[Row]:
    """What a run's recordings tell of trouble; that one ended early is none where the next went on from it."""
    names = [_name(each.path) for each in recordings]
    went_on = [*pairwise(names), None]
    parts = zip(recordings, run, went_on, strict=True)
    return [row for each, source, pair in parts for row in trouble.event_rows(each, source.sidecar, pair, **where)]


def _name(path: Path) -> str:
    """``online 001`` of ``..._task-online_run-001_eeg.xdf``; else the file's name."""
    parts = dict(part.split("-", 1) for part in path.stem.split("_") if "-" in part)
    return f"{parts['task']} {parts['run']}" if {"task", "run"} <= parts.keys() else path.stem


def _newest(recording: Path) -> Path | None:
    """The newest decoder fitted on a calibration, by its number."""
    stem = recording.name.removesuffix(".xdf").removesuffix("_eeg")
    found = list(recording.parent.glob(f"{stem}_decoder*{SUFFIX}"))
    return max(found, key=lambda path: int(path.stem.partition("_decoder")[2].removeprefix("-") or 1), default=None)


def _used(source: Source) -> Path | None:
    """The decoder that a run's sidecar names, there or beside the recording, and no other of its name."""
    named = source.sidecar.get("model")
    if not isinstance(named, dict) or not named.get("path"):
        return None
    path = Path(str(named["path"]))
    candidates = [each for each in (path, source.path.with_name(path.name)) if each.exists()]
    return next((each for each in candidates if checksum(each) == named.get("sha256")), None)


def _run_row(
    where: Row, task: str, run: Sequence[Source], recordings: Sequence[Recording], n_moves: int, speed: float
) -> Row:
    sidecar, eeg, ends = run[-1].sidecar, recordings[-1].eeg, recordings[-1].of(SessionEnd)
    policy, decoder = ((sidecar.get(key) or {}).get("path") for key in ("policy", "model"))
    return {
        **where,
        "task": task,
        "recordings": ", ".join(each.path.name for each in run),
        "ended": ends[-1][1].reason if ends else "broken off",
        "n_moves": n_moves,
        "seconds": sum(float(np.ptp(each.times)) for each in recordings),
        "simulated": sidecar.get("simulated"),
        "speed": speed,
        "policy": Path(policy).stem if policy else None,
        "told": sidecar.get("told"),
        "decoder": Path(decoder).name if decoder else None,
        "seed": sidecar.get("seed"),
        "amplifier": eeg.name,
        "sfreq_hz": eeg.sfreq,
        "n_channels": len(eeg.picks),
    }
