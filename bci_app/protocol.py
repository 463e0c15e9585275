"""All messages and streams of the loop, in one place. docs/protocol.md is the page for other people's programs.

A message is one JSON object in a one-channel string sample. Its LSL time stamp is part of it: for `MoveOnset` it is
the session time of the flip. ``(session, episode, step)`` is the key of a move in every message.
"""

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

PROTOCOL_VERSION: Literal[5] = 5
"""What we send. Older ones are still read, for calibrations are kept in them: 4 is the same without `Link`,
`LateFrame`, `Screen` and `Belief`, 3 also without `Returned`, `Recall`, `Continued` and `Status.hears`, 2 also without
`Electrodes`, 1 also without `Verdict.evidence`."""

Position = tuple[int, int]
"""(row, column), both from 0, row 0 in the north."""
Sensed = tuple[bool, bool, bool, bool, bool]
"""Goal sensed: here, north, south, west, east."""
ActionName = Literal["north", "south", "west", "east"]
VerdictUsed = Literal["error", "correct", "missing"]
Role = Literal["stimulus", "decoder", "policy", "amplifier", "session", "console"]
Index = Annotated[int, Field(ge=0)]
Step = Annotated[int, Field(ge=1)]


class Message(BaseModel):
    """What all messages carry. Immutable; unknown fields are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    protocol: Literal[1, 2, 3, 4, 5] = PROTOCOL_VERSION
    session: str


class SessionStart(Message):
    """First message of a run: what is going to happen, on which map."""

    type: Literal["SessionStart"] = "SessionStart"
    task: Literal["calibration", "online"]
    participant: str
    map: str
    layout: list[str]
    n_episodes: int | None = None
    n_blocks: int | None = None
    n_moves: int | None = None


class BlockStart(Message):
    """A block of calibration moves begins."""

    type: Literal["BlockStart"] = "BlockStart"
    block: Index
    n_moves: int


class BlockEnd(Message):
    """A block is over; a break follows."""

    type: Literal["BlockEnd"] = "BlockEnd"
    block: Index
    n_moves: int


class EpisodeStart(Message):
    """The agent stands at a new start. The goal is not told here: see `EpisodeGoal` on the truth stream."""

    type: Literal["EpisodeStart"] = "EpisodeStart"
    episode: Index
    position: Position
    sensed: Sensed
    max_steps: int


class MoveOnset(Message):
    """The agent jumped; the LSL stamp is the time of the flip that showed it."""

    type: Literal["MoveOnset"] = "MoveOnset"
    episode: Index
    step: Step
    action: ActionName
    position: Position
    sensed: Sensed


class EpisodeEnd(Message):
    """The episode is over, a rest after its last move."""

    type: Literal["EpisodeEnd"] = "EpisodeEnd"
    episode: Index
    steps: Index
    reason: Literal["goal", "limit", "block", "aborted"]


class Pause(Message):
    """The stimulus waits; it says for what."""

    type: Literal["Pause"] = "Pause"
    reason: str
    by_person: bool = False
    """Whether only a person's key ends it."""


class Resume(Message):
    """The stimulus goes on after a pause."""

    type: Literal["Resume"] = "Resume"


class Continued(Message):
    """The stimulus was started again and goes on after this step: whatever was announced of later ones is void."""

    type: Literal["Continued"] = "Continued"
    episode: Annotated[int, Field(ge=-1)]
    """-1 before the first."""
    step: Index | None = None
    """Moves of the episode that count; None where it is over."""


class SessionEnd(Message):
    """Last message of a run."""

    type: Literal["SessionEnd"] = "SessionEnd"
    reason: Literal["complete", "interrupted", "failed"]
    text: str = ""


class RunSeed(Message):
    """Truth stream only: the seed all goals and a calibration's errors follow from. Sent with `SessionStart`."""

    type: Literal["RunSeed"] = "RunSeed"
    seed: int


class EpisodeGoal(Message):
    """Truth stream only: where the goal of an episode is."""

    type: Literal["EpisodeGoal"] = "EpisodeGoal"
    episode: Index
    goal: Position
    distance: Index


class Truth(Message):
    """Truth stream only: whether the move made the shortest path to the goal longer. Stamp: the move's onset."""

    type: Literal["Truth"] = "Truth"
    episode: Index
    step: Step
    error: bool
    distance: Index


