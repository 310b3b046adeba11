"""What the base tells and is told, as ROS records."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any, Final

from vertebra.messages import Array
from vertebra_simulator.base import Base, Pose, Velocity
from vertebra_simulator.floorplan import BEAMS, LASER_MAX_M, LASER_MIN_M, FloorPlan
from vertebra_simulator.navigator import Outlook

ODOM: Final = "odom"
BASE_LINK: Final = "base_link"
WHEELS: Final = ("wheel_left_joint", "wheel_right_joint")
_OK: Final = 0
_WARN: Final = 1

Record = Mapping[str, Any]


def token_of(robot: str) -> str:
    """Return the name of a robot as ROS can say it."""
    return re.sub(r"^(?=\d)|\W", "_", robot, flags=re.ASCII)


def header(stamp_ns: int, frame_id: str = ODOM) -> Record:
    """Return the header of what is true at a time."""
    return {"stamp": time_of(stamp_ns), "frame_id": frame_id}


def time_of(stamp_ns: int) -> Record:
    """Return a time, or a duration."""
    return {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9}


def pose_of(pose: Pose) -> Record:
    """Return a pose on the floor."""
    return {
        "position": {"x": pose.x_m, "y": pose.y_m},
        "orientation": {"z": math.sin(pose.heading_rad / 2), "w": math.cos(pose.heading_rad / 2)},
    }


def read_pose(record: Record) -> Pose:
    """Return the pose in a `geometry_msgs/msg/Pose`; what it says of heights is left out."""
    position, turn = record["position"], record["orientation"]
    x, y, z, w = (turn[axis] for axis in "xyzw")
    heading = math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
    return Pose(position["x"], position["y"], heading)


def read_velocity(record: Record) -> Velocity:
    """Return what a `geometry_msgs/msg/Twist` asks of a base that cannot drive sideways."""
    return Velocity(record["linear"]["x"], record["angular"]["z"])


def odometry(base: Base, stamp_ns: int) -> Record:
    """Return `nav_msgs/msg/Odometry`."""
    linear, angular = base.velocity
    return {
        "header": header(stamp_ns),
        "child_frame_id": BASE_LINK,
        "pose": {"pose": pose_of(base.pose)},
        "twist": {"twist": {"linear": {"x": linear}, "angular": {"z": angular}}},
    }


def transform(base: Base, stamp_ns: int) -> Record:
    """Return `tf2_msgs/msg/TFMessage`: where the base is, seen from where it started."""
    pose = pose_of(base.pose)
    moved = {"translation": pose["position"], "rotation": pose["orientation"]}
    return {
        "transforms": [
            {"header": header(stamp_ns), "child_frame_id": BASE_LINK, "transform": moved}
        ]
    }


def joints(base: Base, stamp_ns: int) -> Record:
    """Return `sensor_msgs/msg/JointState`."""
    return {
        "header": header(stamp_ns, ""),
        "name": WHEELS,
        "position": base.wheels_rad,
        "velocity": base.wheel_speeds_rad_s,
    }


def scan(base: Base, plan: FloorPlan, rate_hz: float, stamp_ns: int) -> Record:
    """Return `sensor_msgs/msg/LaserScan`; all beams are of the same moment."""
    return {
        "header": header(stamp_ns, BASE_LINK),
        "angle_min": -math.pi,
        "angle_max": math.pi - 2 * math.pi / BEAMS,
        "angle_increment": 2 * math.pi / BEAMS,
        "scan_time": 1 / rate_hz,
        "range_min": LASER_MIN_M,
        "range_max": LASER_MAX_M,
        "ranges": Array.of(plan.scan(base.pose.place, base.pose.heading_rad).data),
    }


def progress(base: Base, outlook: Outlook, driven_s: float, stamp_ns: int) -> Record:
    """Return the feedback of `nav2_msgs/action/NavigateToPose`."""
    return {
        "current_pose": {"header": header(stamp_ns), "pose": pose_of(base.pose)},
        "navigation_time": time_of(round(driven_s * 1e9)),
        "estimated_time_remaining": time_of(round(outlook.remaining_s * 1e9)),
        "distance_remaining": outlook.distance_m,
    }


def diagnostics(base: Base, robot: str, doing: str, stamp_ns: int) -> Record:
    """Return `diagnostic_msgs/msg/DiagnosticArray`; `doing` is what the navigation does."""
    linear, angular = base.velocity
    values = {
        "linear_m_s": f"{linear:.3f}",
        "angular_rad_s": f"{angular:.3f}",
        "navigation": doing,
    }
    status = {
        "level": _WARN if base.stuck else _OK,
        "name": f"{robot}_base: drive",
        "message": f"{base.stuck} is in the way" if base.stuck else "works",
        "hardware_id": f"simulated {robot}",
        "values": [{"key": key, "value": value} for key, value in values.items()],
    }
    return {"header": header(stamp_ns, ""), "status": [status]}
