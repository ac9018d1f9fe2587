"""Messages that no browser sends, from clients that know the token. Truth: the run's time goes on; the page's text."""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hostile import BAD_GOALS, CAMERA, MALFORMED, Client, check_access, get
from test_live import free_port

from effort import thorough
from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.runtime.shared_memory import Mailbox
from wbmpc.view import bounds
from wbmpc.view.access import Access
from wbmpc.view.user_commands import MAX_WEIGHTS, REQUESTS, Controls

viser = pytest.importorskip("viser")
msgspec = pytest.importorskip("msgspec")

from websockets.datastructures import Headers  # noqa: E402 - they come with viser, or need it
from websockets.exceptions import ConnectionClosed  # noqa: E402 - they come with viser, or need it
from websockets.http11 import Request, Response  # noqa: E402
from websockets.protocol import State  # noqa: E402

from wbmpc.view.frames import checked  # noqa: E402
from wbmpc.view.panel import Panel  # noqa: E402
from wbmpc.view.scene import _aim, _drawable  # noqa: E402
from wbmpc.view.server import MAX_CONNECTIONS, Guard, Throttle, open_server  # noqa: E402

#: Values that a control may not have.
WRONG: dict[str, tuple[Any, ...]] = {
    "Speed": (0.0, float("nan"), -1.0, 1e9, "fast", True, [1.0]),
    "Force [N]": (1e9, float("inf"), -5.0),
    "Time [s]": (float("nan"), 1e6),
    "end_effector": (400.0, float("nan"), "heavy"),
    "Configuration": ("Z", 7, "__class__"),
    "Brakes open": (2, "yes", 0.5),
    "Pause": ("no", 7.0),
}


Running = tuple[subprocess.Popen[str], Client]


def start(kind: str) -> Running:
    """A view and a client of it."""
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2] / "src")}
    extra = ["--realtime"] if kind == "realtime" else []
    command = [sys.executable, "-m", "wbmpc", "view", "swerve-ur10", *extra, "--json", "--port", str(free_port())]
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    client = Client(json.loads(process.stdout.readline())["url"])
    assert client.hears(" s  \nend effector error", 180.0)
    return process, client


@pytest.fixture(scope="module")
def started() -> Iterator[dict[str, Running]]:
    views: dict[str, Running] = {}
    yield views
    for process, _ in views.values():
        if process.poll() is None:
            process.kill()
        process.communicate()


@pytest.fixture(params=["lockstep", pytest.param("realtime", marks=thorough)])
def running(request: pytest.FixtureRequest, started: dict[str, Running]) -> Running:
    """A view that several tests share. They come in any order, and one of them ends it: the next one gets another."""
    if request.param not in started or started[request.param][0].poll() is not None:
        started[request.param] = start(request.param)
    return started[request.param]


def test_only_the_page_with_the_token_gets_in(running: Running) -> None:
    check_access(running[1].url)


def run_time(client: Client) -> float:
    """The run's time [s] as the page shows it."""
    client.listen(0.5)
    found = [re.search(r", ([0-9.]+) s", text) for text in client.history]
    return float([m for m in found if m is not None][-1][1])


def hand_error(client: Client) -> float:
    """As the page shows it last [mm]."""
    found = [
        m for m in (re.search(r"end effector error ([0-9.]+) mm", text) for text in client.history) if m is not None
    ]
    return float(found[-1][1])


@pytest.mark.parametrize("running", ["lockstep"], indirect=True)
def test_the_page_says_how_late_it_is(running: Running) -> None:
    """The real-time factor, and how many of the ticks began later than a period."""
    _, client = running
    assert client.hears("real-time factor ", 60.0)
    found = [re.search(r"real-time factor ([0-9.]+), ([0-9]+) of ([0-9]+) ticks late", text) for text in client.history]
    factor, late, ticks = (float(v) for v in [m for m in found if m is not None][-1].groups())
    assert 0.0 < factor < 1.5 and 0 <= late <= ticks and ticks > 0


