"""From policies to drive commands of a swerve robot, and from encoders to observations.

The MPC's state holds the *planned* steering angles; a servo closes their difference to the measured ones. (With measured
angles the rolling rows of four wheels are never exactly consistent, and their only exact solution is standstill.)
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from wbmpc import lie
from wbmpc.checks import not_negative, positive
from wbmpc.control.brakes import BrakeControl
from wbmpc.control.drives import DryFriction, Smoothing
from wbmpc.control.leg_guard import LegGuard
from wbmpc.estimation import (
    BrakeFault,
    BrakeMonitor,
    FusedOdometry,
    OdometryNoise,
    WheelCalibration,
    WheelOdometry,
)
from wbmpc.estimation.odometry import odd_one_out
from wbmpc.model import RobotModel, aligned_steering, wheel_velocities
from wbmpc.mpc import Observation, Plans
from wbmpc.plant import SwerveCommand, SwerveMeasurement

_LOG = logging.getLogger("wbmpc")
#: Steering errors [rad]: of a start from which wheels are aligned first; that stop a base on its way; that end a stop.
#: The last is no smaller: the plan's angles move on meanwhile, and a base that waits for the rest falls behind its reference.
CROOKED, MISALIGNED, ALIGNED = 0.05, 0.45, 0.1
#: Gain [1/s] of the steering servo while it aligns wheels: the base waits for them.
ALIGN_GAIN = 15.0
#: Time [s] over which the arm's sag is learned, longer than drives lag; the most that is taken for it [rad/s].
SAG_TIME, SAG_MOST = 1.0, 0.15
#: Sideways speed [m/s] at which a plan lets a wheel slip; for how long [s] after it the wheel does (drives lag), and its weight in
#: the odometry meanwhile.
SCRUBS, SCRUBBING, SCRUB_WEIGHT = 0.02, 0.1, 1e-3
#: Brakes are looked at about every so often [s]: legs do not move far meanwhile, and a look takes nearly as long as the rest of
#: a command.
LOOK = 0.01
#: What the monitor of brakes sees: time [s], measured legs (n) [rad], brakes (n, 1 = open), planned rates (n) [rad/s].
Tick = tuple[float, np.ndarray, np.ndarray, np.ndarray]
#: A wheel that hangs in the air goes its own way: contradiction of the wheels [m/s] averaged over [s], the share of it that one
#: wheel has to make, for how long [s] it is not believed after that, fewest wheels that can tell which one it is.
CONTRADICTS, ODD_TIME, ODD_SHARE, ODD_FOR, ODD_WHEELS = 0.01, 0.03, 0.8, 0.1, 4


def brake_monitor(robot: RobotModel) -> BrakeMonitor | None:
    """Of the brakes of a robot's legs, with the usual tolerances; None for fixed legs."""
    if "leg" not in robot.input:
        return None
    return BrakeMonitor(robot.state.groups["leg"], limit=robot.limits.input_upper[robot.input["leg"]])


