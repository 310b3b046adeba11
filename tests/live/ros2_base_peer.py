"""A ROS node beside the base: it sees and drives it in plain `cyclonedds`, with types of its own.

It has no `from __future__ import annotations`: the library reads the annotations of its types.
`python ros2_base_peer.py watch|drive` prints JSON lines, first "ready", and ends with its input.
"""

import json
import os
import sys
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float32, float64, int32, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

if TYPE_CHECKING:
    sequence = Sequence
    Covariance = Sequence[float]
else:
    from cyclonedds.idl.types import array, sequence

    Covariance = array[float64, 36]


@dataclass
class Time(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
    stamp: Time
    frame_id: str


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs.msg.dds_.Vector3_"):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
class Point(IdlStruct, typename="geometry_msgs.msg.dds_.Point_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs.msg.dds_.Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Pose(IdlStruct, typename="geometry_msgs.msg.dds_.Pose_"):
    position: Point
    orientation: Quaternion


@dataclass
class PoseWithCovariance(IdlStruct, typename="geometry_msgs.msg.dds_.PoseWithCovariance_"):
    pose: Pose
    covariance: Covariance


@dataclass
class Twist(IdlStruct, typename="geometry_msgs.msg.dds_.Twist_"):
    linear: Vector3
    angular: Vector3


@dataclass
class TwistStamped(IdlStruct, typename="geometry_msgs.msg.dds_.TwistStamped_"):
    header: Header
    twist: Twist


@dataclass
class TwistWithCovariance(IdlStruct, typename="geometry_msgs.msg.dds_.TwistWithCovariance_"):
    twist: Twist
    covariance: Covariance


@dataclass
class Odometry(IdlStruct, typename="nav_msgs.msg.dds_.Odometry_"):
    header: Header
    child_frame_id: str
    pose: PoseWithCovariance
    twist: TwistWithCovariance


@dataclass
class Transform(IdlStruct, typename="geometry_msgs.msg.dds_.Transform_"):
    translation: Vector3
    rotation: Quaternion


@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs.msg.dds_.TransformStamped_"):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs.msg.dds_.TFMessage_"):
    transforms: sequence[TransformStamped]


@dataclass
class LaserScan(IdlStruct, typename="sensor_msgs.msg.dds_.LaserScan_"):
    header: Header
    angle_min: float32
    angle_max: float32
    angle_increment: float32
    time_increment: float32
    scan_time: float32
    range_min: float32
    range_max: float32
    ranges: sequence[float32]
    intensities: sequence[float32]


@dataclass
class JointState(IdlStruct, typename="sensor_msgs.msg.dds_.JointState_"):
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


def ros_qos(*, reliable: bool = True, depth: int = 10) -> Qos:
    """Return what rclpy asks for: its default, or that of sensor data."""
    return Qos(
        Policy.Reliability.Reliable(max_blocking_time=duration(seconds=1))
        if reliable
        else Policy.Reliability.BestEffort,
        Policy.Durability.Volatile,
        Policy.History.KeepLast(depth),
    )


TOPICS: dict[str, tuple[Any, Qos]] = {
    "odom": (Odometry, ros_qos()),
    "tf": (TFMessage, ros_qos(depth=100)),
    "scan": (LaserScan, ros_qos(reliable=False, depth=5)),
    "joint_states": (JointState, ros_qos()),
    "cmd_vel": (Twist, ros_qos()),
    "stamped": (TwistStamped, ros_qos()),
}


def say(*what: Any) -> None:
    sys.stdout.write(f"{json.dumps(what)}\n")
    sys.stdout.flush()


def told(one: Any) -> Any:
    """Return what a sample says, short."""
    if isinstance(one, Odometry):
        pose, twist = one.pose.pose, one.twist.twist
        frames = [one.header.frame_id, one.child_frame_id]
        return [*frames, pose.position.x, pose.position.y, pose.orientation.w, twist.linear.x]
    if isinstance(one, TFMessage):
        (only,) = one.transforms
        return [only.header.frame_id, only.child_frame_id, only.transform.translation.x]
    if isinstance(one, LaserScan):
        return [one.header.frame_id, len(one.ranges), one.ranges[len(one.ranges) // 2]]
    if isinstance(one, JointState):
        return [list(one.name), list(one.position), list(one.velocity)]
    if isinstance(one, TwistStamped):
        return [one.header.stamp.sec, one.twist.linear.x, one.twist.angular.z]
    return [one.linear.x, one.angular.z]


def watch(participant: Any, done: threading.Event) -> None:
    """Say everything that comes."""
    readers: dict[str, Any] = {
        name: DataReader(participant, Topic(participant, f"rt/{name}", kind), qos=settings)
        for name, (kind, settings) in TOPICS.items()
    }
    say("ready")
    while not done.wait(0.005):
        for name, reader in readers.items():
            for sample in reader.take(100):
                if sample.sample_info.valid_data:
                    say(name, sample.sample_info.source_timestamp / 1e9, told(sample))


def drive(participant: Any, done: threading.Event) -> None:
    """Drive backwards at 10 Hz, as a joystick does."""
    kind, settings = TOPICS["cmd_vel"]
    writer: Any = DataWriter(participant, Topic(participant, "rt/cmd_vel", kind), qos=settings)
    say("ready")
    while not done.wait(0.1):
        writer.write(Twist(Vector3(x=-0.2), Vector3()))


def main() -> None:
    done = threading.Event()

    def follow_input() -> None:
        sys.stdin.read()
        done.set()

    threading.Thread(target=follow_input, daemon=True).start()
    participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
    {"watch": watch, "drive": drive}[sys.argv[1]](participant, done)


if __name__ == "__main__":
    main()