def test_no_message_ends_a_run(running: Running) -> None:
    """Each one is answered on the page, the run goes on and does afterwards what it is asked for properly. It ends below."""
    process, client = running
    previous = run_time(client)
    for message in MALFORMED:
        client.history.clear()
        client.send(message)
        assert client.hears("**Not done:**"), message
    for position, quaternion, answer in BAD_GOALS:
        for handle in ("/goal", "/base_goal"):
            if handle == "/base_goal" and "height" in answer:
                continue
            client.history.clear()
            client.move(handle, position, quaternion)
            assert client.hears(answer), (handle, position, quaternion, client.history[-1:])
    assert set(WRONG) - set(client.controls) <= {"Speed", "Pause"}  # which real time does not have
    for label, values in ((label, values) for label, values in WRONG.items() if label in client.controls):
        for value in values:
            client.history.clear()
            client.set(label, value)
            assert client.hears("**Not done:**"), (label, value)
    uuid = client.controls["Force [N]"]
    for updates in ({"min": -1e9}, {"update_cb": 1}, {"removed": True}, {"value": 10.0, "max": 1e9}, {}):
        client.history.clear()
        client.send({"type": "GuiUpdateMessage", "uuid": uuid, "updates": updates})
        assert client.hears("**Not done:**"), updates
    assert client.alive and process.poll() is None
    assert run_time(client) > previous + 1.0 and hand_error(client) < 20.0
    client.move("/goal", (1.0, 0.2, 1.0), (1.0, 0.0, 0.0, 0.0))
    client.history.clear()
    assert client.hears("end effector error")
    client.listen(0.5)
    assert hand_error(client) > 50.0  # a proper goal is taken


def test_a_flood_of_malformed_messages_is_a_few_lines(running: Running) -> None:
    process, client = running
    previous = run_time(client)
    for _ in range(700):
        client.send(b"\xc1")
        client.send("text")
    # the answers to the flood come first, so the page's next time may be some seconds away
    assert client.alive and any(run_time(client) > previous for _ in range(60))
    in_real_time = "Speed" not in client.controls
    if in_real_time:  # as a service manager ends it
        process.terminate()
    else:
        client.set("End the run", True)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 143 if in_real_time else process.returncode == 0 and "ended in the view" in err
    assert "Traceback" not in err and len(err.splitlines()) < 40


def test_who_floods_waits_and_nobody_else() -> None:
    """At first nothing; then 500 messages in a second, by the clock."""
    now = [0.0]
    throttle = Throttle(200, 500.0, lambda: now[0])
    assert max(throttle.wait() for _ in range(199)) == 0.0
    for _ in range(1000):
        now[0] += throttle.wait()
    assert now[0] == pytest.approx(1000 / 500.0, abs=0.01)
    now[0] += 10.0  # quiet for a while, and all is as at first
    assert max(throttle.wait() for _ in range(199)) == 0.0 < max(throttle.wait() for _ in range(2))


def test_a_flood_of_one_page_leaves_the_server_to_others() -> None:
    """A second page is let in and served meanwhile; what is rejected changes no text of a page by itself."""
    server, guard = open_server(Access.of("127.0.0.1"), free_port())
    panel = Panel(server, Mailbox.shared(REQUESTS), Controls("title", (), brakes=False, base=False))
    guard.rejected = panel.reject
    url = guard.access.url(server.get_port())
    try:
        flooding, other = Client(url), Client(url)
        taken = []
        guard.take, take = (lambda raw: (taken.append(raw), take(raw))[1]), guard.take  # type: ignore[method-assign]
        ended = threading.Event()
        thread = threading.Thread(target=_flood, args=(flooding, ended))
        thread.start()
        start = time.monotonic()
        Client(url)
        other.set("Force [N]", 80.0)
        assert other.alive
        seconds = time.monotonic() - start
        ended.set()
        flooding.drop()
        thread.join()
        assert sum(raw == b"\xc1" for raw in taken) < 300 + 500 * (seconds + 1.0)
        assert not any("Not done" in text for text in other.history)
        panel.show_message("")
        assert other.hears("**Not done:**")
    finally:
        server.stop()


def test_clicks_that_come_at_once_are_done_one_after_the_other(capfd: pytest.CaptureFixture[str]) -> None:
    """Two pages put, change and take away the box as fast as they can. Truth: the last order, and no traceback of the server's threads."""
    server, guard = open_server(Access.of("127.0.0.1"), free_port())
    requests = Mailbox.shared(REQUESTS)
    Panel(server, requests, Controls("title", (), brakes=False, base=False, obstacle=True))
    url = guard.access.url(server.get_port())
    try:
        pages = [Client(url), Client(url)]
        for k in range(150):
            for page in pages:
                page.set("Edge [m]", 0.1 + 0.01 * (k % 100))
                page.set("Put there", True)
                page.set("Edge [m]", 0.2)
                page.set("Take away", True)
        assert all(page.alive for page in pages)
        pages[0].set("Put there", True)
        pages[0].set("Edge [m]", 0.75)
        assert wait_for(lambda: (found := requests.read()) is not None and found.values["obstacle"][7] == 0.75)
    finally:
        server.stop()
    assert "Traceback" not in "".join(capfd.readouterr())


def wait_for(condition: Callable[[], bool], seconds: float = 20.0) -> bool:
    """Whether it comes true in time."""
    deadline = time.monotonic() + seconds
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.02)
    return time.monotonic() < deadline


