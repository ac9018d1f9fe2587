"""A base type of another package, found by its entry point. Truth: MuJoCo's kinematics of the file; a table without the entry point."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import casadi as ca
import mujoco
import numpy as np
import pytest
from pydantic import Field

from wbmpc import MPC, Constraint, Cost, Observation, OptimalControlProblem, Reference, bases, residuals, sets
from wbmpc.bases.base import BaseDescription, BaseType, System
from wbmpc.errors import InputError
from wbmpc.lie import quaternion_to_rotation
from wbmpc.model.joints import Limits, joint_home, joint_limits
from wbmpc.model.kinematics import Chain, FramePose, constant
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.model.tree import read_tree
from wbmpc.runtime.shared_memory import Mailbox
from wbmpc.simulation.any_perturbation import AnyPerturbation, models
from wbmpc.simulation.kept_calibration import plugin_folders
from wbmpc.simulation.lockstep import Ending, Running
from wbmpc.simulation.perturbation import Perturbation, perturbation_model
from wbmpc.types import Timing

if TYPE_CHECKING:
    from wbmpc.bases.footprint import Footprint
    from wbmpc.robots import RobotDescription

#: Base types with a controller on a ROS 2 bus.
ON_BUSES = "ball, differential, fixed, omnidirectional, planar, swerve, wheels"
FILE = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="beam" pos="0.1 0 0.5">
      <inertial mass="5" pos="0 0 0" diaginertia="1 1 1"/>
      <body name="cart">
        <joint name="slide" type="slide" axis="1 0 0" range="-2 2"/>
        <inertial mass="2" pos="0 0 0" diaginertia="0.1 0.1 0.1"/>
        <body name="link">
          <joint name="elbow" type="hinge" axis="0 0 1" range="-3 3"/>
          <inertial mass="1" pos="0.2 0 0" diaginertia="0.1 0.1 0.1"/>
          <site name="tip" pos="0.3 0 0"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
YAML = """
name: gantry
model: gantry.xml
base: {type: rail, body: beam, axis: slide}
arm: {joints: [elbow], tool: tip}
home: {elbow: 0.5}
limits: {velocity: {slide: 0.4, elbow: 1.0}}
"""


class RailDescription(BaseDescription):
    """A cart on a straight rail: the name of its sliding joint."""

    joint_key: ClassVar[str] = "axis"

    type: Literal["rail"]
    axis: str

    def joint_groups(self) -> dict[str, list[str]]:
        return {"rail": [self.axis]}


class RailBase:
    """State and input: the cart's position and speed, and the arm's."""

    def __init__(self, description: RobotDescription, spec: mujoco.MjSpec) -> None:
        base = description.base
        self.tree = read_tree(spec, base.body)
        body = spec.compile().body(base.body)
        self._position, self._quaternion = body.pos.copy(), body.quat.copy()
        self.state = {**base.joint_groups(), "arm": list(description.arm.joints)}
        self.input = self.state
        self._links = [self.tree.joint(n) for names in self.state.values() for n in names]
        self.mode: dict[str, list[str]] = {}
        self.parameters: dict[str, list[str]] = {}
        self.mode_bounds: dict[str, tuple[float, float]] = {}
        self.brakes: dict[str, str] = {}
        self.rolling_groups: tuple[str, ...] = ()
        self.steering_groups: tuple[str, ...] = ()
        self.unit_quaternions: tuple[int, ...] = ()
        self.footprint: Footprint | None = None
        self.twist = np.eye(3)
        self.wheels, self.balances, self.ground, self.body_height = 0, False, 0.0, float(self._position[2])

    def root_pose(self, x: ca.SX) -> FramePose:
        rotation = constant(quaternion_to_rotation(self._quaternion))
        return FramePose(constant(self._position), constant(self._quaternion), rotation)

    def chain(self, x: ca.SX) -> Chain:
        return Chain(self.tree.links, {link: x[k] for k, link in enumerate(self._links)}, self.root_pose(x))

    def velocities(self, x: ca.SX, u: ca.SX) -> tuple[dict[int, ca.SX], ca.SX, ca.SX]:
        return {link: u[k] for k, link in enumerate(self._links)}, ca.SX(3, 1), ca.SX(3, 1)

    def derivative(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        return u

    def rolling(self, x: ca.SX, u: ca.SX, m: ca.SX) -> ca.SX:
        return ca.SX(0, 1)

    def constraints(self, robot: RobotModel) -> list[Constraint]:
        return []

    def limits(self, description: RobotDescription) -> Limits:
        return joint_limits(self, description, tuple(self.state), description.limits.velocity, {}, {})

    def home(self, robot: RobotModel) -> np.ndarray:
        return joint_home(self, robot.description, tuple(self.state))


@dataclass(frozen=True)
class Speeds:
    """A command: speeds of cart and elbow [m/s, rad/s]."""

    values: np.ndarray


class RailPlant:
    """Drives that follow speeds at once: MuJoCo's positions are integrals of the commands."""

    timestep, fell, diverged, rests, has_physics, fall_reason = 0.005, False, False, True, True, ""

    def __init__(self, robot: RobotModel) -> None:
        self.description, self.time, self.world = robot.description, 0.0, self
        self.model = mujoco.MjModel.from_xml_string(FILE)
        self.data = mujoco.MjData(self.model)
        self.arrange(robot.home)

    def arrange(self, state: np.ndarray) -> None:
        self.data.qpos[:] = state
        mujoco.mj_forward(self.model, self.data)

    def measure(self) -> np.ndarray:
        return self.data.qpos.copy()

    def step(self, command: Speeds, steps: int = 1) -> None:
        self.time += steps * self.timestep
        self.arrange(self.data.qpos + steps * self.timestep * command.values)

    def push(self, force: np.ndarray) -> None: ...

    def end_pushes(self) -> None: ...

    def frames(self, height: float) -> dict[str, np.ndarray]:
        tip = self.data.site("tip")
        return {"tool": tip.xpos - [0.0, 0.0, height], "tool_rotation": tip.xmat.reshape(3, 3)}


