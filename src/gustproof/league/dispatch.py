"""Do a league's tasks on a pool of workers, each once, and survive the death of workers."""

from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, wait

from gustproof.campaign.executors import Pool
from gustproof.league.ledger import Ledger, Result
from gustproof.league.tasks import Task, run_task

Progress = Callable[[float, str], None]


class Dispatcher:
    """Tasks that wait and run; results go to the ledger at once."""

    def __init__(self, ledger: Ledger, pool: Pool, progress: Progress) -> None:
        self._ledger, self._pool, self._progress = ledger, pool, progress
        self._tasks: dict[str, Task] = {}
        self._waiting: deque[str] = deque()
        self._running: dict[Future[Result], str] = {}
        self._suspects: deque[str] = deque()  # ran when a worker died: each runs alone

    def do(self, tasks: Iterable[Task]) -> None:
        """Do the tasks that are not in the ledger; one whose worker dies even when it runs alone fails."""
        self._tasks = {key: task for task in tasks if (key := task.key) not in self._ledger}
        self._waiting.extend(self._tasks)
        if self._tasks:  # or the last task before would be named until the first of these ends
            self._progress(0.0, next(iter(self._tasks.values())).label)
        finished = 0
        while self._waiting or self._suspects or self._running:
            self._submit_pending()
            done, _ = wait(self._running, return_when=FIRST_COMPLETED)
            for future in done:
                key = self._running.pop(future)
                finished += self._collect(key, future)
                self._progress(finished / len(self._tasks), self._tasks[key].label)

    def _submit_pending(self) -> None:
        if self._suspects:
            if not self._running:
                self._submit(self._suspects[0])
            return
        while self._waiting and len(self._running) < self._pool.max_pending:
            self._submit(self._waiting.popleft())

    def _submit(self, key: str) -> None:
        try:
            future = self._pool.submit(run_task, self._tasks[key])
        except self._pool.death_errors as error:  # the workers died between two tasks
            future = Future()
            future.set_exception(error)
        self._running[future] = key

    def _collect(self, key: str, future: Future[Result]) -> bool:
        """Store a result; return False if its worker died and the task is to run again, alone."""
        try:
            result = future.result()
        except self._pool.death_errors:
            if key not in self._suspects:
                self._suspects.append(key)
                return False
            result = self._tasks[key].fail("its process died")
        if key in self._suspects:
            self._suspects.remove(key)
        self._ledger.add(key, result)
        return True
