"""From goals, paths and speeds to tracks over time for base and end effector of a robot that stands on the floor.

All in the planner's world frame; times are the plan's [s]. A goal without times is approached along a straight line with
a cosine's profile. Who goes where: a base that is sent carries the end effector along; an end effector that is sent far takes the base along.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.bases.optional import mounting
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel
from wbmpc.ros2.convert import nearest_angle, planar, upright
from wbmpc.ros2.settings import Goals, Speeds

#: Between two samples of a reference [s]; how far the end effector goes before the base comes along [m].
STEP, LEASH = 0.02, 0.3
#: A way has no more samples than this, however long it takes: they are farther apart then.
_MAX_SAMPLES = 2000
#: Ways that take less than this [s] are none.
_ROUNDING = 1e-4
#: A base that cannot go sideways does not turn for a way up to this [m].
_SHORT = 0.005
#: A speed is held for longer than the horizon [s], and changes within this acceleration [m/s², rad/s²].
HOLD, ACCELERATION = 12.0, 1.0
#: The reference of a speed is at most so far from the robot [m, rad]: who is held or leans first has little to catch up.
AWAY = 0.05


@dataclass(frozen=True)
class Track:
    """Planar poses (n, 3) of the base over times (n,) [s]."""

    times: Array
    poses: Array

    @property
    def twists(self) -> Array:
        """Body twists (n, 3) between the samples, constant in between; at rest at the end."""
        step, turn = np.diff(self.poses[:, :2], axis=0), np.diff(self.poses[:, 2])
        middle = self.poses[:-1, 2] + 0.5 * turn
        c, s = np.cos(middle), np.sin(middle)
        # the chord of an arc: along the middle heading, shorter by sin(a) / a of half its angle
        ahead = np.stack([c * step[:, 0] + s * step[:, 1], c * step[:, 1] - s * step[:, 0]], axis=1)
        ahead /= np.sinc(turn / (2.0 * np.pi))[:, None]
        rates = np.concatenate([ahead, turn[:, None]], axis=1) / np.maximum(np.diff(self.times), 1e-6)[:, None]
        return np.concatenate([rates, np.zeros((1, 3))])

    def at(self, t: float) -> tuple[Array, Array]:
        """Pose (3) and body twist (3) at t [s], before the first sample the first pose."""
        k = max(int(np.searchsorted(self.times, t, side="right")) - 1, 0)
        twist = self.twists[k]
        return lie.se2_step(self.poses[k], twist * max(t - self.times[k], 0.0)), twist


@dataclass(frozen=True)
class EndEffectorTrack:
    """Positions (n, 3) [m] and quaternions (n, 4) of the end effector over times (n,) [s]."""

    times: Array
    positions: Array
    orientations: Array


@dataclass(frozen=True)
class Task:
    """What base and end effector are to do. ``carried``: the end effector goes with the base; ``description``: the task as a message."""

    base: Track
    end_effector: EndEffectorTrack
    carried: bool
    description: str


class Planner:
    """Makes tasks that begin at a state ``x`` (nx) and time ``t`` [s].

    ``lift`` [m]: height of the model's origin above the floor; heights on the bus are above the floor, those of tasks above the
    origin. ``base_height`` [m] of the base's frame above the floor. ``goals``: how far they may
    be; farther ones, and those that the arm cannot reach, raise :class:`InputError`.
    """

    def __init__(self, robot: RobotModel, speeds: Speeds, goals: Goals | None = None) -> None:
        self.robot, self.speeds, self.goals = robot, speeds, goals or Goals()
        self.lift = -robot.base.ground
        self.base_height = robot.base.body_height
        self.moves = robot.description.base.moves
        self._center, self.reach = _arm(robot)
        self.shoulder = float(self._center[2])
        #: (3, m): the twists of the base's frame that its speeds make, the last of which is the turn
        self.twist = np.asarray(robot.base.twist, float)

    # ------------------------------------------------------------------ tasks
    def hold(self, x: Array, t: float) -> Task:
        return self._carry(Track(np.array([t]), self._base(x)[None]), self._held(x), "stay")

    def to_base(self, x: Array, t: float, goal: Array) -> Task:
        """The base goes to the pose ``goal`` (x, y, yaw), the shorter way round."""
        start = self._base(x)
        self._check_far("base", goal[None, :2], start[:2])
        self._check_moves()
        goal = np.array([goal[0], goal[1], nearest_angle(goal[2], start[2])])
        if self.twist.shape[1] < 3:
            times, poses = self._turn_and_drive(start, goal)
            return self._carry(Track(t + times, poses), self._held(x), "base to a goal")
        way = float(np.hypot(*(goal - start)[:2])) / self.speeds.base
        times, share = _profile(max(way, abs(goal[2] - start[2]) / self.speeds.turn))
        poses = start + share[:, None] * (goal - start)
        return self._carry(Track(t + times, poses), self._held(x), "base to a goal")

    def to_end_effector(self, x: Array, t: float, position: Array, orientation: Array) -> Task:
        """The end effector goes to a pose; the base comes along by what it is farther than :data:`LEASH`."""
        self._check_end_effector(x, position[None])
        end_effector = self._approach(x, t, position, orientation)
        return Task(self._follow(x, end_effector), end_effector, False, "end effector to a goal")

    def along_end_effector_path(self, x: Array, t: float, path: EndEffectorTrack, base: Track | None) -> Task:
        """The end effector goes to the path's beginning, then along it at the path's times (later if it takes longer to get there).

        ``base``: the base's own track; left out, it comes along.
        """
        self._check_end_effector(x, path.positions)
        end_effector = self._join(x, t, path)
        return Task(base or self._follow(x, end_effector), end_effector, False, "end effector along a path")

    def along_base_path(self, x: Array, t: float, path: Track, end_effector: EndEffectorTrack | None) -> Task:
        """The base goes along a path at its times, from where it is; ``end_effector``: the end effector's own track, else it is carried."""
        start = self._base(x)
        self._check_moves()
        self._check_far("base", path.poses[:, :2], start[:2])
        first = path.poses[0] + np.array([0.0, 0.0, nearest_angle(path.poses[0, 2], start[2]) - path.poses[0, 2]])
        poses = path.poses + (first - path.poses[0])
        approach = self.to_base(x, t, first).base
        late = max(float(approach.times[-1]) - float(path.times[0]), 0.0)
        times, later = path.times + late, approach.times[0] < path.times[0] + late
        way = (approach.times, approach.poses) if later and approach.times.size > 1 else (np.zeros(0), np.zeros((0, 3)))
        keep = way[0] < times[0] - 1e-9
        track = Track(np.concatenate([way[0][keep], times]), np.concatenate([way[1][keep], poses]))
        task = self._carry(track, self._held(x), "base along a path")
        return task if end_effector is None else replace(task, end_effector=end_effector, carried=False)

    def drive(self, x: Array, t: float, twist: Array, going: Task | None = None) -> Task:
        """The base goes on with a body twist (3), or what of it its speeds can make; the end effector is carried. ``going``: the task under
        way. A stream of speeds does not restart with every message where the robot is by then, always somewhat behind: it would
        be as slow as that."""
        self._check_moves()
        if self.twist.shape[1] < 3:
            twist = self.twist @ np.array([twist[0], twist[2]])
        return self._change(x, t, twist, HOLD, going, "base at a speed")

    def slow_down(self, x: Array, t: float, going: Task | None) -> Task:
        """From the speed of the task under way to rest."""
        return self._change(x, t, np.zeros(3), 0.0, going, "base to rest")

    # ------------------------------------------------------------------ parts
    def _turn_and_drive(self, start: Array, goal: Array) -> tuple[Array, Array]:
        """Times (n) and poses (n, 3) of a base that cannot go sideways: it turns about the middle of its axle, drives there forward or
        backward, and turns again."""
        middle = np.array([-self.twist[1, -1], self.twist[0, -1]])  # what does not move in a turn, in axes of the base
        at = lambda pose: pose[:2] + _turned(pose[2]) @ middle
        way = at(goal) - at(start)
        heading, length = nearest_angle(float(np.arctan2(way[1], way[0])), start[2]), float(np.hypot(*way))
        if abs(heading - start[2]) > 0.5 * np.pi:
            heading = nearest_angle(heading + np.pi, start[2])
        heading = heading if length > _SHORT else start[2]
        end = nearest_angle(goal[2], heading)
        times, share, yaw = [np.zeros(1)], [np.zeros(1)], [np.array([start[2]])]
        for turn, part in ((heading - start[2], 0.0), (0.0, 1.0), (end - heading, 0.0)):
            long, risen = _profile(max(abs(turn) / self.speeds.turn, part * length / self.speeds.base))
            if long.size > 1:
                times.append(times[-1][-1] + long[1:])
                yaw.append(yaw[-1][-1] + turn * risen[1:])
                share.append(share[-1][-1] + part * risen[1:])
        yaws, places = np.concatenate(yaw), at(start) + np.concatenate(share)[:, None] * way
        poses = np.array([[*(p - _turned(a) @ middle), a] for p, a in zip(places, yaws, strict=True)])
        return np.concatenate(times), poses

    def base_pose(self, x: Array) -> tuple[Array, Array]:
        """Position (3) [m] above the floor and quaternion (4) of the base's frame, without its lean."""
        if not self.moves:
            position, quaternion = mounting(self.robot.base)
            return position + [0.0, 0.0, self.lift], quaternion
        return upright(x[self.robot.state["base"]], self.base_height)

    def _base(self, x: Array) -> Array:
        """(x, y, yaw)."""
        return np.array(x[self.robot.state["base"]][:3]) if self.moves else planar(*self.base_pose(x))

    def _check_moves(self) -> None:
        if not self.moves:
            raise InputError("the base of this robot does not move; valid: goals and paths of the end effector")

    def _change(self, x: Array, t: float, twist: Array, hold: float, going: Task | None, description: str) -> Task:
        """To a body twist (3), which is then held for ``hold`` [s]."""
        (place, now), held = (self._base(x), np.zeros(3)), self._held(x)
        if going is not None:
            reference, now = going.base.at(t)
            place = place + np.clip(reference - place, -AWAY, AWAY)
            if going.carried:
                held = going.base.poses[0], going.end_effector.positions[0], going.end_effector.orientations[0]
        ramp = float(np.abs(twist - now).max()) / ACCELERATION
        ramp = ramp if ramp > _ROUNDING else 0.0
        changing = np.linspace(0.0, ramp, 1 + int(np.ceil(ramp / STEP)))
        s = np.concatenate([changing, ramp + np.arange(0.1, hold, 0.1)])
        share = np.minimum(0.5 * (s[1:] + s[:-1]) / ramp, 1.0) if ramp > 0.0 else np.ones(s.size - 1)
        poses = _integrated(place, now + share[:, None] * (twist - now), np.diff(s))
        return self._carry(Track(t + s, poses), held, description)

    def _held(self, x: Array) -> tuple[Array, Array, Array]:
        """Pose of the base (3), position (3) and quaternion (4) of the end effector that belong together."""
        return self._base(x), *self.robot.pose(x)

    def _carry(self, base: Track, held: tuple[Array, Array, Array], description: str) -> Task:
        start, position, orientation = held
        turns = base.poses[:, 2] - start[2]
        c, s = np.cos(turns), np.sin(turns)
        d = position[:2] - start[:2]
        moved = np.stack([c * d[0] - s * d[1], s * d[0] + c * d[1]], axis=1) + base.poses[:, :2]
        positions = np.concatenate([moved, np.full((moved.shape[0], 1), position[2])], axis=1)
        quaternions = [lie.quaternion_multiply(lie.quaternion_about((0, 0, 1), a), orientation) for a in turns]
        return Task(base, EndEffectorTrack(base.times, positions, np.array(quaternions)), True, description)

    def _approach(self, x: Array, t: float, position: Array, orientation: Array) -> EndEffectorTrack:
        start, turned = self.robot.pose(x)
        angle = np.linalg.norm(
            lie.quaternion_log(lie.quaternion_multiply(lie.quaternion_conjugate(turned), orientation))
        )
        way = float(np.linalg.norm(position - start)) / self.speeds.end_effector
        times, share = _profile(max(way, float(angle) / self.speeds.turn))
        quaternions = np.array([lie.slerp(turned, orientation, s) for s in share])
        return EndEffectorTrack(t + times, start + share[:, None] * (position - start), quaternions)

    def _join(self, x: Array, t: float, path: EndEffectorTrack) -> EndEffectorTrack:
        way = self._approach(x, t, path.positions[0], path.orientations[0])
        times = path.times + max(float(way.times[-1]) - float(path.times[0]), 0.0)
        keep = way.times < times[0] - 1e-9
        return EndEffectorTrack(
            np.concatenate([way.times[keep], times]),
            np.concatenate([way.positions[keep], path.positions]),
            np.concatenate([way.orientations[keep], path.orientations]),
        )

    def _follow(self, x: Array, end_effector: EndEffectorTrack) -> Track:
        """The base on a leash behind the end effector's way over the floor."""
        start, shift = self._base(x), np.zeros(2)
        begin = self.robot.pose(x)[0][:2]
        poses = np.tile(start, (end_effector.times.size, 1))
        if not self.moves:
            return Track(end_effector.times, poses)
        for k, position in enumerate(end_effector.positions):
            pull = position[:2] - begin - shift
            length = float(np.hypot(*pull))
            if length > LEASH:
                shift = shift + pull * (1.0 - LEASH / length)
            poses[k, :2] += shift
        return Track(end_effector.times, poses)

    def _check_end_effector(self, x: Array, positions: Array) -> None:
        """The base takes the arm there over the floor; the height is what the arm reaches above the floor. Without such a base all is
        within the arm's reach."""
        if not self.moves:
            far = float(np.linalg.norm(positions - self._center, axis=1).max())
            if far > self.reach:
                raise InputError(
                    f"the end effector's goal is out of reach: {far:.2f} m from the arm's first joint, possible: up to {self.reach:.2f} m"
                )
            return
        self._check_far("end_effector", positions[:, :2], self.robot.pose(x)[0][:2])
        middle, heights = self.lift + self.shoulder, self.lift + positions[:, 2]
        low, high = max(middle - self.reach, 0.0), middle + self.reach
        over = np.maximum(heights - high, low - heights)
        k = int(np.argmax(over))
        if over[k] > 1e-9:
            raise InputError(
                f"the end effector's goal is out of reach: height {heights[k]:.2f} m, possible {low:.2f} to {high:.2f} m"
            )

    def _check_far(self, key: str, places: Array, here: Array) -> None:
        """Places (n, 2) on the floor against ``key`` of the settings' ``goals``, from ``here`` (2)."""
        limit, who = getattr(self.goals, key), key.replace("_", " ")
        farthest = float(np.hypot(*(places - here).T).max())
        if farthest > limit:
            raise InputError(f"the {who}'s goal is {farthest:.4g} m away, valid: 0 to {limit:g} m (key 'goals.{key}')")


