"""Moves, verdicts, truths and actions of a run as they come, and the figures of them that the console shows.

Figures are those of `bci_app.metrics`, of what was heard so far. Pure: messages are handed in.
"""

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bci_app.metrics import Confusion
from bci_app.protocol import (
    Action,
    AnyMessage,
    Continued,
    EpisodeEnd,
    EpisodeGoal,
    EpisodeStart,
    MoveOnset,
    Position,
    Truth,
    Verdict,
)
from bci_app.said import is_void, place_after

Key = tuple[int, int]
"""(episode, step)."""
SHOWN = 60
"""Newest verdicts that are shown one by one (decided: a whole episode)."""


@dataclass
class Episode:
    """One episode as far as it was heard of."""

    number: int
    start: Position
    began: float
    max_steps: int
    goal: Position | None = None
    distance: int | None = None
    end: EpisodeEnd | None = None
    ended: float | None = None


@dataclass
class Ledger:
    """Who said what on each move. Of two verdicts, or two actions, on one move the first counts."""

    speed: float = 1.0
    """Session seconds a real second, for latencies."""
    episodes: dict[int, Episode] = field(default_factory=dict)
    moves: dict[Key, tuple[float, MoveOnset]] = field(default_factory=dict)
    truths: dict[Key, bool] = field(default_factory=dict)
    verdicts: dict[Key, tuple[float, Verdict]] = field(default_factory=dict)
    actions: dict[Key, tuple[float, Action]] = field(default_factory=dict)
    _goals: dict[int, EpisodeGoal] = field(default_factory=dict)

    def take(self, stamp: float, message: AnyMessage) -> None:
        """Take in one message."""
        match message:
            case EpisodeStart():
                self._begin(stamp, message)
            case EpisodeGoal():
                self._goals[message.episode] = message
                self._set_goal(message.episode)
            case EpisodeEnd():
                episode = self.episodes.get(message.episode)
                if episode is not None:
                    episode.end, episode.ended = message, stamp
            case MoveOnset():
                self.moves.setdefault((message.episode, message.step), (stamp, message))
            case Truth():
                self.truths[message.episode, message.step] = message.error
            case Verdict():
                self.verdicts.setdefault((message.episode, message.step), (stamp, message))
            case Action():
                self.actions.setdefault((message.episode, message.step), (stamp, message))
            case Continued():
                self._drop_void(message)

    def _begin(self, stamp: float, start: EpisodeStart) -> None:
        if start.episode not in self.episodes:  # a stimulus that was started again may say it once more
            self.episodes[start.episode] = Episode(start.episode, start.position, stamp, start.max_steps)
            self._set_goal(start.episode)

    def _set_goal(self, number: int) -> None:
        episode, goal = self.episodes.get(number), self._goals.get(number)
        if episode is not None and goal is not None:
            episode.goal, episode.distance = goal.goal, goal.distance

    def _drop_void(self, continued: Continued) -> None:
        place = place_after(continued)
        self.moves = {key: said for key, said in self.moves.items() if key <= place}
        self.truths = {key: error for key, error in self.truths.items() if key <= place}
        self.verdicts = {key: said for key, said in self.verdicts.items() if key <= place}
        self.actions = {key: said for key, said in self.actions.items() if not is_void(said[1], continued)}
        self.episodes = {number: episode for number, episode in self.episodes.items() if (number, 0) <= place}
        for number, episode in self.episodes.items():
            if (number, float("inf")) > place:
                episode.end = episode.ended = None

    @property
    def current(self) -> Episode | None:
        """The newest episode."""
        return self.episodes[max(self.episodes)] if self.episodes else None

    def path(self, number: int) -> list[MoveOnset]:
        """The moves of an episode that were heard of, in order."""
        found = [onset for (episode, _), (_, onset) in self.moves.items() if episode == number]
        return sorted(found, key=lambda onset: onset.step)

    def steps(self) -> dict[int, int]:
        """Moves of each episode; of one that was heard of only at its end, those it told then."""
        heard = Counter(episode for episode, _ in self.moves)
        ended = {number: episode.end.steps for number, episode in self.episodes.items() if episode.end is not None}
        return {number: max(heard[number], ended.get(number, 0)) for number in {*heard, *ended}}

    @property
    def n_rejected(self) -> int:
        """Moves whose epoch couldn't be judged."""
        return sum(verdict.outcome == "rejected" for _, verdict in self.verdicts.values())

    def confusion(self) -> Confusion:
        """Verdicts against the truth; rejected and unjudged moves don't count."""
        names = {
            (True, "error"): "hits",
            (True, "correct"): "misses",
            (False, "error"): "false_alarms",
            (False, "correct"): "correct_rejections",
        }
        counts = dict.fromkeys(names.values(), 0)
        for key, (_, verdict) in self.verdicts.items():
            name = names.get((self.truths[key], verdict.outcome)) if key in self.truths else None
            if name is not None:
                counts[name] += 1
        return Confusion(**counts)

    def accuracy(self) -> dict[str, Any]:
        """Counts and rates, as `metrics.Confusion` has them."""
        found = self.confusion()
        return {
            "hits": found.hits,
            "misses": found.misses,
            "false_alarms": found.false_alarms,
            "correct_rejections": found.correct_rejections,
            "n": found.n,
            "accuracy": found.accuracy,
            "balanced_accuracy": found.balanced_accuracy,
            "hit_rate": found.hit_rate,
            "correct_rejection_rate": found.correct_rejection_rate,
            "rejected": self.n_rejected,
            "unjudged": sum(verdict.outcome == "unjudged" for _, verdict in self.verdicts.values()),
        }

    def recent(self) -> list[dict[str, Any]]:
        """The newest verdicts, oldest first."""
        rows = []
        for key, (_, verdict) in list(self.verdicts.items())[-SHOWN:]:
            rows.append(
                {
                    "episode": key[0],
                    "step": key[1],
                    "outcome": verdict.outcome,
                    "reason": verdict.reason,
                    "log_odds": verdict.log_odds,
                    "evidence": verdict.evidence,
                    "latency_ms": verdict.latency_ms,
                    "truth": self.truths.get(key),
                }
            )
        return rows

    def latencies(self) -> dict[str, Any]:
        """Median and 99th percentile in real ms, and of how many, as `metrics.latencies` defines them."""
        verdict = [said.latency_ms for _, said in self.verdicts.values() if said.latency_ms is not None]
        action = [
            (stamp - self.verdicts[episode, step - 1][0]) / self.speed * 1e3
            for (episode, step), (stamp, _) in self.actions.items()
            if (episode, step - 1) in self.verdicts
        ]
        return {"verdict": _percentiles(verdict), "action": _percentiles(action)}

    def finished(self) -> list[dict[str, Any]]:
        """Episodes that are over, oldest first."""
        return [
            {
                "episode": episode.number,
                "distance": episode.distance,
                "steps": episode.end.steps,
                "reason": episode.end.reason,
            }
            for episode in self.episodes.values()
            if episode.end is not None
        ]

    def success(self) -> dict[str, Any]:
        """Share of episodes that reached their goal, and mean steps, failures with those they took."""
        ends = [episode.end for episode in self.episodes.values() if episode.end is not None]
        whole = [end for end in ends if end.reason in ("goal", "limit")]
        return {
            "n": len(whole),
            "success": sum(end.reason == "goal" for end in whole) / len(whole) if whole else None,
            "mean_steps": float(np.mean([end.steps for end in whole])) if whole else None,
        }


def _percentiles(values: list[float]) -> dict[str, Any]:
    p50, p99 = (float(np.percentile(values, percent)) if values else None for percent in (50, 99))
    return {"n": len(values), "p50_ms": p50, "p99_ms": p99, "last_ms": values[-1] if values else None}
