"""The tests of `swerve-brakes`, each on a plant of its own: pushes, slip of a brake, sliding, brakes that do not answer."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import mujoco
import numpy as np
from pydantic import Field

from wbmpc.bases.swerve.brake_monitor import BrakeFault, BrakeMonitor
from wbmpc.bases.swerve.brake_supervision import SupervisionSettings, brake_monitor
from wbmpc.bases.swerve.brakes import BRAKE_TORQUE
from wbmpc.bases.swerve.configurations import CONFIGURATIONS, corners
from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.perturbation import SoundPerturbation
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.settings import ControlSettings, Robot, Settings
from wbmpc.simulation.contacts import GROUND
from wbmpc.simulation.lockstep import Progress, watched
from wbmpc.stability import assess, configuration_positions
from wbmpc.studies.pankert2022.rolling import RollingController

#: Push [N] and its length [s] (Fig. 4).
PUSH, PUSH_TIME = 100.0, 2.0
#: The ramps of torque [N m/s] and force [N/s], and the motions [rad, m] that count as slip.
TORQUE_RAMP, FORCE_RAMP, SLIPPED, SLID = 20.0, 100.0, 0.005, 0.005
#: Legs that swing out and in during the search for faults: amplitude [rad], period [s], when brakes open and one fails [s].
SWING, SWING_PERIOD, OPENS, FAILS = 0.15, 6.0, 0.5, 4.0
#: Torque [N m] of a knock about the left front hinge, when it comes and ends [s]: less than a brake holds.
KNOCK, KNOCK_BEGINS, KNOCK_ENDS = 120.0, SWING_PERIOD + 0.5, SWING_PERIOD + 1.5


class SwerveBrakesSettings(Settings):
    """``push`` [N] sideways at the body; ``height`` [m] of the blocks under three wheels while the fourth hangs. Brakes of the ``plant`` are
    sound: the experiment makes them fail itself, in its last two tests."""

    control: ControlSettings = ControlSettings()
    plant: SoundPerturbation = SoundPerturbation()
    robot: Robot = "swerve-ur10"
    push: float = Field(PUSH, gt=0, le=500)
    height: float = Field(0.03, gt=0.005, le=0.2)


@dataclass(frozen=True)
class Bench:
    """One robot on the test bench: settings, seed, where the log goes; ``plants``: those that were made for tests."""

    settings: SwerveBrakesSettings
    robot: RobotModel
    seed: int
    log: Log
    plants: list[SwervePlant] = field(default_factory=list)

    @property
    def left_front(self) -> int:
        """Index of the leg that is tried."""
        return corners(self.robot)["LF"]

    @property
    def steps(self) -> int:
        """Physics steps of a controller period."""
        return round(1.0 / self.settings.control.rate / 5e-4)

    @property
    def period(self) -> float:
        """A controller period [s]."""
        return 1.0 / self.settings.control.rate

    def plant(self, configuration: str, **options: object) -> SwervePlant:
        """Standing in a configuration, as its encoders see it, wheels parallel to the body."""
        x = assess(self.robot, configuration, arm=options.pop("arm", None)).x  # type: ignore[arg-type]
        plant = SwervePlant(
            self.robot.description, self.robot.state.split(x), self.settings.plant, self.seed, **options  # type: ignore[arg-type]
        )  # fmt: skip
        self.plants.append(plant)
        return plant


def reject(robot: RobotModel) -> None:
    """What this robot cannot do is said before the first test (:class:`InputError`)."""
    for name in CONFIGURATIONS:
        configuration_positions(robot, name)
    assess(robot, "X", arm=_reached_back(robot))


def _reached_back(robot: RobotModel) -> np.ndarray:
    """Arm joints of the home turned about by half a turn of the first one."""
    return np.asarray(robot.home[robot.state["arm"]] + np.array([np.pi] + [0.0] * (len(robot.input.groups["arm"]) - 1)))


def push(bench: Bench, name: str, is_open: bool, progress: Progress | None) -> float:
    """Largest displacement [m] of the body while it is pushed to the left at its center of mass."""
    state = "open" if is_open else "closed"
    plant, farthest, channel = bench.plant(name), 0.0, f"push_{name}_{state}"
    modules = swerve_base(bench.robot).geometry.modules
    command = replace(
        SwerveCommand.stop(modules, len(bench.robot.input.groups["arm"])), brake=np.full(modules, float(is_open))
    )
    _step(plant, command, 0.5, bench)
    start, begin, hinges = plant.truth().pose, plant.time, bench.robot.state.groups["leg"]
    bench.log.label(channel, ("x", "y", "yaw", *hinges), ("m", "m", "rad", *("rad" for _ in hinges)))
    plant.push([0.0, bench.settings.push, 0.0])
    with watched(plant, 4 * bench.period, PUSH_TIME, progress) as tick:
        while plant.time < begin + PUSH_TIME:
            tick(plant.time - begin, command)
            plant.step(command, 4 * bench.steps)
            truth = plant.truth()
            farthest = max(farthest, float(np.hypot(*(truth.pose - start)[:2])))
            bench.log.add(
                channel,
                plant.time - begin,
                [*(truth.pose - start), *(truth.joints[n] for n in hinges)],
            )
    return farthest


def _step(plant: SwervePlant, command: SwerveCommand, seconds: float, bench: Bench) -> None:
    for _ in range(round(seconds * bench.settings.control.rate)):
        plant.step(command, bench.steps)


def slip_torque(bench: Bench, progress: Progress | None) -> float:
    """Torque [N m] about the left front hinge at which its closed brake gives way, that wheel in the air.

    The other wheels stand on blocks, and the arm reaches to the right rear, so that the robot stands on those three.
    """
    robot, height = bench.robot, bench.settings.height
    feet, tried = assess(robot, "X").stance.feet, bench.left_front

    def blocks(spec: mujoco.MjSpec) -> None:
        for x, y in np.delete(feet, tried, axis=0):
            spec.worldbody.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.15, 0.15, height / 2], pos=[x, y, height / 2],
                friction=[0.8, 0.005, 1e-4], solref=[0.01, 1.0], **GROUND,
            )  # fmt: skip

    plant = bench.plant("X", edit=blocks, lift=height, arm=_reached_back(robot))
    stop = SwerveCommand.stop(swerve_base(robot).geometry.modules, len(robot.input.groups["arm"]))
    _step(plant, stop, 1.0, bench)
    hinge = plant.model.joint(robot.state.groups["leg"][tried])
    start = float(plant.data.qpos[hinge.qposadr[0]])
    torque, step = 0.6 * BRAKE_TORQUE, TORQUE_RAMP / bench.settings.control.rate
    plant.external = lambda m, d: d.qfrc_applied.__setitem__(hinge.dofadr[0], torque)
    begin, longest = plant.time, (1.5 * BRAKE_TORQUE - torque) / TORQUE_RAMP
    bench.log.label("slip", ("torque", "angle", "load of the wheel"), ("N m", "rad", "N"))
    with watched(plant, bench.period, longest, progress) as tick:
        while torque < 1.5 * BRAKE_TORQUE:
            tick(plant.time - begin, stop)
            plant.step(stop, bench.steps)
            angle = float(plant.data.qpos[hinge.qposadr[0]]) - start
            bench.log.add("slip", plant.time, [torque, angle, plant.truth().wheel_force[tried]])
            if abs(angle) > SLIPPED:
                return torque
            torque += step
    return float("inf")


def slide_force(bench: Bench, name: str, progress: Progress | None) -> float:
    """Sideways force [N] at the body, brakes closed, at which the robot slides."""
    plant = bench.plant(name)
    stop = SwerveCommand.stop(swerve_base(bench.robot).geometry.modules, len(bench.robot.input.groups["arm"]))
    _step(plant, stop, 0.5, bench)
    start, begin, force = plant.truth().pose, plant.time, 200.0
    bench.log.label(f"slide_{name}", ("force", "way", "force over friction"), ("N", "m", "1"))
    with watched(plant, bench.period, 1800.0 / FORCE_RAMP, progress) as tick:
        while force < 2000.0 and not plant.fell:
            plant.push([0.0, force, 0.0])
            tick(plant.time - begin, stop)
            plant.step(stop, bench.steps)
            moved = float(np.hypot(*(plant.truth().pose - start)[:2]))
            bench.log.add(f"slide_{name}", plant.time, [force, moved, force / (plant.draw.friction * plant.weight)])
            if moved > SLID:
                return force
            force += FORCE_RAMP / bench.settings.control.rate
    return float("inf")


@dataclass(frozen=True)
class Found:
    """What a monitor found: ``time`` [s] from when the fault can be seen to its message about it, infinite without one; of
    brakes that no test made fail all ``alarms``, and those of them that it did not take back (``real``)."""

    time: float
    alarms: list[BrakeFault]
    real: list[BrakeFault]

    @classmethod
    def of(cls, monitor: BrakeMonitor, failing: int | None, seen_from: float) -> Found:
        """``failing``: the leg whose brake is made to fail, which can be seen from ``seen_from`` [s] on."""
        right = [f.time for f in monitor.real if f.leg == failing]
        alarms, real = ([f for f in faults if f.leg != failing] for faults in (monitor.faults, monitor.real))
        return cls(right[0] - seen_from if right else float("inf"), alarms, real)


def fault(bench: Bench, kind: str | None, progress: Progress | None) -> Found:
    """Whether the monitor finds a brake that fails.

    The legs swing in and out with open brakes, driven by the wheels, then they are closed, and the left front leg is
    knocked. ``kind`` "closed": its brake never opens; "open": it does not close again; None: all is well.
    """
    robot = bench.robot
    home, tried = configuration_positions(robot, "X"), bench.left_front
    outward = np.sign(home - configuration_positions(robot, "H"))

    def goals(t: float) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
        w = 2.0 * np.pi / SWING_PERIOD
        angle, rate = 0.5 * SWING * (np.cos(w * t) - 1.0), -0.5 * SWING * w * np.sin(w * t)
        still = t > SWING_PERIOD
        return (np.zeros(3), np.zeros(3)), (
            home + outward * (0.0 if still else angle),
            outward * (0.0 if still else rate),
        )

    plant = bench.plant("X")
    period = bench.period
    monitor = brake_monitor(robot)
    assert monitor is not None  # of a robot whose legs have brakes
    brakes = lambda t: np.full(home.size, float(OPENS < t < SWING_PERIOD))
    controller = RollingController(
        robot, np.zeros(3), period, goals, brakes=brakes, supervision=SupervisionSettings(monitor=monitor)
    )
    if kind == "closed":
        plant.brakes.fail(tried, "closed")
    hinge = plant.model.joint(robot.state.groups["leg"][tried]).dofadr[0]
    hinges = robot.state.groups["leg"]
    bench.log.label(f"fault_{kind or 'none'}", [*hinges, *(f"{n}, reference" for n in hinges)], "rad")
    with watched(plant, period, SWING_PERIOD + 3.0, progress, controller) as tick:
        for k in range(round((SWING_PERIOD + 3.0) / period)):
            t = k * period
            if kind == "open" and t > FAILS:
                plant.brakes.fail(tried, "open")
            plant.data.qfrc_applied[hinge] = KNOCK if KNOCK_BEGINS <= t < KNOCK_ENDS else 0.0
            controller.measure(plant.measure())
            command = controller.drive(t)
            tick(t, command)
            plant.step(command, bench.steps)
            assert controller.measured is not None
            bench.log.add(f"fault_{kind or 'none'}", t, [*controller.measured.leg, *goals(t)[1][0]])
    return Found.of(monitor, None if kind is None else tried, OPENS if kind == "closed" else KNOCK_BEGINS)
