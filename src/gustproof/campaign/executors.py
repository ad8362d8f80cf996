"""Who flies: processes of this machine, or a dask cluster; both behind `submit`."""

import asyncio
import gc
import logging
import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Future
from contextlib import contextmanager
from typing import Any, Protocol

from firmware_model.errors import ConfigError

_ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")}
_CONNECT_S = 10.0


class Pool(Protocol):
    """Workers that fly stretches of runs."""

    deaths: tuple[type[BaseException], ...]
    """What a future raises whose worker died."""

    @property
    def width(self) -> int:
        """How many tasks keep all workers busy."""
        ...

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Have a worker call `function`."""
        ...


class _ProcessPool:
    """Processes of this machine; those that die are replaced."""

    deaths: tuple[type[BaseException], ...] = (BrokenExecutor,)

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._executor: Any = None

    @property
    def width(self) -> int:
        return 2 * self._workers  # one flies, one waits its turn

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        from loky import get_reusable_executor

        # The one that there is, or a new one if its workers have died.
        self._executor = get_reusable_executor(self._workers, initializer=_ignore_sigint, env=_ONE_THREAD)
        future: Future[Any] = self._executor.submit(_call_and_freeze, function, *arguments)
        return future

    def end(self, *, now: bool) -> None:
        if self._executor is not None:
            self._executor.shutdown(wait=True, kill_workers=now)


@contextmanager
def process_pool(workers: int) -> Iterator[Pool]:
    """Give processes of this machine; they end with the block, at once if it is left by an error or Ctrl-C.

    Examples
    --------
    >>> from gustproof import process_pool
    >>> with process_pool(2) as pool:
    ...     pool.submit(sum, [1, 2]).result()
    3
    """
    pool = _ProcessPool(workers)
    try:
        yield pool
    except BaseException:
        pool.end(now=True)
        raise
    pool.end(now=False)


def _ignore_sigint() -> None:
    """Leave Ctrl-C, which reaches all processes of a terminal, to the one that waits for the others."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _call_and_freeze(function: Callable[..., Any], *arguments: Any) -> Any:
    """Return what `function` returns, and take what stays loaded out of the collector's sight.

    loky has a worker collect after each task, a second from the time before; to go through all that numba and scipy
    have loaded takes a tenth of that.
    """
    done = function(*arguments)
    gc.collect()
    gc.freeze()
    return done


class _DaskPool:
    """Workers of a dask cluster."""

    def __init__(self, client: Any) -> None:
        from distributed import KilledWorker

        self.deaths: tuple[type[BaseException], ...] = (KilledWorker,)
        self._client, self._executor = client, client.get_executor(pure=False)

    @property
    def width(self) -> int:
        cores: dict[str, int] = self._client.ncores()
        return 2 * max(sum(cores.values()), 1)

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        future: Future[Any] = self._executor.submit(function, *arguments)
        return future


@contextmanager
def dask_pool(address: str) -> Iterator[Pool]:
    """Give the workers of the dask cluster whose scheduler is at `address`, as dask://tcp://127.0.0.1:8786.

    Raises
    ------
    ConfigError
        If dask is not installed, or no scheduler answers there.
    """
    scheme, _, scheduler = address.partition("://")
    if scheme != "dask" or "://" not in scheduler:
        raise ConfigError(f"--executor '{address}': give dask://tcp://HOST:PORT")
    try:
        from distributed import Client
    except ImportError:
        raise ConfigError("--executor: dask is not installed: pip install 'gustproof[dask]'") from None
    for name in ("distributed", "distributed.client"):  # what it complains of is told by this package, in a line
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        # Before there is a client: one that did not get through hangs when it is collected.
        asyncio.run(_knock(scheduler))
        client = Client(scheduler, timeout=_CONNECT_S, set_as_default=False)
    except Exception as error:  # whatever the answer of something else leads dask to
        reason = error if isinstance(error, (OSError, ValueError)) else "what answers is something else"
        raise ConfigError(f"--executor: no dask scheduler answers at {scheduler}: {reason}") from None
    with client:
        yield _DaskPool(client)


async def _knock(scheduler: str) -> None:
    """Shake hands with a dask scheduler, and leave."""
    from distributed.comm import connect

    connection = await connect(scheduler, timeout=_CONNECT_S)
    await connection.close()


def count_cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
