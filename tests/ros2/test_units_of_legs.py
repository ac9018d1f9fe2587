"""What is said of legs and joints that slide is in meters. Truth: MuJoCo's joint types of the robots' files."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from toys import robot
from wbmpc.bases.swerve.brake_control import BrakeControl, reject_floating, reject_floating_way
from wbmpc.bases.swerve.brake_monitor import SwerveReadings
from wbmpc.bases.swerve.brake_supervision import brake_monitor
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.ros_legs import PATIENCE, Legs
from wbmpc.bases.swerve.ros_settings import SwerveRosSettings
from wbmpc.errors import InputError
from wbmpc.robots import load_spec
from wbmpc.ros2.joints import JointReader
from wbmpc.ros2.settings import load_settings

KINDS = {int(mujoco.mjtJoint.mjJNT_SLIDE): "m", int(mujoco.mjtJoint.mjJNT_HINGE): "rad"}


class Node:
    """A bus on which nobody is."""

    def subscribe(self, *given: Any, **named: Any) -> None: ...

    def serve(self, *given: Any, **named: Any) -> None: ...


def truth(name: str, joint: str) -> str:
    return KINDS[int(load_spec(robot(name).description).compile().joint(joint).type[0])]


@pytest.mark.parametrize("name", ["telescope-ur10", "swerve-ur10"])
def test_orders_for_legs_and_their_brakes_name_the_unit(name: str, caplog: pytest.LogCaptureFixture) -> None:
    one = robot(name)
    first, home = one.state.groups["leg"][0], one.home[one.state["leg"]].copy()
    unit = truth(name, first)
    legs = Legs(Node(), one, SwerveRosSettings(), lambda: "", lambda: (np.zeros(4), home))  # type: ignore[arg-type]
    goal = home[0] + 0.05
    assert legs._target("", [first], [goal], []) == f"{first} to {goal:.3f} {unit}"
    with pytest.raises(InputError, match=f"{first} at 9 {unit} is outside"):
        legs._target("", [first], [9.0], [])
    brakes = BrakeControl(one)
    assert legs.apply(brakes, 0.0, home)
    for t in (0.0, 1.0, 1.0 + 2.0 * PATIENCE):
        legs.watch(brakes, t, home)
    assert legs.short.startswith(f"{first} stopped at {home[0]:.3f} {unit} on its way to {goal:.3f} {unit}")


def test_a_fault_of_a_brake_names_the_unit_and_the_leg_as_the_bus_does() -> None:
    one = robot("telescope-ur10")
    first = one.state.groups["leg"][0]
    settings = SwerveRosSettings(joints={first: "front_left"})
    monitor, home = brake_monitor(one, settings.bus_name), one.home[one.state["leg"]]
    assert monitor is not None
    for k in range(100):
        monitor.update(SwerveReadings(0.02 * k, home + 0.1 * (k > 70), np.zeros(4), np.zeros(4)))
    assert str(monitor.faults[0]).startswith("brake of front_left ")
    assert ": the leg moved by 0.100 m (" in str(monitor.faults[0])


@pytest.mark.parametrize(("name", "unit"), [("swerve-ur10", "rad"), ("telescope-ur10", "m")])
def test_legs_that_hold_nothing_are_named_with_their_unit(
    name: str, unit: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("wbmpc.bases.swerve.brake_control.FLOATING", 1e9)  # whatever holds, it is too little
    geometry, leg = swerve_base(robot(name)).geometry, np.array([0.1, 0.2, 0.1, 0.2])
    with pytest.raises(InputError, match=rf"with these legs, \[0\.1 0\.2 0\.1 0\.2\] {unit}, nothing"):
        reject_floating(geometry, leg, np.ones(4))
    with pytest.raises(InputError, match=rf"on the way to \[0\.1 0\.2 0\.1 0\.2\] {unit} nothing"):
        reject_floating_way(geometry, leg - 0.5, leg, np.ones(4), np.full(4, 0.1))


@pytest.mark.parametrize("name", ["telescope-ur10", "fetch", "swerve-ur10"])
def test_joint_states_that_jump_name_the_unit(name: str) -> None:
    reader = JointReader(robot(name), load_settings(None, robot(name)))
    stamp = lambda k: SimpleNamespace(stamp=SimpleNamespace(sec=1, nanosec=k * 10_000_000))
    for joint in reader.names:
        reader.reset()
        before = SimpleNamespace(header=stamp(1), name=reader.names, position=[0.0] * len(reader.names))
        reader.read(before, 0.0)
        after = [9.0 * (n == joint) for n in reader.names]
        with pytest.raises(InputError, match=rf"'{joint}' jumped by 9 {truth(name, joint)} in 10 ms, faster"):
            reader.read(SimpleNamespace(header=stamp(2), name=reader.names, position=after), 0.01)
