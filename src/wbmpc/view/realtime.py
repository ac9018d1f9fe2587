"""The view of a real-time runner: its control thread hands out states, its MPC's thread plans and goals, and takes commands.

Both write into mailboxes in shared memory and do not wait; pictures are made in the view's own process, of the estimated
state by the robot's kinematics. Where the robot is simulated, its physics shows the contacts.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.bases import base_type
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.mpc.mpc import MPC
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.recording.observer import predicted, thinned
from wbmpc.runtime.runner import RealTimeRunner
from wbmpc.runtime.shared_memory import Mailbox
from wbmpc.simulation.lockstep import Running
from wbmpc.simulation.perturbation import perturbation_model
from wbmpc.simulation.scene import SceneReader
from wbmpc.solver import Trajectory
from wbmpc.view.actuator_load import DRIVES, SHARES, Loads
from wbmpc.view.core import LiveView, followed, numbers, solved
from wbmpc.view.history import Factor, Trail
from wbmpc.view.named_configuration import NamedConfiguration
from wbmpc.view.process import RATE
from wbmpc.view.snapshot import GROUND, PLAN, REFERENCE, TRAIL, filled
from wbmpc.view.user_commands import UserCommands

_HERE = np.array([0.0, 0, 0, 1, 0, 0, 0])
#: How often the session's own thread looks whether the run has ended [s].
_POLL_PERIOD = 0.05


class RealtimeView(LiveView):
    """Shows one runner after another at ``url``; ``wants_reset``, ``ended``: what the user asked for; ``stopped``: whether the last
    one stopped by safety.

    ``robot``: name or path, for the view's process loads it too; ``push(force)``: what a push (3) [N] does; ``seen``: mailbox of
    what a simulation shows (:data:`wbmpc.view.physics.SEEN`). Give :attr:`watch` to the runner; :meth:`guide` steers its MPC.
    """

    def __init__(
        self, title: str, robot: str, host: str = "127.0.0.1", port: int = 8080, *,
        opened: Callable[[str], None] = lambda url: None, with_token: bool = True,
    ) -> None:  # fmt: skip
        super().__init__(title, host, port, opened, with_token)
        self.robot_name, self.robot = robot, load_robot(robot)
        self.stopped, self._shown_at, self._late = False, -np.inf, 0.0
        self._runner: RealTimeRunner | None = None
        #: What the view's process reads of every simulation, one after another; None before :meth:`open`.
        self.seen: Mailbox | None = None

    def open(self, mpc: MPC, seen: Mailbox | None) -> None:
        """Start the process; returns when it answers."""
        self.seen = seen
        scene = scene_of(self.robot)[1]
        loads = Loads(self.robot.description, scene.joint_names)
        groups = tuple(g for g in loads.groups if g != DRIVES)  # which come last, and are not measured
        controls = self._controls(mpc, self.robot, groups, paced=False, pushes=seen is not None)
        nx = mpc.dynamics.state.size
        self.moments = Mailbox.shared({"t": (), "late": (), "x": (nx,), "ticks": (), "misses": ()})
        shown = {
            "plan": (PLAN, nx), "reference": (REFERENCE, 3), "goal": (7,), "base_goal": (3,), "solve": (), "deadline": (),
            "clearance": (), "brakes": (), "obstacle": (8,),
        }  # fmt: skip
        drawer = partial(Picture, self.robot_name, self.moments, seen)
        self.start(scene.scene, controls, shown, drawer)

    # ------------------------------------------------------------------ the control thread
    def watch(self, t: float, late: float, plans: PolicyQueue) -> None:
        """Hand out the estimated state, at most :data:`~wbmpc.view.process.RATE` times a second."""
        self._late = max(self._late, late)
        if t < self._shown_at + 1.0 / RATE:
            return
        counts = {n: np.nan if self._runner is None else self._runner.own[n] for n in ("ticks", "misses")}
        self.moments.write(t=t, late=self._late, x=self._controller.state(), **counts)
        self._shown_at, self._late = t, 0.0

    # ------------------------------------------------------------------ the MPC's thread
    def guide(self, mpc: MPC, controller: Any, push: Callable[[Array], None]) -> None:
        """Steer this MPC from now on, before each of its solves; ``controller`` is the runner's."""
        self._controller, self._shown_at = controller, -np.inf
        self.wants_reset = self.stopped = False
        self.show_message(self._previous)
        lift = np.array([0.0, 0.0, -self.robot.base.ground])
        stand_in = _Robot(controller, push)
        running: Any = Running(stand_in, stand_in, mpc, None, np.inf)  # type: ignore[arg-type]
        commands = UserCommands(running, lift, self.reject)
        commands.skip(self._requests)
        self._expect()
        previous, planned = mpc.guess, [-np.inf]

        def guess(t: float, x0: Array, trajectory: Trajectory) -> Trajectory | None:
            self._read_requests()
            stand_in.x = x0
            commands.apply(t, self._requests, _HERE)
            self.ended = self.ended or self._asked("ends")
            self.wants_reset = self._asked("resets")
            if t >= planned[0] + 1.0 / RATE:
                planned[0] = t
                self.shown.write(
                    **_plan(mpc, t, lift), brakes=commands.brakes_open(t), obstacle=commands.obstacle(_HERE)
                )
            return None if previous is None else previous(t, x0, trajectory)

        mpc.guess = guess

    # ------------------------------------------------------------------ the session's thread
    def follow(self, runner: RealTimeRunner) -> str:
        """Start the runner and wait until the user, Ctrl-C or a safe stop ends it; returns why. Raises what :meth:`check_shown` does."""
        self._runner = runner
        with runner:
            while not (runner.stopped or self.ended or self.wants_reset):
                self.check_shown()
                time.sleep(_POLL_PERIOD)
            self.show_message(f"The run is over: {self._reason(runner)}")  # the threads' end may take a while
        self.stopped = runner.stopped
        self._previous = f"Before: {runner.state}" if runner.stopped else ""
        return self._reason(runner)

    def _reason(self, runner: RealTimeRunner) -> str:
        if runner.stopped:
            return runner.state
        return "restarted in the view" if self.wants_reset else "ended in the view"


