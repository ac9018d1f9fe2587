"""Who does the runs: this process, processes of this machine, or the workers of a Dask scheduler."""

from __future__ import annotations

import logging
import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import TYPE_CHECKING, Any, Protocol
from uuid import uuid4

from wbmpc.errors import InputError, RunAborted
from wbmpc.interrupts import interrupts_blocked
from wbmpc.simulation.lockstep import interrupt_noted
from wbmpc.study.store import MISSING
from wbmpc.study.work import lost

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

Task = dict[str, Any]
Row = dict[str, Any]
Work = Callable[[Task], Row]
#: Dask's scheduler opens a port for pages always; of two studies at once the second would warn that the usual one is taken.
_NO_PAGES = {"dashboard": False, "dashboard_address": "127.0.0.1:0"}
#: A run that ends its process is given to others so often before it counts as lost.
RETRIES = 2
#: How long [s] a scheduler may be silent, at first and while runs go on.
SILENCE = 30.0
#: How often [s] a cluster of this machine is checked while its workers work, and how long [s] one of them may be gone before another takes
#: its place: a process that ends while it starts is not started again by Dask.
_LOOK, GONE = 0.5, 30.0
_THREADS = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}


class Pool(Protocol):
    """Does tasks: ``submit`` hands one over, ``next`` waits for one that is done. ``threads``: how many are done at a time."""

    @property
    def threads(self) -> int: ...
    def submit(self, work: Work, task: Task) -> None: ...
    def next(self) -> tuple[Task, Row]: ...


class Here:
    """A pool that is this process."""

    threads = 1

    def __init__(self) -> None:
        self._waiting: list[tuple[Work, Task]] = []

    def submit(self, work: Work, task: Task) -> None:
        self._waiting.append((work, task))

    def next(self) -> tuple[Task, Row]:
        work, task = self._waiting.pop(0)
        return task, work(task)


class Cluster:
    """A pool of Dask's workers."""

    def __init__(self, client: Client, address: str = "", own: LocalCluster | None = None) -> None:
        """``own``: the cluster of this machine whose workers they are."""
        from distributed import as_completed

        self._client, self._address, self._own = client, address, own
        self._done = as_completed(loop=client.loop)
        self._tasks: dict[str, Task] = {}
        self._threads, self._looked = 1, -float("inf")

    @property
    def threads(self) -> int:
        if time.monotonic() - self._looked > 1.0:  # workers come and go
            self._threads, self._looked = max(sum(self._client.nthreads().values()), 1), time.monotonic()
        return self._threads

    def submit(self, work: Work, task: Task) -> None:
        key = f"{task['key']}-{uuid4().hex[:8]}"
        self._tasks[key] = task
        self._done.add(self._client.submit(work, task, key=key, pure=False))

    def next(self) -> tuple[Task, Row]:
        while True:
            self._wait()
            future = next(self._done)
            if future.status == "finished":
                row: Row = future.result()
                return self._tasks.pop(future.key), row
            if future.status == "error":
                why = f"{type(future.exception()).__name__}: the process of the run ended {RETRIES + 1} times"
                return self._tasks.pop(future.key), lost(why)
            if future.status == "cancelled" or self._client.status != "running":
                raise RunAborted(
                    f"the scheduler {self._address} is gone; what is finished is kept, the same command continues"
                )
            self._done.add(future)  # its result was lost with its worker: another one does it again

    def _wait(self) -> None:
        """Until something is done; workers of this machine that are gone for good are replaced meanwhile."""
        looked = time.monotonic()
        while self._own is not None and self._client.status == "running" and not self._done.has_ready():
            time.sleep(0.02)
            if time.monotonic() - looked > _LOOK:
                looked = time.monotonic()
                if len(self._own.workers) < len(self._own.worker_spec):
                    self._own.scale(len(self._own.worker_spec))


