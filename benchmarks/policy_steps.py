"""Every figure of the shipped policies beside what the exact Bayes filter reaches, and whether it is good enough.

    python benchmarks/policy_steps.py [--episodes 20000] [--rates real_verdicts.tsv] [--special FOLDER]
                                      [--cache FILE.jsonl] [--json FILE]

For each map, as Markdown tables: binary verdicts by accuracy, scores, both near chance, real pairs of rates, wrongly
told accuracies and missing verdicts; at the end one line for each requirement with its worst case. Roles are Bayes (the
exact filter and the greedy move), the planner on its belief, the specialised policy (trained for these very verdicts),
the one that is told the decoder's statistics, the paper's recipe, and none (the policy without verdicts).

All play greedily on the same starts and goals, distance 2 or more; an episode without end counts 400 steps. Intervals
are of 95 %, each of its case alone: of means the normal one, of ratios the paired one. Success is the mean over the
initial distances 2 to 20, of as many episodes again, with Wilson's interval of all of them. Deterministic; all cores
share the work. With --cache a run that was interrupted goes on where it was.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

from policy_cases import Play, Row, play_all, read_people, rows

from bci_app.gridworld import SHIPPED_MAPS
from bci_app.terminal import progress_bar
from policy.cards import PRETRAINED
from policy.evaluation import Played, paired_ratio, summarise
from policy.library import ACCURACIES

Figure = tuple[float, float, float]
"""An estimate and the ends of its interval."""
Quantity = Literal["steps", "ratios", "success"]
TITLES: dict[Quantity, str] = {
    "steps": "mean steps",
    "ratios": "ratios of mean steps, paired",
    "success": "success within 60 steps, mean over distances 2 to 20",
}
RATIOS = {
    "binary": ("specialised/Bayes", "told/Bayes", "planner/Bayes", "paper/Bayes", "told/specialised"),
    "score": ("told/Bayes", "planner/Bayes", "told/none"),
    "near chance": ("told/none", "Bayes/none", "planner/none", "told/Bayes"),
    "real": ("told/specialised", "told/Bayes", "told/none", "specialised/Bayes", "planner/Bayes"),
    "wrongly told": ("wrongly/rightly",),
    "missing": ("told/Bayes", "told/told all"),
}
WITH_SUCCESS = ("binary", "score")


@dataclass(frozen=True)
class Measured:
    """The figures of one row, by role or by pair of roles."""

    row: Row
    steps: dict[str, Figure]
    ratios: dict[str, Figure]
    success: dict[str, Figure]


@dataclass(frozen=True)
class Requirement:
    """A bound that every case of a table must keep: all maps and labels unless they are named."""

    table: str
    quantity: Quantity
    what: str
    sense: Literal["<=", "<", ">="]
    bound: float
    labels: tuple[str, ...] = ()
    maps: tuple[str, ...] = ()

    def concerns(self, row: Row) -> bool:
        """Whether the row is one of its cases."""
        inside = (not self.labels or row.label in self.labels) and (not self.maps or row.map in self.maps)
        return row.table == self.table and inside

    def kept(self, value: float) -> bool:
        """Whether an estimate is good enough."""
        return {"<=": value <= self.bound, "<": value < self.bound, ">=": value >= self.bound}[self.sense]

    def __str__(self) -> str:
        labels = "all" if not self.labels else " to ".join(dict.fromkeys((self.labels[0], self.labels[-1])))
        where = ", ".join((*self.maps, self.table, labels))
        bound = f"{100 * self.bound:g} %" if self.quantity == "success" else f"{self.bound:g}"
        what = self.what if self.quantity == "ratios" else f"{self.quantity} of {self.what}"
        return f"{where}: {what} {self.sense} {bound}"


EVERY_P = tuple(f"{accuracy:.2f}" for accuracy in ACCURACIES)
OPEN_STEPS = {"none": 23.0, "0.70": 17.0, "0.80": 12.9, "1.00": 9.6}
SUCCESS = {"none": 0.96, "0.70": 0.99, "0.80": 0.999}
REQUIREMENTS = (
    *(Requirement("binary", "ratios", f"{who}/Bayes", "<=", 1.02) for who in ("specialised", "told")),
    *(
        Requirement("binary", "steps", who, "<=", bound, (label,), ("open",))
        for who in ("specialised", "told")
        for label, bound in OPEN_STEPS.items()
    ),
    *(
        Requirement("binary", "success", who, ">=", bound, (label,))
        for who in ("specialised", "told")
        for label, bound in SUCCESS.items()
    ),
    *(Requirement("score", "success", "told", ">=", SUCCESS[label], (label,)) for label in ("0.70", "0.80")),
    Requirement("score", "ratios", "told/Bayes", "<=", 1.02),
    Requirement("score", "steps", "told", "<=", 15.1, ("0.70",)),
    Requirement("score", "ratios", "told/none", "<", 0.92, ("0.60",)),
    Requirement("binary", "ratios", "told/specialised", "<=", 1.02, EVERY_P),
    Requirement("real", "ratios", "told/specialised", "<=", 1.03),
    Requirement("real", "ratios", "told/none", "<=", 1.02),
    Requirement("real", "ratios", "told/none", "<=", 1.02, ("s10",)),
    Requirement("wrongly told", "ratios", "wrongly/rightly", "<=", 1.10),
)


def needed(row: Row) -> list[Play]:
    """What must be played for a row."""
    far = [replace(play, distribution="distances") for play in row.plays.values() if row.table in WITH_SUCCESS]
    return [*row.plays.values(), *far]


def measure(row: Row, played: dict[Play, Played]) -> Measured:
    """The figures of a row; a ratio is left out where one of its two roles is."""
    pairs = [what.split("/") for what in RATIOS[row.table]]
    return Measured(
        row,
        {role: _mean(played[play]) for role, play in row.plays.items()},
        {
            f"{one}/{other}": paired_ratio(played[row.plays[one]], played[row.plays[other]])
            for one, other in pairs
            if one in row.plays and other in row.plays
        },
        {
            role: _success(played[replace(play, distribution="distances")])
            for role, play in row.plays.items()
            if row.table in WITH_SUCCESS
        },
    )


def _mean(played: Played) -> Figure:
    found = summarise(played)
    return found.mean_steps, *found.mean_steps_ci


def _success(played: Played) -> Figure:
    found = summarise(played)
    return found.success_60_by_distance_mean, *found.success_60_ci


def show(found: Sequence[Measured], name: str, table: str, quantity: Quantity) -> None:
    """One Markdown table: a line a row, a column a role or a pair of roles."""
    lines = {
        each.row.label: getattr(each, quantity) for each in found if (each.row.map, each.row.table) == (name, table)
    }
    columns = list(dict.fromkeys(column for line in lines.values() for column in line))
    if quantity == "ratios":
        columns.sort(key=RATIOS[table].index)
    if columns:
        print(f"\n### {name}, {table}: {TITLES[quantity]}\n")
        _print_table(
            ["verdicts", *columns],
            [[label, *(_cell(line.get(column), quantity) for column in columns)] for label, line in lines.items()],
        )


def _print_table(header: Sequence[str], lines: Sequence[Sequence[str]]) -> None:
    for line in (header, ["---"] * len(header), *lines):
        print("| " + " | ".join(line) + " |")


def _cell(figure: Figure | None, quantity: Quantity) -> str:
    if figure is None:
        return ""
    value, low, high = figure
    match quantity:
        case "steps":
            return f"{value:.2f} ± {(high - low) / 2:.2f}"
        case "ratios":
            return f"{value:.3f} [{low:.3f}, {high:.3f}]"
        case "success":
            return f"{100 * value:.2f} % [{100 * low:.2f}, {100 * high:.2f}]"


@dataclass(frozen=True)
class Verdict:
    """How a requirement fares: its worst case, how many of its cases were played, and whether all of them keep it."""

    requirement: str
    worst: Figure | None
    where: str
    played: int
    cases: int
    holds: str


def judge(requirement: Requirement, found: Sequence[Measured]) -> Verdict:
    """Look for the worst case; an estimate decides, not its interval, and cases that weren't played prove nothing."""
    rows = [each for each in found if requirement.concerns(each.row)]
    figures = [(getattr(each, requirement.quantity).get(requirement.what), each.row) for each in rows]
    there = [(figure, row) for figure, row in figures if figure is not None]
    if not there:
        return Verdict(str(requirement), None, "", 0, len(rows), "not played")
    worst, row = (min if requirement.sense == ">=" else max)(there, key=lambda case: case[0][0])
    complete = "yes" if len(there) == len(rows) else "incomplete"
    holds = complete if requirement.kept(worst[0]) else "NO"
    return Verdict(str(requirement), worst, f"{row.map}, {row.label}", len(there), len(rows), holds)