class _Robot:
    """What steering needs of plant and controller, in the MPC's thread: the state ``x`` (nx) that the next solve begins with."""

    def __init__(self, controller: Any, push: Callable[[Array], None]) -> None:
        self._controller, self.push, self.robot, self.x = controller, push, controller.robot, controller.robot.home

    def state(self) -> Array:
        return self.x

    @property
    def brakes(self) -> Any:
        """Brake states over time; the controller's own."""
        return self._controller.brakes

    @brakes.setter
    def brakes(self, value: Any) -> None:
        self._controller.brakes = value


def _plan(mpc: MPC, t: float, lift: Array) -> dict[str, Any]:
    """What the MPC follows and plans; the plan is that of the solve before."""
    target, states = followed(mpc, t, lift), thinned(mpc.solver.trajectory(copy=False).x)
    return {
        "plan": filled(states, (PLAN, mpc.dynamics.state.size)), "goal": target.goal, "base_goal": target.base,
        "reference": filled(target.way, (REFERENCE, 3)), **solved(mpc),
    }  # fmt: skip


# ---------------------------------------------------------------------- in the view's process
def scene_of(robot: RobotModel) -> tuple[Any, SceneReader]:
    """The robot in MuJoCo as its file describes it, to be posed without physics, and the reader of its scene."""
    kind = robot.description.base.type
    plant = base_type(kind).plant(robot, perturbation_model(kind).none(), 0)
    return plant, SceneReader(plant.model, robot.description.base.body)