class RailController:
    """Follows the MPC's policy from the measured state."""

    faults = ()

    def __init__(self, robot: RobotModel) -> None:
        self.robot, self._x = robot, robot.home

    def measure(self, measurement: np.ndarray) -> None:
        self._x = measurement

    def state(self) -> np.ndarray:
        return self._x

    def predict(self, t: float, until: float, plans: Any) -> Observation:
        return Observation(until, self._x)

    def command(self, t: float, plans: Any) -> Speeds:
        return Speeds(plans.current(t, self._x))

    def stop(self) -> Speeds:
        return Speeds(np.zeros(2))


class RailPerturbation(Perturbation):
    """``bend`` [rad]: how crooked the rail is."""

    bend: float = Field(default=0.01, ge=0, le=1)


class RailBaseType(BaseType):
    """What another package would have in its plug-in: description, model and a simulated system; nothing for ROS 2."""

    Description = RailDescription

    def check(self, description: RobotDescription, model: mujoco.MjModel) -> None:
        kind = model.joint(description.base.axis).type[0]  # type: ignore[attr-defined]
        if kind != mujoco.mjtJoint.mjJNT_SLIDE:
            raise InputError(f"{description.source}: key 'base.axis': a sliding joint is needed")

    def model(self, description: RobotDescription, spec: mujoco.MjSpec) -> RailBase:
        return RailBase(description, spec)

    def perturbation(self) -> type[RailPerturbation]:
        return RailPerturbation

    def plant(self, robot: RobotModel, perturbation: Any, seed: int) -> RailPlant:
        return RailPlant(robot)

    def system(self, robot: RobotModel, seed: int) -> System:
        plant, mpc = self.plant(robot, None, seed), reaching(robot, "end_effector")
        mpc.reference["end_effector"] = Reference.poses([0.0], [robot.pose(robot.home)[0]], robot.pose(robot.home)[1])
        mpc.reset(robot.home)
        return System(plant, RailController(robot), mpc, Timing.of(plant.timestep, 200.0, mpc.rate, 0.0))