def summary(found: Sequence[Measured]) -> list[Verdict]:
    """Print and return how all requirements fare."""
    verdicts = [judge(requirement, found) for requirement in REQUIREMENTS]
    print("\n### requirements\n")
    lines = [
        [v.requirement, _cell(v.worst, r.quantity), v.where, f"{v.played} of {v.cases}", v.holds]
        for v, r in zip(verdicts, REQUIREMENTS, strict=True)
    ]
    _print_table(["requirement", "worst case", "where", "cases played", "holds"], lines)
    return verdicts


def as_json(each: Measured) -> dict[str, Any]:
    """A row with its figures, each an estimate and the ends of its interval."""
    row = each.row
    players = {
        role: {"player": Path(play.player).stem, "verdicts": asdict(play.verdicts)} for role, play in row.plays.items()
    }
    figures = {"steps": each.steps, "ratios": each.ratios, "success": each.success}
    return {"table": row.table, "map": row.map, "verdicts": row.label, "players": players, **figures}


def main() -> None:
    """Play what isn't in the cache and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=2022)
    parser.add_argument("--maps", nargs="+", default=SHIPPED_MAPS)
    parser.add_argument("--policies", type=Path, default=PRETRAINED, help="folder of policies and teachers")
    parser.add_argument("--rates", type=Path, help="counted hits and correct rejections of people, tab-separated")
    parser.add_argument("--special", type=Path, help="folder of policies trained for the true rates of these people")
    parser.add_argument("--cache", type=Path, help="keep what was played here, one JSON line each, and go on from it")
    parser.add_argument("--json", type=Path, help="write all figures here")
    options = parser.parse_args()
    people = read_people(options.rates) if options.rates else []
    wanted = [row for name in options.maps for row in rows(name, people, options.policies, options.special)]
    plays = [play for row in wanted for play in needed(row)]
    print(f"{options.episodes} episodes, seed {options.seed}; {len(set(plays))} sets of them", flush=True)
    with progress_bar(quiet=False) as progress:
        played = play_all(plays, options.policies, options.episodes, options.seed, options.cache, progress)
    found = [measure(row, played) for row in wanted]
    for name in options.maps:
        for table in RATIOS:
            for quantity in TITLES:
                show(found, name, table, quantity)
    verdicts = summary(found)
    if options.json:
        figures = {"episodes": options.episodes, "seed": options.seed, "rows": [as_json(each) for each in found]}
        figures["requirements"] = [asdict(verdict) for verdict in verdicts]
        options.json.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
