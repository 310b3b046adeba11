"""Where the head and its camera look: rotations from joints, and what an IMU in the head feels.

Axes are those of the robot: x to the front, y to the left, z up. The chain is that of an iCub
head: neck pitch, neck roll, neck yaw, eyes tilt, and each eye turns by version and half the
vergence. All axes meet in one point, where the left camera is too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

Vector: TypeAlias = NDArray[np.float64]
Rotation: TypeAlias = NDArray[np.float64]
"""A 3 x 3 matrix whose columns are the axes of the turned frame, seen from the fixed one."""

GRAVITY_M_S2: Final = 9.81
MAGNETIC_FIELD_UT: Final = np.array([24.0, 0.0, -38.0])  # about that of Lisbon, facing north
_X: Final = np.array([1.0, 0.0, 0.0])
_Y: Final = np.array([0.0, 1.0, 0.0])
_Z: Final = np.array([0.0, 0.0, 1.0])


def about_x(angle_deg: float) -> Rotation:
    """Return the rotation that lowers the right side."""
    c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def about_y(angle_deg: float) -> Rotation:
    """Return the rotation that lowers the front."""
    c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def about_z(angle_deg: float) -> Rotation:
    """Return the rotation that turns to the left."""
    c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def head_rotation(positions_deg: Sequence[float]) -> Rotation:
    """Return how the head is turned, from the positions of all joints."""
    pitch, roll, yaw = positions_deg[:3]
    return about_y(-pitch) @ about_x(roll) @ about_z(yaw)


def camera_rotation(positions_deg: Sequence[float]) -> Rotation:
    """Return how the left camera is turned, from the positions of all joints."""
    tilt, version, vergence = positions_deg[3:6]
    return head_rotation(positions_deg) @ about_y(-tilt) @ about_z(version - vergence / 2)


def inertial(positions_deg: Sequence[float], velocities_deg_s: Sequence[float]) -> list[float]:
    """Return the twelve numbers of an old inertial port, in the frame of the head.

    Roll, pitch and yaw in degrees (turned in the order yaw, pitch, roll), acceleration in m/s²
    (gravity only: it is +9.81 along z at rest), angular velocity in deg/s, magnetic field in uT.
    """
    _, roll, yaw = positions_deg[:3]
    pitch_rate, roll_rate, yaw_rate = velocities_deg_s[:3]
    head = head_rotation(positions_deg)
    # Each joint turns about its own axis, which the joints after it carry along.
    without_yaw = roll_rate * _X - pitch_rate * (about_x(roll).T @ _Y)
    turning = yaw_rate * _Z + about_z(yaw).T @ without_yaw
    return [
        math.degrees(math.atan2(head[2, 1], head[2, 2])),
        math.degrees(math.asin(-np.clip(head[2, 0], -1.0, 1.0))),
        math.degrees(math.atan2(head[1, 0], head[0, 0])),
        *map(float, head.T @ (GRAVITY_M_S2 * _Z)),
        *map(float, turning),
        *map(float, head.T @ MAGNETIC_FIELD_UT),
    ]
