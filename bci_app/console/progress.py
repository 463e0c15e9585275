"""How far a run is and how long it will still take, from the messages of the stimulus. Pure."""

from dataclasses import dataclass
from typing import Any

from bci_app.console.scores import Ledger
from bci_app.protocol import AnyMessage, BlockEnd, BlockStart, Pause, Resume, SessionEnd, SessionStart


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
                self.block = message
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
        paused = self.paused_s + (now - self.paused_since if self.paused_since is not None else 0.0)
        spent = now - self.began - paused
        if start.n_moves is not None:
            left = self._moves_left(start.n_moves)
            moves = sum(self.ledger.steps().values())
            return round(left * spent / moves, 1) if moves else None
        finished = [episode for episode in self.ledger.episodes.values() if episode.ended is not None]
        if not finished or start.n_episodes is None:
            return None
        mean = sum((episode.ended or 0.0) - episode.began for episode in finished) / len(finished)
        current = self.ledger.current
        is_under_way = current is not None and current.end is None
        under_way = now - current.began if current is not None and is_under_way else 0.0
        left = is_under_way if self.is_last else start.n_episodes - len(finished)
        return round(max(0.0, left * mean - under_way), 1)

    def _moves_left(self, n_moves: int) -> int:
        moves = sum(self.ledger.steps().values()) - self.ledger.n_rejected
        if not self.is_last or self.block is None:
            return max(0, n_moves - moves)
        if self.n_blocks_done > self.block.block:
            return 0
        return max(0, -(-moves // self.block.n_moves) * self.block.n_moves - moves)
