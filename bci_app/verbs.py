"""What `calibrate` and `online` do: find the files, check what can be checked beforehand, conduct the run."""

import re
import secrets
import shutil
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from bci_app import metrics
from bci_app.config import Config, PolicyConfig
from bci_app.eeg import EegDescription
from bci_app.errors import SetupError
from bci_app.gridworld import GridWorld, load_map
from bci_app.heard import Outcome
from bci_app.lookout import Look
from bci_app.lsl import describe, find_eeg, running_session
from bci_app.plan import Disturb, Plan, Task
from bci_app.progress import Progress
from bci_app.protocol import Role
from bci_app.recording import Recording, read
from bci_app.resuming import Stopped, find
from bci_app.runs import check_label, new_run
from bci_app.session import conduct
from bci_app.set_up import applied

MIN_SPEED = 0.1
SECONDS_A_MOVE = 5.0
"""Of recording, pauses and all (decided: 3 and some)."""
ANSWER_S = 1.0
"""Real seconds in which a session that runs on this computer answers (decided; it takes a hundredth)."""
SESSION_ID = re.compile(r"[A-Za-z0-9_-]+\Z")
MAX_SPEED = 100.0
"""Session seconds a real second beyond which no computer keeps up: a move would take 30 ms (decided)."""

if TYPE_CHECKING:
    from decoder.model import ModelInfo
    from policy.cards import PolicyCard


@dataclass(frozen=True)
class Wishes:
    """What the researcher asked for, before it is known to be possible.

    Attributes
    ----------
    config : resolved configuration.
    participant, visit : BIDS labels.
    simulate, speed : a simulated participant, and how much faster than real time.
    seed : of the run; None draws one.
    session : session id, needed with `remote`.
    remote : roles started by hand on other machines.
    disturb : what a drill does to the run.
    resume : go on where the last run of this task stopped.
    """

    config: Config
    participant: str
    visit: str = "S001"
    simulate: bool = False
    speed: float = 1.0
    seed: int | None = None
    session: str | None = None
    remote: tuple[str, ...] = ()
    disturb: Disturb | None = None
    resume: bool = False


def calibrate(wishes: Wishes, progress: Progress, look: Look | None = None) -> dict[str, Any]:
    """Conduct a calibration; its outcome with the recording's path. ``look`` is how to look at it after each block."""
    wishes = _checked(wishes)
    load_map(wishes.config.calibration.map)
    if not wishes.simulate:
        _look_at_eeg(wishes)
    goes_on = _stopped(wishes, "calibration", wishes.config.calibration.map)
    plan = _plan(wishes, "calibration", wishes.config.calibration.map)
    told = _told(conduct(replace(plan, look=look, goes_on=goes_on), progress)[0])
    return told | {"recordings": [*map(str, goes_on.recordings if goes_on else ()), told["recording"]]}


def _stopped(wishes: Wishes, task: Task, map_name: str) -> Stopped | None:
    if not wishes.resume:
        return None
    return find(wishes.config, wishes.participant, wishes.visit, task, map_name, wishes.simulate)


def online(
    wishes: Wishes,
    map_name: str,
    model_path: Path | None,
    policy: str | None,
    below_gate: bool,
    progress: Progress,
) -> tuple[dict[str, Any], Recording]:
    """Conduct an online run with the participant's decoder and the policy that suits it.

    Returns its outcome and its recording, which was read back anyway.

    Below the gate, unless a `policy` or `below_gate` is asked for, the run goes without verdicts; `policy_reason` says
    so.

    Raises SetupError for a missing or unfit model or policy.
    """
    wishes = _checked(wishes)
    world = load_map(map_name)
    from decoder.model import fit_stream, load

    goes_on = _stopped(wishes, "online", map_name)
    if goes_on is not None:
        wishes, model_path, policy = _as_before(wishes, goes_on.sidecar, model_path, policy)
    path = model_path or newest_model(Path(wishes.config.recordings), wishes.participant)
    model = load(path)
    if model.info.participant != wishes.participant and model_path is None:
        raise SetupError(
            f"{path} was calibrated on participant {model.info.participant}, not {wishes.participant}. Recalibrate, or "
            "name a decoder with --model."
        )
    card, reason = choose_policy(policy, model.info, wishes.config.policy, below_gate, world)
    if not wishes.simulate:
        eeg = _look_at_eeg(wishes)
        fit_stream(model, eeg.name, eeg.picked, eeg.sfreq)
    plan = _plan(wishes, "online", map_name, path, card.path)
    plan = replace(plan, told=str(model.info.evidence.told), goes_on=goes_on)
    progress(f"policy {card.name}: {reason}", 0, 1)
    outcome, recording = conduct(plan, progress)
    complete = outcome.reason == "complete"
    eeg_type = wishes.config.eeg.stream_type
    before = goes_on.recordings if goes_on else ()
    runs = [*(read(each, allow_damage=True, eeg_type=eeg_type) for each in before), recording]
    figures = metrics.online(runs) if complete else {}
    whose = model.info.participant
    others = () if whose == wishes.participant else (f"The decoder is participant {whose}'s.",)
    told = _told(outcome) | {
        "notes": [*outcome.notes, *others],
        "recordings": [*map(str, before), str(outcome.recording)],
        "figures": figures,
        "policy": card.name,
        "policy_reason": reason,
        "model": str(path),
        "cross_validated_accuracy": float(model.info.blocked["accuracy"]["value"]),
    }
    return told, recording


