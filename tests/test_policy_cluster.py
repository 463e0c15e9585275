"""A Dask cluster: what it makes is collected, and what it can't do is said, never waited for."""

import socket
import threading

import dask
import pytest
from dask.distributed import LocalCluster

from bci_app.errors import SetupError
from policy import cluster
from policy.cluster import connected, results

WHERE = {"processes": False, "threads_per_worker": 1, "host": "127.0.0.1", "protocol": "tcp://"}
RELEASED = threading.Event()


class Unreadable:
    """A task that no worker can take apart, as where a package is missing."""

    def __reduce__(self):
        return missing, ()


def missing():
    raise ModuleNotFoundError("No module named 'policy'")


def doubled(number):
    return 2 * number


def refusing(number):
    return ValueError(number) if number else number


def stopping(number):
    if number:
        raise ValueError(f"stopped at {number}")
    return number


def waiting(number):
    if number:
        RELEASED.wait(20)
    return number


@pytest.fixture
def one_worker():
    """The address of a cluster with a single worker of one thread."""
    with LocalCluster(n_workers=1, dashboard_address=None, **WHERE) as made:
        yield made.scheduler_address


def test_each_item_comes_back_with_its_number_from_a_single_worker(one_worker):
    with connected(one_worker) as client:
        assert sorted(results(client, doubled, [1, 2, 3])) == [(0, 2), (1, 4), (2, 6)]
        returned = dict(results(client, refusing, [0, 7]))
        assert isinstance(returned[1], ValueError)
        assert returned[0] == 0


def test_what_dask_cant_get_done_is_an_error_beside_the_others_results(one_worker):
    with connected(one_worker) as client:
        found = dict(results(client, doubled, [1, Unreadable(), 3]))
        stopped = dict(results(client, stopping, [0, 5]))
    assert (found[0], found[2]) == (2, 6)
    assert isinstance(found[1], SetupError)
    assert str(found[1]) == (f"the cluster at {one_worker} gave it up (ModuleNotFoundError: No module named 'policy')")
    assert stopped[0] == 0
    assert "ValueError: stopped at 5" in str(stopped[1])


def test_a_scheduler_that_is_lost_half_way_ends_the_work():
    RELEASED.clear()
    made = LocalCluster(n_workers=1, dashboard_address=None, **WHERE)
    with connected(made.scheduler_address) as client:
        coming = results(client, waiting, [0, 1, 2])
        assert next(coming) == (0, 0)
        made.sync(made.scheduler.close)
        with pytest.raises(SetupError, match=r"scheduler at tcp://127.* was lost.*the same command goes on"):
            list(coming)
        RELEASED.set()
        with pytest.raises(SetupError, match="was lost"):
            list(results(client, doubled, [1]))
    # It asks the scheduler, which is gone, and by default for half a minute.
    with dask.config.set({"distributed.comm.timeouts.connect": "0.2s"}):
        made.close()


@pytest.mark.parametrize(("package", "says"), [("errp-bci", r"has \d\S*"), ("errp-bci-absent", "has none")])
def test_machines_that_have_another_program_or_none_are_named(one_worker, monkeypatch, package, says):
    monkeypatch.setattr(cluster, "PACKAGE", package)
    monkeypatch.setattr(cluster, "own_version", lambda: "9.9")
    with (
        pytest.raises(
            SetupError, match=rf"must have {package} 9\.9.* tcp://\S+ {says}, the scheduler tcp://\S+ {says}"
        ),
        connected(one_worker),
    ):
        pass


def test_a_cluster_without_workers_is_said_to_have_none(monkeypatch):
    monkeypatch.setattr(cluster, "CONNECT_TIMEOUT_S", 1.0)
    with (
        LocalCluster(n_workers=0, dashboard_address=None, **WHERE) as made,
        pytest.raises(SetupError, match=r"has no worker after 1 s.*dask worker tcp://127"),
        connected(made.scheduler_address),
    ):
        pass


def test_a_scheduler_that_does_not_answer_is_named(monkeypatch):
    monkeypatch.setattr(cluster, "CONNECT_TIMEOUT_S", 0.5)
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))  # and doesn't listen
        address = f"tcp://127.0.0.1:{nobody.getsockname()[1]}"
        with (
            pytest.raises(SetupError, match=rf"No Dask scheduler answers at {address} within 0\.5 s"),
            connected(address),
        ):
            pass


def test_a_cluster_needs_an_address():
    with pytest.raises(SetupError, match="needs --scheduler ADDRESS"), connected(None):
        pass


@pytest.mark.parametrize("address", ["nonsense", "tcp://127.0.0.1", "127.0.0.1:8786"])
def test_what_is_no_address_is_refused_at_once(address):
    with pytest.raises(SetupError, match="should be an address like tcp://"), connected(address):
        pass
