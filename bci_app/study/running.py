"""`bci-app study`: participants side by side, as far as the cores or a cluster allow, then the report."""

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

import joblib

from bci_app.errors import SetupError
from bci_app.gridworld import load_map
from bci_app.progress import Progress
from bci_app.report import Row
from bci_app.study import page, tables
from bci_app.study.apart import has_own_ports
from bci_app.study.conduct import done_of, go_through, names_of
from bci_app.study.jobs import Job, Made, made_of
from bci_app.study.parts import Kept
from bci_app.study.plan import Participant, Study, Through
from bci_app.watching import Watch
from policy import cards

SESSIONS_A_CORE, MOST_SESSIONS = 2.5, 10
"""Sessions side by side on one machine, unless `side_by_side` says otherwise: one takes a third of a core at speed 40,
for half of its time it waits for its processes to start, find each other and end (measured)."""
MOST_ON_THE_SAME_PORTS = 3
"""Where the lab's own LSL settings hold: an online session has 8 streams, and LSL's usual ports are 32."""


def run(
    study: Study,
    through: Through,
    person: str | None,
    backend: str,
    scheduler: str | None,
    progress: Progress,
) -> dict[str, Any]:
    """Make what is left to do of a study, then its report.

    Parameters
    ----------
    person : the one participant to conduct; a real one is conducted only if named. None for all simulated ones.
    backend, scheduler : ``local``, or ``dask`` at an address. A cluster's machines must share the study's folder, or
        the work is done there and kept here part by part only once a participant is through.

    Returns what `summary` tells. Raises SetupError for what is kept of another study. Once all others are through and
    the report is written, raises SetupError for participants whose parts couldn't be kept or whom the cluster gave up,
    and RuntimeError for those who ended by an error that nobody foresaw.
    """
    started = perf_counter()
    check_maps(study)
    wanted = [study.participant(person)] if person else [each for each in study.participants if not each.is_real]
    before = {each.name: Kept.of(study, each, _through(each, through)) for each in wanted}
    left = [each for each in wanted if set(names_of(study, each)) - set(before[each.name].parts)]
    for who in [each for each in left if each.is_real]:
        go_through(study, who, "processes", progress)
    simulated = [each for each in left if not each.is_real]
    troubles = _Troubles(study, through, len(simulated))
    if simulated:
        done = [before[who.name] for who in simulated]
        _simulate(study, simulated, done, through, backend, scheduler, progress, troubles)
    try:
        result = summary(study, through) | {"seconds": perf_counter() - started}
    except SetupError as error:
        troubles.end(f"no report: {error}")
        raise
    troubles.end(f"report: {result['report']}")
    return result


def _simulate(
    study: Study,
    people: Sequence[Participant],
    before: Sequence[Kept],
    through: Through,
    backend: str,
    scheduler: str | None,
    progress: Progress,
    troubles: "_Troubles",
) -> None:
    """Make what is left to do of these participants, of whom is kept what was done `before`, side by side."""
    n = _side_by_side(study, through)
    beside = through == "processes" and n > 1 and len(people) > 1
    # A worker that outlives an interruption may hold a note open; Windows then can't remove it.
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as notes:
        here = None if backend == "dask" else notes
        text = study.model_dump_json()
        jobs = [Job(text, who.name, through, number, here, beside) for number, who in enumerate(people)]
        with _watch(study, people, before, Path(notes), progress) as watching:
            for number, made in made_of(jobs, n, backend, scheduler):
                if troubles.take(people[number].name, made):
                    watching.finished(number)


class _Troubles:
    """Those of single participants: told when all others are through."""

    def __init__(self, study: Study, through: Through, n: int) -> None:
        self._study, self._through, self._n = study, through, n
        self._refusals: list[str] = []
        self._crashes: list[str] = []

    def take(self, name: str, made: Made) -> bool:
        """Keep what was made; whether the participant is through, which who stopped isn't."""
        refusals = [made.refusal] if made.refusal else []
        try:
            if made.kept is not None:
                _keep(self._study, self._through, name, made.kept)
        except SetupError as error:
            refusals.append(str(error))
        self._refusals += [f"Participant {name}: {refusal}" for refusal in refusals]
        self._crashes += [f"Participant {name}: {made.crash}"] if made.crash else []
        return not (refusals or made.crash or (made.kept or {}).get("stopped"))

    def end(self, where: str) -> None:
        """Raise RuntimeError for errors of the program, SetupError for others; ``where`` the rest is to be seen."""
        kept = f"what the others did is kept ({where})."
        if self._crashes:
            told = "\n".join([*self._refusals, *self._crashes])
            n = len(self._crashes)
            raise RuntimeError(f"Of {self._n} participants {n} ended by an error of the program; {kept}\n{told}")
        if self._refusals:
            n = len(self._refusals)
            raise SetupError(f"Of {self._n} participants {n} couldn't go on; {kept} {' '.join(self._refusals)}")


