"""Support switches of a robot with one wheel on a block while its stretched arm turns: predicted, and learned from.

What is predicted from the model is off by what the model does not know of the robot's masses. Turns of the arm show them: the gyro
sees when the robot begins to rock over an edge, on which its zero-moment point is then (:mod:`wbmpc.studies.pankert2022.mass_offset`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.swerve.configurations import corners
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.constants import GRAVITY
from wbmpc.model.robot import RobotModel
from wbmpc.stability import StanceOf, Triangle, assess
from wbmpc.studies.pankert2022.mass_offset import MassOffset, Tipping
from wbmpc.studies.pankert2022.rocking import rockings
from wbmpc.studies.pankert2022.support_switches import Switch, resting_triangles, support_switches, upright

#: Feet (n, 2) [m], zero-moment points (k, 2) [m] and forces (k,) [N] that press on the ground.
Stances = tuple[Array, Array, Array]
#: The arm turns after the block was raised with RAISE [m/s] and the robot has stood for REST [s].
RAISE, REST = 0.05, 2.0
#: A wheel that carries less than UNLOADED [N] for AWAY [s] has left the ground.
UNLOADED, AWAY = 5.0, 1.0
#: Interval [s] of the motions of predictions.
_STEP = 0.05


@dataclass(frozen=True)
class Case:
    """A configuration with a block of ``height`` [m] under a ``wheel`` (LF, RF, LB or RB); the arm, stretched and horizontal,
    turns once in ``turn`` [s] with its first joint, from half a turn. ``prefix``: of the names of its channels."""

    configuration: str
    height: float
    turn: float
    wheel: str = "LF"
    prefix: str = ""

    @property
    def start(self) -> float:
        """When the arm starts [s]."""
        return self.height / RAISE + REST

    @property
    def end(self) -> float:
        """When it has arrived [s]."""
        return self.start + self.turn + 0.5

    @property
    def key(self) -> str:
        """The name of its channels."""
        return f"{self.prefix}{self.configuration}_{1e3 * self.height:g}mm"

    def heading(self, t: Array) -> Array:
        """The first joint's angle (n) [rad] at times t (n,) [s]; the speed rises within a second."""
        s = np.clip(t - self.start, 0.0, None)
        gone = np.where(s < 1.0, 0.5 * s * s, s - 0.5) * 2.0 * np.pi / self.turn
        return np.asarray(np.minimum(gone, 2.0 * np.pi) - np.pi)

    def rates(self, t: Array) -> tuple[Array, Array]:
        """The first joint's speed (n) [rad/s] and acceleration (n) [rad/s²]."""
        s, speed = t - self.start, 2.0 * np.pi / self.turn
        going = np.where(s < self.turn + 0.5, np.clip(s, 0.0, 1.0), 0.0)
        return speed * going, np.where((s >= 0.0) & (s < 1.0), speed, 0.0)

    def arm(self, t: Array, joints: int) -> Array:
        """All joints' angles (n, joints) [rad] at times t (n,) [s]."""
        out = np.zeros((t.size, joints))
        out[:, 0] = self.heading(t)
        return out


class Support:
    """What the model says of a case: ``feet`` (n, 2) [m] on level ground, ``heights`` (n) [m] of the ground, the ``faces`` on which
    the robot can stand; ``times`` (k,) [s] along the arm's motion.

    A tilted wheel touches the ground with another point of its rim.
    """

    def __init__(self, robot: RobotModel, case: Case) -> None:
        self.robot, self.case = robot, case
        base = assess(robot, case.configuration)
        self.feet, self._x = base.stance.feet, base.x
        self.heights = np.zeros(len(self.feet))
        self.heights[corners(robot)[case.wheel]] = case.height
        self.faces = resting_triangles(self.feet, self.heights)
        self.times = np.arange(case.start, case.end, _STEP)
        g, state = swerve_base(robot).geometry, robot.state
        heading = g.wheel_heading + g.leg_angles(self._x[state["leg"]]) + self._x[state["steer"]]
        self._along, self._radius = np.stack([np.cos(heading), np.sin(heading)], axis=1), g.wheel_radius
        self._stance_of = StanceOf(robot)
        self._known: dict[bytes, Stances] = {}

    def upright(self, face: Triangle) -> Array:
        """The vertical (3) in the robot's axes on a face."""
        return upright(self.feet, self.heights, face)

    def stances(self, up: Array) -> Stances:
        """At all times, with the vertical ``up`` (3)."""
        if up.tobytes() not in self._known:
            self._known[up.tobytes()] = self.stances_at(self.times, up)
        return self._known[up.tobytes()]

    def stances_at(self, t: Array, up: Array) -> Stances:
        """At times t (k,) [s], with the vertical ``up`` (3)."""
        part = self.robot.state["arm"]
        x, u = np.tile(self._x, (t.size, 1)), np.zeros((2, t.size, self.robot.input.size))
        x[:, part] = self.case.arm(t, part.stop - part.start)
        u[:, :, self.robot.input["arm"].start] = self.case.rates(t)
        found = [self._stance_of(at, gravity=-GRAVITY * up, u=v, u_rate=a) for at, v, a in zip(x, *u, strict=True)]
        feet = self.feet - self._radius * (self._along @ up[:2])[:, None] * self._along
        return feet, np.array([s.zmp for s in found]), np.array([-s.force[2] for s in found])


def predict(support: Support, offset: MassOffset | None = None) -> list[Switch]:
    """Support switches along the planned arm motion, of the model or of the model with an ``offset`` of its masses.

    Times [s] count from when the arm starts.
    """
    case = support.case
    heading = case.heading(support.times)
    shift = np.zeros((heading.size, 2)) if offset is None else offset.at(heading)

    def stance(up: Array, _: Triangle) -> Stances:
        feet, zmp, force = support.stances(up)
        return feet, zmp + shift, force

    level = support.stances_at(support.times[:1], np.array([0.0, 0.0, 1.0]))[1][0] + shift[0]
    switches = support_switches(support.times, support.feet, support.heights, stance, UNLOADED, level)
    return [Switch(s.time - case.start, s.previous, s.after) for s in switches]


def tippings(support: Support, t: Array, gyro: Array) -> list[Tipping]:
    """Where the model's zero-moment point was when the ``gyro`` (k, 2) [rad/s], less its bias, saw the robot begin to rock.

    ``t`` (k,) [s] from when the arm starts. The sense of the rocking shows the face it was on. Nothing where the robot can stand on
    one face only, or on more than two.
    """
    if len(support.faces) != 2:
        return []
    ups = [support.upright(f) for f in support.faces]
    change = ups[1] - ups[0]
    axis = np.array([change[1], -change[0]]) / np.hypot(*change[:2])  # the vertical turns against the body
    common = sorted(set(support.faces[0]) & set(support.faces[1]))
    found = []
    for rocking in rockings(t, gyro @ axis):
        when = np.array([rocking.time + support.case.start])
        feet, zmp, _ = support.stances_at(when, ups[0 if rocking.sign > 0 else 1])
        found.append(Tipping(feet[common], zmp[0], float(support.case.heading(when)[0])))
    return found
