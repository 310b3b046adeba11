"""Joints, inertial measurements, poses and velocities.

YARP counts angles in degrees. What a device does not measure is NaN in an inertial vector.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Sequence
from typing import Final

from vertebra.errors import DecodeError, EncodeError
from vertebra.messages import Imu, JointState, Message, Odometry, Pose, Twist
from vertebra.yarp.objects import Matrix, Measurement, OdometryData, SensorData, Vector

_IMU_VALUES: Final = 12
_TWIST_VALUES: Final = 6
_NAN3: Final = (math.nan, math.nan, math.nan)
_UNIT_WITHIN: Final = 1e-6
_FLAT_WITHIN: Final = 1e-9
_UPRIGHT_SINE: Final = 1 - 1e-12
_Triple = tuple[float, float, float]
_Quaternion = tuple[float, float, float, float]


def joint_state(values: Sequence[float], names: Sequence[str]) -> Message:
    """Return positions in degrees as the state of these joints."""
    if len(values) != len(names):
        raise DecodeError(f"{len(values)} positions for the {len(names)} joints of this part")
    return JointState(names=tuple(names), positions_deg=tuple(values))


def from_joint_state(message: JointState) -> Vector:
    """Return the positions; who reads them knows the joints by their order."""
    if message.velocities_deg_s or message.efforts_nm:
        raise EncodeError(
            "a YARP vector of joint positions has no velocities and efforts; leave them out"
        )
    return Vector.of(message.positions_deg)


# --- inertial measurements -------------------------------------------------------------------


def imu(values: Sequence[float]) -> Message:
    """Read the 12 numbers of an `inertial` port (rpy, acceleration, gyro, magnetometer)."""
    if len(values) != _IMU_VALUES:
        raise DecodeError(f"an inertial port streams {_IMU_VALUES} numbers, not {len(values)}")
    rpy = _measured(values[:3])
    return Imu(
        orientation_xyzw=None if rpy is None else _quaternion(rpy),
        linear_acceleration_m_s2=_measured(values[3:6]),
        angular_velocity_deg_s=_measured(values[6:9]),
        magnetic_field_ut=_measured(values[9:12]),
    )


def imu_of_sensors(data: SensorData) -> Message:
    """Return the first sensor of each kind that an `Imu` has (magnetometers give tesla).

    A `Native` has all of them.
    """
    rpy = _first(data.orientations)
    acceleration = _first(data.linear_accelerometers)
    velocity = _first(data.gyroscopes)
    tesla = _first(data.magnetometers)
    if not (rpy or acceleration or velocity or tesla):
        raise DecodeError("none of these analog sensors is an IMU")
    return Imu(
        orientation_xyzw=rpy and _quaternion(rpy),
        linear_acceleration_m_s2=acceleration,
        angular_velocity_deg_s=velocity,
        magnetic_field_ut=tesla and (1e6 * tesla[0], 1e6 * tesla[1], 1e6 * tesla[2]),
    )


def from_imu(message: Imu) -> Vector:
    """Return the 12 numbers of an `inertial` port."""
    rotation = message.orientation_xyzw
    return Vector.of(
        [
            *(_NAN3 if rotation is None else _roll_pitch_yaw(_unit(rotation))),
            *(message.linear_acceleration_m_s2 or _NAN3),
            *(message.angular_velocity_deg_s or _NAN3),
            *(message.magnetic_field_ut or _NAN3),
        ]
    )


def _measured(values: Sequence[float]) -> _Triple | None:
    x, y, z = values
    return None if all(map(math.isnan, values)) else (x, y, z)


def _first(sensors: Sequence[Measurement]) -> _Triple | None:
    if not sensors:
        return None
    if len(sensors[0].values) != 3:
        raise DecodeError(f"an inertial sensor gives 3 numbers, not {len(sensors[0].values)}")
    return _measured(sensors[0].values)


def _quaternion(roll_pitch_yaw_deg: _Triple) -> _Quaternion:
    roll, pitch, yaw = (math.radians(angle) / 2 for angle in roll_pitch_yaw_deg)
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def _roll_pitch_yaw(xyzw: _Quaternion) -> Iterable[float]:
    x, y, z, w = xyzw
    pitch_sine = max(-1.0, min(1.0, 2 * (w * y - z * x)))
    if abs(pitch_sine) > _UPRIGHT_SINE:  # roll and yaw turn about one axis: all of it is yaw
        turn = math.remainder(2 * math.atan2(x, w), math.tau)
        return (
            0.0,
            math.copysign(90.0, pitch_sine),
            -math.copysign(1.0, pitch_sine) * math.degrees(turn),
        )
    angles = (
        math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        math.asin(pitch_sine),
        math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    )
    return map(math.degrees, angles)


def _unit(xyzw: _Quaternion) -> _Quaternion:
    if abs(math.hypot(*xyzw) - 1.0) > _UNIT_WITHIN:
        raise EncodeError(f"{xyzw} is no rotation: the quaternion has length {math.hypot(*xyzw):g}")
    return xyzw


# --- poses and velocities --------------------------------------------------------------------


def pose(matrix: Matrix) -> Message:
    """Return the pose in a 4 x 4 matrix: the rotation, and the position in the last column."""
    if (matrix.rows, matrix.columns) != (4, 4) or [*matrix.values[12:]] != [0.0, 0.0, 0.0, 1.0]:
        raise DecodeError(
            f"a pose is a 4 x 4 matrix with the last row 0 0 0 1, not one of {matrix.rows} x "
            f"{matrix.columns} with {[*matrix.values[-matrix.columns :]]}"
        )
    m = matrix.values
    xyzw = _of_rotation([m[0:3], m[4:7], m[8:11]])
    return Pose(position_m=(m[3], m[7], m[11]), orientation_xyzw=xyzw)


def from_pose(message: Pose) -> Matrix:
    """Return a pose as a 4 x 4 matrix."""
    x, y, z, w = _unit(message.orientation_xyzw)
    px, py, pz = message.position_m
    values = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), px,
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), py,
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), pz,
        0.0, 0.0, 0.0, 1.0,
    ]  # fmt: skip
    return Matrix(4, 4, array("d", values))


def _of_rotation(r: Sequence[Sequence[float]]) -> _Quaternion:
    """Return the quaternion of a rotation matrix, whose largest part is positive."""
    # Four times the square of each part; dividing by the largest one keeps all digits.
    squares = (
        1 + r[0][0] - r[1][1] - r[2][2],
        1 - r[0][0] + r[1][1] - r[2][2],
        1 - r[0][0] - r[1][1] + r[2][2],
        1 + r[0][0] + r[1][1] + r[2][2],
    )
    largest = max(range(4), key=squares.__getitem__)
    xw, yw, zw = r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1]
    xy, xz, yz = r[0][1] + r[1][0], r[0][2] + r[2][0], r[1][2] + r[2][1]
    if not _is_rotation(r):
        raise DecodeError(f"these rows are no rotation: {[[*row] for row in r]}")
    products = (
        (squares[0], xy, xz, xw),
        (xy, squares[1], yz, yw),
        (xz, yz, squares[2], zw),
        (xw, yw, zw, squares[3]),
    )[largest]
    length = math.hypot(*products)
    x, y, z, w = (product / length for product in products)
    return (x, y, z, w)


def _is_rotation(r: Sequence[Sequence[float]]) -> bool:
    def dot(a: Sequence[float], b: Sequence[float]) -> float:
        return sum(x * y for x, y in zip(a, b, strict=True))

    unit = all(abs(dot(row, row) - 1) < _UNIT_WITHIN for row in r)
    upright = all(abs(dot(r[a], r[b])) < _UNIT_WITHIN for a, b in ((0, 1), (0, 2), (1, 2)))
    cross = (
        r[0][1] * r[1][2] - r[0][2] * r[1][1],
        r[0][2] * r[1][0] - r[0][0] * r[1][2],
        r[0][0] * r[1][1] - r[0][1] * r[1][0],
    )
    return unit and upright and dot(cross, r[2]) > 0


def twist(values: Sequence[float]) -> Message:
    """Return six numbers as a velocity: m/s along x y z, then deg/s about x y z."""
    if len(values) != _TWIST_VALUES:
        raise DecodeError(f"a velocity is {_TWIST_VALUES} numbers, not {len(values)}")
    x, y, z = values[:3]
    wx, wy, wz = map(math.radians, values[3:])
    return Twist(linear_m_s=(x, y, z), angular_rad_s=(wx, wy, wz))


def from_twist(message: Twist) -> Vector:
    """Return a velocity as six numbers."""
    return Vector.of([*message.linear_m_s, *map(math.degrees, message.angular_rad_s)])


def odometry(data: OdometryData) -> Message:
    """Return where a base is on the floor and how it moves; `odom_vel` repeats that, turned."""
    half = math.radians(data.odom_theta) / 2
    return Odometry(
        pose=Pose(
            position_m=(data.odom_x, data.odom_y, 0.0),
            orientation_xyzw=(0.0, 0.0, math.sin(half), math.cos(half)),
        ),
        twist=Twist(
            linear_m_s=(data.base_vel_x, data.base_vel_y, 0.0),
            angular_rad_s=(0.0, 0.0, math.radians(data.base_vel_theta)),
        ),
    )


def from_odometry(message: Odometry) -> OdometryData:
    """Return what YARP knows of a base: x, y and the turn about z."""
    x, y, height = message.pose.position_m
    roll, pitch, yaw = _roll_pitch_yaw(_unit(message.pose.orientation_xyzw))
    forward, left, up = message.twist.linear_m_s
    *tilting, turning = message.twist.angular_rad_s
    if max(map(abs, (height, roll, pitch, up, *tilting))) > _FLAT_WITHIN:
        raise EncodeError("YARP's odometry is flat; this one leaves the floor: send its pose")
    if message.child_frame_id:
        raise EncodeError(f"YARP's odometry has no child_frame_id ({message.child_frame_id!r})")
    cosine, sine = math.cos(math.radians(yaw)), math.sin(math.radians(yaw))
    turning_deg = math.degrees(turning)
    return OdometryData(
        odom_x=x,
        odom_y=y,
        odom_theta=yaw,
        base_vel_x=forward,
        base_vel_y=left,
        base_vel_theta=turning_deg,
        odom_vel_x=cosine * forward - sine * left,
        odom_vel_y=sine * forward + cosine * left,
        odom_vel_theta=turning_deg,
    )
