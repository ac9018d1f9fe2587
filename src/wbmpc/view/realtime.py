"""The view of a real-time runner: its control thread hands out states, its MPC's thread plans and goals, and takes orders.

Both write into mailboxes in shared memory and wait for nobody; pictures are made in the view's own process, of the estimated
state by the robot's kinematics. Where the robot is simulated, its physics shows the contacts.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from wbmpc import lie
from wbmpc.loop import Running
from wbmpc.model import RobotModel, load_robot
from wbmpc.model.ball import BallBase
from wbmpc.mpc import MPC, Plans, Runner
from wbmpc.mpc.buffer import Mailbox
from wbmpc.ocp import Reference
from wbmpc.plant import RezeroPlant, SwervePlant
from wbmpc.plant.perturbation import Perturbation
from wbmpc.plant.scene import SceneReader
from wbmpc.recording.observer import PLAN_POINTS, base_poses
from wbmpc.solver import Solver
from wbmpc.view.history import Factor
from wbmpc.view.loads import GROUPS, Loads
from wbmpc.view.process import RATE
from wbmpc.view.snapshot import GROUND, NUMBERS, PLAN, REFERENCE, errors, filled
from wbmpc.view.steering import Controls, Steering, no_orders
from wbmpc.view.window import Window

Array = np.ndarray
_HERE = np.array([0.0, 0, 0, 1, 0, 0, 0])
#: How often the session's own thread looks whether the run has ended [s].
_LOOK = 0.05


class RealtimeView(Window):
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
        self.wants_reset = self.ended = self.stopped = False
        self._orders, self._shown_at, self._late = no_orders(), -np.inf, 0.0
        self._runner: Runner | None = None
        self._before = ""

    def open(self, mpc: MPC, seen: Mailbox | None) -> None:
        """Start the process; returns when it answers."""
        names = tuple(cost.name for cost in Steering.costs_of(mpc))
        scene = scene_of(self.robot)[1]
        groups = tuple(
            g for g in Loads(self.robot.description, scene.joint_names).groups if g != "drives"
        )  # not measured
        controls = Controls(
            self.title,
            names,
            Steering.legs_of(mpc),
            Steering.base_of(mpc),
            groups,
            paced=False,
            pushes=seen is not None,
        )
        nx = mpc.ocp.dynamics.state.size
        self.moments = Mailbox.shared({"t": (), "late": (), "x": (nx,), "ticks": (), "misses": ()})
        shown = {
            "plan": (PLAN, nx), "reference": (REFERENCE, 3), "goal": (7,), "base_goal": (3,), "solve": (), "deadline": (),
            "brakes": (),
        }  # fmt: skip
        drawer = partial(Picture, self.robot_name, self.moments, seen)
        self.start(scene.scene, controls, shown, drawer)

    # ------------------------------------------------------------------ the control thread
    def watch(self, t: float, late: float, plans: Plans) -> None:
        """Hand out the estimated state, at most :data:`~wbmpc.view.process.RATE` times a second."""
        self._late = max(self._late, late)
        if t < self._shown_at + 1.0 / RATE:
            return
        counts = {n: np.nan if self._runner is None else self._runner.own[n] for n in ("ticks", "misses")}
        self.moments.write(t=t, late=self._late, x=self._agent.state(), **counts)
        self._shown_at, self._late = t, 0.0

    # ------------------------------------------------------------------ the MPC's thread
    def guide(self, mpc: MPC, agent: Any, push: Callable[[Array], None]) -> None:
        """Steer this MPC from now on, before each of its solves; ``agent`` is the runner's."""
        self._agent, self._shown_at = agent, -np.inf
        self.wants_reset = self.stopped = False
        self.say(self._before)
        lift = np.array([0.0, 0.0, self.robot.base.radius if isinstance(self.robot.base, BallBase) else 0.0])
        stand_in = _Robot(agent, push)
        running: Any = Running(stand_in, stand_in, mpc, None, np.inf)  # type: ignore[arg-type]
        steering = Steering(running, lift, self.reject)
        steering.skip(self._orders)
        before, planned, counts = mpc.guess, [-np.inf], {n: int(self._orders[n]) for n in ("resets", "ends")}

        def guess(solver: Solver, t: float, x0: Array) -> None:
            message = self.orders.read()
            if message is not None:
                self._orders = message.values
            stand_in.x = x0
            steering.apply(t, self._orders, _HERE)
            self.ended = self.ended or int(self._orders["ends"]) != counts["ends"]
            self.wants_reset = int(self._orders["resets"]) != counts["resets"]
            if t >= planned[0] + 1.0 / RATE:
                planned[0] = t
                self.shown.write(**_plan(mpc, t, lift), brakes=steering.brakes_open(t))
            if before is not None:
                before(solver, t, x0)

        mpc.guess = guess

    # ------------------------------------------------------------------ the session's thread
    def follow(self, runner: Runner) -> str:
        """Start the runner and wait until the user, Ctrl-C or a safe stop ends it; returns why."""
        self._runner = runner
        with runner:
            while not (runner.stopped or self.ended or self.wants_reset):
                time.sleep(_LOOK)
            self.say(f"The run is over: {self._reason(runner)}")  # the threads' end may take a while
        self.stopped = runner.stopped
        self._before = f"Before: {runner.state}" if runner.stopped else ""
        return self._reason(runner)

    def _reason(self, runner: Runner) -> str:
        if runner.stopped:
            return runner.state
        return "begun anew in the view" if self.wants_reset else "ended in the view"


