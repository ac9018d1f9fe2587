"""The live view beside a run. Truth: the run without it; a browser's stand-in that never reads; a view that is killed."""

from __future__ import annotations

import gc
import json
import os
import re
import signal
import socket
import threading
import time
import weakref
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from effort import thorough
from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.cli import main
from wbmpc.cli.running import STEERED
from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.recording.reader import read_recording
from wbmpc.robots import load_description
from wbmpc.runtime.shared_memory import Mailbox
from wbmpc.simulation.lockstep import PREPARATION, Ending, Running, Watch, run_lockstep, watched
from wbmpc.simulation.scene import SceneReader
from wbmpc.view import session
from wbmpc.view.session import run_session, system_of
from wbmpc.view.user_commands import REQUESTS, no_requests

pytest.importorskip("viser")
live = pytest.importorskip("wbmpc.view.live")


SHORT = [text for key in ("forces=[10]", "settle_time=0.5", "pause=2.0") for text in ("--set", key)]


def free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def panel_of(view: Any) -> Mailbox:
    """The panel's end of the orders, as a writer that goes on where the panel has stopped."""
    writer = Mailbox(REQUESTS, view.requests.memory, view.requests.checked)
    writer._written = int(writer._latest[0])
    return writer


def press(view: Any, writer: Mailbox, requests: dict[str, Any], after: int = 40) -> None:
    """Write orders when so many more ticks are over, however long a busy machine takes for them."""
    ticks = len(view.own_time) + after

    def later() -> None:
        end = time.monotonic() + 120.0
        while len(view.own_time) < ticks and time.monotonic() < end:
            time.sleep(0.01)
        writer.write(**requests)

    threading.Thread(target=later, daemon=True).start()


class Hand:
    """Takes the panel's part: writes orders into the mailbox at times of the run."""

    def __init__(self, view: Any, plan: list[tuple[float, dict[str, Any]]]) -> None:
        self.view, self.plan, self.seen = view, plan, []  # type: ignore[var-annotated]

    def begin(self, running: Running) -> None:
        self.writer = panel_of(self.view)
        self.requests = no_requests()

    def tick(self, t: float, command: Any, plans: PolicyQueue) -> None:
        self.seen.append((t, time.perf_counter()))
        while self.plan and t >= self.plan[0][0]:
            self.give(self.plan.pop(0)[1])

    def give(self, requests: dict[str, Any]) -> None:
        for name, value in requests.items():
            self.requests[name][...] = value
        self.writer.write(**self.requests)

    def end(self, ending: Ending) -> None: ...


def run(view: Any, seconds: float, *others: Any, seed: int = 1) -> tuple[Ending, Running]:
    plant, controller, mpc, timing = system_of(load_robot("swerve-ur10"), seed).parts
    kept: list[Running] = []

    class Keep:
        def begin(self, running: Running) -> None:
            kept.append(running)

        def tick(self, t: float, command: Any, plans: PolicyQueue) -> None: ...
        def end(self, ending: Ending) -> None: ...

    watchers = (Keep(), *([view] if view else []), *others)
    return run_lockstep(plant, controller, mpc, timing, seconds, lambda *_: None, Watch(None, watchers)), kept[0]


@pytest.mark.wallclock
def test_a_run_with_a_view_is_in_real_time_and_the_same() -> None:
    view = live.View("test", port=free_port())
    try:
        start = time.perf_counter()
        view.open(run(None, 0.01)[1])
        opened = time.perf_counter()
        ending, watched = run(view, 1.5)
        assert ending.reason == "" and time.perf_counter() - opened == pytest.approx(1.5, abs=1.0)
        assert opened - start < 60.0
        assert view.board.text == "The run is over"
    finally:
        view.close()
    _, alone = run(None, 1.5)
    np.testing.assert_array_equal(watched.plant.data.qpos, alone.plant.data.qpos)


@pytest.mark.wallclock
def test_browsers_that_hang_change_nothing() -> None:
    """Two clients connect, ask for everything and never read: the time that watching takes at a tick stays as it was."""
    view = live.View("test", port=free_port())
    sockets: list[socket.socket] = []

    class Connect:
        def begin(self, running: Running) -> None: ...

        def tick(self, t: float, command: Any, plans: PolicyQueue) -> None:
            if t >= 1.5 and not sockets:
                self.previous = len(view.own_time)
                for _ in range(2):
                    sockets.append(hanging_client(view.port, view.access.token))

        def end(self, ending: Ending) -> None: ...

    connect = Connect()
    try:
        ending, _ = run(view, 3.5, connect)
        assert ending.reason == ""
        times = np.array(view.own_time)
        previous, after = times[100 : connect.previous], times[connect.previous :]
        assert np.median(after) < 1.5 * np.median(previous) + 20e-6
        assert np.percentile(after, 90) < 2.0 * np.percentile(previous, 90) + 1e-3
    finally:
        view.close()
        for s in sockets:
            s.close()


