"""The policy server's core, shared with the replay: messages in, actions out. No LSL, no clock.

A move and its verdict come on two streams, in either order; the policy steps once it has both.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field

from bci_app.gridworld import ACTIONS, GridWorld
from bci_app.protocol import Action, Belief, Continued, EpisodeStart, Message, MoveOnset, Verdict, VerdictUsed
from bci_app.said import place_after
from policy.agent import Agent, Decision

BELIEF_DIGITS = 4
"""Of the probabilities that are told for people to look at."""


@dataclass
class Navigator:
    """Chooses the moves of one session.

    Attributes
    ----------
    agent : the recurrent policy with its hidden state.
    world : the map, to number the cells that messages give as (row, column).
    session : goes into every action.
    """

    agent: Agent
    world: GridWorld
    session: str
    _episode: EpisodeStart | None = None
    _decided: int = 0  # the step of the last action
    _newest: int = 0  # the step of the last move
    _last: Action | None = None
    _onset: MoveOnset | None = None
    _verdicts: dict[int, Verdict] = field(default_factory=dict)

    def begin(self, start: EpisodeStart) -> Action:
        """A new episode: forget the last one and choose the first move."""
        self._episode, self._decided, self._newest, self._onset, self._last = start, 1, 0, None, None
        self._verdicts.clear()
        decision = self.agent.begin(self.world.cell_at(*start.position), start.sensed)
        return self._action(decision, "missing")

    def moved(self, onset: MoveOnset) -> Action | None:
        """A move was shown; the next action if its verdict is here already."""
        if not self._is_current(onset) or onset.step != self._decided:
            return None
        self._onset, self._newest = onset, onset.step
        return self._decide()

    def judged(self, verdict: Verdict) -> Action | None:
        """The decoder's word on a move; the next action if that move was announced already."""
        if not self._is_current(verdict) or self.is_late(verdict) or self.is_known(verdict):
            return None
        self._verdicts[verdict.step] = verdict
        return self._decide()

    def missing(self) -> Action | None:
        """Give up waiting for the verdict of the last move: it is said to be missing."""
        return self._step("missing", None) if self._onset is not None else None

    def again(self, onset: MoveOnset, verdict: Verdict | None, went_on: bool) -> Action | None:
        """A move of the past, with its verdict if there is one, or, where the policy `went_on`, without."""
        action = self.moved(onset)
        if went_on:
            return self.missing()
        return self.judged(verdict) if verdict else action

    def relive(self, messages: Iterable[Message]) -> Action | None:
        """Go through an episode's messages, in order: the last action, which its move hasn't followed yet, if any."""
        said = list(messages)
        self._episode, self._onset, self._verdicts = None, None, {}
        verdicts = {message.step: message for message in reversed(said) if isinstance(message, Verdict)}
        actions = {message.step: message for message in said if isinstance(message, Action)}
        action: Action | None = None
        for message in said:
            match message:
                case EpisodeStart():
                    action = self.begin(message)
                case MoveOnset():
                    action = self.again(message, verdicts.get(message.step), is_without(actions.get(message.step + 1)))
        return action

    @property
    def in_episode(self) -> bool:
        """Whether an episode has begun."""
        return self._episode is not None

    def is_in(self, start: EpisodeStart) -> bool:
        """Whether this very episode is under way: its start was heard before."""
        return start == self._episode

    def forget_void(self, continued: Continued) -> bool:
        """Forget what the stimulus, started again, has made void. True where a move was among it: then `relive`."""
        if self._episode is None:
            return False
        episode, place = self._episode.episode, place_after(continued)
        self._verdicts = {step: verdict for step, verdict in self._verdicts.items() if (episode, step) <= place}
        return (episode, self._newest) > place

    def is_known(self, verdict: Verdict) -> bool:
        """Whether there is a verdict on that move already: from a decoder that was started again. The first counts."""
        return self._is_current(verdict) and verdict.step in self._verdicts

    @property
    def awaited(self) -> Action | None:
        """The last action, while the move it is for hasn't been made."""
        return self._last if self._last is not None and self._newest < self._last.step else None

    def belief(self) -> Belief | None:
        """Where the policy believed the goal to be as it chose the last action; None before the first."""
        if self._last is None:
            return None
        believed = self.agent.believed()
        return Belief(
            session=self.session,
            episode=self._last.episode,
            step=self._last.step,
            goal=tuple(round(probability, BELIEF_DIGITS) for probability in believed.goal),
            exact=believed.exact,
        )

    def is_late(self, verdict: Verdict) -> bool:
        """Whether the policy has already moved on without this verdict."""
        return self._is_current(verdict) and verdict.step < self._decided

    @property
    def waiting_for(self) -> MoveOnset | None:
        """The move whose verdict is awaited, if any."""
        return self._onset

    def _is_current(self, message: MoveOnset | Verdict) -> bool:
        return self._episode is not None and message.episode == self._episode.episode

    def _decide(self) -> Action | None:
        verdict = self._verdicts.get(self._decided) if self._onset else None
        if verdict is None:
            return None
        return self._step(used(verdict), verdict.evidence)

    def _step(self, verdict: VerdictUsed, said: float | None) -> Action | None:
        assert self._onset is not None
        assert self._episode is not None
        onset, self._onset = self._onset, None
        cell = self.world.cell_at(*onset.position)
        if onset.sensed[0] or onset.step >= self._episode.max_steps:
            return None
        decision = self.agent.step(ACTIONS.index(onset.action), cell, onset.sensed, verdict, said)
        self._decided = onset.step + 1
        return self._action(decision, verdict)

    def _action(self, decision: Decision, verdict: VerdictUsed) -> Action:
        assert self._episode is not None
        self._last = Action.model_validate(
            {
                "session": self.session,
                "episode": self._episode.episode,
                "step": self._decided,
                "action": ACTIONS[decision.action],
                "probabilities": decision.probabilities,
                "verdict": verdict,
                "evidence": decision.evidence,
            }
        )
        return self._last


def is_without(following: Action | None) -> bool:
    """Whether the action after a move was chosen without a verdict on it: when one came isn't in the samples."""
    return following is not None and following.verdict == "missing"


def used(verdict: Verdict) -> VerdictUsed:
    """What the policy takes from a verdict: a rejected or unjudged epoch says nothing, and that is told."""
    if verdict.outcome == "error":
        return "error"
    return "correct" if verdict.outcome == "correct" else "missing"
