"""The message types of the fleet: typed values with a versioned schema, units in the names."""

from vertebra.messages.array import Array, item_bytes
from vertebra.messages.general import Bottle, Foreign, Native, Status, Tensor, Text
from vertebra.messages.media import PIXELS, AudioChunk, CompressedImage, Image, PixelFormat
from vertebra.messages.message import Header, Message
from vertebra.messages.motion import (
    Imu,
    JointCommand,
    JointState,
    LaserScan,
    Odometry,
    PointCloud,
    Pose,
    Quaternion,
    Twist,
    Vector3,
)
from vertebra.messages.perception import (
    Box,
    Expression,
    Expressions,
    Face,
    Faces,
    HeadPose,
    HeadPoses,
)

MESSAGES: tuple[type[Message], ...] = (
    AudioChunk,
    Bottle,
    CompressedImage,
    Expressions,
    Faces,
    HeadPoses,
    Image,
    Imu,
    JointCommand,
    JointState,
    LaserScan,
    Native,
    Odometry,
    PointCloud,
    Pose,
    Status,
    Tensor,
    Text,
    Twist,
)
"""Every message type that all services know."""

__all__ = [
    "MESSAGES",
    "PIXELS",
    "Array",
    "AudioChunk",
    "Bottle",
    "Box",
    "CompressedImage",
    "Expression",
    "Expressions",
    "Face",
    "Faces",
    "Foreign",
    "HeadPose",
    "HeadPoses",
    "Header",
    "Image",
    "Imu",
    "JointCommand",
    "JointState",
    "LaserScan",
    "Message",
    "Native",
    "Odometry",
    "PixelFormat",
    "PointCloud",
    "Pose",
    "Quaternion",
    "Status",
    "Tensor",
    "Text",
    "Twist",
    "Vector3",
    "item_bytes",
]