class SwerveAgent:
    """Estimation, prediction and tracking of a swerve robot at the controller's rate.

    ``period`` [s] of the controller; ``brakes``: of the legs over time, or a function ``brakes(t)``: brake state (n) at a time,
    1 = open; ``leg_guard``: whether open legs that go astray are held (:class:`LegGuard`), for which the former is needed, since
    the planner has to know; ``steer_gain`` [1/s];
    ``lag`` [s] of the drives, first order: the plan leads the measured state by it;
    ``calibration``: what is known of the wheels; ``noise`` of wheels and gyro; ``use_gyro``: whether the odometry has one.
    While the robot stands, :meth:`measure` finds the gyro's bias. ``clamped``: whether the wheels of the last command were
    slowed down to their limits; ``aligning``: wheels point elsewhere than planned (turned by hand, or knocked), so that the
    base stands until they do not. ``sag`` (m) [rad/s]: by what the arm's joints turn besides what they are told, as under a
    load that nobody fed forward; it is taken off the commands. ``monitor``: of brakes that do not answer; left out, one with
    the usual tolerances (None for fixed legs); it looks every :data:`LOOK`, and before a stop. ``faulty`` is called with each
    fault that it finds. ``scrubbing``: plans let wheels slip sideways while they turn about, and the odometry hardly listens to
    those.
    ``odd_wheels``: whether the odometry hardly listens to a wheel whose way the others contradict,
    as of one that hangs in the air.
    ``friction``: whether what dry friction takes from wheels and steering is learned and given back. ``smoothing`` [s] of base
    position and arm against the jitter of the encoders' age (0: none).
    """

    def __init__(
        self,
        robot: RobotModel,
        pose: np.ndarray,
        period: float,
        brakes: BrakeControl | Callable[[float], np.ndarray] | None = None,
        steer_gain: float = 5.0,
        planned_steering: bool = True,
        lag: float = 0.0,
        *,
        leg_guard: bool = True,
        calibration: WheelCalibration | None = None,
        noise: OdometryNoise | None = None,
        use_gyro: bool = True,
        monitor: BrakeMonitor | None = None,
        faulty: Callable[[BrakeFault], None] | None = None,
        scrubbing: bool = False,
        odd_wheels: bool = False,
        friction: bool = False,
        smoothing: float = 0.0,
    ) -> None:
        positive("swerve robot's agent", period=period)
        not_negative("swerve robot's agent", steer_gain=steer_gain, lag=lag, smoothing=smoothing)
        self.robot, self.period, self.steer_gain = robot, period, steer_gain
        self.planned_steering = planned_steering
        geometry = robot.base.geometry
        wheels = self.calibration = calibration or WheelCalibration.unknown(geometry)
        self.odometry = FusedOdometry(geometry, pose, calibration=wheels, noise=noise)
        self.wheels_alone = WheelOdometry(
            geometry, pose, wheel_radius=wheels.wheel_radius, leg_zero=wheels.leg_zero, steer_zero=wheels.steer_zero
        )
        self.use_gyro = use_gyro
        self.friction = {g: DryFriction(geometry.modules, period, lag) for g in ("wheel", "steer")} if friction else {}
        self.odd_wheels = odd_wheels and geometry.modules >= ODD_WHEELS
        self._odd, self._apart = np.zeros(geometry.modules), np.zeros((geometry.modules, 2))
        self._smoothing = Smoothing(smoothing) if smoothing > 0.0 else None
        self._mean_age = (noise or OdometryNoise()).mean_age
        # the model has one radius for all wheels
        self.wheel_scale = geometry.wheel_radius / wheels.wheel_radius
        self.lag = lag
        steer = robot.state["steer"]
        self._steer_range = robot.limits.state_lower[steer], robot.limits.state_upper[steer]
        self.monitor, self.faulty, self.scrubbing = monitor or brake_monitor(robot), faulty, scrubbing
        self._watched: Tick | None = None  # the newest tick since the last stop, and when the monitor looked last
        self._looked = -np.inf
        self._blend = 1.0 - np.exp(-period / lag) if lag > 0.0 else 1.0
        self._rates = np.zeros(robot.input.size)
        self._turning = np.zeros(robot.base.geometry.modules)
        self._scrubs = np.zeros(
            robot.base.geometry.modules
        )  # for how long [s] wheels still slip because the plan says so
        self._together = np.delete(
            np.arange(robot.input.size), robot.input["steer"]
        )  # inputs that go one share of the way
        # of the arm: what it turns by itself, commands, rates that lagging drives make of them now and over the last period
        self.sag, self._arm, self._arm_rate, self._arm_mean = np.zeros((4, len(robot.input.groups["arm"])))
        hinges = len(robot.state.groups.get("leg", ()))
        self._control = brakes if isinstance(brakes, BrakeControl) else None
        self.guard = LegGuard(hinges) if leg_guard and self._control is not None else None
        # as commanded; a view may put its own in place, and then the guard, which could not tell the planner, rests
        self.brakes = self._own = (
            brakes.commanded if isinstance(brakes, BrakeControl) else brakes or (lambda t: np.zeros(hinges))
        )
        self.measured: SwerveMeasurement | None = None
        self.clamped = self.aligning = False
        self.wanted = np.zeros(robot.input.size)  # what plan and steering servo ask for, before it is scaled
        self.sent = np.zeros(robot.input.size)  # what of it accelerations allow

    def measure(self, measurement: SwerveMeasurement) -> None:
        """Take in the message of this tick."""
        before, self.measured = self.measured or measurement, measurement
        m = measurement
        turning = self._mean_rate(before, m) if self.use_gyro else None
        self._learn_sag(m.arm - before.arm, m.time - before.time)
        self.wheels_alone.update(m.leg, m.steer, m.wheel)
        if self.odd_wheels:
            self._note_odd_wheel(m.time - before.time)
        slips = (self._scrubs > 0.0) | (self._odd > 0.0)  # one sound wheel alone tells no motion
        weights = np.where(slips, SCRUB_WEIGHT, 1.0) if slips.any() and np.sum(~slips) > 1 else None
        self.odometry.update(m.time, m.leg, m.steer, m.wheel, turning, weights=weights)
        if m.place is not None:
            self.odometry.correct(m.place.time, m.place.pose, m.place.covariance)
        for group, drives in self.friction.items():
            drives.learn(getattr(m, group) - getattr(before, group), m.time - before.time)
        if self._smoothing is not None:
            self._smooth(self._smoothing, m.time - before.time)

    def _mean_rate(self, before: SwerveMeasurement, now: SwerveMeasurement) -> float | None:
        """What the gyro says of the yaw rate [rad/s] from one message to the next; None if it says nothing."""
        return 0.5 * float(before.gyro[2] + now.gyro[2])

    def _note_odd_wheel(self, h: float) -> None:
        """Which wheel goes elsewhere than all others do."""
        self._odd = np.maximum(self._odd - h, 0.0)
        if h <= 0.0:
            return
        self._apart += (1.0 - np.exp(-h / ODD_TIME)) * (self.wheels_alone.residual / h - self._apart)
        if np.sqrt(np.sum(self._apart**2)) > CONTRADICTS:
            axes = self.robot.base.geometry.steer_axes(self.leg if self.leg.size else np.zeros(len(self._odd)))
            i, share = odd_one_out(self._apart, axes)
            if share > ODD_SHARE:
                self._odd[i] = ODD_FOR

    def _smooth(self, smoothing: Smoothing, h: float) -> None:
        """Positions of the base and of the arm at the moment of the message."""
        assert self.measured is not None
        pose = self.odometry.pose
        c, s = np.cos(pose[2]), np.sin(pose[2])
        vx, vy, _ = self._rates[self.robot.input["base"]]
        rates = np.concatenate([[c * vx - s * vy, s * vx + c * vy], self._arm_mean + self.sag])
        smoothing.update(np.concatenate([pose[:2], self.measured.arm]), rates * h, rates * self._mean_age, h)

    def _learn_sag(self, turned: np.ndarray, h: float) -> None:
        """From what the arm's joints ``turned`` (m) [rad] in h [s] and what lagging drives should have made of the commands."""
        if h > 0.0:
            share = 1.0 - np.exp(-h / SAG_TIME)
            self.sag = np.clip(self.sag + share * (turned / h - self._arm_mean - self.sag), -SAG_MOST, SAG_MOST)

    @property
    def pose(self) -> np.ndarray:
        """(x, y, yaw) of the base that is controlled."""
        pose = self.odometry.pose
        if self._smoothing is not None and self._smoothing.value is not None:
            pose = np.append(self._smoothing.value[:2], pose[2])
        return pose

    @property
    def arm(self) -> np.ndarray:
        """Measured angles of the arm, smoothed if they shall be."""
        assert self.measured is not None
        smooth = self._smoothing.value if self._smoothing is not None else None
        return self.measured.arm if smooth is None else smooth[2:]

    def base_pose(self) -> np.ndarray:
        """Estimated pose (7) of the base in the frame of the odometry: position [m] at the nominal height, quaternion."""
        x, y, yaw = self.pose
        return np.array([x, y, self.robot.base.height, *lie.quaternion_about((0.0, 0.0, 1.0), yaw)])

    @property
    def leg(self) -> np.ndarray:
        """Measured leg angles less their zeros (empty for fixed legs)."""
        assert self.measured is not None
        return self.measured.leg - self.calibration.leg_zero if self.measured.leg.size else self.measured.leg

    @property
    def steer(self) -> np.ndarray:
        """Measured steering angles (n) less their zeros."""
        assert self.measured is not None
        return self.measured.steer - self.calibration.steer_zero

    def state(self) -> np.ndarray:
        """Estimated state (nx), with the measured steering angles."""
        m = self.measured
        assert m is not None
        parts = {"base": self.pose, "leg": self.leg, "steer": self.steer, "wheel": m.wheel, "arm": self.arm}
        return self.robot.state.vector({g: parts[g] for g in self.robot.state.groups})

    def predict(self, t: float, until: float, plans: Plans) -> Observation:
        """The state at time ``until``, by the inputs that will be applied from ``t`` on, and what the drives still owe.

        The plan's clock runs ahead of the wall's by the lag: what is commanded now acts that much later.
        """
        state = self.robot.state
        x = self.state()
        if plans.current is not None and self.planned_steering:
            x[state["steer"]] = plans.current.state(t + self.lag)[state["steer"]]
        elif self.planned_steering:
            # Wheels that have no common centre can only stand: the first plan starts from the nearest that have one.
            aligned = aligned_steering(self.robot.base.geometry, self.leg if self.leg.size else 0.0, self.steer)
            if np.abs(aligned - self.steer).max() > CROOKED:
                x[state["steer"]] = aligned
        # A first-order drive still moves by lag times its present rate after the last command: the state leads by that.
        self._move(x, self._rates, self.lag, self._open(t))
        sent = self.sent
        for k in range(round((until - t) / self.period)):
            now = t + (k + 0.5) * self.period
            policy = plans.at(now)
            if policy is None:
                break
            u = self._held(policy.feedforward(now + self.lag))
            moved = sent = self._reachable(sent, u, self._open(now))
            if self.planned_steering:  # the plan's angles go on with the plan, and the servo follows them
                moved = sent.copy()
                moved[self.robot.input["steer"]] = u[self.robot.input["steer"]]
            self._move(x, moved, self.period, self._open(now))
        return Observation(until + self.lag, x)

    def _move(self, x: np.ndarray, u: np.ndarray, h: float, brake: np.ndarray) -> None:
        """Integrate input rates u over h [s] into the state x, in place; the planned steering has no lag."""
        state, given = self.robot.state, self.robot.input
        x[state["base"]] = lie.se2_step(x[state["base"]], u[given["base"]] * h)
        for group in ("leg", "steer", "wheel", "arm"):
            if group in state:
                x[state[group]] += u[given[group]] * (brake * h if group == "leg" else h)

    def _held(self, u: np.ndarray) -> np.ndarray:
        """An input as it will act: while wheels are aligned the base stands."""
        if self.aligning:
            for group in ("base", "leg", "wheel"):
                if group in self.robot.input:
                    u[self.robot.input[group]] = 0.0
        return u

    def stop(self) -> SwerveCommand:
        """Everything at rest, brakes closed. The next plan's commands start from there, as fast as accelerations allow."""
        self._look_before_stop()
        if self.guard is not None and self.brakes is self._own:
            told = np.isfinite(self.guard.until).any()
            self.guard.restart()
            if told:
                self.hold(self.guard.until)
        self._drive_arm(np.zeros(self.sag.size))
        self.wanted, self.sent = np.zeros((2, self.robot.input.size))
        self.clamped = self.aligning = False
        self._lag_behind(self.sent)
        for drives in self.friction.values():
            drives.command(np.zeros(drives.droop.size), np.inf, np.inf)
        still = SwerveCommand.stop(self.robot.base.geometry.modules, len(self.robot.input.groups["arm"]))
        return still if "leg" in self.robot.input else replace(still, brake=np.zeros(0))

    def command(self, t: float, plans: Plans) -> SwerveCommand:
        """Drive speeds for this tick; a stop once the plan has run out.

        The plan's inputs and a steering servo: the gains of the policy are not used, since drives that follow speeds hold
        a kinematic plan without them, and feedback on wheels from an estimated pose would break the rolling rows.
        """
        policy, given = plans.current, self.robot.input
        assert policy is not None and self.measured is not None
        if t > policy.end:
            still = self.stop()
            if self.monitor is not None:
                self.watch(t, still.brake, np.zeros(still.brake.size))
            return still
        self._guard_legs(t)
        # a plan whose limits give way may lie beyond the joints' range, where no wheel can be waited for
        planned = np.clip(policy.state(t + self.lag)[self.robot.state["steer"]], *self._steer_range)
        # what lagging drives still owe counts as done, or a wheel that turns fast would seem to be behind
        error = planned - self.steer - self.lag * self._turning
        off = float(np.abs(error).max()) if self.planned_steering else 0.0
        self.aligning = off > (ALIGNED if self.aligning else MISALIGNED)
        u = self._held(policy.feedforward(t + self.lag))
        if self.scrubbing:
            self._note_scrubbing(planned, u)
        most = self.robot.limits.drive_upper[given["steer"]]
        gain = max(self.steer_gain, ALIGN_GAIN) if self.aligning else self.steer_gain
        steer = np.clip(u[given["steer"]] + gain * error, -most, most)
        self.wanted = u
        self.wanted[given["steer"]] = steer
        brake = self._open(t)
        self.sent = sent = self._reachable(self.sent, u, brake)
        self._lag_behind(sent)
        wheel, limit = sent[given["wheel"]] * self.wheel_scale, self.robot.limits.input_upper[given["wheel"]]
        # Too fast for one wheel: slow the whole motion down, or the wheels drag each other.
        excess = float(np.max(np.abs(wheel) / limit))
        self.clamped, wheel = excess > 1.0, wheel / max(1.0, excess)
        if self.monitor is not None:
            self.watch(t, brake, sent[given["leg"]] * min(1.0, 1.0 / max(excess, 1e-12)))
        limit, change = self.robot.limits.input_upper[given["arm"]], self.robot.limits.input_change[given["arm"]]
        arm = np.clip(sent[given["arm"]] - self.sag, -limit, limit)
        self._drive_arm(self._arm + np.clip(arm - self._arm, -change * self.period, change * self.period))
        return SwerveCommand(
            self._driven("wheel", wheel), self._driven("steer", sent[given["steer"]]), self._arm, brake
        )

    def _open(self, t: float) -> np.ndarray:
        """Brakes (n, 1 = open) at t [s]: as commanded, closed where the guard holds a leg."""
        brake = self.brakes(t)
        if self.guard is None or self.brakes is not self._own:
            return brake
        return np.where(self.guard.held(t), 0.0, brake)

    def _guard_legs(self, t: float) -> None:
        """Hold open legs that go astray from what drives have made of the commands, and tell the planner."""
        if self.guard is None or self.brakes is not self._own:
            return
        assert self.measured is not None
        if self.guard.update(t, self.measured.leg, self._rates[self.robot.input["leg"]], self.brakes(t)):
            self.hold(self.guard.until)

    def hold(self, until: np.ndarray) -> None:
        """Tell the planner until when [s] each leg (n) is held (−inf: was never)."""
        assert self._control is not None
        self._control.hold(until)

    def _driven(self, group: str, wanted: np.ndarray) -> np.ndarray:
        """The command to drives (n) [rad/s] with what friction takes of it."""
        if group not in self.friction:
            return wanted
        limits, index = self.robot.limits, self.robot.input[group]
        step = limits.input_change[index] * self.period
        return self.friction[group].command(wanted, limits.drive_upper[index], step)

    def _note_scrubbing(self, steer: np.ndarray, u: np.ndarray) -> None:
        """Which wheels slip sideways under the planned angles ``steer`` (n) and input u."""
        geometry, given = self.robot.base.geometry, self.robot.input
        rate = u[given["leg"]] if "leg" in given else 0.0
        leg = self.leg if self.leg.size else np.zeros(geometry.modules)
        v = wheel_velocities(geometry, leg, u[given["base"]], rate)
        heading = geometry.wheel_heading + geometry.leg_angles(leg) + steer
        side = v[:, 1] * np.cos(heading) - v[:, 0] * np.sin(heading)
        self._scrubs = np.where(np.abs(side) > SCRUBS, SCRUBBING, np.maximum(self._scrubs - self.period, 0.0))

    def _lag_behind(self, sent: np.ndarray) -> None:
        """What drives of first order owe after a command ``sent`` (nu); the planned steering has no lag."""
        steer = self.robot.input["steer"]
        self._rates[steer] = self._turning
        self._rates += self._blend * (sent - self._rates)
        self._turning = self._rates[steer].copy()
        if self.planned_steering:
            self._rates[steer] = 0.0

    def _drive_arm(self, command: np.ndarray) -> None:
        """What drives of first order make of a command (m) [rad/s] within a period."""
        behind = self._arm_rate - command
        self._arm, self._arm_mean = command, command + behind * self._blend * self.lag / self.period
        self._arm_rate = command + behind * (1.0 - self._blend)

    def _reachable(self, sent: np.ndarray, u: np.ndarray, brake: np.ndarray) -> np.ndarray:
        """The way from the last command ``sent`` (nu) towards u (nu) as far as accelerations allow within a period.

        All but the steering goes the same share of it: one wheel that lags behind would drag the others. The steering goes as
        fast as it can: it follows planned angles. A closed brake stops its leg as hard as it likes.
        """
        given = self.robot.input
        step, most = u - sent, self.robot.limits.input_change * self.period
        if "leg" in given:
            most[given["leg"]] = np.where(brake > 0.5, most[given["leg"]], np.inf)
        excess = np.maximum(np.abs(step) / most, 1.0)
        excess[self._together] = excess[self._together].max()
        return sent + step / excess

    @property
    def holds(self) -> int:
        """How often the guard has held a leg."""
        return 0 if self.guard is None else int(self.guard.holds.sum())

    @property
    def faults(self) -> list[str]:
        """Brakes that were found not to answer, as sentences; those that did after all are left out."""
        return [] if self.monitor is None else [str(fault) for fault in self.monitor.real]

    def watch(self, t: float, brake: np.ndarray, rate: np.ndarray) -> None:
        """A tick at t [s] of hinged legs: commanded ``brake`` (n, 1 = open), planned leg rates ``rate`` (n) [rad/s]. Their brakes
        are judged by the last measurement, if the last look is :data:`LOOK` ago (within half a period). Times may start anew."""
        assert self.measured is not None and self.monitor is not None
        if not np.isfinite(rate).all():
            return  # such a command is refused, by the name of its drives, before it goes to them
        self._watched = t, self.measured.leg, brake, rate
        if t < self._looked - self.period:  # the clock of a new run; by less: the look before a stop was ahead
            self.monitor.restart_clock()
            self._looked = -np.inf
        if t - self._looked >= max(LOOK - 0.5 * self.period, 0.0):
            self._look(self._watched)

    def _look_before_stop(self) -> None:
        """A stop closes the brakes and ends the plan: what legs have done until now is judged by the commands until now."""
        watched, self._watched = self._watched, None
        if watched is None or self.measured is None:
            return
        t, before, brake, rate = watched
        if self.measured.leg.shape != before.shape or not np.isfinite(self.measured.leg).all():
            return  # the odometry has refused this message, and the robot stops for it
        if brake.any() or rate.any():  # else the stop changes nothing for them
            self._look((max(t + self.period, self._looked), self.measured.leg, brake, rate))

    def _look(self, tick: Tick) -> None:
        self._looked = tick[0]
        self.judge(tick)

    def judge(self, tick: Tick) -> None:
        """Judge the brakes by a tick, and tell what is found."""
        assert self.monitor is not None
        for fault in self.monitor.update(*tick):
            _LOG.log(logging.INFO if fault.withdraws else logging.WARNING, "%s", fault)
            self.note(fault)
            if self.faulty is not None:
                self.faulty(fault)

    def note(self, fault: BrakeFault) -> None:
        """A fault that was found: a brake that does not hold is no use to the guard."""
        if self.guard is not None and fault.kind == "does not hold":
            self.guard.give_up(fault.leg)