def timed(positions: Array, turns: Array, times: Array | None, t: float, speed: float, turn: float) -> Array:
    """Times [s] of a path's points (n, 3), of which each turns by ``turns`` (n - 1) [rad]: the given ones, or by speeds.

    Given times in the past are taken as relative to ``t``.
    """
    if times is not None and times.size > 1 and np.all(np.diff(times) > 0.0):
        return times if times[0] >= t - 1.0 else times - times[0] + t
    lengths = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    return t + np.concatenate([[0.0], np.cumsum(np.maximum(np.maximum(lengths / speed, turns / turn), 1e-3))])


def base_track(poses: Array, times: Array | None, t: float, speeds: Speeds) -> Track:
    """A path of planar poses (n, 3), the yaw of neighbors the shorter way round."""
    poses = np.array(poses, float)
    poses[:, 2] = np.unwrap(poses[:, 2])
    return Track(timed(poses[:, :2], np.abs(np.diff(poses[:, 2])), times, t, speeds.base, speeds.turn), poses)


def end_effector_track(
    positions: Array, orientations: Array, times: Array | None, t: float, speeds: Speeds
) -> EndEffectorTrack:
    """A path of the end effector."""
    turns = np.array([2.0 * np.arccos(min(abs(float(a @ b)), 1.0)) for a, b in pairwise(orientations)])
    return EndEffectorTrack(
        timed(positions, turns, times, t, speeds.end_effector, speeds.turn), positions, orientations
    )


