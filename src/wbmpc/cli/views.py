"""Commands that open a view in the browser."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from wbmpc.view.live import View

LOCAL = "127.0.0.1"
Host = Annotated[str, typer.Option(help="Address that the view listens on (the default: this machine alone).")]
Port = Annotated[int, typer.Option(help="Port of the view; a busy one is passed over.")]


def warn(host: str) -> None:
    """Say what an address beyond this machine means."""
    if host not in (LOCAL, "localhost", "::1"):
        typer.echo(
            f"warning: the view listens on {host} without authentication: whoever reaches it steers the run", err=True
        )


def open_view(title: str, host: str, port: int, *, reset: bool = False) -> View:
    """A view that says where it is when it can be opened."""
    from wbmpc.view.live import View

    shown = View(title, host, port, reset=reset, opened=lambda url: typer.echo(f"the view is at {url}", err=True))
    warn(host)
    return shown


def view(
    robot: Annotated[str, typer.Argument(help="Name of a robot (see 'wbmpc list'), or one's own YAML.")],
    seed: Annotated[int, typer.Option(help="Seed of the plant and of all noise.")] = 200,
    host: Host = LOCAL,
    port: Port = 8080,
) -> None:
    """Drive a robot in a browser: it stands in MuJoCo with its MPC and goes where its goals are dragged."""
    from wbmpc.view.session import run_session

    shown = open_view(robot, host, port, reset=True)
    try:
        ending = run_session(robot, seed, shown)
    finally:
        shown.close()
    typer.echo(ending.reason, err=True)
