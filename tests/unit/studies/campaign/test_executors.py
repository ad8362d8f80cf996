"""Pools of workers: what is asked before a cluster is joined, and how much each is given at once."""

import logging
import sys
from types import SimpleNamespace
from typing import Any

import pytest

from firmware_model.errors import ConfigError
from gustproof.studies.campaign import executors
from gustproof.studies.campaign.executors import dask_pool

TCP = "tcp://127.0.0.1:8786"


class Cluster:
    """A cluster in place of dask's: whom it was asked for, and its workers' cores."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, cores: dict[str, int]) -> None:
        self.steps = list[object]()
        self.closed = False
        self.ncores = lambda: cores
        self.get_executor = lambda **options: SimpleNamespace(submit=lambda *call: (call, options))

        async def knock(scheduler: str) -> None:
            self.steps.append(("knock", scheduler))

        def client(scheduler: str, **options: object) -> Cluster:
            self.steps.append((scheduler, options))
            return self

        monkeypatch.setattr(executors, "_knock", knock)
        fake: Any = SimpleNamespace(Client=client, KilledWorker=KeyError)
        monkeypatch.setitem(sys.modules, "distributed", fake)

    def __enter__(self) -> "Cluster":
        return self

    def __exit__(self, *_: object) -> None:
        self.closed = True


@pytest.mark.parametrize(("cores", "pending"), [({}, 2), ({"a": 3, "b": 5}, 16)])
def test_a_cluster_is_knocked_at_and_then_given_two_tasks_a_core(
    monkeypatch: pytest.MonkeyPatch, cores: dict[str, int], pending: int
) -> None:
    cluster = Cluster(monkeypatch, cores)
    with dask_pool(f"dask://{TCP}") as pool:
        assert pool.max_pending == pending
        assert pool.death_errors == (KeyError,)
        submitted: Any = pool.submit(max, 1, 2)
        assert submitted == ((max, 1, 2), {"pure": False})
        assert not cluster.closed
    assert cluster.steps == [("knock", TCP), (TCP, {"timeout": 10.0, "set_as_default": False})]
    assert cluster.closed
    assert logging.getLogger("distributed.client").level > logging.CRITICAL


@pytest.mark.parametrize(
    ("failure", "words"), [(OSError("refused"), "refused"), (RuntimeError("odd"), "another program answers")]
)
def test_nobody_who_does_not_answer_is_joined(monkeypatch: pytest.MonkeyPatch, failure: Exception, words: str) -> None:
    cluster = Cluster(monkeypatch, {})

    async def knock(_: str) -> None:
        raise failure

    monkeypatch.setattr(executors, "_knock", knock)
    with pytest.raises(ConfigError, match=f"no dask scheduler answers at {TCP}: {words}"), dask_pool(f"dask://{TCP}"):
        pass
    assert cluster.steps == []


@pytest.mark.parametrize("address", ["", TCP, f"http://{TCP}", "dask://127.0.0.1:8786", "dask:"])
def test_what_is_no_address_of_dask_is_refused(address: str) -> None:
    with pytest.raises(ConfigError, match="give dask://tcp://HOST:PORT"), dask_pool(address):
        pass


def test_without_dask_its_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ConfigError, match=r"pip install 'gustproof\[dask\]'"), dask_pool(f"dask://{TCP}"):
        pass
