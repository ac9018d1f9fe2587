"""What the metrics of the swerve robots' experiments are: by experiment and name (``*``: any ending) unit and definition."""

from __future__ import annotations

from wbmpc.experiment import Definitions
from wbmpc.tasks.definitions import DEFINITIONS as GENERAL

_WORLD = "true, in the world"
_OWN = "in the estimated frame: estimated base, true kinematics of the arm"
_SLIP = {"wheel_slip_max": ("m/s", "largest speed of a wheel's contact point over the floor")}
_DRIFT = "wheels alone"
_LEGS = {
    "brake_faults": ("1", "brake faults that were found; all brakes are sound"),
    "legs_held": ("1", "how often the guard of open legs held a leg"),
}


def _both(name: str, unit: str, text: str, estimated: str = "") -> Definitions:
    """A metric in both frames."""
    return {f"{name}_world": (unit, f"{text}; {_WORLD}"), f"{name}{estimated}": (unit, f"{text}; {_OWN}")}


_TRACK: Definitions = {
    **_both("hand_error_mean", "m", "mean distance of the end effector from its reference", "_odometry"),
    **_both("hand_error_max", "m", "largest distance of the end effector from its reference", "_odometry"),
    **_both("hand_error_mean_nearest", "m", "mean distance of the end effector from the nearest point of the path"),
    **_both("hand_orientation_error_max", "rad", "largest angle of the end effector to its reference"),
    "path_length": ("m", "length of the reference's path"),
    "base_path_length": ("m", "length of the way of the base over the floor; true"),
    "base_error_rms_world": ("m", "rms distance of the estimated position of the base from the true one"),
    "odometry_drift_ratio": ("1", "final error of the odometry over the way of the base; wheels and gyro"),
    "odometry_drift_ratio_wheels": ("1", f"final error of the odometry over the way of the base; {_DRIFT}"),
    "odometry_drift_ratio_release": ("1", "final error over the way of the base; odometry that the authors released"),
    **_SLIP,
}
_FAST: Definitions = {
    **GENERAL,
    "time_to_goal": (
        "s",
        f"time from the order until the end effector (on the s-curve: the base) stays within 1 cm of its goal; {_WORLD}",
    ),
    "tilt_max": ("rad", "largest angle of the axis of the base to the vertical; true"),
    "time_unloaded": ("s", "time in which any wheel carries less than 1 N; true"),
    "path_error_max": ("m", f"largest distance of the end effector (on the s-curve: the base) from its path; {_WORLD}"),
    "heading_error_max": ("rad", f"largest difference of the base's heading to the direction of its path; {_WORLD}"),
    **_SLIP,
}
_FIXED: Definitions = {
    "tracking_error_ratio_world": ("1", f"position error of the MPC over that of inverse kinematics; {_WORLD}"),
    "tracking_error_ratio": ("1", "position error of the MPC over that of inverse kinematics; in the estimated frame"),
    "tracking_error_rms_world_*_no_flip": ("m", f"rms position error of the base until the first wheel of any run turns about; {_WORLD}"),
    "tracking_error_rms_*_no_flip": ("m", "rms position error of the base until the first wheel of any run turns about; estimated"),
    "tracking_error_rms_world_*": ("m", f"rms position error of the base, by controller (mpc, ik, four_wheel) and motion; {_WORLD}"),
    "tracking_error_rms_*": ("m", "rms position error of the estimated base, by controller (mpc, ik, four_wheel) and motion"),
    "yaw_error_rms_world_*": ("rad", f"rms yaw error of the base, by controller; {_WORLD}"),
    "yaw_error_rms_*": ("rad", "rms yaw error of the estimated base, by controller"),
    "wheel_slip_max_*": ("m/s", "largest speed of a wheel's contact point over the floor, by controller"),
    "longest_standstill": ("s", "longest time in which the base, asked for more than 0.05 m/s, moved slower than 0.01 m/s"),
}  # fmt: skip
_CALIBRATE: Definitions = {
    "base_error_rms_world": ("m", "rms distance of the position fused from wheels, gyro and global poses from the true one"),
    "yaw_error_rms_world": ("rad", "rms difference of the fused yaw from the true one"),
    "base_path_length": ("m", "length of the way of the base over the floor; true"),
    "odometry_drift_ratio_wheels": ("1", f"final error of the odometry over the way of the base, before the calibration; {_DRIFT}"),
    "steer_zero_mean": ("rad", "mean steering offset that the calibration found"),
    "steer_zero_mean_std": ("rad", "standard deviation of the mean steering offset, by the calibration"),
    "wheel_radius_mean": ("m", "mean wheel radius that the calibration found"),
}  # fmt: skip
_STABILITY: Definitions = {
    "support_polygon_area_*": ("m2", "area of the convex hull of the wheels' contacts, by leg configuration"),
    "double_support_area_*": ("m2", "largest region in which two support triangles overlap, by leg configuration"),
}
_BRAKES: Definitions = {
    "displacement_closed*": ("m", "largest displacement of the base under 100 N, brakes closed; worst or by leg configuration"),
    "displacement_open*": ("m", "largest displacement of the base under 100 N, brakes open; worst or by leg configuration"),
    "brake_slip_torque": ("N m", "torque at which the hinge of a closed brake has moved by 5 mrad"),
    "slide_force": ("N", "smallest force at which the base has moved by 5 mm, brakes closed"),
    "fault_detection_time_*": ("s", "from when a brake that is stuck (closed, open) can be noticed to its message"),
    "false_alarms": ("1", "messages about sound brakes"),
}  # fmt: skip
_PLASTER: Definitions = {
    "pass_spread_rms": ("m", f"rms difference of the passes from their mean along the wall's normal; {_OWN}"),
    "pass_spread_rms_world": ("m", f"rms difference of the passes from their mean along the wall's normal; {_WORLD}"),
    "hand_error_rms_world_normal": ("m", f"rms error of the end effector along the wall's normal; {_WORLD}"),
    **_both("hand_error_rms", "m", "rms distance of the end effector from its reference"),
    "wall_distance_min": ("m", "smallest distance of the end effector from the wall; true"),
    "path_length": ("m", "length of the reference's path"),
    "stops": ("1", "how often the end effector stood though it was asked to move"),
    "coat_variation": ("1", "standard deviation of the coat's thickness over its mean"),
    "coat_gaps": ("1", "share of the wall with less than 70 % of the mean thickness"),
    "base_error_rms_world": ("m", "rms distance of the estimated position of the base from the true one"),
    **_SLIP,
}
_WIPE: Definitions = {
    "force_error_ratio": ("1", "rms error of the true normal force over the ordered one, from 0.1 s after its rise to the end of the way"),
    "force_mean": ("N", "mean normal force in that time; true"),
    "force_max": ("N", "largest normal force of the tip at any physics step; true"),
    "touch_peak": ("N", "largest normal force in the first 0.1 s after the touch, at any physics step; true"),
    "time_without_contact": ("s", "time with less than 0.1 N in the time in which the force is judged; true"),
    **_both("path_error_rms", "m", "rms distance of the end effector from its reference, without what is along the wall's normal"),
    **{n + "_along": about for n, about in _both("path_error_rms", "m", "rms error of the end effector along its way").items()},
    "friction_error": ("1", "difference of the mean estimated friction coefficient of tip and wall from the true one"),
    "base_travel": ("m", "how far the base drives along the wall; true"),
}  # fmt: skip
_WOBBLE: Definitions = {
    "roll_pitch_rate_max_*": ("rad/s", "largest true roll and pitch rate with one wheel on the block, by leg configuration"),
    "imu_rate_max_*": ("rad/s", "the same of the gyro, filtered and without its mean at rest, by leg configuration"),
    "roll_pitch_rate_ratio": ("1", "the smaller of the true rates of H and X over that of A"),
    "support_switch_time_error_max": ("s", "largest time between predicted and true switches of the support; infinite if others happened"),
    "support_switch_time_error_nominal_max": ("s", "the same with the masses of the robot's file instead of the learned offset"),
    "support_switches": ("1", "how many switches of the support were predicted"),
    "calibration_tippings": ("1", "how often the robot tipped while it learned its mass offset"),
    "mass_offset_base": ("m", "learned shift of the zero-moment point, the part that is fixed in the base"),
    "mass_offset_arm": ("m", "learned shift of the zero-moment point, the part that turns with the arm"),
}  # fmt: skip
_BASE: Definitions = {
    **_both("base_position_error_rms", "m", "rms distance of the base from its reference"),
    **_both("base_yaw_error_rms", "rad", "rms yaw error of the base against its reference"),
    "leg_angle_error_rms": ("rad", "rms error of the legs' angles while their brakes are open"),
    **_SLIP,
    **_LEGS,
}
_DRIVE: Definitions = {
    **_BASE,
    "leg_angle_error_rms_on_ground": ("rad", "the same of legs whose wheels carry 5 N and more"),
    "door_clearance": ("m", "smallest distance of body and wheels to the door's posts; true"),
    "wheel_off_ground_share": ("1", "share of the time in which a wheel is in the air"),
    "planned_speed_ratio_max": ("1", "largest planned speed of legs, steering and wheels over its limit"),
    "joint_speed_ratio_max": ("1", "largest true speed of legs, steering and wheels over its limit"),
    "leg_knock": ("rad", "largest error of the angle of the leg that is knocked"),
    "leg_recovery_time": ("s", "time after the knock until the leg's error stays below 1°"),
    **_both("closed_position_error_rms", "m", "rms distance of the base from its reference with closed brakes, worst configuration"),
    **_both("baseline_position_error_rms", "m", "rms distance of the base from its reference with rolling inverse kinematics"),
    **_both("baseline_yaw_error_rms", "rad", "rms yaw error of the base with rolling inverse kinematics"),
    "baseline_leg_angle_error_rms": ("rad", "rms error of the legs' angles with rolling inverse kinematics, brakes open"),
    "baseline_ratio_world": ("1", f"position error of the MPC over that of rolling inverse kinematics; {_WORLD}"),
    "baseline_ratio": ("1", "position error of the MPC over that of rolling inverse kinematics; in the estimated frame"),
}  # fmt: skip
_TOUR: Definitions = {
    **_BASE,
    "wheel_off_ground_share": ("1", "share of the time in which a wheel is in the air"),
    "planned_speed_ratio_max": ("1", "largest planned speed of legs, steering and wheels over its limit"),
    "foot_error_rms": ("m", "rms distance of the steer axes from where the legs' references have them, while brakes are open; in the body; true"),
    "foot_error_end": ("m", "largest distance of a steer axis from where the legs' references have it, at the end; in the body; true"),
    "stance_width_min": ("m", "twice the largest distance of a steer axis from the body's axis, where that is least; true"),
    "stance_width_max": ("m", "twice the largest distance of a steer axis from the body's axis, where that is largest; true"),
}  # fmt: skip
_UNIFIED: Definitions = {
    **_both("hand_error_rms", "m", "rms distance of the end effector from where it is held, since the base starts"),
    **_both("hand_error_max", "m", "largest distance of the end effector from where it is held, since the base starts"),
    **_both("base_position_error_end", "m", "distance of the base from its goal at the end"),
    **_both("base_yaw_error_end", "rad", "yaw of the base to its goal at the end"),
    **_BASE,
    "base_travel": ("m", "length of the way of the base over the floor; true"),
    "support_margin_end": ("m", "how far the zero-moment point may move before the robot can rock, at the end"),
    "support_margin_min": (
        "m",
        "how far the zero-moment point may move before the robot can rock, at the worst moment",
    ),
}

#: By experiment.
DEFINITIONS: dict[str, Definitions] = {
    "swerve-track": _TRACK,
    "swerve-fixed": _FIXED,
    "swerve-calibrate": _CALIBRATE,
    "swerve-fast": _FAST,
    "swerve-stability": _STABILITY,
    "swerve-brakes": _BRAKES,
    "swerve-plaster": _PLASTER,
    "swerve-wipe": _WIPE,
    "swerve-wobble": _WOBBLE,
    "swerve-drive": _DRIVE,
    "legs": _TOUR,
    "swerve-unified": _UNIFIED,
}