def hanging_client(port: int, token: str) -> socket.socket:
    s = socket.create_connection(("127.0.0.1", port))
    s.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    lines = (
        f"GET /{token} HTTP/1.1", f"Host: 127.0.0.1:{port}", "Upgrade: websocket", "Connection: Upgrade",
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Version: 13",
        f"Sec-WebSocket-Protocol: viser-v{version('viser')}",  # others are turned away at once
    )  # fmt: skip
    s.sendall(("\r\n".join(lines) + "\r\n\r\n").encode())
    return s


def test_a_view_whose_process_cannot_start_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    """As where the system gives no more processes. Truth: what the system says."""

    def fails(process: Any) -> None:
        raise OSError(11, "Resource temporarily unavailable")

    monkeypatch.setattr("multiprocessing.process.BaseProcess.start", fails)
    view = live.View("test", port=free_port())
    with pytest.raises(OSError, match="Resource temporarily unavailable"):
        try:
            view.open(run(None, 0.01)[1])
        finally:
            view.close()


@pytest.mark.wallclock
def test_a_view_that_dies_leaves_the_run_alone_even_paused() -> None:
    view = live.View("test", port=free_port())

    try:
        end_effector = Hand(view, [(0.3, {"paused": 1.0})])
        view.open(run(None, 0.01)[1])
        killer = threading.Timer(3.0, os.kill, (view.process.pid, signal.SIGKILL))
        killer.start()
        start = time.perf_counter()
        ending, _ = run(view, 1.0, end_effector)
        assert ending.reason == "" and 2.5 < time.perf_counter() - start < 8.0
    finally:
        view.close()


@pytest.mark.wallclock
def test_pause_step_speed_and_end() -> None:
    view = live.View("test", port=free_port())
    try:
        end_effector = Hand(view, [(0.2, {"speed": 0.5}), (0.6, {"paused": 1.0})])

        def later() -> None:
            time.sleep(1.5)
            for k in (1, 2, 3):
                end_effector.give({"steps": k})
                time.sleep(0.2)
            end_effector.give({"paused": 0.0, "speed": 1.0})
            time.sleep(0.3)
            end_effector.give({"ends": 1})

        view.open(run(None, 0.01)[1])
        thread = threading.Timer(0.0, later)
        hand_begin = end_effector.begin
        end_effector.begin = lambda running: (hand_begin(running), thread.start())  # type: ignore[method-assign,assignment]
        ending, _ = run(view, 60.0, end_effector)
        assert ending.reason.endswith("ended in the view") and view.ended
        assert view.board.text == f"The run is over: {ending.reason}"
        seen = np.array(end_effector.seen)
        wall = lambda a, b: np.interp(b, seen[:, 0], seen[:, 1]) - np.interp(a, seen[:, 0], seen[:, 1])
        assert wall(0.25, 0.55) == pytest.approx(0.6, abs=0.15)  # half the speed
        waits = np.diff(seen[:, 1])
        held = np.flatnonzero(waits > 0.12)
        assert 3 <= len(held) <= 4 and np.all(np.diff(held) == 1)  # the pause, and three single steps
    finally:
        view.close()


def test_each_click_is_a_single_step() -> None:
    """Three clicks before the next tick are three ticks, then the run is held again; clicks while nothing is paused are none."""
    view, held = live.View("test", port=free_port()), []
    view.process, view.running = (
        SimpleNamespace(is_alive=lambda: True),
        SimpleNamespace(interrupted=lambda: bool(held.append(1)) or True),
    )
    view._steps, view._speed, view._origin = 0, 1.0, time.perf_counter() - 1.0
    for steps, paused, expected in ((2, 0.0, 0), (5, 1.0, 0), (5, 1.0, 0), (5, 1.0, 0), (5, 1.0, 1)):
        view._requests["steps"][...], view._requests["paused"][...] = steps, paused
        view._wait(0.0, None)
        assert len(held) == expected


