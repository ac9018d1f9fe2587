"""From a request to a task with its references, in a thread of its own: who supervises the robot never waits for it."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass

from wbmpc.arrays import Array
from wbmpc.ocp import Reference
from wbmpc.ros2.goals import Task
from wbmpc.ros2.request_queue import Request

References = dict[str, Reference]
#: Most tasks are ready within this time [s]: they become active in the step in which their goal was taken.
PROMPT = 0.01


@dataclass(frozen=True)
class Planned:
    """``moving``: whether the robot was commanded when the goal was taken, which ``came`` at a time [s] of
    :class:`~wbmpc.ros2.hold_ups.HoldUps`."""

    task: Task
    references: References
    moving: bool
    came: float


class Planning:
    """One request at a time; ``prepare(task, x)`` makes the references of a task that begins at state x (nx)."""

    def __init__(self, prepare: Callable[[Task, Array], References]) -> None:
        self._prepare = prepare
        self._pool = ThreadPoolExecutor(1, "planning")
        self._job: Future[Planned] | None = None

    def begin(self, request: Request, x: Array, t: float, moving: bool) -> None:
        """Plan from state x (nx) at time t [s] of the plan."""

        def plan() -> Planned:
            task = request(x, t)
            return Planned(task, self._prepare(task, x), moving, request.came)

        self._job = self._pool.submit(plan)

    @property
    def busy(self) -> bool:
        """Whether there is a request whose task has not been taken."""
        return self._job is not None

    def ready(self) -> bool:
        """Whether the task is there, at the latest after :data:`PROMPT`."""
        assert self._job is not None
        return bool(wait([self._job], PROMPT).done)

    def take(self) -> Planned:
        """The task, once. Raises what planning raised."""
        assert self._job is not None
        job, self._job = self._job, None
        return job.result()

    def close(self) -> None:
        """End the thread, after what it does now."""
        self._pool.shutdown(cancel_futures=True)
