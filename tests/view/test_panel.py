"""The controls beside the picture. Truth: the orders that reach the run, and the brakes that the run's controller asks for."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_live import free_port

from wbmpc.runtime.shared_memory import Mailbox
from wbmpc.view.snapshot import NUMBERS
from wbmpc.view.steering import REQUESTS, Controls, Steering

viser = pytest.importorskip("viser")
panels = pytest.importorskip("wbmpc.view.panel")


@pytest.fixture
def panel() -> Any:
    server = viser.ViserServer(host="127.0.0.1", port=free_port(), verbose=False)
    yield panels.Panel(server, Mailbox(REQUESTS), Controls("test", ("end_effector",), legs=True, base=True))
    server.stop()


def show(panel: Any, brakes: float) -> None:
    nothing = {"numbers": np.zeros(len(NUMBERS)), "goal": np.full(7, np.nan), "base_goal": np.full(3, np.nan)}
    for _ in range(panels._EVERY):
        panel.show({**nothing, "brakes": np.array(brakes)})


def click(panel: Any, value: bool) -> None:
    """As a browser does it: the box's value, then the callbacks with that browser as their client."""
    panel._brakes._impl.value = value
    for callback in panel._brakes._impl.update_cb:
        callback(SimpleNamespace(client=object(), target=panel._brakes))


def test_the_box_shows_how_the_brakes_are(panel: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever moved them; a click stays until the run had time to follow it; showing is no click."""
    clock = [100.0]
    monkeypatch.setattr(panels, "time", SimpleNamespace(monotonic=lambda: clock[0]))
    show(panel, 1.0)  # X was clicked: the run opens them
    assert panel._brakes.value is True
    show(panel, 0.0)  # they are there: it closes them
    assert panel._brakes.value is False and panel._values["brake_clicks"] == 0
    click(panel, True)
    assert (panel._values["brake_clicks"], panel._values["brakes_open"]) == (1, 1.0)
    show(panel, 0.0)
    assert panel._brakes.value is True
    clock[0] += 1.1  # the run has rejected
    show(panel, 0.0)
    assert panel._brakes.value is False and panel._values["brake_clicks"] == 1
    show(panel, np.nan)
    assert panel._brakes.value is False


def test_open_are_brakes_of_which_all_are() -> None:
    steering = Steering.__new__(Steering)
    steering.has_legs = True
    for brakes, reported in (([1, 1, 1, 1], 1.0), ([0, 0, 0, 0], 0.0), ([1, 0, 1, 1], 0.0)):
        steering.running = SimpleNamespace(controller=SimpleNamespace(brakes=lambda t, b=brakes: np.array(b)))  # type: ignore[assignment]
        assert steering.brakes_open(0.0) == reported
    steering.has_legs = False
    assert np.isnan(steering.brakes_open(0.0))


def test_a_goal_is_given_where_its_handle_is_moved(panel: Any) -> None:
    """Grasping it and letting go gives none; while it is held the run does not move it."""
    handle = panel._goal

    def drag(phase: str) -> None:
        for callback in handle._impl_aux.update_cb:
            asyncio.run(callback(SimpleNamespace(phase=phase, client=object(), target=handle)))

    drag("start")
    assert panel._dragged and panel._values["goals"] == 0
    handle.position = (1.0, 2.0, 3.0)
    drag("update")
    assert panel._values["goals"] == 1
    np.testing.assert_allclose(panel._values["goal"][:3], [1.0, 2.0, 3.0])
    drag("end")
    assert not panel._dragged and panel._values["goals"] == 1