@thorough
def test_a_run_restarts_from_its_start_on_reset(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The first one ends where the button was pressed, with all its files; the next one is the run as it is without a view."""
    make, begun = live.View.begin, []

    def begin(view: Any, running: Running) -> None:
        make(view, running)
        begun.append(running)
        if len(begun) == 1:
            requests, writer = no_requests(), panel_of(view)
            requests["resets"][...] = 1
            press(view, writer, requests)

    arguments = ["run", "rezero-push-ball", *SHORT, "--json", "--out"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(live.View, "begin", begin)
        port = str(free_port())
        assert main([*arguments, str(tmp_path / "seen"), "--view", "--port", port]) == 0
    captured = capsys.readouterr()
    result = json.loads(captured.out)
    assert len(begun) == 2 and f"restarted; the run until then is in {tmp_path / 'seen'}\n" in captured.err
    first, second = read_recording(tmp_path / "seen"), read_recording(tmp_path / "seen-2")
    assert first.metadata["result"]["reason"].endswith("restarted in the view")
    assert 0.0 < first.end < second.end and second.metadata["result"]["completed"] == "true"
    assert main([*arguments, str(tmp_path / "alone")]) == 0
    printed = capsys.readouterr().out  # a view of a test before may end now, and says so
    assert json.loads(printed[printed.index("{") :])["metrics"] == result["metrics"]
    np.testing.assert_array_equal(
        *(read_recording(tmp_path / n)["/ground_truth/end_effector"].data for n in ("seen-2", "alone"))
    )


def test_a_steered_run_says_so(tmp_path: Path) -> None:
    make = live.View.begin

    def begin(view: Any, running: Running) -> None:
        make(view, running)
        requests, writer = no_requests(), panel_of(view)
        requests["pushes"][...], requests["push"][...], requests["push_time"][...] = 1, [1.0, 0.0, 0.0], 0.1
        writer.write(**requests)
        requests["ends"][...] = 1
        press(view, writer, requests)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(live.View, "begin", begin)
        command = ["run", "rezero-push-ball", *SHORT, "--quiet", "--out", str(tmp_path), "--view", "--port"]
        assert main([*command, str(free_port())]) == 130
    result = json.loads((tmp_path / "metrics.json").read_text())
    assert result["reason"].endswith("ended in the view") and result["idealisations"][-1] == STEERED


def listening(port: int) -> set[str]:
    """The addresses, as the kernel has them, at which somebody listens on a port."""
    with open("/proc/net/tcp") as table:
        rows = [line.split() for line in table.readlines()[1:]]
    return {r[1].split(":")[0] for r in rows if r[3] == "0A" and int(r[1].split(":")[1], 16) == port}


def test_a_run_without_an_mpc_is_shown_on_this_machine_alone() -> None:
    """Every part in its own world; there are no goals and no weights."""
    view = live.View("test", port=free_port())
    shown: list[dict[str, Any]] = []

    def block(spec: Any) -> None:
        spec.worldbody.add_geom(type=6, size=[0.1, 0.1, 0.1], pos=[1.5, 0.0, 0.1])

    try:
        for edit in (None, block):
            plant = SwervePlant(load_description("swerve-ur10"), edit=edit)
            with watched(plant, 0.01, 0.2, Watch(None, (view,))) as tick:
                for k in range(20):
                    tick(0.01 * k, SwerveCommand.stop())
                    plant.step(SwerveCommand.stop(), 20)
            shown.append(view.shown.read().values)
            assert listening(view.port) == {"0100007F"}
        assert [len(view.scene.shapes)] == [len(SceneReader(plant.model, "body").scene.shapes)]
        assert all(np.isfinite(s["poses"]).all() and np.isnan(s["goal"]).all() for s in shown)
    finally:
        view.close()


def test_a_drive_before_the_run_is_announced_and_cannot_be_pushed() -> None:
    """Its calibration is kept for later runs: a push would be in all of them."""
    view, pushed = live.View("test", port=free_port()), []
    try:
        for name in (PREPARATION, ""):
            plant = SwervePlant(load_description("swerve-ur10"))
            with watched(plant, 0.01, 0.4, Watch(None, (view,), name)) as tick:
                assert view.board.text == (f"{PREPARATION} (0 s)" if name else "")
                push = {
                    **no_requests(),
                    "pushes": np.array(1.0),
                    "push": np.array([0.0, 300.0, 0.0]),
                    "push_time": np.array(0.2),
                }
                panel_of(view).write(**push)
                for k in range(40):
                    tick(0.01 * k, SwerveCommand.stop())
                    plant.step(SwerveCommand.stop(), 20)
            pushed.append(view.commanded)
        assert pushed == [False, True]
    finally:
        view.close()


def test_a_session_restarts_on_reset() -> None:
    view = live.View("test", port=free_port())
    begun: list[float] = []
    original = view.begin

    def begin(running: Running) -> None:
        original(running)
        begun.append(time.perf_counter())
        writer, requests = panel_of(view), no_requests()
        requests["resets" if len(begun) == 1 else "ends"][...] = len(begun)
        requests["resets"][...] = 1
        press(view, writer, requests)

    view.begin = begin  # type: ignore[method-assign]
    try:
        ending = run_session("rezero", 1, view)
        assert ending.reason.endswith("ended in the view") and len(begun) == 2
    finally:
        view.close()


def test_runs_that_were_reset_leave_no_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Truth: weak references to their planners, while Python itself collects nothing. The view still shows the last one."""
    view = live.View("test", port=free_port())
    planners: list[Any] = []
    gone: list[bool] = []

    def ended(*parts: Any) -> Ending:
        planners.append(weakref.ref(parts[2]))
        view.running = Running(*parts[:4], 1.0)
        gone.append(len(planners) < 3 or planners[-3]() is None)
        view.wants_reset = len(planners) < 4
        return Ending("restarted in the view")

    monkeypatch.setattr(session, "run_lockstep", ended)
    gc.collect()
    gc.disable()
    try:
        run_session("rezero", 1, view)
    finally:
        gc.enable()
    assert gone == [True] * 4


def test_bad_input(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="--port: must be 1 to 65535, got 70000"):
        live.View("test", port=70000)
    assert main(["replay", "nowhere", "--port", "0"]) == 2
    assert "--port: must be 1 to 65535, got 0" in capsys.readouterr().err
    assert main(["view", "swerv-ur10"]) == 2
    assert "did you mean 'swerve-ur10'" in capsys.readouterr().err
    monkeypatch.setattr("wbmpc.view.core.find_spec", lambda name: None)
    assert main(["run", "swerve-track", "--view"]) == 2
    assert capsys.readouterr().err == "wbmpc: view: this needs viser: pip install 'wbmpc[viz]'\n"


def test_a_view_that_cannot_open_leaves_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert main(["run", "rezero-steps", "--view", "--host", "no.such.host.invalid", "--out", str(out)]) == 2
    err = capsys.readouterr().err
    assert (
        "--host: 'no.such.host.invalid' is no address of this machine" in err
        and "Traceback" not in err
        and not out.exists()
    )


def test_a_host_beyond_this_machine_is_warned_of(capsys: pytest.CaptureFixture[str]) -> None:
    from wbmpc.cli.views import open_view

    open_view("x", "127.0.0.1", 8080)
    assert capsys.readouterr().err == ""
    open_view("x", "0.0.0.0", 8080)
    assert "unencrypted" in capsys.readouterr().err


def test_the_page_says_why_the_robot_fell() -> None:
    """Shoved with 3 000 N; also beside the run that restarts afterwards."""
    view, texts = live.View("test", port=free_port()), []  # type: ignore[var-annotated]

    class Shove:
        def begin(self, running: Running) -> None:
            texts.append(view.board.text)
            if len(texts) == 1:
                running.plant.push([3000.0, 0.0, 0.0])

        def tick(self, t: float, command: Any, plans: PolicyQueue) -> None: ...
        def end(self, ending: Ending) -> None:
            texts.append(view.board.text)

    try:
        for seconds in (3.0, 0.01):
            plant, controller, mpc, timing = system_of(load_robot("rezero"), 1).parts
            run_lockstep(plant, controller, mpc, timing, seconds, lambda *_: None, Watch(None, (view, Shove())))
    finally:
        view.close()
    why = r"the robot fell at \d\.\d\d s because its base leaned by (\d+) deg, the limit is 52 deg.*"
    assert texts[0] == "" and re.fullmatch(f"The run is over: {why}", texts[1])
    assert texts[2] == texts[1].replace("The run is over", "Before") and texts[3] == "The run is over"
    found = re.search(why, texts[1])
    assert found is not None and 52 <= int(found[1]) < 90


def test_speeds_that_are_none_are_left_out() -> None:
    """Whatever writes the orders: a speed of 0 or NaN would end the run."""
    view, rejected = live.View("test", port=free_port()), []  # type: ignore[var-annotated]
    view.requests, view.reject = Mailbox(REQUESTS), rejected.append  # type: ignore[method-assign]
    view._ends = view._resets = 0
    for speed, kept in ((0.5, 0.5), (0.0, 0.5), (np.nan, 0.5), (np.inf, 0.5), (1.0, 1.0)):
        view.requests.write(**{**no_requests(), "speed": np.array(speed)})
        view._take_requests()
        view._anchor(0.0)
        assert view._speed == kept
    assert len(rejected) == 3 and all("speed: must be 0.05 to 1" in reason for reason in rejected)


def test_the_page_says_that_a_robot_fell_once_it_was_stopped() -> None:
    """Pushes that the page offers end in a stop with a reason, and the motors are off before it lies."""
    view, texts = live.View("test", port=free_port()), list[str]()
    view.show_message, view._before = texts.append, False  # type: ignore[method-assign]
    view.end(Ending("stopped at 0.44 s: a force of at least 333 N; motors off", fell=True))
    view.end(Ending("the robot fell at 1.20 s because its base leaned by 55 deg", fell=True))
    view.end(Ending("stopped at 0.44 s: an encoder stands still"))
    assert texts[0] == "The run is over: stopped at 0.44 s: a force of at least 333 N; motors off; then the robot fell"
    assert [text.count("fell") for text in texts] == [1, 1, 0]
