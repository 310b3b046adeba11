"""What YARP's bytes mean on the backbone, and back; no I/O."""

from __future__ import annotations

import math
import sys
from array import array
from collections.abc import Sequence
from typing import Any, Final

from vertebra.errors import DecodeError, EncodeError
from vertebra.messages import (
    PIXELS,
    Array,
    AudioChunk,
    Bottle,
    Image,
    Imu,
    JointState,
    Message,
    PixelFormat,
    Tensor,
    Text,
)
from vertebra.yarp import (
    Dialect,
    Dict,
    Float32,
    Int8,
    Int16,
    Int64,
    Payload,
    Value,
    Vocab,
    Vocab64,
    decode,
    objects,
)
from vertebra.yarp.wire import Buffer
from vertebra_yarp.routes import StreamType

PIXEL_FORMATS: Final[dict[str, PixelFormat]] = {
    "mono": "mono8",
    "mo16": "mono16",
    "rgb": "rgb8",
    "bgr": "bgr8",
    "rgba": "rgba8",
    "bgra": "bgra8",
    "dec": "depth32f",
    "rggb": "bayer_rggb8",
    "bggr": "bayer_bggr8",
    "grbg": "bayer_grbg8",
    "gbrg": "bayer_gbrg8",
}
"""YARP's pixel codes and ours."""

_PIXEL_CODES: Final = {ours: theirs for theirs, ours in PIXEL_FORMATS.items()}
_IMU_VALUES: Final = 12
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


def to_message(
    payload: Buffer,
    wanted: StreamType,
    *,
    names: Sequence[str] = (),
    dialect: Dialect = Dialect.V3,
) -> Message:
    """Return the message in a YARP payload; `names` are those of the joints of a `JointState`.

    Raises:
        DecodeError: The payload is damaged or is not what the route says.
    """
    if wanted == "auto":
        return _tell(payload, dialect)
    if wanted == "Image":
        return _image(objects.Image.decode(payload, dialect))
    if wanted == "Imu":
        if objects.kind_of(payload, dialect) == "sensor_data":
            return _sensed(objects.SensorData.decode(payload, dialect))
        return _imu(objects.Vector.decode(payload, dialect).values)
    if wanted == "JointState":
        return _joint_state(objects.Vector.decode(payload, dialect).values, names)
    if wanted == "Tensor":
        return _tensor(objects.Vector.decode(payload, dialect).values)
    values = decode(payload, dialect)
    if wanted == "Bottle":
        return Bottle(values=plain_of(values))
    if len(values) != 1 or not isinstance(values[0], str):
        raise DecodeError(f"a bottle with one string was expected, it holds {len(values)} values")
    return Text(text=values[0])


def _tell(payload: Buffer, dialect: Dialect) -> Message:
    kind = objects.kind_of(payload, dialect)
    if kind == "image":
        image = objects.Image.decode(payload, dialect)
        if image.pixel_code in PIXEL_FORMATS:
            return _image(image)
    if kind == "vector":
        return _tensor(objects.Vector.decode(payload, dialect).values)
    if kind == "sound":
        return _sound(objects.Sound.decode(payload, dialect))
    if kind in ("unknown", "point_cloud"):
        view = memoryview(payload)
        return Tensor(array=Array(view, "|u1", (view.nbytes,)))
    return Bottle(values=plain_of(decode(payload, dialect)))


def _image(image: objects.Image) -> Image:
    pixel_format = PIXEL_FORMATS.get(image.pixel_code)
    if pixel_format is None:
        raise DecodeError(
            f"images of pixel code {image.pixel_code!r} have no message; "
            f"known: {', '.join(PIXEL_FORMATS)}"
        )
    dtype, channels = PIXELS[pixel_format]
    shape = (image.height, image.width) + ((channels,) if channels > 1 else ())
    return Image(pixels=Array(image.packed_pixels(), dtype, shape), pixel_format=pixel_format)


def _tensor(values: array[float]) -> Tensor:
    return Tensor(array=Array.of(values))


def _imu(values: array[float]) -> Imu:
    """Read the 12 numbers of an `inertial` port (rpy, acceleration, gyro, magnetometer)."""
    if len(values) != _IMU_VALUES:
        raise DecodeError(f"an inertial port streams {_IMU_VALUES} numbers, not {len(values)}")
    return Imu(
        orientation_xyzw=_quaternion(values[:3]),
        linear_acceleration_m_s2=(values[3], values[4], values[5]),
        angular_velocity_deg_s=(values[6], values[7], values[8]),
        magnetic_field_ut=(values[9], values[10], values[11]),
    )


def _sensed(data: objects.SensorData) -> Imu:
    """Read the first sensor of each kind of a multi-analog-sensors server (fields in tesla)."""
    orientation, acceleration, velocity, field = (
        _triple(found[0].values) if found else None
        for found in (
            data.orientations,
            data.linear_accelerometers,
            data.gyroscopes,
            data.magnetometers,
        )
    )
    if not (orientation or acceleration or velocity or field):
        raise DecodeError("none of these analog sensors is an IMU")
    return Imu(
        orientation_xyzw=orientation and _quaternion(orientation),
        linear_acceleration_m_s2=acceleration,
        angular_velocity_deg_s=velocity,
        magnetic_field_ut=field and (1e6 * field[0], 1e6 * field[1], 1e6 * field[2]),
    )