class Electrodes(Message):
    """Which channels are bad, as the decoder found at an episode's start, or before a step where moves were rejected;
    they are repaired from the others until the next. Looked at are the `n_samples` EEG samples that end with the one
    stamped `last_time`; none where there were too few."""

    type: Literal["Electrodes"] = "Electrodes"
    episode: Index
    step: Index = 0
    """The first that is judged so; 0 at an episode's start."""
    bad: dict[str, list[str]] = {}
    """Faults of each bad channel, as `decoder.quality.Fault`."""
    last_time: float | None = None
    """Raw stamp of the newest sample looked at."""
    n_samples: Index = 0


class Verdict(Message):
    """The decoder's word on a move. Stamp: session time at which it was pushed.

    `outcome` is `rejected` when the epoch can't be judged (`reason` says why) and `unjudged` in a calibration, when
    there is no decoder yet and the epoch is only checked.
    """

    type: Literal["Verdict"] = "Verdict"
    episode: Index
    step: Step
    outcome: Literal["error", "correct", "rejected", "unjudged"]
    reason: str | None = None
    by_time: bool = False
    """Rejected because of when things came, not of what is in the samples: a replay takes it over."""
    log_odds: float | None = None
    """Natural log of P(error)/P(correct) under the classifier's priors."""
    evidence: float | None = None
    """Calibrated log-likelihood ratio, natural log of P(log odds | error)/P(log odds | correct), within 10 of 0; None
    where there is no verdict."""
    clock_offset: float
    """Seconds added to the onset's stamp to put it on the EEG stream's clock."""
    first_time: float | None = None
    """Raw stamp of the first EEG sample used."""
    n_samples: Index = 0
    digest: str | None = None
    """First 16 hex digits of the SHA-256 of the features (float64, little-endian, in order)."""
    latency_ms: float | None = None
    """Real milliseconds from the arrival of the last needed sample at the decoder to the push of this message."""


class Action(Message):
    """The policy's next move: what to do at `step` of `episode`."""

    type: Literal["Action"] = "Action"
    episode: Index
    step: Step
    action: ActionName
    probabilities: tuple[float, float, float, float]
    verdict: VerdictUsed
    """The verdict of the move before, as the policy took it; `missing` before the first move."""
    evidence: float = 0.0
    """What the policy took it for: natural log of P(verdict | error)/P(verdict | correct); 0 where it is missing."""
    latency_ms: float | None = None
    """Real milliseconds from the verdict's arrival (or the episode's start) to the push of this message."""


class Status(Message):
    """How a process is doing; repeated every half second, so that late listeners hear it."""

    type: Literal["Status"] = "Status"
    role: Role
    state: Literal["waiting", "ready", "running", "done", "failed"]
    text: str = ""
    hears: dict[str, float] = {}
    """Stamp of the newest message heard on each stream it listens to, by the stream's name."""


class Note(Message):
    """Something a reader of the recording must know: a lost peer, a late truth, a refused message."""

    type: Literal["Note"] = "Note"
    role: Role
    level: Literal["info", "warning", "error"]
    text: str


class Link(Message):
    """How well a process hears a stream; said once a second of real time."""

    type: Literal["Link"] = "Link"
    role: Role
    """Who hears it."""
    stream: str
    """The stream's name."""
    age_s: Annotated[float, Field(ge=0)]
    """Real seconds since its newest sample came."""
    rate_hz: float | None = None
    """Samples a session second lately; None where that tells nothing, as of a stream of messages."""
    gaps: Index = 0
    """Times that samples were missing, so far."""
    offset_s: float | None = None
    """Seconds to add to its stamps to put them on this process's clock; None where not known yet."""
    reconnects: Index = 0
    """Times that it was silent for more than a second and came back, so far."""


class LateFrame(Message):
    """A picture came to the screen later than it was due, or one was left out."""

    type: Literal["LateFrame"] = "LateFrame"
    episode: Annotated[int, Field(ge=-1)]
    """-1 before the first."""
    step: Index | None = None
    """The move whose jump was late; None for any other picture."""
    late_ms: Annotated[float, Field(ge=0)]


class Screen(Message):
    """What the participant sees between the moves: `name` is that of an instruction, a break, the end ..."""

    type: Literal["Screen"] = "Screen"
    name: str


class Belief(Message):
    """Where the policy believes the goal to be, as it chose the action for `step`. For people to look at: nothing
    depends on it."""

    type: Literal["Belief"] = "Belief"
    episode: Index
    step: Step
    goal: tuple[Annotated[float, Field(ge=0, le=1)], ...]
    """Probability of each free cell of the map, row by row."""
    exact: bool = False
    """Computed by Bayes' rule from what the policy heard, for it has learnt no belief of its own."""


