"""From a policy to drive commands of a swerve robot: steering servo, accelerations, wheel scaling, arm.

The gains of the policy are not used: drives that follow speeds hold a kinematic plan without them, and feedback on wheels from
an estimated pose would break the rolling rows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.swerve.drives import ArmDrives, DriveModel
from wbmpc.bases.swerve.estimator import SwerveEstimator
from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.tracking_step import integrate, predict, simulate_drives, track
from wbmpc.checks import not_negative
from wbmpc.kernel.step import bind
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.policy import Policy

#: Gain [1/s] of the steering servo while it aligns wheels: the base waits for them.
ALIGN_GAIN = 15.0


@dataclass(frozen=True)
class TrackingSettings:
    """``lag`` [s] of the drives, first order: the plan leads the measured state by it; ``steer_gain`` [1/s] of the steering servo;
    ``planned_steering``: whether plans start from their own steering angles instead of the measured ones."""

    lag: float = 0.0
    steer_gain: float = 5.0
    planned_steering: bool = True

    def __post_init__(self) -> None:
        not_negative("swerve robot's tracking", steer_gain=self.steer_gain, lag=self.lag)


class SwerveTracking:
    """The law at the controller's ``period`` [s]. ``wheel_scale`` (n): the model's wheel radius over each wheel's own.

    ``clamped``: whether the last wheels were slowed down to their limits; ``aligning``: wheels point elsewhere than planned
    (turned by hand, or knocked), so that the base stands until they do not.
    """

    def __init__(
        self, robot: RobotModel, period: float, settings: TrackingSettings, wheel_scale: Array,
    ) -> None:  # fmt: skip
        self.robot, self.period, self.settings = robot, period, settings
        self.drives = DriveModel(robot, period, settings.lag, settings.planned_steering)
        self.arm = ArmDrives(len(robot.input.groups["arm"]), period, settings.lag)
        self.clamped = self.aligning = False
        self._arrays = self._memory(wheel_scale)
        self._bind()

    def _memory(self, wheel_scale: Array) -> dict[str, Array]:
        """Arrays by the names of fields in :mod:`wbmpc.bases.swerve.tracking_step`."""
        robot, limits = self.robot, self.robot.limits
        n, nu, steer = swerve_base(robot).geometry.modules, robot.input.size, robot.state["steer"]
        own = {name: np.zeros(nu) for name in ("u", "sent", "future", "ahead", "moved", "excess")}
        own |= {name: np.zeros(n) for name in ("planned", "measured", "brake", "error", "wheels", "leg_rates")}
        values = {
            "low": limits.state_lower[steer], "high": limits.state_upper[steer], "wheel_scale": wheel_scale,
            "actuator_upper": limits.actuator_upper, "input_upper": limits.input_upper, "input_rate": limits.input_rate,
        }  # fmt: skip
        arm = {k: v for k, v in self.arm.arrays.items() if k != "turned"}
        return (
            own
            | self.drives.arrays
            | arm
            | {k: np.array(v, float) for k, v in values.items()}
            | {"x": np.zeros(robot.state.size)}
        )

    def _bind(self) -> None:
        s, inputs, state, blend = self.settings, self.robot.input, self.robot.state, self.drives.blend
        groups = ("base", "leg", "steer", "wheel", "arm")
        law = {
            "nu": inputs.size, "n": swerve_base(self.robot).geometry.modules, "legs": len(inputs.groups.get("leg", ())),
            "m": len(inputs.groups["arm"]), **{g: inputs[g].start if g in inputs else 0 for g in groups},
            **{f"x_{g}": state[g].start if g in state else 0 for g in groups}, "period": self.period, "lag": s.lag, "blend": blend,
            "late": blend * s.lag / self.period, "gain": s.steer_gain, "align_gain": ALIGN_GAIN,
            "planned_steering": s.planned_steering,
        }  # fmt: skip
        self._track, self._simulate_drives, self._predict, self._integrate = (
            bind(step, self._arrays, **law) for step in (track, simulate_drives, predict, integrate)
        )

    @property
    def target(self) -> Array:
        """What plan and steering servo ask for (nu), before it is scaled."""
        return self._arrays["u"].copy()

    @property
    def sent(self) -> Array:
        """What of it accelerations allow (nu)."""
        return self._arrays["sent"].copy()

    def rest(self) -> None:
        """A stop: the next commands start from rest."""
        self.arm.follow(np.zeros(self.arm.sag.size))
        self._arrays["u"][:] = self._arrays["sent"][:] = 0.0
        self.clamped = self.aligning = False
        self._simulate_drives()

    def command(
        self, t: float, policy: Policy, estimator: SwerveEstimator, brake: Array
    ) -> tuple[SwerveCommand, Array]:
        """Drive speeds at t [s] under ``brake`` (n, 1 = open), and the rates (n) [rad/s] of legs that go with them."""
        a, inputs, ahead = self._arrays, self.robot.input, t + self.settings.lag
        x, a["u"][:] = policy.planned(ahead)
        a["planned"][:] = x[self.robot.state["steer"]]
        a["measured"][:], a["brake"][: brake.size] = estimator.steer, brake
        self.aligning, self.clamped = self._track(self.aligning)
        legs = a["leg_rates"].copy() if "leg" in inputs else np.zeros(0)
        wheel, steer = self.driven("wheel", a["wheels"]), self.driven("steer", a["sent"][inputs["steer"]])
        return SwerveCommand(wheel, steer, self.arm.command.copy(), brake), legs

    def driven(self, group: str, target: Array) -> Array:
        """The command (n) [rad/s] to the drives of a ``group``, "wheel" or "steer", that are to turn at ``target`` (n)."""
        return target.copy()

    def ahead(self, x: Array, brake: Array) -> None:
        """Begin a prediction at the state x (nx): the drives still move by lag times their present rates."""
        a = self._arrays
        a["x"][:], a["brake"][: brake.size], a["moved"][:], a["ahead"][:] = x, brake, a["rates"], a["sent"]
        self._integrate(self.settings.lag)

    def predict(self, u: Array, brake: Array) -> None:
        """Go on with it for a period under a plan's input u (nu)."""
        a = self._arrays
        a["future"][:], a["brake"][: brake.size] = u, brake
        self._predict(self.aligning)

    @property
    def predicted(self) -> Array:
        """Its state (nx)."""
        return self._arrays["x"].copy()
