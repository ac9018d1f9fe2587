"""The compiled controller and the same source as ordinary Python. Truth: each other, and the affine law in NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from exported import trolley
from wbmpc.embedded.image import make_image
from wbmpc.solver import controller, feedback
from wbmpc.solver.controller import Count, Result
from wbmpc.solver.memory_layout import BASE
from wbmpc.solver.receding import receding_solve
from wbmpc.solver.workspace import ADDRESSES, POINTERS, aligned


def arguments(t: float, x: np.ndarray) -> dict[str, object]:
    """Of an update, on arrays of its own: those that an exported controller has."""
    mpc = trolley()
    image = make_image(mpc, 4)
    found: dict[str, object] = {**image.areas, **image.constants, **image.numbers, "t": t, "x": x}
    memory = aligned(image.areas["m"].size)
    memory[:] = image.areas["m"]
    table = image.areas["o"]
    assert mpc.solver.kernel is not None
    table[BASE], table[ADDRESSES:POINTERS] = memory.ctypes.data, mpc.solver.kernel.addresses
    return {**found, "m": memory, "first": 2, "kernel": mpc}


def test_an_update_as_machine_code_and_as_python_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """All but the solve itself, whose interpreted twin has tests of its own."""
    monkeypatch.setattr(receding_solve, "_interpreted", receding_solve)
    plans = []
    for way in (controller.update, controller.update.interpreted):
        given = arguments(0.0, np.array([0.3, 0.1]))
        flat = [given[name] for name in controller.update.argument_names]
        assert way(*controller.update.signature.structured(flat)) == Result.OK
        plans.append(given)
    for name in ("times", "states", "inputs", "gains", "active", "moving", "value"):
        np.testing.assert_allclose(plans[0][name], plans[1][name], atol=1e-9)
    assert plans[1]["count"][Count.UPDATES] == 1 and np.abs(plans[1]["inputs"]).max() > 0.1


def test_feedback_is_the_affine_law_at_every_time() -> None:
    rng, n, nx, nu = np.random.default_rng(3), 5, 4, 3
    times = np.cumsum(rng.uniform(0.1, 0.3, n + 1))
    states, inputs, gains = rng.normal(size=(n + 1, nx)), rng.normal(size=(n, nu)), rng.normal(size=(n, nu, nx))
    free = np.concatenate([np.full(nu, -np.inf), np.full(nu, np.inf)])
    for t in np.linspace(times[0] - 0.1, times[-1] + 0.1, 23):
        k = int(np.clip(np.searchsorted(times, t + 1e-9, side="right") - 1, 0, n - 1))
        x, u = rng.normal(size=nx), np.empty(nu)
        middle = [np.interp(t, times, column) for column in states.T]
        given = (
            times,
            states,
            inputs,
            gains,
            free,
            np.ones(1),
            np.zeros(1),
            n,
            nx,
            nu,
            0,
            0,
            True,
            t,
            x,
            np.empty(3 * nu),
            u,
        )
        for way in (feedback.evaluate, feedback.evaluate.interpreted):
            flat = [a.ravel() if isinstance(a, np.ndarray) and a is not u else a for a in given]
            assert way(*feedback.evaluate.signature.structured(flat)) == feedback.FINE
            np.testing.assert_allclose(u, inputs[k] + gains[k] @ (x - middle), atol=1e-12)


@pytest.mark.parametrize(
    ("status", "broken", "faults", "after"),
    [
        (3, 1, 1, controller.RESUME),
        (3, 2, 2, controller.RESTART),
        (5, 0, 1, controller.RESUME),
        (5, 0, controller.STUCK, controller.GO_ON),
        (6, 0, 1, controller.GO_ON),
    ],
)
def test_where_the_next_solve_starts(status: int, broken: int, faults: int, after: int) -> None:
    """As :meth:`MPC.recover` says."""
    assert controller.recovery(status, broken, faults) == controller.recovery.python(status, broken, faults) == after