def reaching(robot: RobotModel, cost: str) -> MPC:
    """An MPC that brings the tip to the reference of ``cost``."""
    ocp = OptimalControlProblem(robot.dynamics(), 1.0, 20)
    ocp.add(Cost(cost, residuals.FramePose(robot, robot.tool), [100.0] * 3 + [0.0] * 3, at="path+terminal"))
    ocp.add(Cost("input", residuals.Input(robot, reference=None), 0.01))
    for constraint in robot.base.constraints(robot):
        ocp.add(constraint)
    box = sets.Box(robot.limits.input_lower, robot.limits.input_upper)
    ocp.add(Constraint("speeds", residuals.Input(robot, reference=None), box, hard=True))
    return MPC(ocp, rate=20.0)


class BareType:
    """A plug-in that derives from nothing and has the description and the model only."""

    Description = RailDescription

    def check(self, description: RobotDescription, model: mujoco.MjModel) -> None: ...

    def model(self, description: RobotDescription, spec: mujoco.MjSpec) -> RailBase:
        return RailBase(description, spec)


def forget() -> None:
    bases._locations.cache_clear()
    bases.base_type.cache_clear()


@pytest.fixture
def gantry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A robot file of the base type "rail", with an installed package that names its plug-in."""
    installed = tmp_path / "site" / "rail_bases-1.0.dist-info"
    installed.mkdir(parents=True)
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: rail-bases\nVersion: 1.0\n")
    (installed / "entry_points.txt").write_text(f"[wbmpc.bases]\nrail = {__name__}:RailBaseType\n")
    (tmp_path / "gantry.xml").write_text(FILE)
    (tmp_path / "gantry.yaml").write_text(YAML)
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    forget()
    yield tmp_path / "gantry.yaml"
    monkeypatch.undo()
    forget()


def test_its_perturbation_is_a_setting_of_experiments_of_any_robot(gantry: Path) -> None:
    assert perturbation_model("rail") is RailPerturbation and RailPerturbation in models()
    every = type("Every", models(), {"__module__": __name__})
    given, description = every(bend=0.3, mass=0.1, brake_delay=0.0), load_robot(gantry).description
    assert RailPerturbation.of(given, description) == RailPerturbation(bend=0.3, mass=0.1)
    with pytest.raises(InputError, match=r"plant\.bend: .*'panda'.* does not read it"):
        perturbation_model("fixed").of(given, load_robot("panda").description)
    assert not hasattr(AnyPerturbation(), "bend")  # made before the package was there


def mujoco_tip(x: np.ndarray) -> np.ndarray:
    model = mujoco.MjModel.from_xml_string(FILE)
    data = mujoco.MjData(model)
    data.qpos[:] = x
    mujoco.mj_forward(model, data)
    return np.array(data.site("tip").xpos)


def test_its_robot_has_the_kinematics_of_the_file(gantry: Path) -> None:
    robot = load_robot(gantry)
    assert list(robot.state.names) == ["rail.slide", "arm.elbow"]
    np.testing.assert_allclose(robot.home, [0.0, 0.5])
    np.testing.assert_allclose(robot.limits.state_upper, [2.0, 3.0])
    np.testing.assert_allclose(robot.limits.input_upper, [0.4, 1.0])
    for x in ([0.0, 0.0], [0.7, -1.1]):
        np.testing.assert_allclose(robot.pose(x)[0], mujoco_tip(np.array(x)), atol=1e-12)


def test_a_group_called_base_has_to_be_a_pose(gantry: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Recordings and views read x, y and yaw from it: a cart's position alone would fail there, in the middle of a run."""
    monkeypatch.setattr(RailDescription, "joint_groups", lambda self: {"base": [self.axis]})
    with pytest.raises(InputError, match=r"base type 'rail': its state group 'base' has 1 numbers; valid: a pose"):
        load_robot(gantry)


