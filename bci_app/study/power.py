"""How many participants a study needs to see an effect: from a thousand simulated studies, for each number of them.

The participants of the study file are the population. Each is calibrated in one process; what the decoder says of
moves of another hour, which it wasn't fitted on, with the ErrP as it is online, is drawn from in thousands of episodes
at once (`policy.verdicts.HeldOut`), as `evaluate --decoder` does. A simulated study draws its participants from the
population, plays the study's own episodes with each under both conditions, and tests the differences.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import joblib
import numpy as np
from numpy.typing import NDArray
from scipy import stats

from bci_app import fitting
from bci_app.config import Config
from bci_app.errors import SetupError
from bci_app.gridworld import GridWorld, load_map
from bci_app.metrics import truths
from bci_app.progress import Progress
from bci_app.study import alone, conditions
from bci_app.study.conditions import choose
from bci_app.study.parts import CALIBRATION
from bci_app.study.plan import Condition, Participant, Study
from bci_app.told import Told
from decoder.calibration import wilson
from decoder.evidence import Evidence
from decoder.model import DecoderModel
from policy import checkpoint
from policy.ear import Ear
from policy.evaluation import NetworkPlayer, play
from policy.simulator import Simulator
from policy.verdicts import HeldOut, Verdicts
from stimulus.episodes import online_episodes

Array = NDArray[np.float64]

WANTED_POWER = 0.8
ALPHA = 0.05
"""Two-sided."""
MOST = 60
"""Participants beyond which no study is simulated."""
TIMES = 100
"""Times that each participant plays all episodes: what studies draw from (decided: 14 participants give 1,400)."""
CONDITIONS: tuple[Condition, ...] = ("paper", "ours")


@dataclass(frozen=True, eq=False)
class Heard:
    """A participant's decoder, and what it says of moves it wasn't fitted on.

    Attributes
    ----------
    info : of the decoder's file.
    log_odds, error : (n_moves,), of the other hour.
    """

    info: Any
    log_odds: Array
    error: NDArray[np.bool_]


def run(study: Study, n_studies: int, progress: Progress) -> dict[str, Any]:
    """Participants needed for `WANTED_POWER`, for each condition against no ErrP, and for ours against the paper's.

    Returns ``needed`` by comparison (None where `MOST` don't do), ``power`` by comparison and number of participants
    with its interval, ``effects`` (mean and standard deviation over participants, in steps), ``population``,
    ``studies`` and ``seconds``. Raises SetupError for a study without simulated participants.
    """
    started = perf_counter()
    people = [each for each in study.participants if each.kind == "simulated"]
    if not people:
        raise SetupError("--power needs simulated participants in the study file: they are the population drawn from.")
    progress("calibrating the population", 0, 2)
    jobs = [joblib.delayed(steps_of)(study.model_dump_json(), each.name) for each in people]
    tables = joblib.Parallel(n_jobs=min(len(jobs), joblib.cpu_count()), backend="loky")(jobs)
    progress("simulating studies", 1, 2)
    found = {
        name: np.stack([table[a] - table[b] for table in tables])
        for name, (a, b) in {
            "paper against none": ("paper", "none"),
            "ours against none": ("ours", "none"),
            "ours against paper": ("ours", "paper"),
        }.items()
    }
    curves = {name: curve(differences, n_studies, study.seed) for name, differences in found.items()}
    progress("done", 2, 2)
    return {
        "study": study.name,
        "needed": {name: needed(points) for name, points in curves.items()},
        "effects": {name: effect(differences) for name, differences in found.items()},
        "power": curves,
        "population": [each.name for each in people],
        "studies": n_studies,
        "seconds": perf_counter() - started,
    }


def needed(points: Sequence[dict[str, float]]) -> int | None:
    """The fewest participants from which on the power is as wanted, and never below again."""
    below = [place for place, point in enumerate(points) if point["power"] < WANTED_POWER]
    enough = points[below[-1] + 1 :] if below else points
    return int(enough[0]["participants"]) if enough else None


def effect(differences: Array) -> dict[str, float]:
    """Steps an episode, of (n_people, n_times) differences: mean, its spread over people, and over one's own tries."""
    means = differences.mean(axis=1)
    return {
        "mean": float(means.mean()),
        "sd_of_people": float(means.std(ddof=1)) if len(means) > 1 else 0.0,
        "sd_of_tries": float(differences.std(axis=1, ddof=1).mean()),
    }


def curve(differences: Array, n_studies: int, seed: int) -> list[dict[str, float]]:
    """Power of studies of 2, 3 ... participants, until well above what is wanted.

    Parameters
    ----------
    differences : (n_people, n_times), a participant's mean steps less those under the other condition, try by try.

    A study sees the effect where a paired t test finds fewer steps at `ALPHA`, two-sided.
    """
    rng = np.random.default_rng([seed, 1])
    points, above = [], 0
    for n in range(2, MOST + 1):
        who = rng.integers(differences.shape[0], size=(n_studies, n))
        when = rng.integers(differences.shape[1], size=(n_studies, n))
        drawn = differences[who, when]
        spread = drawn.std(axis=1, ddof=1)
        t = np.divide(drawn.mean(axis=1) * np.sqrt(n), spread, out=np.zeros(n_studies), where=spread > 0)
        seen = int((t < stats.t.ppf(ALPHA / 2, n - 1)).sum())
        share = wilson(seen, n_studies)
        points.append({"participants": n, "power": share.value, "low": share.low, "high": share.high})
        above = above + 1 if share.low >= WANTED_POWER else 0
        if above == 3:
            break
    return points


def steps_of(study_json: str, name: str) -> dict[str, Array]:
    """In a worker: a participant's mean steps over all episodes of the study, (`TIMES`,), by condition."""
    study = Study.model_validate_json(study_json)
    who = study.participant(name)
    config = study.settings(who)
    ours, papers = hear(study, who, config)
    worlds = [load_map(each) for each in study.maps]
    found: dict[str, Array] = {}
    for condition in ("none", *CONDITIONS):
        heard = papers if condition == "paper" else ours
        steps = [play_all(study, config, heard, condition, world, name) for world in worlds]
        found[condition] = np.concatenate(steps, axis=1).mean(axis=1)
    return found


def hear(study: Study, who: Participant, config: Config) -> tuple[Heard, Heard]:
    """Calibrate and have our decoder, and one with the paper's classifier, judge another hour of the same kind, with
    the ErrP as it is online."""
    calibration = alone.calibrate(config, who.name, study.run_seed(who.name, CALIBRATION))
    ours, papers = (
        _judging(study, who, each, fitting.decoder_of(calibration, who.name, each)[2])
        for each in (config, conditions.papers(config))
    )
    return ours, papers


def _judging(study: Study, who: Participant, config: Config, fitted: DecoderModel) -> Heard:
    recording = alone.calibrate(config, who.name, study.run_seed(who.name, "power"), model=fitted)
    known = truths(recording)
    judged = [(known[key], verdict.log_odds) for key, verdict in recording.verdicts.items()]
    error, log_odds = zip(*[each for each in judged if each[1] is not None], strict=True)
    return Heard(fitted.info, np.array(log_odds, dtype=float), np.array(error, dtype=bool))


def play_all(study: Study, config: Config, heard: Heard, condition: Condition, world: GridWorld, name: str) -> Array:
    """Steps of each of a map's episodes, (`TIMES`, n_episodes), failed ones with their limit."""
    choice = choose(condition, heard.info, config.policy, study.papers_gate, world)
    network, card = checkpoint.load(choice.policy)
    evidence: Evidence = heard.info.evidence
    ear = Ear(Verdicts.parse(card.verdicts), Told.parse(str(evidence.told)))
    draw = held_out(ear, evidence, heard)
    seeds = range(config.online.episodes_seed, config.online.episodes_seed + config.online.rounds)
    episodes = [each for seed in seeds for each in online_episodes(world, config.online.distances, seed)]
    start = np.tile([each.start for each in episodes], TIMES)
    goal = np.tile([each.goal for each in episodes], TIMES)
    rng = np.random.default_rng([study.run_seed(name, f"power {condition} {world.name}")])
    simulator = Simulator(world, start, goal, draw(len(start), rng), rng, config.online.max_steps)
    return play(NetworkPlayer(network, world), simulator).reshape(TIMES, -1).astype(float)


def held_out(ear: Ear, evidence: Evidence, heard: Heard) -> HeldOut:
    """What a policy takes each of these verdicts for."""
    taken = np.array(
        [ear.evidence("error" if each > 0 else "correct", evidence.of(each)) for each in heard.log_odds.tolist()],
        np.float32,
    )
    return HeldOut(taken[heard.error], taken[~heard.error], ear.information)