def test_messages_that_are_right_are_no_flood_either() -> None:
    """One page moves a goal as fast as it can: it is read at a page's rate, and others are served meanwhile. Truth: what is counted before
    the server."""
    server, guard = open_server(Access.of("127.0.0.1"), free_port())
    panel = Panel(server, Mailbox.shared(REQUESTS), Controls("title", (), brakes=False, base=False))
    url = guard.access.url(server.get_port())
    try:
        flooding, other = Client(url), Client(url)
        taken, take, ended = [], guard.take, threading.Event()
        guard.take = lambda raw: (taken.append(raw), take(raw))[1]  # type: ignore[method-assign]
        goal = {
            "type": "TransformControlsUpdateMessage",
            "name": "/goal",
            "wxyz": (1, 0, 0, 0),
            "position": (0.6, 0.1, 1.0),
        }
        thread = threading.Thread(target=_flood, args=(flooding, ended, msgspec.msgpack.encode(goal)))
        start = time.monotonic()
        thread.start()
        time.sleep(1.0)
        other.set("Force [N]", 80.0)
        Client(url)
        assert other.alive and np.allclose(panel._goal.position, (0.6, 0.1, 1.0))
        count = sum(b"TransformControls" in raw for raw in list(taken))
        seconds = time.monotonic() - start
        ended.set()
        for client in (flooding, other):
            client.drop()
        thread.join()
        assert count < 300 + 500 * seconds
    finally:
        server.stop()


def test_connections_that_say_nothing_leave_the_run_its_files() -> None:
    """Each is an open file of the process: with 1024 of them a run could write nothing. Whoever has made a request stays, and
    others get in: the oldest silent one makes room."""
    server, guard = open_server(Access.of("127.0.0.1"), free_port())
    url, port = guard.access.url(server.get_port()), server.get_port()
    silent: list[socket.socket] = []
    try:
        page = Client(url)
        silent += [socket.create_connection(("127.0.0.1", port), 10.0) for _ in range(MAX_CONNECTIONS + 20)]
        assert get(url)[0] == 200 and page.alive
        assert MAX_CONNECTIONS - 1 <= len(guard.connections) <= MAX_CONNECTIONS
    finally:
        for each in silent:
            each.close()
        server.stop()


def test_what_is_shown_reaches_browsers_from_any_thread() -> None:
    """A server that is filled by the thread that draws wakes nobody in it: that ended a view with a few browsers. Truth: asyncio's
    debug mode, which raises where another thread touches what waits in its loop."""
    server, guard = open_server(Access.of("127.0.0.1"), free_port())
    try:
        text = server.gui.add_markdown("before")
        pages = [Client(guard.access.url(server.get_port())) for _ in range(3)]
        loop, ready = server.get_event_loop(), threading.Event()
        loop.call_soon_threadsafe(lambda: (loop.set_debug(True), ready.set()))
        assert ready.wait(10.0)
        for k in range(5):
            text.content = f"picture {k}"
            for client in server.get_clients().values():
                client.camera.fov = 1.0 + 0.01 * k  # each browser has a buffer of its own, too
            assert all(page.hears(f"picture {k}") for page in pages)
            time.sleep(0.1)  # all wait again
    finally:
        server.stop()


@pytest.mark.parametrize("flood", ["pings", "parts"])
def test_who_sends_no_messages_is_disconnected(flood: str) -> None:
    """Answers that nobody reads, and parts of a message without an end, would fill the memory of the server."""
    server, guard = open_server(Access.of("127.0.0.1"), free_port())
    said: list[str] = []
    guard.rejected = said.append
    try:
        page, flooding = Client(guard.access.url(server.get_port())), Client(guard.access.url(server.get_port()))
        packed = msgspec.msgpack.encode(CAMERA)
        page.socket.send(packed[k : k + 8] for k in range(0, len(packed), 8))  # a message in parts is one
        with pytest.raises(ConnectionClosed):
            if flood == "pings":
                for _ in range(100_000):
                    flooding.socket.ping()
            else:
                flooding.socket.send(b"" for _ in range(100_000))
        assert page.alive and said == ["a connection was closed: it sent too many pings or parts of messages"]
    finally:
        server.stop()


def test_no_browser_gets_in_before_the_page_is_there() -> None:
    guard = Guard(Access("127.0.0.1", ""))
    request = Request("/", Headers({"Host": "localhost:80"}))
    connection = SimpleNamespace(local_address=("127.0.0.1", 80))
    serve = lambda connection, request: Response(200, "OK", Headers())
    assert guard.answer(connection, request, serve).status_code == 503
    guard.server = cast(Any, object())
    assert guard.answer(connection, request, serve).status_code == 200


class _Connection:
    def __init__(self, state: State) -> None:
        self.state = state


