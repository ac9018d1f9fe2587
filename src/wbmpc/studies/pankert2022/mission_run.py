"""One run of a swerve base whose legs and base follow a mission: plant, controller, brakes, record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from wbmpc.bases.base import System
from wbmpc.bases.swerve.brake_control import BrakeControl
from wbmpc.bases.swerve.brake_supervision import SupervisionSettings
from wbmpc.bases.swerve.configurations import corners
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.defaults import swerve_mpc
from wbmpc.bases.swerve.estimator import EstimatorSettings
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.bases.swerve.steering_planner import SteeringGuess
from wbmpc.bases.swerve.tracking import TrackingSettings
from wbmpc.experiment import Loop, Outcome
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.ocp import Reference
from wbmpc.result import Plot
from wbmpc.simulation.lockstep import Progress
from wbmpc.studies.pankert2022.drive_missions import Knock, MissionSettings
from wbmpc.studies.pankert2022.mission import Mission, at_home, carried_poses
from wbmpc.studies.pankert2022.standing import stand_still
from wbmpc.tasks.joint_figures import JointRecord
from wbmpc.types import Timing, Truth

#: The run whose joints are recorded.
TOUR_RUN = "tour"


@dataclass(frozen=True)
class MissionRun:
    """What the runs of an experiment share whose base and legs follow a mission."""

    settings: MissionSettings
    robot: RobotModel
    seed: int
    log: Log
    estimation: EstimatorSettings  # what every controller knows of the wheels
    joints: dict[str, JointRecord] = field(default_factory=dict)  # of the tour that is driven with the MPC

    @classmethod
    def of(cls, settings: MissionSettings, robot: RobotModel, seed: int) -> MissionRun:
        return cls(settings, robot, seed, Log(), settings.estimation(robot, seed))

    def joint_plots(self) -> list[Plot]:
        """Joints of the tour with their limits; none where it did not begin."""
        return [plot for record in self.joints.values() for plot in record.plots()]

    def start(
        self, mission: Mission, edit: Callable[[mujoco.MjSpec], None] | None = None
    ) -> tuple[np.ndarray, SwervePlant]:
        home = at_home(self.robot, mission.legs)
        plant = SwervePlant(
            self.robot.description, self.robot.state.split(home), self.settings.plant, self.seed, edit=edit,
            localization=self.settings.global_poses(self.seed),
        )  # fmt: skip
        return home, plant

    def record(
        self, name: str, t: float, truth: Truth, controller: SwerveController, mission: Mission, command: Any
    ) -> None:
        add = self.log.add
        if f"{name}.leg" not in self.log.names:
            self._label(name)
        add(f"{name}.base", t, truth.pose)
        add(f"{name}.base_odometry", t, controller.pose)
        add(f"{name}.base_reference", t, mission.base(t)[0][0])
        add(f"{name}.leg", t, truth.state[self.robot.state["leg"]])
        add(f"{name}.leg_reference", t, mission.leg(t)[0][0])
        add(f"{name}.brake", t, command.brake)
        add(f"{name}.wheel_slip", t, truth.slip)
        add(f"{name}.wheel_force", t, truth.wheel_force)
        add(f"{name}.wanted", t, controller.target)
        speeds = [truth.joint_speeds[n] for g in ("leg", "steer", "wheel") for n in self.robot.input.groups[g]]
        add(f"{name}.drive_speed", t, speeds)
        add(f"{name}.steer", t, truth.state[self.robot.state["steer"]])

    def _label(self, name: str) -> None:
        joints, label = self.robot.input.groups, lambda channel, *about: self.log.label(f"{name}.{channel}", *about)
        for channel, group, unit in (
            ("leg", "leg", "rad"), ("leg_reference", "leg", "rad"), ("brake", "leg", "1"), ("steer", "steer", "rad"),
            ("wheel_slip", "wheel", "m/s"), ("wheel_force", "wheel", "N"),
        ):  # fmt: skip
            label(channel, joints[group], unit)
        driven = [n for g in ("leg", "steer", "wheel") for n in joints[g]]
        label("drive_speed", driven, "rad/s")
        label("wanted", self.robot.input.names, self.robot.input.units)

    def planned(
        self, name: str, mission: Mission, duration: float, edit: Any = None, knock: float | None = None,
        progress: Progress | None = None,
    ) -> tuple[Outcome, Knock | None]:  # fmt: skip
        """With the MPC. A knock comes at ``knock`` [s], without the guard of open legs, which would stop the leg on its way."""
        s, robot = self.settings, self.robot
        home, plant = self.start(mission, edit)
        mpc = swerve_mpc(robot, s.mpc, s.cost, SteeringGuess(robot, mission.preview))
        mission.set(mpc, robot, home, duration + s.mpc.horizon)
        t = np.arange(0.0, duration, 0.1)
        mpc.reference["end_effector"] = Reference.poses(t, *carried_poses(robot, home, mission.base(t)[0]))
        brakes = BrakeControl(robot, delay=s.plant.brake_delay, changed=mpc.set_schedule)
        mission.apply(brakes)
        timing = Timing.of(plant.timestep, s.control.rate, s.mpc.rate, s.mpc.computation_delay)
        controller = SwerveController(
            robot, plant.truth().pose, timing.period, brakes, tracking=TrackingSettings(lag=s.actuator_time_constant),
            estimation=self.estimation,
            supervision=SupervisionSettings(guard=s.leg_guard and knock is None, report=brakes.accept),
        )  # fmt: skip
        stand_still(plant, controller, timing, s.settle_time)
        mpc.reset(home)
        hit = None if knock is None else Knock(knock, plant, plant.time, corners(robot)["LF"])
        plant.external = hit
        if name == TOUR_RUN:
            self.joints[name] = JointRecord(self.log, robot, System(plant, controller, mpc, timing), f"{name}.")

        def record(now: float, command: Any, plans: Any) -> None:
            if round(now / timing.period) % 4 == 0:
                truth = plant.truth()
                self.record(name, now, truth, controller, mission, command)
                if name in self.joints:
                    self.log.add(f"{name}.state", now, truth.state)
                    self.log.add(f"{name}.input", now, plans.current.feedforward(now))
                    self.joints[name].tick(now, truth, plans)

        return Loop(plant, controller, mpc, timing, duration, record).run(progress), hit