def _triple(values: Sequence[float]) -> tuple[float, float, float]:
    if len(values) != 3:
        raise DecodeError(f"an inertial sensor gives 3 numbers, not {len(values)}")
    return (values[0], values[1], values[2])


def _quaternion(angles_deg: Sequence[float]) -> tuple[float, float, float, float]:
    """Return x, y, z, w of roll, pitch and yaw."""
    roll, pitch, yaw = (math.radians(angle) / 2 for angle in angles_deg)
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def _joint_state(values: array[float], names: Sequence[str]) -> JointState:
    if len(values) != len(names):
        raise DecodeError(f"{len(values)} positions for the {len(names)} joints of this part")
    return JointState(names=tuple(names), positions_deg=tuple(values))


def _sound(sound: objects.Sound) -> AudioChunk:
    planar = array("h", sound.samples)
    samples = array("h", bytes(planar.itemsize * len(planar)))
    per_channel = len(planar) // max(sound.channels, 1)
    for channel in range(sound.channels):  # YARP has one channel after the other
        samples[channel :: sound.channels] = planar[
            channel * per_channel : (channel + 1) * per_channel
        ]
    shape = (per_channel, sound.channels)
    return AudioChunk(samples=Array(samples, "<i2", shape), rate_hz=sound.frequency_hz)


def to_payload(message: Message) -> Payload:
    """Return the YARP object for `message`, which a port writes in each reader's dialect.

    Raises:
        EncodeError: YARP has no object for it.
    """
    if isinstance(message, Image):
        return _yarp_image(message)
    if isinstance(message, JointState):
        return objects.Vector.of(message.positions_deg)
    if isinstance(message, Imu):
        return objects.Vector.of(_inertial(message))
    if isinstance(message, Tensor):
        return _vector(message.array)
    if isinstance(message, Bottle):
        return values_of(message.values)
    if isinstance(message, Text):
        return [message.text]
    raise EncodeError(
        f"YARP has no object for {type(message).__name__}; "
        "send an Image, JointState, Imu, Tensor, Bottle or Text"
    )


def _yarp_image(image: Image) -> objects.Image:
    code = _PIXEL_CODES[image.pixel_format]
    return objects.Image.from_packed(code, image.width, image.height, image.pixels.data)


def _vector(values: Array) -> objects.Vector:
    if len(values.shape) != 1 or values.dtype != "<f8" or not values.nbytes:
        raise EncodeError(
            "a YARP Vector is a non-empty one-dimensional '<f8' tensor, "
            f"not {values.dtype!r} of shape {values.shape}"
        )
    numbers = array("d")
    numbers.frombytes(values.data)
    if sys.byteorder == "big":
        numbers.byteswap()
    return objects.Vector(numbers)


def _inertial(imu: Imu) -> list[float]:
    nothing = (0.0, 0.0, 0.0)
    x, y, z, w = imu.orientation_xyzw or (0.0, 0.0, 0.0, 1.0)
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return [
        *(math.degrees(angle) for angle in (roll, pitch, yaw)),
        *(imu.linear_acceleration_m_s2 or nothing),
        *(imu.angular_velocity_deg_s or nothing),
        *(imu.magnetic_field_ut or nothing),
    ]


_NAMED: Final[dict[str, type[Int8 | Int16 | Int64 | Float32 | Vocab | Vocab64]]] = {
    "int8": Int8,
    "int16": Int16,
    "int64": Int64,
    "float32": Float32,
    "vocab": Vocab,
    "vocab64": Vocab64,
}


def plain_of(values: Sequence[Value]) -> list[Any]:
    """Return bottle values as the plain values of a `Bottle` message; nothing is lost."""
    return [_plain(value) for value in values]


def _plain(value: Value) -> Any:
    for name, kind in _NAMED.items():
        if type(value) is kind:
            base = str if isinstance(value, str) else float if isinstance(value, float) else int
            return {name: base(value)}
    if isinstance(value, Dict):
        return {"dict": plain_of(value)}
    if isinstance(value, list):
        return plain_of(value)
    return value


def values_of(plain: Sequence[Any]) -> list[Value]:
    """Return the bottle values that `plain_of` made, or that a person wrote in that form.

    Raises:
        EncodeError: Something has no place in a bottle.
    """
    return [_value(item) for item in plain]


def _value(item: Any) -> Value:
    if isinstance(item, list | tuple):
        return values_of(item)
    if isinstance(item, dict):
        if len(item) == 1:
            ((name, value),) = item.items()
            if name == "dict" and isinstance(value, list | tuple):
                return Dict(values_of(value))
            kind = _NAMED.get(name)
            fits = str if kind in (Vocab, Vocab64) else int | float
            if kind is not None and isinstance(value, fits):
                return kind(value)
        raise EncodeError(
            f"{item!r} is no bottle value; a map has one entry: dict, {', '.join(_NAMED)}"
        )
    if item is None:
        raise EncodeError("None has no place in a bottle")
    if isinstance(item, bool | int | float | str | bytes):
        return item
    raise EncodeError(f"a {type(item).__name__} has no place in a bottle")
