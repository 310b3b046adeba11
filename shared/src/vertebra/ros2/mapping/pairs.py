"""Which ROS type is which message."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

from vertebra.errors import DecodeError, EncodeError
from vertebra.messages import (
    AudioChunk,
    CompressedImage,
    Image,
    Imu,
    JointState,
    LaserScan,
    Message,
    Native,
    Odometry,
    PointCloud,
    Pose,
    Text,
    Twist,
)
from vertebra.ros2.mapping import media, motion, ranges
from vertebra.ros2.mapping.parts import Record

_SOUNDS: Final = {"audio_common_msgs/msg/AudioDataStamped", "audio_common_msgs/msg/AudioData"}


class _Pair(NamedTuple):
    message: type[Message]
    to_message: Callable[[Record], Message | None]
    to_record: Callable[[Any, int], Record]


def _no_message(_: Record) -> None:
    return None


_PAIRS: Final[dict[str, _Pair]] = {
    "std_msgs/msg/String": _Pair(Text, media.text, media.of_text),
    "sensor_msgs/msg/Image": _Pair(Image, media.image, media.of_image),
    "sensor_msgs/msg/CompressedImage": _Pair(
        CompressedImage, media.compressed, media.of_compressed
    ),
    "sensor_msgs/msg/JointState": _Pair(JointState, motion.joints, motion.of_joints),
    "sensor_msgs/msg/Imu": _Pair(Imu, motion.imu, motion.of_imu),
    "geometry_msgs/msg/PoseStamped": _Pair(Pose, motion.pose_stamped, motion.of_pose_stamped),
    "geometry_msgs/msg/Pose": _Pair(Pose, motion.pose, motion.of_pose),
    "geometry_msgs/msg/PoseWithCovariance": _Pair(
        Pose, motion.pose_with_covariance, motion.of_pose_with_covariance
    ),
    "geometry_msgs/msg/PoseWithCovarianceStamped": _Pair(
        Pose, motion.pose_with_covariance_stamped, motion.of_pose_with_covariance_stamped
    ),
    "geometry_msgs/msg/Twist": _Pair(Twist, motion.twist, motion.of_twist),
    "geometry_msgs/msg/TwistStamped": _Pair(Twist, motion.twist_stamped, motion.of_twist_stamped),
    "geometry_msgs/msg/TwistWithCovariance": _Pair(
        Twist, motion.twist_with_covariance, motion.of_twist_with_covariance
    ),
    "geometry_msgs/msg/TwistWithCovarianceStamped": _Pair(
        Twist, motion.twist_with_covariance_stamped, motion.of_twist_with_covariance_stamped
    ),
    "nav_msgs/msg/Odometry": _Pair(Odometry, motion.odometry, motion.of_odometry),
    "sensor_msgs/msg/LaserScan": _Pair(LaserScan, ranges.scan, ranges.of_scan),
    "sensor_msgs/msg/PointCloud2": _Pair(PointCloud, ranges.cloud, ranges.of_cloud),
    "audio_common_msgs/msg/AudioDataStamped": _Pair(
        AudioChunk, _no_message, media.of_audio_data_stamped
    ),
    "audio_common_msgs/msg/AudioData": _Pair(AudioChunk, _no_message, media.of_audio_data),
    "audio_common_msgs/msg/AudioInfo": _Pair(AudioChunk, _no_message, media.of_audio_info),
    "audio_common_msgs/msg/AudioStamped": _Pair(
        AudioChunk, media.audio_stamped, media.of_audio_stamped
    ),
    "audio_common_msgs/msg/Audio": _Pair(AudioChunk, media.audio, media.of_audio),
}
"""The first type of a message is the one it goes out as."""


def to_message(record: Record, type_name: str, sound: media.Sound | None = None) -> Message:
    """Return the message that a record means, a `Native` if it has none of its own.

    `sound` says what the bytes of an `AudioData` are; without it nobody knows.

    Raises:
        DecodeError: Its values contradict each other.
    """
    pair = _PAIRS.get(type_name)
    if pair is None:
        return Native(value=record)
    try:
        if type_name in _SOUNDS:
            return media.audio_data(record, sound) or Native(value=record)
        return pair.to_message(record) or Native(value=record)
    except (DecodeError, ValueError) as error:
        raise DecodeError(f"{type_name}: {error}") from error


def to_record(message: Message, type_name: str, stamp_ns: int) -> Record:
    """Return the record of a message; raise `EncodeError` if it is not what the type means."""
    if isinstance(message, Native) and isinstance(message.value, Mapping):
        return message.value
    pair = _PAIRS.get(type_name)
    if pair is None or not isinstance(message, pair.message):
        wanted = "a Native with its fields" if pair is None else f"{pair.message.__name__} or that"
        raise EncodeError(f"{type_name} is made of {wanted}, not of {type(message).__name__}")
    return pair.to_record(message, stamp_ns)


def type_of(message_type: type[Message]) -> str | None:
    """Return the ROS type that a message goes out as, unless a route says another one."""
    return next((name for name, pair in _PAIRS.items() if pair.message is message_type), None)
