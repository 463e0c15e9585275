"""A Dask cluster: whether it is there and can do the work, and the work itself, handed out and collected.

Tasks go to Dask directly: through joblib, one that Dask itself gives up would be waited for without end.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from typing import Any, TypeVar

from bci_app.errors import SetupError

Item = TypeVar("Item")
Made = TypeVar("Made")

CONNECT_TIMEOUT_S = 10.0
"""Real seconds a scheduler may take to answer, and its first worker to be there."""
PACKAGE = "errp-bci"
ADDRESS = re.compile(r"(tcp|tls|ws|wss|ucx)://[^\s/]+:\d+")
"""Of a scheduler: dask would try others for long, and complain of more than one thing."""


@contextmanager
def connected(address: str | None) -> Iterator[Any]:
    """A client of the cluster whose scheduler is at an address, as tcp://192.168.1.10:8786.

    Raises SetupError when Dask isn't installed, no scheduler answers, it has no worker, or the program isn't the same
    everywhere.
    """
    if address is None:
        raise SetupError("--backend dask needs --scheduler ADDRESS, as in tcp://192.168.1.10:8786.")
    try:
        from dask.distributed import Client
    except ImportError as error:
        raise SetupError("--backend dask needs the package dask: pip install 'errp-bci[cluster]'.") from error
    if not ADDRESS.fullmatch(address):
        raise SetupError(f"--scheduler should be an address like tcp://192.168.0.5:8786, found {address!r}.")
    try:
        client = Client(address, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise SetupError(
            f"No Dask scheduler answers at {address} within {CONNECT_TIMEOUT_S:g} s ({error}). Start one with `dask "
            "scheduler` and workers with `dask worker ADDRESS --nworkers=-1 --nthreads=1`, or leave out --backend."
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=CONNECT_TIMEOUT_S)
        except TimeoutError as error:
            raise SetupError(
                f"The Dask scheduler at {address} has no worker after {CONNECT_TIMEOUT_S:g} s. Start some with `dask "
                f"worker {address} --nworkers=-1 --nthreads=1`."
            ) from error
        _check_versions(client, address)
        yield client


def _check_versions(client: Any, address: str) -> None:
    """Refuse a cluster whose machines have another program: they would train other policies, or none."""
    ours, found = own_version(), _versions(client, address)
    others = [f"{where} has {said}" for where, said in found.items() if said != ours]
    if others:
        raise SetupError(
            f"All of the cluster must have {PACKAGE} {ours}, as this machine has, but {', '.join(others)}. Install it "
            "there and start the workers anew."
        )


def own_version() -> str:
    """Of this machine. Raises SetupError where the program runs without having been installed."""
    try:
        return version(PACKAGE)
    except PackageNotFoundError as error:
        raise SetupError(f"A cluster needs {PACKAGE} installed, here as there: pip install {PACKAGE}.") from error


def _versions(client: Any, address: str) -> dict[str, str]:
    """The program's version at each address; the scheduler takes jobs apart, too, so it is asked as well."""
    # `version` is Python's own: a machine that lacks our package can still be asked.
    found = client.run(version, PACKAGE, on_error="return")
    try:
        found |= {f"the scheduler {address}": client.run_on_scheduler(version, PACKAGE)}
    except PackageNotFoundError as error:
        found |= {f"the scheduler {address}": error}
    return {where: "none" if isinstance(said, PackageNotFoundError) else str(said) for where, said in found.items()}


def results(
    client: Any, function: Callable[[Item], Made], items: Sequence[Item]
) -> Iterator[tuple[int, Made | SetupError]]:
    """Each item's number and what the function made of it on some worker, as they get ready.

    In place of what Dask couldn't get done, as a worker was killed or couldn't read the task, there is a SetupError.
    One is raised when the scheduler is lost, and all that is under way with it.
    """
    from dask.distributed import CancelledError, as_completed

    where = client.scheduler.address
    lost = (
        f"The Dask scheduler at {where} was lost, and with it what was under way. Start it and its workers again; the "
        "same command goes on with what is missing."
    )
    if client.status != "running":
        raise SetupError(lost)
    numbers = {client.submit(function, item, pure=False): number for number, item in enumerate(items)}
    for future in as_completed(list(numbers), loop=client.loop):
        try:
            error = future.exception()
            made = future.result() if error is None else SetupError(_given_up(where, error))
        except (OSError, CancelledError) as gone:
            raise SetupError(lost) from gone
        yield numbers[future], made


def _given_up(where: str, error: BaseException) -> str:
    """Dask's error in one line; what caused it says more than how Dask wraps it."""
    cause = error.__cause__ or error
    return f"the cluster at {where} gave it up ({type(cause).__name__}: {' '.join(str(cause).split())})"
