"""The policy process: verdicts and sensed surroundings in, the next move out. It never hears of the goal."""

from collections.abc import Sequence

from bci_app.clock import Clock
from bci_app.config import PolicyConfig
from bci_app.errors import SetupError
from bci_app.gridworld import GridWorld
from bci_app.lsl import Received, local_clock
from bci_app.peer import Peer, State
from bci_app.protocol import (
    ACTIONS_STREAM,
    STIMULUS,
    VERDICTS,
    Action,
    Continued,
    EpisodeStart,
    MoveOnset,
    Recall,
    Resume,
    SessionEnd,
    SessionStart,
    Verdict,
)
from policy.agent import Agent
from policy.navigator import Navigator

POLL_S = 0.002
"""Real seconds a round waits for a verdict before it looks at the stimulus again."""


def run(
    config: PolicyConfig,
    session: str,
    clock: Clock,
    agent: Agent,
    world: GridWorld,
    parent: int | None = None,
    returning: bool = False,
) -> None:
    """Serve one session, from the stimulus's first message to its `SessionEnd`.

    When it is `returning` the session has begun already, with a policy that is gone.
    """
    peer = Peer(ACTIONS_STREAM, "policy", session, clock, parent)
    stimulus = peer.wait_for(STIMULUS)
    verdicts = peer.wait_for(VERDICTS)
    server = _Server(config, peer, Navigator(agent, world, session))
    if returning:
        server.recall(peer.remember())
    while not server.ended:
        peer.say(server.state)
        server.listen(peer.hear(verdicts, timeout=POLL_S))
        server.listen(peer.hear(stimulus))
        server.expire()
    peer.linger()


class _Server:
    """One session's navigator together with what only a live session has: patience and latencies."""

    def __init__(self, config: PolicyConfig, peer: Peer, navigator: Navigator) -> None:
        self.config = config
        self.peer = peer
        self.navigator = navigator
        self.ended = False
        self._onset_arrived = 0.0

    @property
    def state(self) -> State:
        return "running" if self.navigator.in_episode else "ready"

    def recall(self, recall: Recall) -> None:
        """Have the memory of the episode under way again. The last action may never have arrived: it is said again."""
        self._onset_arrived = local_clock()
        self._answer(self.navigator.relive(item.message for item in recall.said), local_clock())

    def listen(self, received: Sequence[Received]) -> None:
        for item in received:
            try:
                self._take(item)
            except ValueError as error:  # a position that isn't on the map
                self.peer.note("error", f"Refused {type(item.message).__name__}: {error}.")

    def _take(self, item: Received) -> None:
        match item.message:
            case SessionStart() as start:
                self._check_map(start)
            case EpisodeStart() as episode if not self.navigator.is_in(episode):
                self._answer(self.navigator.begin(episode), item.arrived)
            case MoveOnset() as onset:
                self._onset_arrived = item.arrived
                self._answer(self.navigator.moved(onset), item.arrived)
            case Continued() as continued if self.navigator.forget_void(continued):
                self.recall(self.peer.remember())
            case Verdict() as verdict:
                self._judged(verdict, item.arrived)
            case Resume():
                # The stimulus may have waited for an action that never reached it.
                self._answer(self.navigator.awaited, item.arrived)
            case SessionEnd():
                self.ended = True

    def expire(self) -> None:
        """A verdict that doesn't come is said to be missing, aloud."""
        waiting = self.navigator.waiting_for
        if waiting is None or local_clock() - self._onset_arrived < self.config.verdict_timeout_s:
            return
        self.peer.note(
            "warning",
            f"No verdict on episode {waiting.episode}, step {waiting.step} within "
            f"{self.config.verdict_timeout_s:g} s; taken as missing.",
        )
        self._answer(self.navigator.missing(), local_clock())

    def _judged(self, verdict: Verdict, arrived: float) -> None:
        if self.navigator.is_known(verdict):
            return
        if self.navigator.is_late(verdict):
            text = f"Verdict on episode {verdict.episode}, step {verdict.step} came after it was taken as missing."
            self.peer.note("warning", text)
            return
        self._answer(self.navigator.judged(verdict), arrived)

    def _answer(self, action: Action | None, since: float) -> None:
        if action is None:
            return
        self.peer.push(action.model_copy(update={"latency_ms": (local_clock() - since) * 1e3}))
        belief = self.navigator.belief()  # only now: the action doesn't wait for what is for people to look at
        if belief is not None:
            self.peer.push(belief)

    def _check_map(self, start: SessionStart) -> None:
        layout = self.navigator.world.layout()
        if start.layout != layout:
            raise SetupError(
                f"The stimulus runs map '{start.map}', but this policy was started for map "
                f"'{self.navigator.world.name}' of another layout. Start the policy with the stimulus's map."
            )