class _Robot:
    """What steering needs of plant and agent, in the MPC's thread: the state ``x`` (nx) that the next solve begins with."""

    def __init__(self, agent: Any, push: Callable[[Array], None]) -> None:
        self._agent, self.push, self.robot, self.x = agent, push, agent.robot, agent.robot.home

    def state(self) -> Array:
        return self.x

    @property
    def brakes(self) -> Any:
        """Brake states over time; the agent's own."""
        return self._agent.brakes

    @brakes.setter
    def brakes(self, value: Any) -> None:
        self._agent.brakes = value


def _plan(mpc: MPC, t: float, lift: Array) -> dict[str, Any]:
    """What the MPC follows and plans; the plan is that of the solve before."""
    reference, layout = mpc.reference, mpc.ocp.dynamics.state
    hand: Reference | None = reference["hand"] if "hand" in reference else None  # noqa: SIM401 - not a dictionary
    goal = np.full(7, np.nan) if hand is None else hand.at(t).copy()
    goal[:3] += lift
    base = np.full(3, np.nan)
    if Steering.base_of(mpc):
        base = reference["state"].at(t)[layout["base"]]
    way = np.zeros((0, 3)) if hand is None else hand.values[:, :3] + lift
    return {
        "plan": filled(mpc.solver.ws.x[_chosen(len(mpc.solver.ws.x))], (PLAN, layout.size)), "goal": goal, "base_goal": base,
        "reference": filled(way, (REFERENCE, 3)), "solve": mpc.solve_time, "deadline": mpc.period,
    }  # fmt: skip


def _chosen(count: int) -> Array:
    return np.unique(np.linspace(0, count - 1, PLAN_POINTS).round().astype(int))


# ---------------------------------------------------------------------- in the view's process
def scene_of(robot: RobotModel) -> tuple[Any, SceneReader]:
    """A puppet of the robot, as described, and who reads its scene."""
    made: type[Any] = RezeroPlant if isinstance(robot.base, BallBase) else SwervePlant
    puppet = made(robot.description, perturbation=Perturbation.none())
    return puppet, SceneReader(puppet.model, robot.description.base.body)


class Picture:
    """From messages of a real-time run to snapshots, all in the frame of the estimate."""

    def __init__(self, robot: str, moments: Mailbox, seen: Mailbox | None) -> None:
        self.robot, self._moments, self._seen = load_robot(robot), moments, seen
        self._puppet, self._reader = scene_of(self.robot)
        self._lift = self.robot.base.radius if isinstance(self.robot.base, BallBase) else 0.0
        self._loads = Loads(self.robot.description, self._reader.joint_names)
        self._moment: dict[str, Array] = {"t": np.array(0.0), "late": np.array(np.nan), "x": self.robot.home}
        self._moment |= {name: np.array(np.nan) for name in ("ticks", "misses")}
        self._ground: dict[str, Array] = {"base": _HERE, **{n: np.full(s, np.nan) for n, s in GROUND.items()}}
        self._ground |= {name: np.array(np.nan) for name in ("time", "clock")}
        self._factor = Factor()
        self._before: tuple[float, Array] | None = None
        self._shares = dict.fromkeys(GROUPS, np.nan)

    def __call__(self, plan: dict[str, Array]) -> dict[str, Any]:
        """The newest of everything; ``plan``: the MPC's message."""
        moment = self._moments.read()
        self._moment = moment.values if moment is not None else self._moment
        seen = self._seen.read() if self._seen is not None else None
        self._ground = seen.values if seen is not None else self._ground
        self._puppet.arrange(self._moment["x"])
        poses = self._reader.poses(self._puppet.data)
        position, orientation = self.robot.pose(self._moment["x"])
        hand = np.concatenate([position + [0.0, 0.0, self._lift], orientation])
        states = plan["plan"][np.isfinite(plan["plan"]).all(axis=1)]
        ways = {"hand_plan": self._hand(states), "base_plan": base_poses(states[:, self.robot.state["base"]])[:, :3]}
        for way in ways.values():
            way[:, 2] += self._lift
        numbers: dict[str, Any] = {
            "t": self._moment["t"], "late": self._moment["late"],
            **errors(hand, plan["goal"], poses[self._reader.scene.index], plan["base_goal"]),
            "solve": plan["solve"], "deadline": plan["deadline"], **self._speeds(),
            **{name: self._ground[name] for name in ("margin", "triangle_margin")},
            "ticks": self._moment["ticks"], "late_ticks": self._moment["misses"],
            "factor": self._factor.add(float(self._ground["clock"]), float(self._ground["time"])),
        }  # fmt: skip
        return {
            "numbers": np.array([float(numbers[name]) for name in NUMBERS]), "poses": poses, "goal": plan["goal"],
            "base_goal": plan["base_goal"], "brakes": plan["brakes"], "reference": plan["reference"],
            **{name: filled(way, (PLAN, 3)) for name, way in ways.items()}, **self._on_floor(poses[self._reader.scene.index]),
        }  # fmt: skip

    def _hand(self, states: Array) -> Array:
        columns = [states[:, self.robot.state[group]] for group in self.robot.state.groups]
        return self.robot.poses(np.hstack(columns))[:, :3].copy()

    def _speeds(self) -> dict[str, float]:
        """Largest joint speeds over their limits, between the last two states."""
        t, joints = float(self._moment["t"]), self._reader.joint_states(self._puppet.data)[:, 0]
        if self._before is None or t > self._before[0]:
            if self._before is not None:
                self._shares = self._loads.shares((joints - self._before[1]) / (t - self._before[0]))
            self._before = (t, joints)
        return self._shares

    def _on_floor(self, estimated: Array) -> dict[str, Array]:
        """Contacts where the estimate has the robot."""
        shift = lie.pose_compose(estimated, lie.pose_inverse(self._ground["base"]))
        turn = lie.quaternion_to_rotation(shift[3:]).T
        return {name: self._ground[name] @ turn + shift[:3] for name in ("forces", "support", "triangle", "pressure")}