class Picture:
    """From messages of a real-time run to snapshots, all in the frame of the estimate."""

    def __init__(self, robot: str, moments: Mailbox, seen: Mailbox | None) -> None:
        self.robot, self._moments, self._seen = load_robot(robot), moments, seen
        self._plant, self._reader = scene_of(self.robot)
        self._lift = np.array([0.0, 0.0, -self.robot.base.ground])
        self._loads = Loads(self.robot.description, self._reader.joint_names)
        self._moment: dict[str, Array] = {"t": np.array(0.0), "late": np.array(np.nan), "x": self.robot.home}
        self._moment |= {name: np.array(np.nan) for name in ("ticks", "misses")}
        self._ground: dict[str, Array] = {"base": _HERE, **{n: np.full(s, np.nan) for n, s in GROUND.items()}}
        self._ground |= {name: np.array(np.nan) for name in ("time", "clock")}
        self._factor, self._trail = Factor(), Trail()
        self._configuration = NamedConfiguration(self.robot, self._reader.joint_names)
        self._previous: tuple[float, Array] | None = None
        self._shares = dict.fromkeys(SHARES, np.nan)

    def __call__(self, plan: dict[str, Array]) -> dict[str, Any]:
        """The newest of everything; ``plan``: the MPC's message."""
        moment = self._moments.read()
        if moment is not None and moment.values["t"] < self._moment["t"]:  # another run begins
            self._trail.reset()
            self._previous, self._shares = None, dict.fromkeys(SHARES, np.nan)
        self._moment = moment.values if moment is not None else self._moment
        seen = self._seen.read() if self._seen is not None else None
        self._ground = seen.values if seen is not None else self._ground
        self._plant.arrange(self._moment["x"])
        poses = self._reader.poses(self._plant.data)
        position, orientation = self.robot.pose(self._moment["x"])
        end_effector = np.concatenate([position + self._lift, orientation])
        states, index = plan["plan"][np.isfinite(plan["plan"]).all(axis=1)], self._reader.scene.index
        base_plan, end_effector_plan = predicted(self.robot, self.robot.state, states, self._lift)
        ways = {"end_effector_plan": end_effector_plan, "base_plan": base_plan}
        others: dict[str, Any] = {
            "t": self._moment["t"], "late": self._moment["late"],
            **{name: plan[name] for name in ("solve", "deadline", "clearance")}, **self._speeds(),
            **{name: self._ground[name] for name in ("margin", "triangle_margin")},
            "ticks": self._moment["ticks"], "late_ticks": self._moment["misses"],
            "configuration": self._configuration.number(self._reader.joint_states(self._plant.data)[:, 0]),
            "factor": self._factor.add(float(self._ground["clock"]), float(self._ground["time"])),
        }  # fmt: skip
        return {
            "numbers": numbers(end_effector, plan["goal"], poses[index], plan["base_goal"], others), "poses": poses, "goal": plan["goal"],
            "base_goal": plan["base_goal"], "brakes": plan["brakes"], "obstacle": plan["obstacle"], "reference": plan["reference"],
            "trail": filled(self._trail.add(end_effector[:3]), (TRAIL, 3)),
            **{name: filled(way[:, :3], (PLAN, 3)) for name, way in ways.items()}, **self._on_floor(poses[index]),
        }  # fmt: skip

    def _speeds(self) -> dict[str, float]:
        """Largest joint speeds over their limits, between the last two states."""
        t, joints = float(self._moment["t"]), self._reader.joint_states(self._plant.data)[:, 0]
        if self._previous is None or t > self._previous[0]:
            if self._previous is not None:
                self._shares = self._loads.shares((joints - self._previous[1]) / (t - self._previous[0]))
            self._previous = (t, joints)
        return self._shares

    def _on_floor(self, estimated: Array) -> dict[str, Array]:
        """Contacts where the estimate has the robot."""
        shift = lie.pose_compose(estimated, lie.pose_inverse(self._ground["base"]))
        turn = lie.quaternion_to_rotation(shift[3:]).T
        return {name: self._ground[name] @ turn + shift[:3] for name in ("forces", "support", "triangle", "pressure")}