class Later:
    """The pool of :func:`pool`, which begins with its first task: where nothing is left to do no process starts. A context."""

    def __init__(self, count: int | None, scheduler: str | None) -> None:
        self._make = count, scheduler
        self._pool: Pool | None = None
        self._stack = ExitStack()

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def _there(self) -> Pool:
        if self._pool is None:
            self._pool = self._stack.enter_context(pool(*self._make))
        return self._pool

    @property
    def threads(self) -> int:
        return 1 if self._pool is None else self._pool.threads

    def submit(self, work: Work, task: Task) -> None:
        self._there().submit(work, task)

    def next(self) -> tuple[Task, Row]:
        return self._there().next()


@contextmanager
def pool(count: int | None, scheduler: str | None) -> Iterator[Pool]:
    """``count`` processes of this machine (None: as many as it has cores; 0: this process alone), or the workers of the scheduler at an
    address. Ctrl-C reaches this process only, which ends the others. Raises :class:`InputError` without Dask or without the scheduler.
    """
    if scheduler is None and count == 0:
        yield Here()
        return
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise InputError(MISSING) from error
    for name in (
        "distributed",
        "distributed.client",
    ):  # what they report of lost workers comes as rows, of a lost scheduler as a message
        logging.getLogger(name).setLevel(logging.CRITICAL)
    dask.config.set({
        "distributed.scheduler.allowed-failures": RETRIES, "distributed.comm.timeouts.connect": SILENCE,
        "distributed.deploy.lost-worker-timeout": GONE,
        "distributed.scheduler.http.routes": [],  # it has a server for browsers whatever it is asked for: that shows nothing
    })  # fmt: skip
    if scheduler is not None:
        try:
            client = Client(scheduler, timeout=SILENCE, set_as_default=False)
        except (OSError, ValueError) as error:
            raise InputError(f"--scheduler: '{scheduler}': no scheduler answers there ({error})") from error
        with _closing(client, None):
            yield Cluster(client, scheduler)
        return
    with (
        interrupt_noted() as interrupted,
        interrupts_blocked(),
        _threads_pinned(),
    ):  # one that is half there cannot be closed
        try:
            cluster = LocalCluster(
                n_workers=count or len(os.sched_getaffinity(0)), threads_per_worker=1, processes=True, dashboard_address=None,
                scheduler_kwargs=_NO_PAGES, silence_logs=logging.CRITICAL,
            )  # fmt: skip
        except (OSError, RuntimeError) as error:  # no processes are left, or their directory is gone
            raise RunAborted(f"--workers: the processes do not start ({error.__cause__ or error})") from error
        client = Client(cluster, set_as_default=False)
    with _closing(client, cluster):
        if interrupted():
            raise KeyboardInterrupt
        yield Cluster(client, own=cluster)


@contextmanager
def _closing(client: Client, cluster: LocalCluster | None) -> Iterator[None]:
    """At the end, and at once where that is an exception: what runs then has no one who waits for it."""
    try:
        yield
    finally:
        with suppress(Exception), interrupts_blocked():
            if cluster is not None:
                for nanny in cluster.workers.values():
                    if nanny.pid is not None:
                        os.kill(nanny.pid, signal.SIGKILL)
            client.close(timeout=5)
            if cluster is not None:
                cluster.close(timeout=5)


@contextmanager
def _threads_pinned() -> Iterator[None]:
    previous = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(_THREADS)
    try:
        yield
    finally:
        for name, value in previous.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def completed(pool: Pool, work: Work, tasks: Iterator[Task]) -> Iterator[tuple[Task, Row]]:
    """All tasks with their rows, as they are done. One for each thread is handed over at a time: memory stays bounded, and a worker
    that dies takes no others along."""
    going, left = 0, True
    while True:
        while left and going < pool.threads:
            task = next(tasks, None)
            left = task is not None
            if task is not None:
                pool.submit(work, task)
                going += 1
        if not going:
            return
        yield pool.next()
        going -= 1
