"""The verbs that hand recordings on: `export-bids` and `export`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from bci_app.bids.about import read_about
from bci_app.errors import SetupError
from bci_app.terminal import finish, progress_bar

PANEL = "Afterwards"
DamageOption = Annotated[bool, typer.Option("--allow-damage", help="Use what a damaged file still holds.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout, nothing else.")]


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.command("export-bids", rich_help_panel=PANEL)(export_bids)
    app.command("export", rich_help_panel=PANEL)(export)


def export_bids(
    recordings: Annotated[list[Path], typer.Argument(help="Recorded runs (.xdf), or folders that hold them.")],
    out: Annotated[Path, typer.Option("--out", help="Folder of the dataset: a new one, or one to go on with.")],
    about: Annotated[
        Path | None, typer.Option("--about", help="TOML file: authors, reference, participants ... (docs/bids.md).")
    ] = None,
    allow_damage: DamageOption = False,
    as_json: JsonOption = False,
) -> None:
    """Put recordings into a BIDS dataset; runs that are in it stay as they are."""
    from bci_app.bids.dataset import export_bids as put

    told = read_about(about)
    with progress_bar(as_json) as progress:
        result = put(recordings, out, told, allow_damage, progress)
    if not as_json:
        result |= {"runs": [_sentence(run) for run in result["runs"]]}
    finish(result, as_json, "" if result["left_out"] else f"Next: bids-validator-deno {out}")
    if not result["fit"]:
        raise typer.Exit(SetupError.exit_code)


def export(
    recording: Annotated[Path, typer.Argument(help="A recorded run (.xdf).")],
    out: Annotated[Path, typer.Option("--out", help="Folder to write into.")],
    kind: Annotated[str, typer.Option("--format", help="brainvision, or eeglab (.set).")] = "brainvision",
    allow_damage: DamageOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write one recording as BrainVision or EEGLAB files, with its table of events."""
    from bci_app.bids import plain

    match kind:
        case "brainvision" | "eeglab":
            pass
        case _:
            raise SetupError(f"--format must be brainvision or eeglab, found {kind!r}.")
    with progress_bar(as_json) as progress:
        result = plain.export(recording, out, kind, allow_damage, progress)
    finish(result, as_json)


def _sentence(run: dict[str, Any]) -> str:
    lost = f", {run['lost_samples']} samples missing" if run["lost_samples"] else ""
    return (
        f"{Path(run['eeg']).name}: {run['state']}, {run['samples']} samples {run['samples_are']}{lost}, "
        f"{run['events']} events, {run['placed']} of {run['epochs']} epochs at the decoder's sample"
    )
