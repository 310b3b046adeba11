"""A ROS node beside the base: it sees and drives it in plain `cyclonedds`, with types of its own.

`python -m tests.live.ros2_base_peer watch|drive` is as `ros2_peer`.
"""

import sys
from typing import Any

from cyclonedds.core import Qos

from .ros2_peer import Peer, qos, say
from .ros2_types import JointState, LaserScan, Odometry, Transforms, Twist, TwistStamped, Vector3

TOPICS: dict[str, tuple[Any, Qos]] = {
    "odom": (Odometry, qos()),
    "tf": (Transforms, qos(depth=100)),
    "scan": (LaserScan, qos(reliable=False, depth=5)),
    "joint_states": (JointState, qos()),
    "cmd_vel": (Twist, qos()),
    "stamped": (TwistStamped, qos()),
}


def told(one: Any) -> Any:
    """Return what a sample says, short."""
    if isinstance(one, Odometry):
        pose, twist = one.pose.pose, one.twist.twist
        frames = [one.header.frame_id, one.child_frame_id]
        return [*frames, pose.position.x, pose.position.y, pose.orientation.w, twist.linear.x]
    if isinstance(one, Transforms):
        (only,) = one.transforms
        return [only.header.frame_id, only.child_frame_id, only.transform.translation.x]
    if isinstance(one, LaserScan):
        return [one.header.frame_id, len(one.ranges), one.ranges[len(one.ranges) // 2]]
    if isinstance(one, JointState):
        return [list(one.name), list(one.position), list(one.velocity)]
    if isinstance(one, TwistStamped):
        return [one.header.stamp.sec, one.twist.linear.x, one.twist.angular.z]
    return [one.linear.x, one.angular.z]


def watch(peer: Peer) -> None:
    """Say everything that comes."""
    readers = {
        name: peer.read(f"rt/{name}", kind, settings) for name, (kind, settings) in TOPICS.items()
    }
    say("ready")
    while not peer.done.wait(0.005):
        for name, reader in readers.items():
            for sample in peer.take(reader):
                say(name, sample.sample_info.source_timestamp / 1e9, told(sample))


def drive(peer: Peer) -> None:
    """Drive backwards at 10 Hz, as a joystick does."""
    writer = peer.write("rt/cmd_vel", *TOPICS["cmd_vel"])
    say("ready")
    while not peer.done.wait(0.1):
        writer.write(Twist(Vector3(x=-0.2), Vector3()))


if __name__ == "__main__":
    {"watch": watch, "drive": drive}[sys.argv[1]](Peer("base"))
