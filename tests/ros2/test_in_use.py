"""What threads use is closed once, when they have ended; also after Ctrl-C. Truth: an interrupt before each instruction, threads."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import nullcontext, suppress

import pytest

from interrupting import in_time, interrupted
from wbmpc.errors import RunAborted
from wbmpc.ros2.in_use import InUse


def held(used: InUse) -> None:
    with used.hold():
        pass


def begun(used: InUse) -> None:
    with used.begin() or nullcontext():
        pass


def ctrl_c() -> None:
    raise KeyboardInterrupt


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("use", [held, begun, InUse.close])
def test_a_node_is_closed_wherever_ctrl_c_came(use: Callable[[InUse], object]) -> None:
    """Where it came as a lock had been taken, who closed the node waited for ever."""
    step, more = 0, True
    while more:
        step, used = step + 1, InUse("node")
        with suppress(KeyboardInterrupt):
            _, more = interrupted(lambda used=used: use(used), ctrl_c, step)
        with in_time(20):
            used.close()
        assert used.closed and used.begin() is None
    assert step > 20


def test_who_closes_it_waits_for_those_who_use_it() -> None:
    used, closed = InUse("node"), list[bool]()
    threads = [threading.Thread(target=lambda: closed.append(used.close())) for _ in range(3)]
    with used.hold():
        for thread in threads:
            thread.start()
        threads[0].join(0.05)
        assert True not in closed
    for thread in threads:
        thread.join(20.0)
    assert sorted(closed) == [False, False, True]
    with pytest.raises(RunAborted, match="node 'node' is closed"), used.hold():
        pass
