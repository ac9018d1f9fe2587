"""What the metrics of the ball robot's experiments are: by experiment and name (``*``: any ending) unit and definition."""

from __future__ import annotations

from wbmpc.experiment import Definitions

_OWN = "in the estimated frame"
_FAULTS: Definitions = {"encoder_faults": ("1", "faults of wheel and arm encoders that were found")}
_COMMON: Definitions = {
    "fell": ("1", "whether the robot fell: 1 if it did"),
    "tilt_max": ("rad", "largest angle of the body to the vertical; true"),
    "estimated_position_error_max": ("m", "largest error of the estimated position of the ball, prediction included"),
    "estimated_tilt_error_max": ("rad", "largest error of the estimated pitch and roll, prediction included"),
    "estimated_yaw_error_max": ("rad", "largest error of the estimated yaw, prediction included"),
    "rolling_fault_share": ("1", "share of the messages in which the ball was found not to roll"),
    "payload_estimated": ("kg", "mass at the end effector that was weighed, at the end"),
    **_FAULTS,
}
_STEPS: Definitions = {
    "rise_time_max": ("s", "longest time from 10 to 90 % of the way of a step, of all steps"),
    "steady_position_error_max": ("m", f"largest mean distance from the pose over the last second of a step; {_OWN}"),
    "steady_position_error_world_max": (
        "m",
        "largest mean distance from the pose over the last second of a step; true",
    ),
    "steady_orientation_error_max": ("rad", f"largest mean angle to the pose over the last second of a step; {_OWN}"),
    "steady_orientation_error_arm_max": ("rad", f"the same without the roll that the arm cannot turn; {_OWN}"),
    "steady_orientation_error_world_max": (
        "rad",
        "largest mean angle to the pose over the last second of a step; true",
    ),
    "unreachable_rotation_error": ("rad", "angle that is left of the last step, which the arm cannot reach; true"),
    "wheel_torque_max": ("N m", "largest torque of a wheel"),
    **_COMMON,
}
_PUSH: Definitions = {
    "not_recovered": ("1", "pushes after which the robot was not back within 5 cm and at rest before the next one"),
    "recovered": ("1", "whether the robot was back within 5 cm and at rest after every push: 1 if so"),
    "rest_error_max": ("m", f"largest distance from its place in the last half second before the next push; {_OWN}"),
    "rest_error_world_max": ("m", "largest distance from its place in the last half second before the next push; true"),
    "ball_travel_max": ("m", "largest distance of the ball from its place; true"),
    "hand_error_max": ("m", "largest distance of the end effector from its place; true"),
    "hand_error_rms": ("m", f"rms distance of the end effector from its place; {_OWN}"),
    **_COMMON,
}
_LIMIT: Definitions = {
    "impulse_max": ("N s", "largest impulse that passes below the smallest one that fails"),
    "ball_travel_max": (
        "m",
        "largest distance of the ball from its place, of pushes that the robot recovered from; true",
    ),
    "pushes": ("1", "how many pushes were tried"),
}
_CIRCLE: Definitions = {
    "hand_error_rms": ("m", f"rms distance of the end effector from its place, since the circles begin; {_OWN}"),
    "hand_error_rms_world": ("m", "rms distance of the end effector from its place, since the circles begin; true"),
    "ball_error_rms_world": ("m", "rms distance of the ball from its reference, since the circles begin; true"),
    "ball_error_rms": ("m", f"rms distance of the ball from its reference, since the circles begin; {_OWN}"),
    **_COMMON,
}
_WHOLEBODY: Definitions = {
    "ball_error_rms_world": ("m", "rms distance of the ball from its place, whole run; true"),
    "ball_error_rms_wholebody": ("m", f"rms distance of the ball from its place, whole run; {_OWN}"),
    "hand_error_max_world": ("m", "largest distance of the end effector from its reference, whole run; true"),
    "hand_error_rms": ("m", f"rms distance of the end effector from its reference, whole run; {_OWN}"),
    "steady_hand_error_max": ("m", f"largest mean error of the end effector over the last second of a hold; {_OWN}"),
    "steady_hand_error_world_max": ("m", "largest mean error of the end effector over the last second of a hold; true"),
    "steady_ball_offset_max": ("m", f"largest mean offset of the ball over the last second of a hold; {_OWN}"),
    "feedback_share": ("1", "rms of the policy's feedback over that of the whole torque, second arm joint"),
    **_COMMON,
}
_TASKSPACE: Definitions = {
    "hand_error_integral_*": ("m s", "integral of the end effector's distance from its pose, by controller; infinite for one that falls"),
    "hand_turn_integral_*": ("rad s", "integral of the end effector's angle to its pose, by controller; infinite for one that falls"),
    "torque_squared_ratio": ("1", "integral of the squared change of the torques, task-space controller over MPC"),
    "falls_taskspace": ("1", "whether the robot fell with the task-space controller: 1 if it did"),
    "tilt_max_*": ("rad", "largest angle of the body to the vertical, by controller; true"),
    **_COMMON,
}  # fmt: skip
_FREQUENCY: Definitions = {
    "torque_error_rms_*": ("N m", "rms of acting less commanded torque of a wheel, without (plain) and with shaped costs"),
    "arm_torque_error_rms_*": ("N m", "rms of acting less commanded torque of an arm joint, without (plain) and with shaped costs"),
    "rise_time_ratio": ("1", "rise time with shaped costs over that without"),
    "rise_time_*": ("s", "time from 10 to 90 % of the way of the step, by variant"),
    "steady_error_*": ("m", "mean distance from the pose over the last second of the step, by variant; true"),
    "tilt_max_*": ("rad", "largest angle of the body to the vertical, by variant; true"),
    "fell_*": ("1", "whether the robot fell: 1 if it did, by variant"),
    "torque_error_ratio": ("1", "torque error of the wheels with shaped costs over that without"),
    **_FAULTS,
}  # fmt: skip
_DOOR: Definitions = {
    "force_error_ratio_*": ("1", "rms error of the true normal force over its reference, from 0.1 s after the touch until the door is open"),
    "contact_share_*": ("1", "share of that time in which the end effector touches the door"),
    "lean_mean_*": ("rad", "mean lean of the base towards the door in that time, against how it stood"),
    "touch_peak": ("N", "largest normal force in the first 0.1 s after the touch"),
    "force_estimate_error_rms": ("N", "rms error of the force that the momentum observer estimates without the sensor"),
    "panel_penetration_max": ("m", "deepest contact of the robot, tip included, with the soft panel"),
    "door_angle_max": ("rad", "largest angle of the door"),
    "rest_hand_swing": ("m", "largest swing of the end effector along an axis in the last second, peak to peak; true"),
    "rest_hand_error": ("m", f"rms distance of the end effector from its place in the last second; {_OWN}"),
    **_COMMON,
}  # fmt: skip
_TOUCH: Definitions = {
    "touch_peak_ratio": ("1", "largest normal force of the tip at any physics step, touch and push, over the wanted one; worst of all speeds; true"),
    "touch_peak_ratio_plain": ("1", "the same without the limit of the approach's speed"),
    "contact_lost_max": ("s", "longest time without contact between touch and release; worst of all speeds; true"),
    "contact_lost_max_plain": ("s", "the same without the limit of the approach's speed"),
    "touch_speed_max": ("m/s", "speed of the tip towards the surface in the 5 ms before the touch; largest of all speeds; true"),
    "touch_time_max": ("s", "time from the start of the approach until the touch; worst of all speeds; true"),
    "touch_time_extra": ("s", "how much later the tip touches than without the limit of the approach's speed; worst of all speeds; true"),
    "fell": ("1", "whether the robot fell: 1 if it did"),
}  # fmt: skip
_SLIP: Definitions = {
    "slide_max": ("m", "how far the tip slides at most from where it touched, contact lost or not, until the push ends; worst grip; true"),
    "slide_max_plain": ("m", "the same with a friction cone of one size"),
    "force_error_ratio": ("1", "rms error of the true normal force over its reference, from 0.1 s after the touch until the push ends; worst grip"),
    "force_error_ratio_plain": ("1", "the same with a friction cone of one size"),
    "touch_peak": ("N", "largest normal force of the tip at any physics step; worst of all grips; true"),
    "time_without_contact": ("s", "time without contact between touch and the end of the push; worst of all grips; true"),
    "grip_bound_ratio": ("1", "largest friction coefficient that was planned with over the true one; worst of all grips"),
    "fell": ("1", "whether the robot fell: 1 if it did"),
}  # fmt: skip

#: By experiment.
DEFINITIONS: dict[str, Definitions] = {
    "rezero-steps": _STEPS,
    "rezero-push-ball": _PUSH,
    "rezero-push-hand": _PUSH,
    "rezero-push-limit-ball": _LIMIT,
    "rezero-push-limit-hand": _LIMIT,
    "rezero-circle": _CIRCLE,
    "rezero-wholebody": _WHOLEBODY,
    "rezero-taskspace": _TASKSPACE,
    "rezero-frequency": _FREQUENCY,
    "rezero-door": _DOOR,
    "touch": _TOUCH,
    "slip": _SLIP,
}
