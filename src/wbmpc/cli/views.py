"""Commands that open a view in the browser."""

from __future__ import annotations

import io
import json
import math
from contextlib import nullcontext, redirect_stdout, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wbmpc.cli.directories import RECORD_LIMIT, AsJson, Force, RecordLimit, new_file, run_directory, size_of
from wbmpc.cli.terminal import ABORTED, robot_names
from wbmpc.errors import InputError
from wbmpc.view.access import Access, is_loopback

if TYPE_CHECKING:
    from wbmpc.view.live import View

LOCAL = "127.0.0.1"
Host = Annotated[str, typer.Option(help="Address that the view listens on (the default: this machine alone).")]
Port = Annotated[int, typer.Option(help="Port of the view; if it is busy, the next free one.")]


NoToken = Annotated[
    bool,
    typer.Option("--no-token", help="Let every user of this machine open the view, without the token in its address."),
]


def warn(host: str) -> None:
    """Say what an address beyond this machine means."""
    if not is_loopback(host):
        typer.echo(
            f"warning: the view listens on {host}, unencrypted: anyone with its address and token can steer the run",
            err=True,
        )


def print_address(url: str, as_json: bool = False, what: str = "view") -> None:
    """Where a browser finds it: a message on standard error, or the object on standard output."""
    typer.echo(json.dumps({"url": url}) if as_json else f"the {what} is at {url}", err=not as_json)


def open_view(title: str, host: str, port: int, no_token: bool = False, *, as_json: bool = False) -> View:
    """A view that says where it is when it can be opened."""
    from wbmpc.view.live import View

    shown = View(title, host, port, opened=partial(print_address, as_json=as_json), with_token=not no_token)
    warn(shown.access.host)
    return shown


def view(
    robot: Annotated[
        str, typer.Argument(help="Name of a robot (see 'wbmpc list') or its YAML file.", autocompletion=robot_names)
    ],
    seed: Annotated[int, typer.Option(help="Seed of the plant and of all noise.")] = 200,
    realtime: Annotated[
        bool, typer.Option("--realtime", help="Run controller, MPC and physics in real time; the run cannot be paused.")
    ] = False,
    out: Annotated[Path | None, typer.Option(help="Directory for a recording (default: no recording).")] = None,
    host: Host = LOCAL,
    port: Port = 8080,
    no_token: NoToken = False,
    record_limit: RecordLimit = RECORD_LIMIT,
    as_json: AsJson = False,
) -> None:
    """Drive a simulated robot in a browser: drag its goals, and its MPC follows them."""
    limit = size_of("--record-limit", record_limit)
    if out is None and record_limit != RECORD_LIMIT:
        raise InputError("--record-limit: nothing is recorded without --out DIRECTORY")
    if realtime:
        if out is not None:
            raise InputError("--out: what runs in real time is not recorded; leave out --realtime")
        _view_realtime(robot, seed, host, port, no_token, as_json)
        return
    from wbmpc.recording.recorder import Recorder
    from wbmpc.report import RECORDING, about_run
    from wbmpc.view.session import run_session

    shown, reason, expected = open_view(robot, host, port, no_token, as_json=as_json), "an error of the program", False
    with nullcontext() if out is None else run_directory(out, robot, seed) as directory:
        recorders = []
        if directory is not None:
            recorders = [Recorder(directory / RECORDING, about_run(f"view {robot}", seed, {}), limit)]
        try:
            ending = run_session(robot, seed, shown, *recorders)
            reason, expected = ending.reason, ending.interrupted or shown.ended or not ending.reason
        finally:
            shown.close()
            for recorder in recorders:
                recorder.close({"completed": "false", "reason": reason})
    typer.echo(reason, err=True)
    for recorder in recorders:
        typer.echo(recorder.failure or f"the recording is {recorder.path}", err=True)
        expected = expected and not recorder.failure
    if not expected:
        raise typer.Exit(ABORTED)