def _turned(yaw: float) -> Array:
    """(2, 2): from the axes of a base to those of the world."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s], [s, c]])


def _integrated(start: Array, twists: Array, intervals: Array) -> Array:
    """Poses (n + 1, 3) from ``start`` (3) on after body twists (n, 3), each for its interval (n) [s]."""
    turns = twists[:, 2] * intervals
    yaw = start[2] + np.concatenate([[0.0], np.cumsum(turns)])
    middle, chord = yaw[:-1] + 0.5 * turns, intervals * np.sinc(turns / (2.0 * np.pi))
    c, s = np.cos(middle), np.sin(middle)
    steps = chord[:, None] * np.stack(
        [c * twists[:, 0] - s * twists[:, 1], s * twists[:, 0] + c * twists[:, 1]], axis=1
    )
    return np.column_stack([start[:2] + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)]), yaw])


def _profile(shortest: float) -> tuple[Array, Array]:
    """Times [s] every :data:`STEP` or, of a long way, every so often that they are not too many, and the shares of the way by
    then, as a cosine; ``shortest`` [s]: at full speed all the way."""
    if shortest < _ROUNDING:
        return np.zeros(1), np.ones(1)
    duration = 0.5 * np.pi * shortest
    count = int(np.ceil(min(duration / STEP, _MAX_SAMPLES)))
    numbers = np.arange(count + 1.0)
    return max(STEP, duration / count) * numbers, 0.5 * (1.0 - np.cos(np.pi * numbers / count))


def _arm(robot: RobotModel) -> tuple[Array, float]:
    """Where the shoulder is (3) [m] with the base at the model's origin, and length [m] of the stretched arm."""
    tree = robot.tree
    joints, frame = {tree.joint(name) for name in robot.description.arm.joints}, tree.frames[robot.tool]
    so_far, link = float(np.linalg.norm(frame.position)), frame.link
    first, length = link, so_far
    while link >= 0:  # a file may have joints in any order
        if link in joints:
            first, length = link, so_far
        so_far += float(np.linalg.norm(tree.links[link].position))
        link = tree.links[link].parent
    place = tree.zero_poses()[first][0]
    if not robot.description.base.moves:
        position, quaternion = mounting(robot.base)
        return np.asarray(position + lie.quaternion_to_rotation(quaternion) @ place), length
    return np.array([*place[:2], robot.base.body_height + robot.base.ground + place[2]]), length