def _as_before(
    wishes: Wishes, sidecar: dict[str, Any], model: Path | None, policy: str | None
) -> tuple[Wishes, Path | None, str | None]:
    """What a run needs to go on as it was begun: its seed, its decoder and its policy, unless others are named."""
    before = {key: (sidecar.get(key) or {}).get("path") for key in ("model", "policy")}
    if model is None and before["model"]:
        model = Path(before["model"])
    return replace(wishes, seed=sidecar.get("seed")), model, policy or before["policy"]


def choose_policy(
    policy: str | None, info: "ModelInfo", settings: PolicyConfig, below_gate: bool, world: GridWorld
) -> tuple["PolicyCard", str]:
    """The policy of a run, and why it: as asked for, or by the decoder's cross-validated statistics.

    Raises SetupError when there is no such policy, or it is of another map.
    """
    from policy import cards

    accuracy, balanced = (float(info.blocked[name]["value"]) for name in ("accuracy", "balanced_accuracy"))
    if policy is not None:
        card = cards.named(policy, world, accuracy)
        cards.check_fits(card, world)
        return card, "as asked for"
    by_accuracy = settings.choice == "accuracy"
    if not (passes_gate(settings, accuracy, balanced) or below_gate):
        measure, gated = ("accuracy", accuracy) if by_accuracy else ("balanced accuracy", balanced)
        return cards.choose_without(world), (
            f"the decoder's cross-validated {measure} of {gated:.1%} is below the gate of {settings.gate_accuracy:.0%} "
            "from which verdicts shorten the way, so the agent searches without them. Recalibrate for a better "
            "decoder, or insist on verdicts by --below-gate"
        )
    if by_accuracy:
        return cards.choose_by_accuracy(accuracy, world), f"trained nearest to the accuracy of {accuracy:.1%}"
    reason = f"told the decoder's statistics, {info.evidence.information:.2f} bits a verdict"
    return cards.choose_told(world), reason


def passes_gate(settings: PolicyConfig, accuracy: float, balanced: float) -> bool:
    """Whether a decoder's verdicts shorten the way, so that a run uses them."""
    # The paper's gate looks at the plain accuracy, which flatters a decoder where errors are rare.
    return (accuracy if settings.choice == "accuracy" else balanced) >= settings.gate_accuracy


def disk(config: Config, eeg: EegDescription) -> tuple[float, float]:
    """Bytes that a calibration and two online runs need, generously, and that are free where recordings go."""
    folder = Path(config.recordings).absolute()
    while not folder.exists():
        folder = folder.parent
    calibration, online = config.calibration, config.online
    moves = calibration.n_blocks * calibration.moves_per_block + 2 * online.expected_moves
    a_sample = len(eeg.channels) * 8 + 9  # doubles at worst, and a stamp
    return moves * SECONDS_A_MOVE * eeg.sfreq * a_sample, float(shutil.disk_usage(folder).free)