class Command(Message):
    """From bci-app to the stimulus: begin, pause and go on again because of the other processes, stop as soon as
    possible, or finish: complete after the block, or online the episode, under way. From the console to bci-app: what
    the experimenter asks for."""

    type: Literal["Command"] = "Command"
    command: Literal["start", "pause", "resume", "stop", "finish"]
    text: str = ""
    """Why."""
    by_person: bool = False
    """Whether it is a person's: only a person ends the pause."""


class Returned(Message):
    """A process that was started again, and hears the others by now, asks what it missed. Repeated until the answer,
    `Recall`, comes."""

    type: Literal["Returned"] = "Returned"
    role: Role


Tellable = (
    SessionStart
    | BlockStart
    | BlockEnd
    | EpisodeStart
    | MoveOnset
    | EpisodeEnd
    | Pause
    | Resume
    | SessionEnd
    | Electrodes
    | Verdict
    | Action
    | Command
)
"""What a process that was started again may have to know."""


class Said(BaseModel):
    """Something that was said before, and its stamp."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    stamp: float
    message: Annotated[Tellable, Field(discriminator="type")]


class Recall(Message):
    """The answer to `Returned`: what a process must know of what was said until then, in the order of the stamps."""

    type: Literal["Recall"] = "Recall"
    role: Role
    said: tuple[Said, ...]


AnyMessage = (
    Tellable
    | Continued
    | RunSeed
    | EpisodeGoal
    | Truth
    | Status
    | Note
    | Returned
    | Recall
    | Link
    | LateFrame
    | Screen
    | Belief
)
_adapter: TypeAdapter[AnyMessage] = TypeAdapter(Annotated[AnyMessage, Field(discriminator="type")])


class BadMessage(ValueError):
    """A sample that is no message of this protocol."""


def encode(message: Message) -> str:
    """The JSON text of a message; floats survive to the bit."""
    return message.model_dump_json(exclude_none=True)


def decode(text: str | bytes, session: str | None = None) -> AnyMessage:
    """Parse a message. Raises BadMessage for anything else, and for another session's message."""
    try:
        message = _adapter.validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise BadMessage(f"expected a message of protocol {PROTOCOL_VERSION}; found {where}: {first['msg']}") from error
    if session is not None and message.session != session:
        raise BadMessage(f"expected session '{session}'; found a message of session '{message.session}'")
    return message


@dataclass(frozen=True)
class StreamSpec:
    """A stream of the loop. Name and source id are what others resolve; the source id carries the session."""

    name: str
    kind: str
    role: Role
    string: bool = True

    PREFIX: ClassVar[str] = "bci-app"

    def source_id(self, session: str) -> str:
        """Stable over restarts of the process, different for every session."""
        return f"{self.PREFIX}/{session}/{self.name}"


STIMULUS = StreamSpec("bci-stimulus", "Events", "stimulus")
TRUTH = StreamSpec("bci-truth", "Truth", "stimulus")
MARKERS = StreamSpec("bci-markers", "Markers", "stimulus", string=False)
VERDICTS = StreamSpec("bci-verdicts", "Events", "decoder")
ACTIONS_STREAM = StreamSpec("bci-actions", "Events", "policy")
AMPLIFIER_NOTES = StreamSpec("bci-amplifier", "Events", "amplifier")
SESSION = StreamSpec("bci-session", "Events", "session")
CONSOLE = StreamSpec("bci-console", "Events", "console")


def simulated_source_id(session: str) -> str:
    """Source id of the simulated amplifier's EEG stream: other sessions' amplifiers are never taken for it."""
    return f"{StreamSpec.PREFIX}/{session}/eeg"


STREAMS = (STIMULUS, TRUTH, MARKERS, VERDICTS, ACTIONS_STREAM, AMPLIFIER_NOTES, SESSION, CONSOLE)

ACTION_CODES: dict[str, int] = {"north": 1, "south": 2, "west": 3, "east": 4}
PLAIN_CODES = {
    "EpisodeStart": 20,
    "Pause": 30,
    "Resume": 31,
    "Continued": 32,
    "SessionStart": 100,
    "SessionEnd": 101,
    "BlockStart": 110,
    "BlockEnd": 111,
}
END_CODES = {"goal": 21, "limit": 22, "block": 23, "aborted": 24}


def marker_code(message: Message) -> int | None:
    """The int32 twin of a stimulus message for tools that can't read strings; None for those without one.

    No code tells the truth of a move: whoever reads the markers can't peek.
    """
    match message:
        case MoveOnset():
            return ACTION_CODES[message.action]
        case EpisodeEnd():
            return END_CODES[message.reason]
        case _:
            return PLAIN_CODES.get(type(message).__name__)
