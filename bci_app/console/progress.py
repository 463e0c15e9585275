"""How far a run is and how long it will still take, from the messages of the stimulus. Pure."""

from dataclasses import dataclass
from typing import Any

from bci_app.console.scores import Ledger
from bci_app.protocol import (
    AnyMessage,
    BlockEnd,
    BlockStart,
    EpisodeEnd,
    EpisodeStart,
    Pause,
    Resume,
    SessionEnd,
    SessionStart,
)


@dataclass
class Course:
    """The course of one run. Times are session seconds."""

    ledger: Ledger
    start: SessionStart | None = None
    began: float = 0.0
    end: SessionEnd | None = None
    ended: float | None = None
    block: BlockStart | None = None
    n_blocks_done: int = 0
    pause: Pause | None = None
    paused_since: float | None = None
    paused_s: float = 0.0
    """In all pauses that are over."""
    moving_since: float | None = None
    """Of a calibration, how long it had lasted without pauses when its first block began: before come instructions."""
    n_before_block: int = 0
    """Moves that counted when the block began."""
    episode_since: float | None = None
    """How long the run had lasted without pauses when the episode under way began."""
    episodes_s: float = 0.0
    n_episodes_heard: int = 0
    """Episodes heard from their start to their end, and how long they took without pauses."""
    is_last: bool = False
    """The run ends after the block or episode under way."""

    def take(self, stamp: float, message: AnyMessage) -> None:
        """Take in one message."""
        match message:
            case SessionStart() if self.start is None:
                self.start, self.began = message, stamp
            case SessionEnd():
                self.end, self.ended = message, stamp
                self._go_on(stamp)
            case BlockStart():
                self.block, self.n_before_block = message, self._n_valid()
                self.moving_since = self._without_pauses(stamp) if self.moving_since is None else self.moving_since
            case EpisodeStart() if message.episode not in self.ledger.episodes:
                self.episode_since = self._without_pauses(stamp)
            case EpisodeEnd() if self.episode_since is not None:
                self.episodes_s += self._without_pauses(stamp) - self.episode_since
                self.n_episodes_heard, self.episode_since = self.n_episodes_heard + 1, None
            case BlockEnd():
                self.n_blocks_done = max(self.n_blocks_done, message.block + 1)
            case Pause():
                self.pause = message
                self.paused_since = stamp if self.paused_since is None else self.paused_since
            case Resume():
                self._go_on(stamp)

    def _go_on(self, stamp: float) -> None:
        if self.paused_since is not None:
            self.paused_s += stamp - self.paused_since
        self.pause = self.paused_since = None

    def _without_pauses(self, now: float) -> float:
        """Session seconds since the run began, less those of pauses."""
        paused = self.paused_s + (now - self.paused_since if self.paused_since is not None else 0.0)
        return now - self.began - paused

    def _n_valid(self) -> int:
        return sum(self.ledger.steps().values()) - self.ledger.n_rejected

    @property
    def phase(self) -> str:
        """waiting, running, paused or ended."""
        if self.end is not None:
            return "ended"
        if self.start is None:
            return "waiting"
        return "paused" if self.pause is not None else "running"

    def progress(self, now: float) -> dict[str, Any]:
        """Blocks, episodes and moves, done and of how many; elapsed session seconds and how many are left, if known."""
        start = self.start
        if start is None:
            return {"done": 0, "total": None, "elapsed_s": None, "to_go_s": None}
        moves = sum(self.ledger.steps().values())
        episode = self.ledger.current
        n_done = sum(episode.end is not None for episode in self.ledger.episodes.values())
        is_calibration = start.n_moves is not None
        rejected = self.ledger.n_rejected if is_calibration else 0
        return {
            "unit": "moves" if is_calibration else "episodes",
            "done": moves - rejected if is_calibration else n_done,
            "total": start.n_moves if is_calibration else start.n_episodes,
            "moves": moves,
            "block": self.block.block + 1 if self.block else None,
            "n_blocks": start.n_blocks,
            "episode": episode.number + 1 if episode else None,
            "n_episodes": start.n_episodes,
            "step": self.ledger.steps().get(episode.number, 0) if episode else 0,
            "max_steps": episode.max_steps if episode else None,
            "elapsed_s": round((self.ended if self.ended is not None else now) - self.began, 1),
            "to_go_s": self._to_go(now),
        }

    def _to_go(self, now: float) -> float | None:
        """By the mean length of the moves, or online of the episodes, so far."""
        start = self.start
        if start is None or self.end is not None:
            return None
        if start.n_moves is not None:
            left = self._moves_left(start.n_moves)
            moves = sum(self.ledger.steps().values())
            spent = self._without_pauses(now) - (self.moving_since or 0.0)
            return round(left * spent / moves, 1) if moves else None
        if not self.n_episodes_heard or start.n_episodes is None:
            return None
        n_over = sum(episode.ended is not None for episode in self.ledger.episodes.values())
        is_under_way = self.episode_since is not None
        under_way = self._without_pauses(now) - self.episode_since if self.episode_since is not None else 0.0
        left = is_under_way if self.is_last else start.n_episodes - n_over
        return round(max(0.0, left * self.episodes_s / self.n_episodes_heard - under_way), 1)

    def _moves_left(self, n_moves: int) -> int:
        moves = self._n_valid()
        if not self.is_last or self.block is None:
            return max(0, n_moves - moves)
        if self.n_blocks_done > self.block.block:
            return 0
        return max(0, self.n_before_block + self.block.n_moves - moves)
