"""Bodies and how they move."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

from vertebra.messages import Array, Imu, JointState, Odometry, Pose, Twist
from vertebra.ros2.mapping.parts import (
    Record,
    covariance,
    frame_id,
    header,
    of_quaternion,
    of_vector,
    quaternion,
    vector,
)

_DEG2_PER_RAD2: Final = math.degrees(1.0) ** 2
_NOT_MEASURED: Final = (-1.0, *([0.0] * 8))


def _degrees(values: Array) -> tuple[float, ...]:
    return tuple(map(math.degrees, values.tolist()))


def joints(record: Record) -> JointState | None:
    """Read a `JointState` that has positions."""
    if record["name"] and not record["position"].nbytes:
        return None
    return JointState(
        names=tuple(record["name"]),
        positions_deg=_degrees(record["position"]),
        velocities_deg_s=_degrees(record["velocity"]),
        efforts_nm=tuple(record["effort"].tolist()),
        frame_id=frame_id(record),
    )


def of_joints(message: JointState, stamp_ns: int) -> Record:
    """Make a `JointState`."""
    sliding = [kind == "prismatic" for kind in message.kinds] or [False] * len(message.names)

    def si(values: Sequence[float]) -> list[float]:
        pairs = zip(values, sliding, strict=True) if values else ()
        return [value if slides else math.radians(value) for value, slides in pairs]

    return {
        "header": header(message.frame_id, stamp_ns),
        "name": list(message.names),
        "position": si(message.positions_deg),
        "velocity": si(message.velocities_deg_s),
        "effort": list(message.efforts_nm),
    }


def imu(record: Record) -> Imu:
    """Read an `Imu`; -1 in a covariance says that a part is not measured."""
    fields: dict[str, Any] = {}
    if _measured(record, "orientation"):
        fields["orientation_xyzw"] = quaternion(record["orientation"])
        fields["orientation_covariance_rad2"] = covariance(record["orientation_covariance"])
    if _measured(record, "angular_velocity"):
        x, y, z = map(math.degrees, vector(record["angular_velocity"]))
        fields["angular_velocity_deg_s"] = (x, y, z)
        fields["angular_velocity_covariance_deg2_s2"] = covariance(
            record["angular_velocity_covariance"], _DEG2_PER_RAD2
        )
    if _measured(record, "linear_acceleration"):
        fields["linear_acceleration_m_s2"] = vector(record["linear_acceleration"])
        fields["linear_acceleration_covariance_m2_s4"] = covariance(
            record["linear_acceleration_covariance"]
        )
    return Imu(frame_id=frame_id(record), **fields)


def _measured(record: Record, part: str) -> bool:
    return bool(record[f"{part}_covariance"].tolist()[0] != -1)


def of_imu(message: Imu, stamp_ns: int) -> Record:
    """Make an `Imu`; what the message does not know is said to be not measured."""
    record: dict[str, Any] = {
        "header": header(message.frame_id, stamp_ns),
        "orientation": of_quaternion((0.0, 0.0, 0.0, 1.0)),
        "orientation_covariance": _NOT_MEASURED,
        "angular_velocity_covariance": _NOT_MEASURED,
        "linear_acceleration_covariance": _NOT_MEASURED,
    }
    angular, linear = message.angular_velocity_deg_s, message.linear_acceleration_m_s2
    if message.orientation_xyzw is not None:
        record["orientation"] = of_quaternion(message.orientation_xyzw)
        record["orientation_covariance"] = message.orientation_covariance_rad2
    if angular is not None:
        x, y, z = map(math.radians, angular)
        record["angular_velocity"] = of_vector((x, y, z))
        record["angular_velocity_covariance"] = [
            value / _DEG2_PER_RAD2 for value in message.angular_velocity_covariance_deg2_s2
        ]
    if linear is not None:
        record["linear_acceleration"] = of_vector(linear)
        record["linear_acceleration_covariance"] = message.linear_acceleration_covariance_m2_s4
    return record


def pose(record: Record, frame: str = "", known: tuple[float, ...] = ()) -> Pose:
    """Read a `Pose`."""
    return Pose(
        position_m=vector(record["position"]),
        orientation_xyzw=quaternion(record["orientation"]),
        frame_id=frame,
        covariance_m_rad=known,
    )


def of_pose(message: Pose, _: int = 0) -> Record:
    """Make a `Pose`."""
    return {
        "position": of_vector(message.position_m),
        "orientation": of_quaternion(message.orientation_xyzw),
    }


def pose_stamped(record: Record) -> Pose:
    """Read a `PoseStamped`."""
    return pose(record["pose"], frame_id(record))


def of_pose_stamped(message: Pose, stamp_ns: int) -> Record:
    """Make a `PoseStamped`."""
    return {"header": header(message.frame_id, stamp_ns), "pose": of_pose(message)}


def pose_with_covariance(record: Record, frame: str = "") -> Pose:
    """Read a `PoseWithCovariance`."""
    return pose(record["pose"], frame, covariance(record["covariance"]))


def of_pose_with_covariance(message: Pose, _: int = 0) -> Record:
    """Make a `PoseWithCovariance`."""
    return {"pose": of_pose(message), "covariance": message.covariance_m_rad}


def pose_with_covariance_stamped(record: Record) -> Pose:
    """Read a `PoseWithCovarianceStamped`."""
    return pose_with_covariance(record["pose"], frame_id(record))


def of_pose_with_covariance_stamped(message: Pose, stamp_ns: int) -> Record:
    """Make a `PoseWithCovarianceStamped`."""
    return {
        "header": header(message.frame_id, stamp_ns),
        "pose": of_pose_with_covariance(message),
    }


def twist(record: Record, frame: str = "", known: tuple[float, ...] = ()) -> Twist:
    """Read a `Twist`."""
    return Twist(
        linear_m_s=vector(record["linear"]),
        angular_rad_s=vector(record["angular"]),
        frame_id=frame,
        covariance_m_s_rad_s=known,
    )


def of_twist(message: Twist, _: int = 0) -> Record:
    """Make a `Twist`."""
    return {
        "linear": of_vector(message.linear_m_s),
        "angular": of_vector(message.angular_rad_s),
    }


def twist_stamped(record: Record) -> Twist:
    """Read a `TwistStamped`."""
    return twist(record["twist"], frame_id(record))


def of_twist_stamped(message: Twist, stamp_ns: int) -> Record:
    """Make a `TwistStamped`."""
    return {"header": header(message.frame_id, stamp_ns), "twist": of_twist(message)}


def twist_with_covariance(record: Record, frame: str = "") -> Twist:
    """Read a `TwistWithCovariance`."""
    return twist(record["twist"], frame, covariance(record["covariance"]))


def of_twist_with_covariance(message: Twist, _: int = 0) -> Record:
    """Make a `TwistWithCovariance`."""
    return {"twist": of_twist(message), "covariance": message.covariance_m_s_rad_s}


def twist_with_covariance_stamped(record: Record) -> Twist:
    """Read a `TwistWithCovarianceStamped`."""
    return twist_with_covariance(record["twist"], frame_id(record))


def of_twist_with_covariance_stamped(message: Twist, stamp_ns: int) -> Record:
    """Make a `TwistWithCovarianceStamped`."""
    return {
        "header": header(message.frame_id, stamp_ns),
        "twist": of_twist_with_covariance(message),
    }


def odometry(record: Record) -> Odometry:
    """Read an `Odometry`."""
    child = record["child_frame_id"]
    return Odometry(
        pose=pose_with_covariance(record["pose"], frame_id(record)),
        twist=twist_with_covariance(record["twist"], child),
        child_frame_id=child,
    )


def of_odometry(message: Odometry, stamp_ns: int) -> Record:
    """Make an `Odometry`."""
    return {
        "header": header(message.pose.frame_id, stamp_ns),
        "child_frame_id": message.child_frame_id,
        "pose": of_pose_with_covariance(message.pose),
        "twist": of_twist_with_covariance(message.twist),
    }
