"""The verb `study`: a cohort of participants under several conditions, and how many participants a study needs."""

from pathlib import Path
from typing import Annotated, cast

import typer

from bci_app.errors import SetupError
from bci_app.terminal import finish, if_interrupted, print_json, progress_bar


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command(rich_help_panel="In the lab")(study)


def study(
    study_file: Annotated[str, typer.Argument(metavar="STUDY", help="A study file (.toml); or wang2022, shipped.")],
    power: Annotated[
        bool, typer.Option("--power", help="Tell how many participants such a study needs, and conduct nobody.")
    ] = False,
    participant: Annotated[
        str | None, typer.Option("--participant", help="Conduct this one only; real participants come one by one.")
    ] = None,
    through: Annotated[
        str | None, typer.Option("--through", help="processes (over LSL), or one-process; default: as the file says.")
    ] = None,
    folder: Annotated[Path | None, typer.Option("--folder", help="Of the study; default: as the file says.")] = None,
    studies: Annotated[int, typer.Option("--studies", min=10, help="Simulated studies for --power.")] = 1000,
    backend: Annotated[str, typer.Option("--backend", help="local processes, or a dask cluster.")] = "local",
    scheduler: Annotated[str | None, typer.Option("--scheduler", help="Address of the Dask scheduler.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout, nothing else.")] = False,
) -> None:
    """Conduct a study: all that isn't done yet of it, then its report."""
    from bci_app.study import plan

    planned = plan.load(study_file)
    if folder is not None:
        planned = planned.model_copy(update={"folder": str(folder)})
    for option, found, known in (("--through", through, plan.WAYS), ("--backend", backend, ("local", "dask"))):
        if found is not None and found not in known:
            raise SetupError(f"{option} must be one of {', '.join(known)}; found {found!r}.")
    way = cast(plan.Through, through or planned.through)
    if power:
        from bci_app.study import power as powers

        with progress_bar(as_json) as progress:
            needed = powers.run(planned, studies, progress)
        finish(needed, as_json)
        return
    from bci_app.study import running

    with progress_bar(as_json) as progress, if_interrupted("The same command goes on."):
        result = running.run(planned, way, participant, backend, scheduler, progress)
    if as_json:
        print_json(result)
    else:
        running.show(result, typer.echo)
        for name in result["to_come"]:
            typer.echo(f"Next: bci-app study {study_file} --participant {name}")