def test_wheels_that_a_description_names_alone_are_joints_of_the_base() -> None:
    """Nothing but ``wheel_joints`` is needed for joints that the state does not have. Truth: the names, and that one
    which is named twice is left to the check of joints."""

    class TrackedDescription(RailDescription):
        def wheel_joints(self) -> list[str]:
            return ["left", "slide", "right", "right"]

    assert TrackedDescription(type="rail", body="beam", axis="slide").joints() == ["slide", "left", "right", "right"]


@pytest.mark.parametrize(
    ("part", "value", "words"),
    [
        ("home", np.zeros(3), r"'home' has the shape \(3,\); valid: \(2,\), a number for each name of 'state'"),
        ("limits", Limits(*[np.ones(2)] * 5, np.ones(1)), r"'limits\.actuator_upper' .*\(1,\); valid: \(2,\), .* 'input'"),
    ],
)  # fmt: skip
def test_a_home_or_limit_of_another_size_is_named(
    gantry: Path, monkeypatch: pytest.MonkeyPatch, part: str, value: Any, words: str
) -> None:
    """Used, they would fail in a place that does not say why. Truth: the two names of state and input."""
    monkeypatch.setattr(RailBase, part, lambda *given: value)
    with pytest.raises(InputError, match=f"base type 'rail': {words}"):
        load_robot(gantry).home  # noqa: B018


def test_an_mpc_moves_the_rail_to_a_goal_that_the_arm_does_not_reach(gantry: Path) -> None:
    robot = load_robot(gantry)
    goal = np.array([1.3, 0.2, 0.5])
    mpc = reaching(robot, "tip")
    mpc.reference["tip"] = Reference.poses([0.0], [goal], [1.0, 0.0, 0.0, 0.0])
    mpc.reset(robot.home)
    x, fastest = robot.home.copy(), 0.0
    for k in range(80):
        u = mpc.update(Observation(k * 0.05, x))(k * 0.05, x)
        fastest = max(fastest, abs(u[0]))
        x = x + 0.05 * u
    np.testing.assert_allclose(mujoco_tip(x), goal, atol=2e-3)
    assert 0.39 < fastest <= 0.4 + 1e-6  # a meter at 0.4 m/s


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("axis: slide", "axes: slide"), r"unknown key 'base\.axes'.*base\.axis"),
        (("axis: slide", "axis: slider"), r"joint \(key 'base\.axis'\).*slider"),
        (("axis: slide", "axis: elbow"), "every joint once, got 'elbow' twice"),
        (("type: rail", "type: rails"), r"key 'base\.type': valid: ball, .*fixed, .*rail, .*swerve"),
    ],
)
def test_faults_of_its_section_name_the_key(gantry: Path, change: tuple[str, str], words: str) -> None:
    gantry.write_text(YAML.replace(*change))
    with pytest.raises(InputError, match=words):
        load_robot(gantry)


