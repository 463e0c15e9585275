"""Policy files: safetensors weights with the card of the policy in their metadata. A file can't run code."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save as serialize

from bci_app.errors import SetupError
from bci_app.gridworld import GridWorld
from policy.network import Network
from policy.observation import LAYOUT

PRETRAINED = Path(__file__).parent / "pretrained"
ENDING = ".safetensors"


@dataclass(frozen=True)
class PolicyCard:
    """What a policy is for and how it came about.

    Attributes
    ----------
    map, map_digest : name and SHA-256 of the map it was trained on.
    accuracy : probability of a right verdict in training; None for a policy without verdicts.
    layout : name of the input layout.
    n_inputs, n_cells : sizes of the network.
    recipe : hyper-parameters, seed, versions and figures; free-form, for people.
    path : the file it was read from; not stored.
    """

    map: str
    map_digest: str
    accuracy: float | None
    layout: str
    n_inputs: int
    n_cells: int
    recipe: dict[str, Any]
    path: Path | None = None

    @property
    def name(self) -> str:
        """Name of its file without the ending: the map, then ``none`` or the accuracy in percent."""
        return f"{self.map}_{'none' if self.accuracy is None else f'{self.accuracy * 100:03.0f}'}"


def save(path: Path, network: Network, card: PolicyCard) -> None:
    """Write weights and card into one file."""
    fields = {key: value for key, value in asdict(card).items() if key != "path"}
    path.parent.mkdir(parents=True, exist_ok=True)
    weights = {name: tensor.contiguous() for name, tensor in network.state_dict().items()}
    # Bytes, for save_file makes files that only their owner may read.
    path.write_bytes(serialize(weights, metadata={"card": json.dumps(fields, sort_keys=True)}))


def read_card(path: Path) -> PolicyCard:
    """The card of a policy file; SetupError when it is no policy file."""
    try:
        with safe_open(path, framework="pt") as file:
            return PolicyCard(**json.loads((file.metadata() or {})["card"]), path=path)
    except (OSError, SafetensorError, KeyError, TypeError, ValueError) as error:
        raise SetupError(
            f"'{path}' must be a policy file written by `python -m policy`, but can't be read as one ({error}). "
            "Choose another file or train the policy again."
        ) from error


def load(path: Path) -> tuple[Network, PolicyCard]:
    """Network and card of a policy file.

    Raises SetupError when it is no policy file, or its input layout isn't this program's.
    """
    card = read_card(path)
    if card.layout != LAYOUT:
        raise SetupError(
            f"Policy '{path}' must read the input layout '{LAYOUT}', but was trained on '{card.layout}'. "
            "Use the program version it was trained with, or train it again."
        )
    network = Network(card.n_inputs, card.n_cells)
    try:
        with safe_open(path, framework="pt") as file:
            network.load_state_dict({name: file.get_tensor(name) for name in file.keys()})  # noqa: SIM118
    except (RuntimeError, SafetensorError) as error:
        raise SetupError(f"Policy '{path}' has weights of another network ({error}). Train it again.") from error
    return network.eval(), card


def check_fits(card: PolicyCard, world: GridWorld) -> None:
    """Raise SetupError unless the policy was trained on this very map."""
    if card.map_digest != world.digest:
        raise SetupError(
            f"Policy '{card.name}' was trained on map '{card.map}' (digest {card.map_digest[:12]}), but the session's "
            f"map is '{world.name}' (digest {world.digest[:12]}). Choose a policy of this map or train one: "
            f"python -m policy --map {world.name} --accuracy 0.75"
        )


def library(folder: Path = PRETRAINED) -> list[PolicyCard]:
    """Cards of all policies in a folder, by default the shipped ones, ordered by file name."""
    return [read_card(path) for path in sorted(folder.glob(f"*{ENDING}"))]


def choose(accuracy: float | None, world: GridWorld, folder: Path = PRETRAINED) -> PolicyCard:
    """The policy of this map trained at the accuracy nearest to the decoder's (paper V.B.2: 78 % -> 0.80).

    Of two equally near the lower one: it trusts the verdicts less. ``None`` asks for the policy without verdicts,
    which no accuracy ever selects. Raises SetupError when there is none.
    """
    fitting = [card for card in library(folder) if card.map_digest == world.digest]
    if accuracy is None:
        without = [card for card in fitting if card.accuracy is None]
        return _first(without, world, "without verdicts", folder)
    trained = [card for card in fitting if card.accuracy is not None]
    # Rounded, for 0.75 - 0.725 and 0.725 - 0.70 differ in binary.
    trained.sort(key=lambda card: (round(abs((card.accuracy or 0) - accuracy), 9), card.accuracy))
    return _first(trained, world, "with verdicts", folder)


def _first(cards: list[PolicyCard], world: GridWorld, kind: str, folder: Path) -> PolicyCard:
    if cards:
        return cards[0]
    raise SetupError(
        f"No policy {kind} for map '{world.name}' in {folder}. Train one: "
        f"python -m policy --map {world.name} --out {folder}"
    )
