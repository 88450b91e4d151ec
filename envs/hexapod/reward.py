"""Reward of the hexapod for one control step: named terms whose sum is the reward."""

from __future__ import annotations

from spikedeploy.envs.hexapod.observation import FloatArray
from spikedeploy.envs.hexapod.robot import Motion

_TARGET_SPEED = 0.40  # [m/s] of Hexapod-v0
_SPEED_KERNEL = 0.12  # [m/s]
_TURN_KERNEL = 0.3  # [rad/s]


def course_terms(speed: float, heading: float, lateral: float) -> dict[str, float]:
    """Terms for walking straight: alive, speed, heading, lateral.

    speed    [m/s] smoothed, along the course
    heading  [rad] from the course
    lateral  [m] off the course
    """
    return {
        "alive": 1.0,
        "speed": 3.0 * max(-1.0, 1.0 - abs(speed - _TARGET_SPEED) / _TARGET_SPEED),
        "heading": -0.5 * min(abs(heading), 1.0),
        "lateral": -0.5 * min(abs(lateral), 1.0),
    }


def command_terms(speed_error: float, turn_error: float, sideways: float) -> dict[str, float]:
    """Terms for following commands: alive, speed, turn, sideways.

    speed_error  [m/s] commanded - smoothed
    turn_error   [rad/s] commanded - smoothed
    sideways     [m/s] leftward
    """
    return {
        "alive": 1.0,
        "speed": 2.5 * kernel(speed_error, _SPEED_KERNEL),
        "turn": 2.0 * kernel(turn_error, _TURN_KERNEL),
        "sideways": -0.5 * min(abs(sideways), 0.5),
    }


def kernel(error: float, width: float) -> float:
    """Score in [-1, 1] of a tracking error: 1 at 0, 0 at the width, a quarter as steep beyond."""
    excess = abs(error) / width
    # k(e) = 1 - e/s up to s; -(e/s - 1)/4 beyond, at least -1
    return 1.0 - excess if excess <= 1.0 else max(-1.0, -0.25 * (excess - 1.0))


def regularisers(
    motion: Motion, height: float, crouch: float, change: FloatArray
) -> dict[str, float]:
    """Terms that both tasks share: posture, smoothness and power.

    height  [m] of the torso above the mean ground
    crouch  [m] height below which crouching is penalised
    change  (18,) change of the action since the last control step

    Power is sampled at the end of the control step, as by a current sensor at 50 Hz.
    """
    gx, gy, _ = motion.gravity
    wx, wy, _ = motion.angular_velocity
    return {
        "tilt": -2.0 * (gx * gx + gy * gy),
        "jerk": -0.02 * float(change @ change),
        "power": -0.025 * motion.power,
        "bounce": -0.5 * min(abs(motion.velocity[2]), 1.0),
        "slip": -0.5 * motion.slip,
        "wobble": -0.02 * (wx * wx + wy * wy),
        "crouch": -5.0 * max(0.0, crouch - height),
    }
