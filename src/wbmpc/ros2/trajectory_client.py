"""Commands to the controllers of ros2_control."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from wbmpc.model.robot import RobotModel
from wbmpc.mpc.policy import Policy
from wbmpc.ros2.base_driver import TwistSender
from wbmpc.ros2.bus import DEFAULT, Node
from wbmpc.ros2.convert import header, stamp
from wbmpc.ros2.settings import Controller, RosSettings, drive_groups

Place = tuple[str, int]
#: How far trajectories look ahead [s] before they brake: if the node dies, the robot is at rest after that.
AHEAD = 0.5
#: Braking at the end of a trajectory: with this share of the acceleration limits (of joints without one: rad/s²), within a time
#: from the first to the second [s].
BRAKING, BRAKES_WITH, BRAKES_WITHIN = 0.8, 2.0, (0.05, 2.0)


class Sender:
    """One controller that takes numbers: those at ``places`` of the groups, in its order."""

    def __init__(self, node: Node, topic: str, kind: str, places: list[Place]) -> None:
        self._to, self._places = node.publisher(topic, kind, DEFAULT), places

    def send(self, values: dict[str, np.ndarray]) -> None:
        """A command by groups."""
        self._to.publish({"data": [values[g][i] for g, i in self._places]})


def places_of(robot: RobotModel) -> dict[str, Place]:
    """Group and number of every drive by its name."""
    return {n: (g, i) for g, part in drive_groups(robot).items() for i, n in enumerate(part)}


def senders(node: Node, robot: RobotModel, settings: RosSettings) -> list[Sender | TwistSender]:
    """One for each controller that takes numbers or a twist."""
    places, controllers = places_of(robot), settings.command_topics(robot).values()
    found: list[Sender | TwistSender] = [
        Sender(node, c.topic, c.type, [places[j] for j in c.joints]) for c in controllers if c.takes == "numbers"
    ]
    base = settings.frames.base
    return found + [TwistSender(node, c.topic, c.type, robot, base) for c in controllers if c.takes == "twist"]


class TrajectorySender:
    """One controller that follows trajectories: what the policy plans for its joints, sent again at a rate."""

    def __init__(self, node: Node, robot: RobotModel, settings: RosSettings, controller: Controller) -> None:
        self._to = node.publisher(controller.topic, controller.type, DEFAULT)
        self._names = [settings.bus_name(n) for n in controller.joints]
        arm = list(robot.state.groups["arm"])
        in_arm = [arm.index(n) for n in controller.joints]
        self._places = [robot.state["arm"].start + i for i in in_arm]
        self._rates = [robot.input["arm"].start + i for i in in_arm]
        limits = robot.limits
        maximum = limits.input_rate[self._rates]
        self._brakes_with = BRAKING * np.where(np.isfinite(maximum), maximum, BRAKES_WITH / BRAKING)
        self._range = limits.state_lower[self._places], limits.state_upper[self._places]
        self.period, self.due = 1.0 / settings.rates.trajectory, -np.inf
        self._sent: tuple[float, np.ndarray, np.ndarray] | None = (
            None  # when [s of the bus], times [s] from then on, rates
        )

    def send(self, policy: Policy, t: float, now: float) -> None:
        """The plan from t [s] on, which is ``now`` on the bus: positions and velocities at its nodes of the next seconds, then a
        ramp to rest: without a successor the arm stands, and a joint_trajectory_controller takes no other ends."""
        self.due = t + self.period
        times = policy.times[(policy.times > t + 1e-3) & (policy.times < t + AHEAD)]
        if not times.size:
            return
        positions = [policy.state(float(s))[self._places] for s in times]
        rates = [policy.feedforward(float(s))[self._rates] for s in times]
        end = float(np.clip(np.max(np.abs(rates[-1]) / self._brakes_with), *BRAKES_WITHIN))
        position = self._at_rest(positions[-1], rates[-1], end)
        after = [*(times - t), float(times[-1]) - t + end]
        self._publish(now, after, [*positions, position], [*rates, 0.0 * rates[-1]])
        self._sent = now, np.array(after), np.array([*rates, 0.0 * rates[-1]])

    def _at_rest(self, position: np.ndarray, rate: np.ndarray, takes: float) -> np.ndarray:
        """Where (n) [rad] braking from ``rate`` (n) [rad/s] ends: all joints brake evenly, in ``takes`` [s], and none leaves its
        range (sooner than that it brakes harder)."""
        low, high = np.minimum(self._range[0], position), np.maximum(self._range[1], position)
        return np.clip(position + 0.5 * takes * rate, low, high)

    def _publish(
        self, now: float, times: Sequence[float], positions: Sequence[np.ndarray], rates: Sequence[np.ndarray]
    ) -> None:
        points = [
            {"positions": p, "velocities": v, "time_from_start": stamp(float(s))}
            for s, p, v in zip(times, positions, rates, strict=True)
        ]
        self._to.publish({"header": header(now, ""), "joint_names": self._names, "points": points})

    def stop(self, x: np.ndarray, ramp: float, now: float, age: float = 0.0) -> None:
        """Brake within ``ramp`` [s] from a state (nx) that is ``age`` [s] old. An end where the joints are, or were, would be passed and
        come back to, harder than any ramp; one beyond where the last trajectory ends would set a resting arm going."""
        takes = max(ramp, BRAKES_WITHIN[0])
        rate, went = self._followed(now, age)
        end = self._at_rest(x[self._places] + went, rate, takes)
        self._publish(now, [takes], [end], [np.zeros(end.size)])
        self._sent = now, np.array([0.0, takes]), np.array([rate, 0.0 * rate])

    def _followed(self, now: float, age: float) -> tuple[np.ndarray, np.ndarray]:
        """Rates (n) [rad/s] at which the last trajectory has the joints by now, and how far [rad] it has led them in the last ``age`` [s]:
        what came before it went on as it begins; of a time that went back nothing is known."""
        if self._sent is None or now < self._sent[0]:
            return np.zeros(len(self._places)), np.zeros(len(self._places))
        at, times, rates = self._sent
        until = now - at
        since = min(max(until - max(age, 0.0), -AHEAD), until)
        grid = np.unique(np.clip([since, *times, until], since, until))
        followed = np.stack([np.interp(grid, times, column) for column in rates.T], axis=1)
        steps = 0.5 * np.diff(grid)[:, None]
        return followed[-1], np.sum(steps * (followed[1:] + followed[:-1]), axis=0)


class Trajectories:
    """All controllers that follow trajectories; ``now()``: the bus's time [s]."""

    def __init__(self, node: Node, robot: RobotModel, settings: RosSettings) -> None:
        controllers = settings.command_topics(robot).values()
        self._senders = [TrajectorySender(node, robot, settings, c) for c in controllers if c.takes == "trajectory"]

    def restart(self) -> None:
        """The next trajectories are due at once."""
        for sender in self._senders:
            sender.due = -np.inf

    def send(self, policy: Policy, t: float, now: Callable[[], float]) -> None:
        """Those that are due at t [s]."""
        for sender in self._senders:
            if t >= sender.due:
                sender.send(policy, t, now())

    def stop(self, x: np.ndarray, ramp: float, now: Callable[[], float], age: float) -> None:
        """Brake within ``ramp`` [s] from a state (nx) that is ``age`` [s] old."""
        for sender in self._senders:
            sender.stop(x, ramp, now(), age)
