"""Fly a campaign on a pool of workers, and survive the death of workers."""

import json
from collections import Counter, deque
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from pathlib import Path
from typing import Any

from gustproof.errors import FlightError
from gustproof.flight.routes.kernels import LANES
from gustproof.studies.campaign.executors import Pool, count_cores, process_pool
from gustproof.studies.campaign.growth import take_runs
from gustproof.studies.campaign.plan import Campaign, check_given
from gustproof.studies.campaign.store import Shard, Store
from gustproof.studies.campaign.worker import Chunk, ChunkResult, check_worker, failed_rows, fly_chunk

Task = Callable[[str, Chunk], ChunkResult]
_TASK_S = 1.0  # work per task: much against the cost of sending it, little to lose
_MAX_CHUNK = 100 * LANES
_GROWTH = 16  # largest factor from a chunk to the next: a short chunk is a poor measure of the time per run
_MAX_DEATHS = 2  # dead workers after which a run flown alone counts as the cause


def fly_campaign(
    campaign: Campaign,
    output: Path,
    pool: Pool | None = None,
    *,
    chunk_runs: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    task: Task = fly_chunk,
    known: Path | None = None,
    shard: Shard | None = None,
) -> None:
    """Fly the runs still missing and write all runs as one Parquet file, one row per run.

    With `shard` only its runs are flown, and stay in a folder beside `output`. Once all shards have left theirs there,
    the same campaign without a shard writes the file: the bytes are those of one run.

    Without `pool` the workers are one process a core. `known` is the table of a smaller campaign, made larger by
    `grow_campaign`; its runs are not flown again.

    Tasks are chunks of `chunk_runs` runs, by default about a second of work; the file does not depend on it.
    `progress` receives the number of runs flown and the number to fly. The task of a dead worker is repeated. Bisection
    isolates a run that kills its workers; it is recorded with the reason. `task` is the function that workers call.

    Raises
    ------
    ConfigError
        If the output can't be written, or its parts belong to another campaign.
    FlightError
        If the disk is full; finished runs stay.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from gustproof import Campaign, compute_statistics, fly_campaign, process_pool
    >>> from gustproof import load_law, load_scenario, load_vehicle_set
    >>> scenario = replace(load_scenario("paper-turbulence"), duration_s=0.5)
    >>> plan = Campaign(
    ...     scenario=scenario, laws=(load_law("pid-fair"),), vehicles=load_vehicle_set("paper"), spreads={}, cases=64
    ... )
    >>> with TemporaryDirectory() as folder, process_pool(1) as pool:
    ...     fly_campaign(plan, Path(folder) / "mc.parquet", pool)
    ...     found = compute_statistics(Path(folder) / "mc.parquet")
    >>> found.laws[0].figures["rmse_deg"].flown
    64
    """
    if pool is None:
        with process_pool(count_cores()) as pool:
            options: dict[str, Any] = {"chunk_runs": chunk_runs, "progress": progress, "task": task}
            fly_campaign(campaign, output, pool, known=known, shard=shard, **options)
        return
    with Store(output, campaign, shard) as store:
        if known is not None:
            take_runs(known, campaign, store)
        _Runner(campaign, store, pool, chunk_runs, progress or (lambda *_: None), task).run()
        if shard is None:
            store.finish()


class _Runner:
    """Running and waiting tasks; the number of running tasks bounds the memory."""

    def __init__(
        self,
        campaign: Campaign,
        store: Store,
        pool: Pool,
        chunk_runs: int | None,
        progress: Callable[[int, int], None],
        task: Task,
    ) -> None:
        self._campaign, self._store, self._pool, self._task = campaign, store, pool, task
        self._metadata, self._progress = json.dumps(campaign.metadata()), progress
        self._fixed = chunk_runs is not None
        self._least = LANES if campaign.flies_in_lanes else 1  # fewer lanes take as long
        self._size = chunk_runs or self._least
        self._waiting = deque(store.missing_chunks())
        check_given((campaign.law_of(chunk.first) for chunk in self._waiting), store.folder)
        self._running: dict[Future[ChunkResult], Chunk] = {}
        self._suspects: deque[Chunk] = deque()  # chunks that ran when a worker died
        self._isolating = False  # True while a suspect flies alone
        self._deaths: Counter[Chunk] = Counter()
        self._pending_runs, self._flown_runs = sum(chunk.runs for chunk in self._waiting), 0

    def run(self) -> None:
        self._progress(0, self._pending_runs)
        while self._waiting or self._suspects or self._running:
            self._submit_pending()
            done, _ = wait(self._running, return_when=FIRST_COMPLETED)
            for future in done:
                self._collect(self._running.pop(future), future)

    def _submit_pending(self) -> None:
        """Submit as many chunks as allowed: suspects one at a time and alone, to identify the one that kills."""
        if not self._running:
            self._isolating = bool(self._suspects)
        if self._isolating:
            if not self._running:
                self._submit(self._suspects.popleft())
        elif not self._suspects:
            room = self._pool.max_pending - len(self._running)
            for _ in range(room):
                if self._waiting and not self._suspects:
                    self._submit(self._next_chunk())

    def _submit(self, chunk: Chunk) -> None:
        try:
            self._running[self._pool.submit(self._task, self._metadata, chunk)] = chunk
        except self._pool.death_errors:
            self._on_worker_death(chunk)

    def _next_chunk(self) -> Chunk:
        first, count = self._waiting.popleft()
        if count > self._size:
            self._waiting.appendleft(Chunk(first + self._size, count - self._size))
        return Chunk(first, min(count, self._size))

    def _collect(self, chunk: Chunk, future: Future[ChunkResult]) -> None:
        try:
            result = future.result()
        except self._pool.death_errors:
            self._on_worker_death(chunk)
            return
        except CancelledError:
            raise FlightError(f"lost the cluster; finished runs are in {self._store.folder}") from None
        self._save(chunk, result.table)
        if not self._fixed:
            size = min(int(chunk.runs * _TASK_S / result.wall_s), _GROWTH * chunk.runs, _MAX_CHUNK)
            self._size = max(size - size % self._least, self._least)

    def _save(self, chunk: Chunk, table: Any) -> None:
        self._store.add(chunk, table)
        self._flown_runs += chunk.runs
        self._progress(self._flown_runs, self._pending_runs)

    def _on_worker_death(self, chunk: Chunk) -> None:
        """Re-run a dead worker's chunk in isolation, bisecting to the run that kills it."""
        first, count = chunk
        if not self._isolating:
            self._suspects.append(chunk)
        elif count > 1:
            half = count // 2
            self._suspects.extendleft([Chunk(first + half, count - half), Chunk(first, half)])
        else:
            self._deaths[chunk] += 1
            if self._deaths[chunk] < _MAX_DEATHS:
                self._suspects.appendleft(chunk)
            else:
                self._check_pool()
                self._save(chunk, failed_rows(self._campaign, chunk, "the worker died on this run, each time"))

    def _check_pool(self) -> None:
        """Raise `FlightError` if workers die even without flying: then no run is to blame."""
        try:
            self._pool.submit(check_worker, self._metadata).result()
        except self._pool.death_errors:
            raise FlightError("workers die before they fly: out of memory, or installed differently") from None
