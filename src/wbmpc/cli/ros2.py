"""Commands of ROS 2: the controller as a node, a simulated robot as one, a check of a bus."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from wbmpc.cli.directories import AsJson
from wbmpc.cli.terminal import ABORTED

if TYPE_CHECKING:
    from wbmpc.model.robot import RobotModel
    from wbmpc.ros2.settings import RosSettings

ros2 = typer.Typer(name="ros2", help="ROS 2: the controller, a simulated robot, a check of a robot's bus.")
Robot = Annotated[str, typer.Argument(help="Name of the robot (see 'wbmpc list') or its YAML file.")]
Config = Annotated[Path | None, typer.Option("--config", help="YAML file: topics, frames, joints, rates.")]
BackEnd = Annotated[str, typer.Option("--backend", help="auto, rclpy or dds.")]
SimTime = Annotated[bool, typer.Option("--use-sim-time", help="Take the time from /clock.")]
Lockstep = Annotated[
    bool, typer.Option("--lockstep", help="For both nodes: the simulation waits for each command, in simulated time.")
]
AsJsonAtEnd = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else, when it has ended.")]
#: So long [s] a check listens at most: a day. What sleeps for ever does not answer.
LONGEST_LOOK = 86_400.0
Fifo = Annotated[bool, typer.Option("--fifo", help="Run with real-time priority (SCHED_FIFO; needs the permission).")]


@ros2.callback(invoke_without_command=True)
def ros2_options(context: typer.Context) -> None:
    """ROS 2: the controller, a simulated robot, a check of a robot's bus."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


def _on_bus(
    context: typer.Context, robot: str, config: Path | None, backend: str, suffix: str = "", use_sim_time: bool = False,
    lockstep: bool = False, priority: int = 0,
) -> tuple[Any, RobotModel, RosSettings]:  # fmt: skip
    """A node for a command that runs until it is interrupted or commanded to end, and what the file and the options say."""
    import logging

    if priority:
        _before_all_others(priority)  # threads that are made from now on, those of the bus too, are as this one

    from wbmpc.logs import PlaceLimit
    from wbmpc.model.robot import load_robot
    from wbmpc.ros2.opening import open_node
    from wbmpc.ros2.settings import load_settings

    log = logging.getLogger("wbmpc")
    verbose = log.isEnabledFor(logging.INFO)  # a node logs what it does, unless it is to be quiet; with --verbose more
    log.setLevel(logging.ERROR if context.obj.quiet else logging.DEBUG if verbose else logging.INFO)
    for handler in log.handlers:  # others on the bus decide how often something happens
        handler.addFilter(PlaceLimit())
    model = load_robot(robot)
    settings = load_settings(config, model)
    lockstep = settings.lockstep or lockstep
    sim_time = settings.use_sim_time or use_sim_time or lockstep
    settings = settings.model_copy(update={"use_sim_time": sim_time, "lockstep": lockstep})
    node = open_node(f"{settings.node}{suffix}", backend)
    log.debug("node '%s' by %s; settings: %s", f"{settings.node}{suffix}", node.backend, settings.model_dump_json())
    return node, model, settings


def _before_all_others(priority: int) -> None:
    """The kernel lets this process run whenever it can, one of higher priority first. Raises :class:`InputError` without the
    right to."""
    import os

    from wbmpc.errors import InputError

    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except (AttributeError, PermissionError) as error:
        raise InputError(f"--fifo: the system does not allow it ({error}); see 'rtprio' in limits.conf") from error


@ros2.command("control")
def ros2_control(
    context: typer.Context, robot: Robot, config: Config = None, backend: BackEnd = "auto",
    use_sim_time: SimTime = False, lockstep: Lockstep = False, fifo: Fifo = False, as_json: AsJsonAtEnd = False,
) -> None:  # fmt: skip
    """Run the controller as a node; it waits for joint states and a goal."""
    node, model, settings = _on_bus(context, robot, config, backend, "", use_sim_time, lockstep, 10 * fifo)
    from wbmpc.ros2.control import ControlNode
    from wbmpc.ros2.publishers import collect_statistics
    from wbmpc.simulation.lockstep import interrupt_noted

    try:
        control = ControlNode(node, model, settings)  # a signal ends it at once: nothing moves yet
        with interrupt_noted() as ended:  # the robot is brought to rest first
            control.spin(ended)
    finally:
        node.close()
    if as_json:
        typer.echo(json.dumps({"state": control.state, "figures": collect_statistics(control)}))


@ros2.command("sim")
def ros2_sim(
    context: typer.Context,
    robot: Robot,
    config: Config = None,
    backend: BackEnd = "auto",
    seed: Annotated[int, typer.Option(min=0, help="Seed of the plant and of all noise.")] = 200,
    factor: Annotated[float, typer.Option(min=0.01, help="Speed of the simulation relative to real time.")] = 1.0,
    seconds: Annotated[
        float, typer.Option(min=0.1, show_default=False, help="Simulated time after which it ends (default: never).")
    ] = 1e9,
    use_sim_time: SimTime = False,
    lockstep: Lockstep = False,
    fifo: Fifo = False,
    as_json: AsJsonAtEnd = False,
) -> None:
    """Simulate the robot as a node: joint states, inertial unit, clock; takes the controllers' commands. Status 1 if the robot falls."""
    verbose = not context.obj.quiet
    node, model, settings = _on_bus(context, robot, config, backend, "_sim", use_sim_time, lockstep, 5 * fifo)
    from wbmpc.ros2.sim import SimNode
    from wbmpc.simulation.lockstep import interrupt_noted

    try:
        sim = SimNode(node, model, settings, seed, factor=factor)
        with interrupt_noted() as ended:
            if verbose:
                typer.echo(f"the simulated robot is on the bus ({node.backend})", err=True)
            why = sim.spin(ended, seconds)
    finally:
        node.close()
    if verbose:
        typer.echo(f"{why}; too slow {sim.behind} times", err=True)
    if as_json:
        typer.echo(json.dumps({"ended": why, "seconds": round(sim.time, 6), "behind": sim.behind, "seed": seed}))
    if sim.failed:
        raise typer.Exit(ABORTED)


@ros2.command("check")
def ros2_check(
    context: typer.Context,
    robot: Robot,
    config: Config = None,
    backend: BackEnd = "auto",
    use_sim_time: SimTime = False,
    seconds: Annotated[float, typer.Option(min=0.5, max=LONGEST_LOOK, help="How long it listens.")] = 3.0,
    as_json: AsJson = False,
) -> None:
    """List what is missing, mistyped, too slow or wrong on a robot's bus. Sends nothing; status 1 if there is an error."""
    node, model, settings = _on_bus(context, robot, config, backend, "_check", use_sim_time)
    from wbmpc.ros2.check import ERROR, check

    try:
        found = check(node, model, settings, seconds)
    finally:
        node.close()
    if as_json:
        typer.echo(json.dumps({"findings": [vars(f) for f in found]}))
    else:
        width = max(len(f.topic) for f in found) + 2
        for f in found:
            typer.echo(f"{f.level:8s}{f.topic:{width}s}{f.text}")
    if any(f.level == ERROR for f in found):
        raise typer.Exit(ABORTED)