def _view_realtime(robot: str, seed: int, host: str, port: int, no_token: bool, as_json: bool) -> None:
    from wbmpc.view.realtime import RealtimeView
    from wbmpc.view.session import run_realtime

    opened = partial(print_address, as_json=as_json)
    shown = RealtimeView(f"{robot}, real time", robot, host, port, opened=opened, with_token=not no_token)
    warn(shown.access.host)
    reason = "interrupted"
    try:
        with suppress(KeyboardInterrupt):
            reason = run_realtime(robot, seed, shown)
    finally:
        shown.close()
    if shown.stopped:  # the runner has said why
        raise typer.Exit(ABORTED)
    typer.echo(reason, err=True)


def replay(
    file: Annotated[Path, typer.Argument(help="The recording (run.mcap), or the directory of the run.")],
    html: Annotated[Path | None, typer.Option(help="Write a page that needs no server, and show nothing.")] = None,
    force: Force = False,
    host: Host = LOCAL,
    port: Port = 8080,
    no_token: NoToken = False,
    as_json: AsJson = False,
) -> None:
    """Show a recording in a browser, with a time bar, or write it as one page."""
    from importlib.util import find_spec

    from wbmpc.recording.reader import read_recording
    from wbmpc.view.replay import Film, Player, write_page

    if html is not None:
        new_file("--html", html, html, force)
        write_page(Film(read_recording(file)), html)
        typer.echo(json.dumps({"page": str(html)}) if as_json else f"the replay is in {html}")
        return
    if find_spec("viser") is None:
        raise InputError("replay: this needs viser: pip install 'wbmpc[viz]'")
    if not 0 < port < 65536:
        raise InputError(f"--port: must be 1 to 65535, got {port}")
    access = Access.of(host, not no_token)
    film = Film(read_recording(file))
    with redirect_stdout(io.StringIO()):  # the server's banner
        warn(access.host)
        player = Player(film, access, port)
    print_address(player.url, as_json, "replay")
    with suppress(KeyboardInterrupt):
        player.run()
    with redirect_stdout(io.StringIO()):  # the server says that it stops
        player.server.stop()


def render(
    file: Annotated[Path, typer.Argument(help="The recording (run.mcap), or the directory of the run.")],
    mp4: Annotated[Path | None, typer.Option(help="Write an MP4 video.")] = None,
    gif: Annotated[Path | None, typer.Option(help="Write an animated GIF.")] = None,
    webp: Annotated[Path | None, typer.Option(help="Write an animated WebP, which is smaller than a GIF.")] = None,
    png: Annotated[Path | None, typer.Option(help="Write a picture at the time --start.")] = None,
    start: Annotated[float, typer.Option(help="Start time (seconds).")] = 0.0,
    end: Annotated[
        float, typer.Option(show_default=False, help="End time (seconds; default: the end of the run).")
    ] = math.inf,
    speed: Annotated[float, typer.Option(help="Speed of the clip relative to the run.")] = 1.0,
    width: Annotated[int, typer.Option(min=16, max=1920, help="Pixels.")] = 960,
    height: Annotated[int, typer.Option(min=16, max=1080, help="Pixels.")] = 540,
    labels: Annotated[bool, typer.Option(help="Draw title, time and a legend of the lines.")] = True,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Render a recording as a video, a GIF or a picture; no display is needed."""
    from wbmpc.recording.reader import read_recording
    from wbmpc.view.render import render as draw
    from wbmpc.view.replay import Film

    targets = [
        (path, kind) for path, kind in zip((mp4, gif, webp, png), (".mp4", ".gif", ".webp", ".png")) if path is not None
    ]
    if not targets:
        raise InputError("render: what to write is missing; valid: --mp4 FILE, --gif FILE, --webp FILE, --png FILE")
    for path, kind in targets:
        if path.suffix.lower() != kind:
            raise InputError(f"--{kind[1:]}: '{path}' must end in {kind}")
        new_file(f"--{kind[1:]}", path, path, force)
    if not start >= 0.0:
        raise InputError(f"--start: must not be negative, got {start:g}")
    film = Film(read_recording(file))
    drawn = {str(path): draw(film, path, (start, end), (width, height), speed, labels) for path, _ in targets}
    if as_json:
        typer.echo(json.dumps({"pictures": drawn}))
        return
    for name, count in drawn.items():
        typer.echo(f"{name}: {count} {'picture' if count == 1 else 'pictures'}")