def test_connections_that_are_open_make_no_room() -> None:
    guard = Guard(Access.of("127.0.0.1"))
    closed: list[int] = []
    transport = lambda k: SimpleNamespace(abort=lambda: closed.append(k))
    states = [State.OPEN, State.CONNECTING, *[State.OPEN] * (MAX_CONNECTIONS - 2)]
    assert all(guard.admit(_Connection(s), transport(k)) for k, s in enumerate(states))
    assert guard.admit(_Connection(State.OPEN), transport(-1)) and closed == [1]
    assert not guard.admit(_Connection(State.OPEN), transport(-2)) and closed == [1, -2]
    assert len(guard.connections) == MAX_CONNECTIONS


def test_only_what_single_precision_has_is_drawn() -> None:
    points = np.array([[1.0, 2.0], [np.nan, 0.0], [1e300, 0.0], [0.0, np.inf], [3.0, 4.0]])
    np.testing.assert_array_equal(_drawable(points), [[1.0, 2.0], [3.0, 4.0]])
    assert _drawable(np.zeros((0, 2, 3))).shape == (0, 2, 3)


def _flood(client: Client, ended: threading.Event, message: bytes = b"\xc1") -> None:
    with suppress(ConnectionClosed):
        while not ended.is_set():
            client.send(message)


@pytest.mark.parametrize(
    "change",
    [
        {"look_at": CAMERA["position"]},
        {"up_direction": (0.0, 0.0, 0.0)},
        {
            "position": (1e9, 0.0, 0.0),
            "look_at": (1e9, 0.0, 1e-3),
        },  # nothing is left of it where the camera is moved back
    ],
)
def test_a_camera_without_a_direction_is_rejected(change: dict[str, Any]) -> None:
    """viser could not turn it later on, in the loop that draws."""
    assert checked(msgspec.msgpack.encode(CAMERA), lambda uuid: None)
    with pytest.raises(InputError, match="the camera: "):
        checked(msgspec.msgpack.encode({**CAMERA, **change}), lambda uuid: None)


def test_a_camera_that_cannot_be_moved_stays() -> None:
    tried = []

    class Camera:
        def __setattr__(self, name: str, value: Any) -> None:
            tried.append(name)
            raise ValueError("Camera look_at cannot equal position (zero look distance).")

    _aim(SimpleNamespace(camera=Camera(), atomic=nullcontext), np.zeros(3), np.ones(3))  # type: ignore[arg-type]
    assert tried == ["position"]


def test_what_is_answered_to_a_slider_is_short() -> None:
    server = viser.ViserServer(host="127.0.0.1", port=free_port(), verbose=False)
    try:
        slider = server.gui.add_slider("Force [N]", 0.0, 300.0, 5.0, 60.0)
        message = {"type": "GuiUpdateMessage", "uuid": "x", "updates": {"value": "y" * 60_000}}
        with pytest.raises(InputError) as caught:
            checked(msgspec.msgpack.encode(message), lambda uuid: slider)
        assert len(str(caught.value)) < 200
    finally:
        server.stop()


# ---------------------------------------------------------------------- what a run may be asked for
def test_what_a_run_may_be_asked_for() -> None:
    """Also where the page lets it pass: the run checks again."""
    base, nan = np.array([2.0, 1.0, 0.0]), np.nan
    good = np.array([3.0, 1.0, 1.0, 1.0 + 5e-4, 0.0, 0.0, 0.0])
    checked = bounds.pose(good, base)
    assert np.linalg.norm(checked[3:]) == pytest.approx(1.0, abs=1e-12) and checked[0] == 3.0
    bad: list[Any] = [
        lambda k=k, v=v: bounds.pose(np.where(np.arange(7) == k, v, good), base)
        for k, v in ((0, nan), (1, 1e9), (2, 3.1), (2, -np.inf), (3, 0.0), (5, nan), (0, 7.1))
    ]
    bad += [lambda v=v: bounds.planar(np.array(v), base) for v in ((nan, 0, 0), (0, 0, nan), (2.0, 6.1, 0.0))]
    bad += [
        lambda v=v: bounds.push(np.array(v[:3]), np.array(v[3]))
        for v in ((nan, 0, 0, 1), (1001, 0, 0, 1), (1, 0, 0, nan))
    ]
    bad += [lambda v=v: bounds.factors(np.full(MAX_WEIGHTS, v)) for v in (nan, 0.0, -1.0, 1e4)]
    bad += [lambda v=v: bounds.choice("configuration", np.array(v), 3) for v in (nan, -1.0, 0.5, 3.0, np.inf)]
    bad += [lambda v=v: bounds.within("speed", v, *bounds.SPEEDS) for v in (nan, 0.0, -1.0, np.inf)]
    for ask in bad:
        with pytest.raises(InputError):
            ask()
    np.testing.assert_array_equal(bounds.planar(np.array([2.0, 5.9, 9.0]), base), [2.0, 5.9, 9.0])
    assert bounds.choice("configuration", np.array(2.0), 3) == 2 and load_robot("rezero") is not None