def _check_disk(config: Config, eeg: EegDescription) -> None:
    needed, free = disk(config, eeg)
    if free < needed:
        raise SetupError(
            f"Only {free / 1e9:.2f} GB are free for recordings in {config.recordings}, and a session needs about "
            f"{needed / 1e9:.2f} GB. Free some, or choose another folder with `recordings = ...`."
        )


def _look_at_eeg(wishes: Wishes) -> EegDescription:
    """The lab's EEG stream, before anything is started or written: there, only once, with labels and units; and no
    session that runs on this computer already with the same id, or with an id of its own and for the same visit."""
    eeg = describe(find_eeg(wishes.config.eeg, timeout=5.0))
    eeg.check()
    _check_disk(wishes.config, eeg)
    theirs = [f"sub-{wishes.participant}_ses-{wishes.visit}_", *([f"{wishes.session}/"] if wishes.session else [])]
    running = running_session(theirs, ANSWER_S)
    if running is not None:
        raise SetupError(
            f"Session {running} is running on this computer already. End it first, or name another participant, visit "
            "or --session."
        )
    return eeg


def newest_model(folder: Path, participant: str) -> Path:
    """The participant's newest decoder: of the last visit, its last run, its last fit. SetupError if there is none."""
    pattern = f"sub-{check_label(participant, '--participant')}/ses-*/eeg/*_task-calibration_run-*_decoder*.safetensors"
    found = list(folder.glob(pattern))
    if not found:
        raise SetupError(
            f"No decoder of participant {participant} below {folder}. Run `bci-app calibrate --participant "
            f"{participant}` and `bci-app fit` on its recording first, or name a decoder with --model."
        )
    return max(found, key=_order)


def _order(model: Path) -> tuple[str, str, int]:
    """Visit, run and number of the fit, as the names tell them; times of files change when they are copied."""
    stem, _, number = model.stem.partition("_decoder")
    return model.parent.parent.name, stem, int(number.removeprefix("-") or 1)


def _checked(wishes: Wishes) -> Wishes:
    """The wishes with what their set-up file says. Raises SetupError for what is wrong whatever the hardware."""
    from stimulus import texts

    check(wishes)
    texts.load(wishes.config.stimulus.texts)
    return replace(wishes, config=applied(wishes.config))


def check(wishes: Wishes) -> None:
    """Raises SetupError for what is wrong whatever the hardware."""
    check_label(wishes.participant, "--participant")
    check_label(wishes.visit, "--visit")
    if wishes.speed != 1.0 and not wishes.simulate:
        raise SetupError(f"--speed {wishes.speed:g} needs --simulate: people and amplifiers run at speed 1.")
    if not MIN_SPEED <= wishes.speed <= MAX_SPEED:
        raise SetupError(f"--speed must be from {MIN_SPEED:g} to {MAX_SPEED:g}, found {wishes.speed:g}.")
    if wishes.seed is not None and wishes.seed < 0:
        raise SetupError(f"--seed must be 0 or more, found {wishes.seed}.")
    if wishes.session is not None and not SESSION_ID.match(wishes.session):
        raise SetupError(f"--session must be letters, digits, - and _ only, found {wishes.session!r}.")
    if wishes.remote and wishes.speed != 1.0:
        raise SetupError("--remote needs --speed 1: another machine's clock can't run faster.")
    unknown = sorted(set(wishes.remote) - set(get_args(Role)))
    if unknown:
        raise SetupError(f"--remote takes one of {', '.join(get_args(Role))}; found {', '.join(unknown)}.")
    if wishes.remote and wishes.session is None:
        raise SetupError("--remote needs --session ID, the id the processes on the other machines were started with.")


def _plan(wishes: Wishes, task: Task, map_name: str, model: Path | None = None, policy: Path | None = None) -> Plan:
    run = new_run(Path(wishes.config.recordings), wishes.participant, wishes.visit, task)
    return Plan(
        run=run,
        config=wishes.config,
        task=task,
        map=map_name,
        seed=secrets.randbelow(2**31) if wishes.seed is None else wishes.seed,
        simulate=wishes.simulate,
        speed=wishes.speed,
        model=model,
        policy=policy,
        remote=frozenset(role for role in get_args(Role) if role in wishes.remote),
        session=wishes.session,
        disturb=wishes.disturb,
    )


def _told(outcome: Outcome) -> dict[str, Any]:
    return asdict(outcome) | {"recording": str(outcome.recording)}