def _watch(
    study: Study, people: Sequence[Participant], before: Sequence[Kept], notes: Path, progress: Progress
) -> Watch:
    """Tells how many parts of these participants are done."""
    parts = [done_of(study, who, kept) for who, kept in zip(people, before, strict=True)]
    total = sum(of for _, of in parts)

    def tell(shares: Sequence[float]) -> None:
        done = sum(round(share * of) for share, (_, of) in zip(shares, parts, strict=True))
        n_through = sum(share == 1 for share in shares)
        progress(f"calibrations and runs, {n_through} of {len(people)} participants through", done, total)

    return Watch(notes, [done / of for done, of in parts], tell)


def check_maps(study: Study) -> None:
    """That every condition can be played on every map is better known before somebody has been calibrated.

    Raises SetupError for a map that can't be read and for one without a policy.
    """
    for name in study.maps:
        world = load_map(name)
        cards.choose_without(world)
        if "paper" in study.conditions:
            cards.choose_by_accuracy(study.papers_gate, world)
        if set(study.conditions) - {"none", "paper"}:
            cards.choose_told(world)


def _through(who: Participant, through: Through) -> Through:
    """People go through the real processes."""
    return "processes" if who.is_real else through


def _side_by_side(study: Study, through: Through) -> int:
    cores = int(joblib.cpu_count())
    if study.side_by_side:
        return study.side_by_side
    if through == "one-process":
        return cores
    return min(MOST_SESSIONS if has_own_ports() else MOST_ON_THE_SAME_PORTS, round(SESSIONS_A_CORE * cores))


def _keep(study: Study, through: Through, name: str, made: dict[str, Any]) -> None:
    """What another machine has made, which this one's folder may not have."""
    kept = Kept.of(study, study.participant(name), through)
    if set(made["parts"]) - set(kept.parts) or made["stopped"] != kept.stopped:
        kept.parts, kept.stopped = made["parts"], made["stopped"]
        kept.save()


def people_of(study: Study, through: Through) -> list[tables.Person]:
    """What is kept of each participant, in the study's order; of one that was begun with other settings only that."""
    found: list[tables.Person] = []
    for who in study.participants:
        way = _through(who, through)
        try:
            kept = Kept.of(study, who, way)
        except SetupError as error:
            head = Kept.new(study, who, way).head
            found.append({**head, "parts": {}, "stopped": {"part": "everything", "why": str(error)}})
        else:
            found.append({**kept.head, "parts": kept.parts, "stopped": kept.stopped})
    return found


def summary(study: Study, through: Through) -> dict[str, Any]:
    """The report, written, and in plain numbers: `conditions` and `participants` by condition and map, `unfinished`,
    `report`."""
    people = people_of(study, through)
    maps = tables.maps_of(study.maps)
    wanted = {who.name: names_of(study, who) for who in study.participants}
    lacking = tables.unfinished(people, wanted)
    real = [who.name for who in study.participants if who.is_real]
    to_come = [row["participant"] for row in lacking if row["participant"] in real and "yet" in row["why"]]
    rows = tables.headline(people, study.conditions, maps, study.papers_gate)
    own = tables.by_participant(people, study.conditions, maps)
    report = page.write(study, through, people, rows, own, lacking) if rows else None
    return {
        "study": study.name,
        "through": through,
        "conditions": _nested([row for row in rows if row["group"] == tables.ALL]),
        "below_the_gate": _nested([row for row in rows if row["group"] == "below the paper's gate"]),
        "participants": {
            name: _nested([row for row in own if row["participant"] == name])
            for name in dict.fromkeys(row["participant"] for row in own)
        },
        "unfinished": lacking,
        "to_come": to_come,
        "report": str(report) if report else None,
    }


KEYS = (
    "participants",
    "n_episodes",
    "success",
    "success_low",
    "success_high",
    "mean_steps",
    "mean_steps_low",
    "mean_steps_high",
    "steps_vs_none",
    "steps_vs_none_low",
    "steps_vs_none_high",
    "p",
    "p_ranks",
)
"""What is told of a condition on a map; the first without `low` and `high` are the contract."""


def _nested(rows: Sequence[Row]) -> dict[str, dict[str, Row]]:
    found: dict[str, dict[str, Row]] = {}
    for row in rows:
        own = {name: row[name] for name in KEYS if name != "participants"}
        found.setdefault(row["condition"], {})[row["map"]] = {"participants": row["participants"], **own}
    return found


def show(result: dict[str, Any], tell: Callable[[str], None]) -> None:
    """The result in words."""
    for condition, by_map in result["conditions"].items():
        for name, row in by_map.items():
            steps = row["steps_vs_none"]
            against = "" if steps is None or condition == "none" else f", {100 * steps:+.1f} % against none"
            if against and row["p"] is not None:
                low, high = (100 * row[f"steps_vs_none_{end}"] for end in ("low", "high"))
                against += f" [{low:+.1f}, {high:+.1f}], p {row['p']:.2g}"
            who = f"{row['participants']} participants"
            tell(f"{condition}, {name}: success {row['success']:.1%}, {row['mean_steps']:.2f} steps{against} ({who})")
    for row in result["unfinished"]:
        tell(f"{row['participant']}: {row['why']}; lacks {row['lacks']}")
    if result["report"]:
        tell(f"Report: {result['report']}")
