"""Worker pools with one interface: processes of this machine, or a dask cluster."""

import asyncio
import gc
import logging
import os
import signal
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Future
from contextlib import contextmanager
from typing import Any, Protocol

from firmware_model.errors import ConfigError

_ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")}
_SAFE_PATH = "PYTHONSAFEPATH"  # keeps the current folder off the path of a Python that starts
_WORKER = {**_ONE_THREAD, _SAFE_PATH: "1"}
_CONNECT_S = 10.0


class Pool(Protocol):
    """Workers that fly chunks of runs."""

    death_errors: tuple[type[BaseException], ...]
    """Exceptions raised by a future whose worker died."""

    @property
    def max_pending(self) -> int:
        """Number of tasks that keeps all workers busy."""
        ...

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Call `function` on a worker."""
        ...


class _ProcessPool:
    """Processes of this machine; dead ones are replaced."""

    death_errors: tuple[type[BaseException], ...] = (BrokenExecutor,)

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._executor: Any = None

    @property
    def max_pending(self) -> int:
        return 2 * self._workers  # per worker one task runs and one waits

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        from loky import get_reusable_executor

        # the existing executor, or a new one if its workers have died
        with _safe_path():  # of loky's own processes too
            self._executor = get_reusable_executor(self._workers, initializer=_prepare_worker, env=_WORKER)
            future: Future[Any] = self._executor.submit(_call_and_freeze, function, *arguments)
        return future

    def shut_down(self, *, now: bool) -> None:
        if self._executor is not None:
            self._executor.shutdown(wait=True, kill_workers=now)


@contextmanager
def process_pool(workers: int) -> Iterator[Pool]:
    """Yield a pool of processes of this machine.

    The processes end with the block: after their tasks, or at once on an error or Ctrl-C.

    Examples
    --------
    >>> from gustproof import process_pool
    >>> with process_pool(2) as pool:
    ...     pool.submit(sum, [1, 2]).result()
    3
    """
    # a worker that has loaded compilers and designs is as large as it gets, and is no leak
    warnings.filterwarnings("ignore", message="A worker was restarted", category=UserWarning)
    pool = _ProcessPool(workers)
    try:
        yield pool
    except BaseException:
        pool.shut_down(now=True)
        raise
    pool.shut_down(now=False)


@contextmanager
def _safe_path() -> Iterator[None]:
    """Start each Python in the block without the current folder on its path."""
    before = os.environ.get(_SAFE_PATH)
    os.environ[_SAFE_PATH] = "1"
    try:
        yield
    finally:
        os.environ.pop(_SAFE_PATH)
        if before is not None:
            os.environ[_SAFE_PATH] = before


def _prepare_worker() -> None:
    """Ignore Ctrl-C and a terminal that closes, which reach all its processes: the parent handles them.

    What a user's controller starts has the path that it would have without us.
    """
    for name in ("SIGINT", "SIGHUP"):
        if number := getattr(signal, name, None):  # not every system has both
            signal.signal(number, signal.SIG_IGN)
    os.environ.pop(_SAFE_PATH, None)


def _call_and_freeze(function: Callable[..., Any], *arguments: Any) -> Any:
    """Return the result of `function`, after freezing loaded objects out of garbage collection.

    loky collects garbage after each task, at most once a second. To traverse all objects loaded by numba and scipy
    takes a tenth of that second.
    """
    result = function(*arguments)
    gc.collect()
    gc.freeze()
    return result


class _DaskPool:
    """Workers of a dask cluster."""

    def __init__(self, client: Any) -> None:
        from distributed import KilledWorker

        self.death_errors: tuple[type[BaseException], ...] = (KilledWorker,)
        self._client, self._executor = client, client.get_executor(pure=False)

    @property
    def max_pending(self) -> int:
        cores: dict[str, int] = self._client.ncores()
        return 2 * max(sum(cores.values()), 1)

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        future: Future[Any] = self._executor.submit(function, *arguments)
        return future


@contextmanager
def dask_pool(address: str) -> Iterator[Pool]:
    """Yield a pool of the workers of a dask cluster; `address` is its scheduler, e.g. dask://tcp://127.0.0.1:8786.

    Raises
    ------
    ConfigError
        If dask is not installed, or no scheduler answers at `address`.
    """
    scheme, _, scheduler = address.partition("://")
    if scheme != "dask" or "://" not in scheduler:
        raise ConfigError(f"--workers '{address}': give dask://tcp://HOST:PORT")
    try:
        from distributed import Client
    except ImportError:
        raise ConfigError("--workers: dask is not installed: pip install 'gustproof[dask]'") from None
    for name in ("distributed", "distributed.client"):  # this package reports its failures, in one line
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        # probe before creating a client: an unconnected client hangs in garbage collection
        asyncio.run(_knock(scheduler))
        client = Client(scheduler, timeout=_CONNECT_S, set_as_default=False)
    except Exception as error:  # a foreign server's answer may raise anything in dask
        reason = error if isinstance(error, (OSError, ValueError)) else "another program answers"
        raise ConfigError(f"--workers: no dask scheduler answers at {scheduler}: {reason}") from None
    with client:
        yield _DaskPool(client)


async def _knock(scheduler: str) -> None:
    """Connect to a dask scheduler, then disconnect."""
    from distributed.comm import connect

    connection = await connect(scheduler, timeout=_CONNECT_S)
    await connection.close()


def count_cores() -> int:
    """Return the number of cores available to this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