def test_without_the_package_the_type_is_unknown(gantry: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    forget()
    with pytest.raises(InputError, match=r"key 'base\.type': valid: ball") as error:
        load_robot(gantry)
    assert "rail" not in str(error.value).removeprefix(str(gantry))


def test_a_kept_calibration_depends_on_the_source_of_its_base_type(gantry: Path) -> None:
    """Else a changed plug-in of another package would start from what the one before has found."""
    assert str(Path(__file__).resolve().parent) in plugin_folders(load_robot(gantry))


def test_a_built_in_type_cannot_be_replaced(gantry: Path) -> None:
    entries = gantry.parent / "site" / "rail_bases-1.0.dist-info" / "entry_points.txt"
    entries.write_text(f"[wbmpc.bases]\nfixed = {__name__}:RailBaseType\n")
    forget()
    assert type(bases.base_type("fixed")).__module__ == "wbmpc.bases.fixed.plugin"


def test_a_plug_in_that_cannot_be_imported_is_named(gantry: Path) -> None:
    entries = gantry.parent / "site" / "rail_bases-1.0.dist-info" / "entry_points.txt"
    entries.write_text("[wbmpc.bases]\nrail = no_such_module:RailBaseType\n")
    forget()
    with pytest.raises(InputError, match="key 'base': base type 'rail': its plug-in no_such_module:RailBaseType"):
        load_robot(gantry)


def free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def test_its_robot_follows_a_goal_dragged_in_the_view(gantry: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The session of ``wbmpc view``, in lockstep. Truth: MuJoCo's tip of the plant, and the cart's speed limit of 0.4 m/s."""
    pytest.importorskip("viser")
    from wbmpc.view import session
    from wbmpc.view.live import View
    from wbmpc.view.user_commands import REQUESTS, no_requests

    robot = load_robot(gantry)
    start, turn = robot.pose(robot.home)
    goal = start + [1.0, 0.0, 0.0]

    class Dragged:
        """The panel's part: the end effector's goal at 0.1 s."""

        def begin(self, running: Running) -> None:
            self.running, self.given = running, False
            self.writer = Mailbox(REQUESTS, view.requests.memory, view.requests.checked)
            self.writer._written = int(self.writer._latest[0])

        def tick(self, t: float, command: Any, plans: Any) -> None:
            if t >= 0.1 and not self.given:
                self.given = True
                assert self.running.plant.data.qpos[0] == pytest.approx(0.0, abs=1e-6)
                self.writer.write(**{**no_requests(), "goals": np.array(1.0), "goal": np.array([*goal, *turn])})

        def end(self, ending: Ending) -> None:
            self.ending = ending

    monkeypatch.setattr(session, "LONGEST", 0.5)
    dragged, view = Dragged(), View("gantry", port=free_port())
    try:
        assert session.run_session(str(gantry), 1, view, dragged).reason == ""
        assert view.commanded and view.board.text == "The run is over"
    finally:
        view.close()
    plant = dragged.running.plant
    assert plant.time == pytest.approx(0.5)
    assert 0.1 < plant.data.qpos[0] <= 0.4 * 0.4 + 1e-6
    assert np.linalg.norm(mujoco_tip(plant.data.qpos) - goal) < 0.9


def test_a_picture_of_it_in_real_time_is_its_own_plant(gantry: Path) -> None:
    pytest.importorskip("viser")
    from wbmpc.view.realtime import scene_of

    plant, reader = scene_of(load_robot(gantry))
    plant.arrange(np.array([0.7, -1.1]))
    np.testing.assert_allclose(plant.data.site("tip").xpos, mujoco_tip(np.array([0.7, -1.1])), atol=1e-12)
    assert reader.joint_names == ["slide", "elbow"]


@pytest.mark.parametrize("plugin", ["RailBaseType", "BareType"])
def test_parts_that_it_does_not_offer_are_named(gantry: Path, plugin: str) -> None:
    """Nothing falls through to another base type: what a plug-in leaves out raises, whether it derives from BaseType or not."""
    entries = gantry.parent / "site" / "rail_bases-1.0.dist-info" / "entry_points.txt"
    entries.write_text(f"[wbmpc.bases]\nrail = {__name__}:{plugin}\n")
    forget()
    robot = load_robot(gantry)
    rail = bases.base_type("rail")
    lacking = r"'gantry' has a base of type 'rail', whose plug-in offers no {} \('{}'\); valid: {}$"
    with pytest.raises(InputError, match=lacking.format("controller for ROS 2", "ros_settings", ON_BUSES)):
        rail.ros_settings(robot.description)
    with pytest.raises(InputError, match=lacking.format("simulated robot for ROS 2", "ros_plant", ON_BUSES)):
        rail.ros_plant(robot, None, 1)
    with pytest.raises(InputError, match=lacking.format("calibration file of its wheels", "calibrator", "swerve")):
        rail.calibrator(robot)
    if plugin == "BareType":
        with pytest.raises(
            InputError,
            match=lacking.format(
                "simulated robot with a controller",
                "system",
                "ball, differential, fixed, omnidirectional, planar, swerve, wheels",
            ),
        ):
            rail.system(robot, 1)
