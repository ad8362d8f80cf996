"""Fly a campaign on a pool of workers, whatever happens to them."""

import json
from collections import Counter, deque
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from pathlib import Path
from typing import Any

from gustproof.campaign.executors import Pool
from gustproof.campaign.plan import Campaign
from gustproof.campaign.store import Store
from gustproof.campaign.worker import Chunk, ChunkResult, check_worker, failed_rows, fly_chunk
from gustproof.errors import FlightError
from gustproof.simulate.kernels import LANES

Task = Callable[[str, Chunk], ChunkResult]
_TASK_S = 1.0  # of work a task: much beside what sending it costs, little to lose
_MAX_CHUNK = 100 * LANES
_GROWTH = 16  # at most, from a stretch to those after it: a short one tells little of how long runs take
_MAX_DEATHS = 2  # of workers that a run flies alone on, after which it is taken to be the cause


def fly_campaign(
    campaign: Campaign,
    output: Path,
    pool: Pool,
    *,
    chunk_runs: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    task: Task = fly_chunk,
) -> None:
    """Fly all runs that are not flown yet, and write them as one Parquet file, a row a run.

    Tasks are stretches of `chunk_runs` runs, by default about a second of work; the file does not depend on it.
    `progress` is told how many runs have been flown, and how many there were to fly. A worker that dies costs its task
    a retry; a run that kills those that fly it is found by halving, and recorded with the reason. `task` is what
    workers do.

    Raises
    ------
    ConfigError
        If the output can't be written, or its parts are of another campaign.
    FlightError
        If the disk is full; what was flown stays.

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
    with Store(output, campaign) as store:
        _Runner(campaign, store, pool, chunk_runs, progress or (lambda *_: None), task).run()
        store.finish()


class _Runner:
    """Tasks under way, and those still to come: memory is bounded by the number of the former."""

    def __init__(
        self, campaign: Campaign, store: Store, pool: Pool, chunk_runs: int | None,
        progress: Callable[[int, int], None], task: Task,
    ) -> None:  # fmt: skip
        self._campaign, self._store, self._pool, self._task = campaign, store, pool, task
        self._note, self._progress = json.dumps(campaign.note()), progress
        self._fixed = chunk_runs is not None
        self._least = 1 if campaign.scenario.has_link_script else LANES  # fewer take as long
        self._size = chunk_runs or self._least
        self._waiting = deque(store.missing())
        self._running: dict[Future[ChunkResult], Chunk] = {}
        self._suspects: deque[Chunk] = deque()  # were under way when a worker died
        self._isolating = False  # a suspect flies alone
        self._deaths: Counter[Chunk] = Counter()
        self._pending_runs, self._flown = campaign.runs - store.flown, 0

    def run(self) -> None:
        self._progress(0, self._pending_runs)
        while self._waiting or self._suspects or self._running:
            self._submit_pending()
            done, _ = wait(self._running, return_when=FIRST_COMPLETED)
            for future in done:
                self._take(self._running.pop(future), future)

    def _submit_pending(self) -> None:
        """Submit what may fly now: suspects one at a time, each alone, so that it is clear who kills."""
        if not self._running:
            self._isolating = bool(self._suspects)
        if self._isolating:
            if not self._running:
                self._start(self._suspects.popleft())
        elif not self._suspects:
            room = self._pool.width - len(self._running)
            for _ in range(room):
                if self._waiting and not self._suspects:
                    self._start(self._next())

    def _start(self, stretch: Chunk) -> None:
        try:
            self._running[self._pool.submit(self._task, self._note, stretch)] = stretch
        except self._pool.deaths:
            self._on_worker_death(stretch)

    def _next(self) -> Chunk:
        first, count = self._waiting.popleft()
        if count > self._size:
            self._waiting.appendleft(Chunk(first + self._size, count - self._size))
        return Chunk(first, min(count, self._size))

    def _take(self, stretch: Chunk, future: Future[ChunkResult]) -> None:
        try:
            flown = future.result()
        except self._pool.deaths:
            self._on_worker_death(stretch)
            return
        except CancelledError:
            raise FlightError(f"the cluster is gone; what was flown is in {self._store.folder}") from None
        self._keep(stretch, flown.table)
        if not self._fixed:
            size = min(int(stretch.runs * _TASK_S / flown.wall_s), _GROWTH * stretch.runs, _MAX_CHUNK)
            self._size = max(size - size % self._least, self._least)

    def _keep(self, stretch: Chunk, table: Any) -> None:
        self._store.add(stretch, table)
        self._flown += stretch.runs
        self._progress(self._flown, self._pending_runs)

    def _on_worker_death(self, stretch: Chunk) -> None:
        """See to what was under way when a worker died: fly it again, alone; then in halves, down to the one run."""
        first, count = stretch
        if not self._isolating:
            self._suspects.append(stretch)
        elif count > 1:
            half = count // 2
            self._suspects.extendleft([Chunk(first + half, count - half), Chunk(first, half)])
        else:
            self._deaths[stretch] += 1
            if self._deaths[stretch] < _MAX_DEATHS:
                self._suspects.appendleft(stretch)
            else:
                self._check_pool()
                self._keep(stretch, failed_rows(self._campaign, stretch, "the worker that flew it died, each time"))

    def _check_pool(self) -> None:
        """Refuse to blame runs for workers that die whatever they do."""
        try:
            self._pool.submit(check_worker, self._note).result()
        except self._pool.deaths:
            raise FlightError("workers die before they fly: out of memory, or not installed alike") from None
