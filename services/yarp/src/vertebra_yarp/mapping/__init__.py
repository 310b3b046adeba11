"""What YARP's bytes mean on the backbone, and back; no I/O.

| message         | YARP object                                                    |
|-----------------|----------------------------------------------------------------|
| Image           | Image; other pixels are a Native of `pixel_code` and `pixels`  |
| AudioChunk      | Sound of 16 bits                                               |
| Tensor          | Vector, VectorOf, Matrix                                       |
| JointState      | Vector of positions                                            |
| Imu             | Vector of 12; also read from SensorStreamingData               |
| Pose, Twist     | Matrix 4 x 4, Vector of 6                                      |
| Odometry        | OdometryData                                                   |
| LaserScan       | LaserScan2D                                                    |
| PointCloud      | PointCloud of XYZ or XYZRGBA                                   |
| Text, Bottle    | Bottle                                                         |
| Native          | Property; also SensorStreamingData and jointData, by fields    |
| any other       | Property of its fields                                         |

Units are converted (YARP has degrees and metres). What one side cannot hold is refused with its
reason: DecodeError on the way in, EncodeError on the way out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Final

from msgspec.structs import replace

from vertebra.errors import DecodeError, EncodeError
from vertebra.messages import (
    Array,
    AudioChunk,
    Bottle,
    Image,
    Imu,
    JointState,
    LaserScan,
    Message,
    Native,
    Odometry,
    PointCloud,
    Pose,
    Tensor,
    Text,
    Twist,
)
from vertebra.yarp import Dialect, Payload, Value, decode, objects
from vertebra.yarp.protocol.bottle import Buffer
from vertebra_yarp.mapping import bottles, media, motion, sensing
from vertebra_yarp.mapping.bottles import plain_of, values_of
from vertebra_yarp.mapping.media import PIXEL_FORMATS
from vertebra_yarp.routes import StreamType

__all__ = [
    "PIXEL_FORMATS",
    "captured_ns",
    "plain_of",
    "to_message",
    "to_payload",
    "values_of",
]

CLOCKS_AGREE_WITHIN_NS: Final = 3600 * 10**9


def captured_ns(envelope: str, received_ns: int) -> int:
    """Return when a message was true: its Stamp, unless that is from another clock.

    A stamp more than an hour away from our clock (a simulation's, or one that counts from the
    start of the robot) says nothing here; then the time of arrival is all we know.
    """
    if not envelope:
        return received_ns
    try:
        stamp = objects.Stamp.from_envelope(envelope)
    except DecodeError:
        return received_ns  # other programs put other texts into envelopes
    if not math.isfinite(stamp.time_s):
        return received_ns
    stamped_ns = round(stamp.time_s * 1e6) * 1000  # a stamp resolves 10 us
    return stamped_ns if abs(stamped_ns - received_ns) < CLOCKS_AGREE_WITHIN_NS else received_ns


# --- from YARP -------------------------------------------------------------------------------


def to_message(
    payload: Buffer,
    wanted: StreamType,
    *,
    names: Sequence[str] = (),
    frame_id: str = "",
    dialect: Dialect = Dialect.V3,
) -> Message:
    """Return the message in a YARP payload.

    Args:
        payload: One YARP object.
        wanted: What the route says that it is.
        names: Those of the joints of a `JointState`.
        frame_id: The coordinate frame of the route; YARP objects do not name any.
        dialect: How the payload is written.

    Raises:
        DecodeError: The payload is damaged, is not what the route says, or has no message.
    """
    if wanted == "JointState":
        values = objects.Vector.decode(payload, dialect).values
        return motion.joint_state(values, names)
    return _in_frame(_READERS[wanted](payload, dialect), frame_id)


_Reader = Callable[[Buffer, Dialect], Message]


def _of_bottle(make: Callable[[list[Value]], Message]) -> _Reader:
    return lambda payload, dialect: make(decode(payload, dialect))


def _any(payload: Buffer, dialect: Dialect) -> Message:
    """Return the message of a payload that tells by its bytes what it is."""
    kind = objects.kind_of(payload, dialect)
    if kind in _BY_KIND:
        try:
            return _BY_KIND[kind](payload, dialect)
        except DecodeError:
            pass  # sound, but without a message: what it is made of has one
    try:
        values = decode(payload, dialect)
    except DecodeError:
        view = memoryview(payload)
        return Tensor(array=Array(view, "|u1", (view.nbytes,)))
    return bottles.fields(values) if bottles.is_fields(values) else bottles.bottle(values)


def _image(payload: Buffer, dialect: Dialect) -> Message:
    return media.image(objects.Image.decode(payload, dialect))


def _sound(payload: Buffer, dialect: Dialect) -> Message:
    return media.sound(objects.Sound.decode(payload, dialect))


def _vector(payload: Buffer, dialect: Dialect) -> Message:
    return sensing.tensor(objects.Vector.decode(payload, dialect))


def _tensor(payload: Buffer, dialect: Dialect) -> Message:
    if objects.is_vector(payload, dialect):
        return sensing.tensor(objects.VectorOf.decode(payload, dialect))
    return sensing.tensor(objects.Matrix.decode(payload, dialect))


def _imu(payload: Buffer, dialect: Dialect) -> Message:
    if objects.is_vector(payload, dialect):
        return motion.imu(objects.Vector.decode(payload, dialect).values)
    return motion.imu_of_sensors(objects.SensorData.decode(payload, dialect))


def _cloud(payload: Buffer, dialect: Dialect) -> Message:
    return sensing.point_cloud(objects.PointCloud.decode(payload, dialect))


def _sensors(payload: Buffer, dialect: Dialect) -> Message:
    return sensing.sensors(objects.SensorData.decode(payload, dialect))


def _joints(payload: Buffer, dialect: Dialect) -> Message:
    return sensing.joints(objects.JointData.decode(payload, dialect))


_BY_KIND: Final[dict[objects.Kind, _Reader]] = {
    "image": _image,
    "joint_data": _joints,
    "point_cloud": _cloud,
    "sensor_data": _sensors,
    "sound": _sound,
    "vector": _vector,
}


def _native(payload: Buffer, dialect: Dialect) -> Message:
    read = _BY_KIND.get(objects.kind_of(payload, dialect))
    message = None if read is None else read(payload, dialect)
    return message if isinstance(message, Native) else bottles.native(decode(payload, dialect))


_READERS: Final[dict[StreamType, _Reader]] = {
    "auto": _any,
    "AudioChunk": _sound,
    "Bottle": _of_bottle(bottles.bottle),
    "Image": _image,
    "Imu": _imu,
    "LaserScan": lambda payload, dialect: sensing.laser_scan(
        objects.LaserScan2D.decode(payload, dialect)
    ),
    "Native": _native,
    "Odometry": lambda payload, dialect: motion.odometry(
        objects.OdometryData.decode(payload, dialect)
    ),
    "PointCloud": _cloud,
    "Pose": lambda payload, dialect: motion.pose(objects.Matrix.decode(payload, dialect)),
    "Tensor": _tensor,
    "Text": _of_bottle(bottles.text),
    "Twist": lambda payload, dialect: motion.twist(objects.Vector.decode(payload, dialect).values),
}


# --- to YARP ---------------------------------------------------------------------------------


def to_payload(message: Message, *, frame_id: str = "") -> Payload:
    """Return the YARP object for `message`, which a port writes in each reader's dialect.

    Args:
        message: What is to be sent; large data is not copied.
        frame_id: The coordinate frame of the route, in which the message has to be.

    Raises:
        EncodeError: YARP's object cannot hold all of it.
    """
    write = _WRITERS.get(type(message))
    if write is None:
        return bottles.from_fields(message)
    given = _frame_of(message)
    if given != frame_id:
        raise EncodeError(
            f"YARP's objects name no coordinate frame; this {type(message).__name__} is in "
            f"{given!r}: set `frame_id: {given}` at the route"
        )
    return write(message)


def _from_native(message: Native) -> Payload:
    value = message.value
    return media.other_image(value) or sensing.object_of(value) or bottles.from_native(message)


_WRITERS: Final[dict[type[Message], Callable[[Any], Payload]]] = {
    AudioChunk: media.from_sound,
    Bottle: bottles.from_bottle,
    Image: media.from_image,
    Imu: motion.from_imu,
    JointState: motion.from_joint_state,
    LaserScan: sensing.from_laser_scan,
    Native: _from_native,
    Odometry: motion.from_odometry,
    PointCloud: sensing.from_point_cloud,
    Pose: motion.from_pose,
    Tensor: sensing.from_tensor,
    Text: bottles.from_text,
    Twist: motion.from_twist,
}


# --- coordinate frames -----------------------------------------------------------------------


def _frame_of(message: Message) -> str:
    given = message.pose if isinstance(message, Odometry) else message
    return getattr(given, "frame_id", "")


def _in_frame(message: Message, frame_id: str) -> Message:
    if not frame_id:
        return message
    if isinstance(message, Odometry):
        return replace(message, pose=replace(message.pose, frame_id=frame_id))
    return replace(message, frame_id=frame_id) if hasattr(message, "frame_id") else message
