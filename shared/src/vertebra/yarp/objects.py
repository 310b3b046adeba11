"""The typed objects that YARP ports stream, and the bytes of each.

All but the point cloud are bottles with a fixed shape. Those that hold many numbers or pixels are
read here without going through a list of Python values. Numbers are kept in `array.array`.
"""

from __future__ import annotations

import math
import re
import struct
import sys
from array import array
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal, NoReturn, Self, TypeVar

from vertebra.errors import DecodeError, EncodeError
from vertebra.yarp import bottle
from vertebra.yarp.bottle import Buffer, Value, Vocab
from vertebra.yarp.dialect import BLOB, INT16, INT32, LIST, VOCAB32, Dialect

_N = TypeVar("_N", int, float)

_I32: Final = struct.Struct("<i")
_TWO_I32: Final = struct.Struct("<ii")


def _damaged(what: str, reason: str) -> NoReturn:
    raise DecodeError(f"not a YARP {what}: {reason}")


def _filled(numbers: array[_N], raw: Buffer) -> array[_N]:
    numbers.frombytes(raw)
    if sys.byteorder == "big":
        numbers.byteswap()
    return numbers


def _as_bytes(numbers: array[_N]) -> bytes:
    if sys.byteorder == "big":
        numbers = numbers[:]
        numbers.byteswap()
    return numbers.tobytes()


def _of_type(code: str, numbers: array[_N]) -> array[_N]:
    """Return the numbers in the type that the wire has; an array of another one is converted."""
    if numbers.typecode == code:
        return numbers
    try:
        return array(code, numbers)
    except (TypeError, OverflowError) as error:
        raise EncodeError(
            f"an array of {numbers.typecode!r} is none of {code!r}: {error}"
        ) from None


def _vector(tag: int, code: str, numbers: array[_N]) -> bytes:
    """Return a list of numbers as YARP's vectors write it: with their tag even if it is empty."""
    return _TWO_I32.pack(LIST + tag, len(numbers)) + _as_bytes(_of_type(code, numbers))


def _floats(values: array[float], dialect: Dialect) -> bytes:
    return _vector(dialect.float64, "d", values)


def _pack(what: str, layout: struct.Struct, *values: object) -> bytes:
    try:
        return layout.pack(*values)
    except struct.error as error:
        raise EncodeError(f"the header of this YARP {what} cannot be written: {error}") from None


# --- vectors ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Vector:
    """A row of float64. The C++ reader refuses an empty one."""

    values: array[float]

    @classmethod
    def of(cls, values: Iterable[float]) -> Self:
        """Return the vector of any numbers."""
        return cls(array("d", values))

    def encode(self, dialect: Dialect = Dialect.V3) -> bytes:
        """Return the vector in binary."""
        return _floats(self.values, dialect)

    @classmethod
    def decode(cls, payload: Buffer, dialect: Dialect = Dialect.V3) -> Self:
        """Return the vector in `payload`.

        Raises:
            DecodeError: It holds none, or one of the other dialect.
        """
        return cls(_read_floats("vector", payload, dialect))


def _read_floats(what: str, payload: Buffer, dialect: Dialect) -> array[float]:
    """Return the numbers of a payload that is one list of float64 and nothing else."""
    if len(payload) < 8:
        _damaged(what, f"{len(payload)} bytes are too few")
    tag, count = _TWO_I32.unpack_from(payload)
    if tag != LIST + dialect.float64:
        _damaged(what, f"it begins with {tag:#x}, not {LIST + dialect.float64:#x} as in {dialect}")
    if count < 0 or len(payload) != 8 + 8 * count:
        _damaged(what, f"{count} float64 were announced, {len(payload) - 8} bytes follow")
    return _filled(array("d"), memoryview(payload)[8:])


@dataclass(frozen=True, slots=True)
class Quaternion:
    """A rotation; YARP sends it as a vector of four."""

    w: float
    x: float
    y: float
    z: float

    def encode(self, dialect: Dialect = Dialect.V3) -> bytes:
        """Return the quaternion in binary."""
        return _floats(array("d", (self.w, self.x, self.y, self.z)), dialect)

    @classmethod
    def decode(cls, payload: Buffer, dialect: Dialect = Dialect.V3) -> Self:
        """Return the quaternion in `payload`.

        Raises:
            DecodeError: It is no vector of four.
        """
        values = _read_floats("quaternion", payload, dialect)
        if len(values) != 4:
            _damaged("quaternion", f"{len(values)} numbers instead of 4")
        return cls(*values)


_MATRIX: Final = struct.Struct("<6i")


@dataclass(frozen=True, slots=True)
class Matrix:
    """A matrix of float64, row by row."""

    rows: int
    columns: int
    values: array[float]

    def encode(self, dialect: Dialect = Dialect.V3) -> bytes:
        """Return the matrix in binary.

        Raises:
            EncodeError: There are not rows x columns values.
        """
        if len(self.values) != self.rows * self.columns:
            raise EncodeError(
                f"a matrix of {self.rows} x {self.columns} cannot have {len(self.values)} values"
            )
        header = _pack("matrix", _MATRIX, LIST, 3, INT32, self.rows, INT32, self.columns)
        return header + _floats(self.values, dialect)

    @classmethod
    def decode(cls, payload: Buffer, dialect: Dialect = Dialect.V3) -> Self:
        """Return the matrix in `payload`.

        Raises:
            DecodeError: It holds none.
        """
        if len(payload) < _MATRIX.size:
            _damaged("matrix", f"{len(payload)} bytes are too few")
        *tags, rows, row_tag, columns = _MATRIX.unpack_from(payload)
        if (*tags, row_tag) != (LIST, 3, INT32, INT32) or rows < 0 or columns < 0:
            _damaged("matrix", "it does not begin with two sizes")
        values = _read_floats("matrix", memoryview(payload)[_MATRIX.size :], dialect)
        if len(values) != rows * columns:
            _damaged("matrix", f"{len(values)} values instead of {rows} x {columns}")
        return cls(rows, columns, values)


# --- images ----------------------------------------------------------------------------------

PIXEL_BYTES: Final = {
    "mono": 1,
    "mo16": 2,
    "rgb": 3,
    "rgba": 4,
    "bgra": 4,
    "int": 4,
    "hsv": 3,
    "bgr": 3,
    "sign": 1,
    "rgb-": 3,
    "rgbi": 12,
    "dec": 4,
    "rgb.": 12,
    "hsv.": 12,
    "grbg": 1,
    "bggr": 1,
    "gbrg": 1,
    "rggb": 1,
    "gr16": 2,
    "bg16": 2,
    "gb16": 2,
    "rg16": 2,
    "yuva": 1,
    "yuvb": 1,
    "yuvc": 1,
    "yuvd": 1,
}
"""Bytes of one pixel, by pixel code."""

_UNSENDABLE_PIXELS: Final = frozenset({"rgb-", "hsv."})
"""The C++ library crashes when it allocates an image of these."""

DEFAULT_QUANTUM: Final = 8

_IMAGE: Final = struct.Struct("<ii i4s i4s ii ii HH ii ii")
_MAT: Final = b"mat\0"
_IMAGE_FRAME: Final = (LIST, 4, VOCAB32, _MAT, VOCAB32, LIST + INT32, 5, BLOB)


def row_bytes(width: int, pixel_bytes: int, quantum: int) -> int:
    """Return the length of a row whose end is padded to a multiple of `quantum` bytes."""
    size = width * pixel_bytes
    return size + -size % quantum if quantum > 1 else size


@dataclass(frozen=True, slots=True)
class Image:
    """A picture with padded rows.

    Attributes:
        pixel_code: One of `PIXEL_BYTES`, or empty for an image without pixels.
        width: Pixels of a row.
        height: Number of rows.
        pixels: The rows one after the other, each `row_bytes` long.
        quantum: Each row is padded to a multiple of so many bytes.
    """

    pixel_code: str
    width: int
    height: int
    pixels: Buffer
    quantum: int = DEFAULT_QUANTUM

    @classmethod
    def from_packed(cls, pixel_code: str, width: int, height: int, pixels: Buffer) -> Self:
        """Return the image of rows without padding, without copying them.

        The quantum is YARP's usual 8 where rows happen to be such multiples, else 1.
        """
        quantum = 1 if width * PIXEL_BYTES.get(pixel_code, 0) % DEFAULT_QUANTUM else DEFAULT_QUANTUM
        return cls(pixel_code, width, height, pixels, quantum)

    @property
    def row_bytes(self) -> int:
        """The length of a row, padding included."""
        return row_bytes(self.width, PIXEL_BYTES.get(self.pixel_code, 0), self.quantum)

    def packed_pixels(self) -> Buffer:
        """Return the rows without their padding; copied only where there is some."""
        padded, size = self.row_bytes, self.width * PIXEL_BYTES.get(self.pixel_code, 0)
        if padded == size:
            return self.pixels
        pixels = memoryview(self.pixels)
        return b"".join([pixels[begin : begin + size] for begin in range(0, len(pixels), padded)])

    def encode_parts(self) -> list[Buffer]:
        """Return header and pixels, to be sent one after the other; the pixels are not copied.

        The bytes are the same in both dialects. The word of the quantum has no flags in its upper
        half: YARP 3 does not miss them and YARP 4 would take them for part of the number.

        Raises:
            EncodeError: The size of `pixels` is not what the other fields say, or the pixel code
                is unknown or one that crashes the C++ library.
        """
        depth = PIXEL_BYTES.get(self.pixel_code, 0)
        if self.pixel_code in _UNSENDABLE_PIXELS or (self.pixel_code and not depth):
            raise EncodeError(
                f"images of pixel code {self.pixel_code!r} cannot be sent: "
                f"use one of {', '.join(sorted(PIXEL_BYTES.keys() - _UNSENDABLE_PIXELS))}"
            )
        size = self.row_bytes * self.height
        given = memoryview(self.pixels).nbytes
        if self.width < 0 or self.height < 0 or given != size:
            raise EncodeError(
                f"{self.width} x {self.height} {self.pixel_code!r} pixels with rows of "
                f"{self.row_bytes} bytes are {size} bytes, not {given}"
            )
        code = self.pixel_code.encode("ascii")
        header = _pack(
            "image", _IMAGE, LIST, 4, VOCAB32, _MAT, VOCAB32, code, LIST + INT32, 5, depth, size,
            self.quantum, 0, self.width, self.height, BLOB, size,
        )  # fmt: skip
        return [header, self.pixels]

    def encode(self, dialect: Dialect = Dialect.V3) -> bytes:  # noqa: ARG002 -- like the others
        """Return the image in binary.

        Raises:
            EncodeError: As from `encode_parts`.
        """
        return b"".join(self.encode_parts())

    @classmethod
    def decode(cls, payload: Buffer, dialect: Dialect = Dialect.V3) -> Self:  # noqa: ARG003
        """Return the image in `payload`; its pixels are a view of that buffer.

        Raises:
            DecodeError: It holds none, or one of unknown pixel code or of contradictory sizes.
        """
        if len(payload) < _IMAGE.size:
            _damaged("image", f"{len(payload)} bytes are fewer than its header of {_IMAGE.size}")
        (
            list_tag, fields_, mat_tag, mat, code_tag, code, sizes_tag, sizes,
            depth, size, quantum, _top_is_low, width, height, blob_tag, blob_size,
        ) = _IMAGE.unpack_from(payload)  # fmt: skip
        if (list_tag, fields_, mat_tag, mat, code_tag, sizes_tag, sizes, blob_tag) != _IMAGE_FRAME:
            _damaged("image", "its header has another form")
        pixel_code = code.rstrip(b"\0").decode("latin-1")
        if pixel_code and pixel_code not in PIXEL_BYTES:
            _damaged("image", f"unknown pixel code {pixel_code!r}")
        if depth != PIXEL_BYTES.get(pixel_code, 0):
            _damaged("image", f"{depth} bytes per pixel of code {pixel_code!r}")
        pixels = memoryview(payload)[_IMAGE.size :]
        expected = row_bytes(width, depth, quantum) * height
        if width < 0 or height < 0 or not size == blob_size == expected == len(pixels):
            _damaged(
                "image",
                f"{width} x {height} {pixel_code!r} pixels with rows padded to {quantum} are "
                f"{expected} bytes; it announces {size} and {blob_size}, and has {len(pixels)}",
            )
        return cls(pixel_code, width, height, pixels, quantum)


# --- stamps, sounds, commands ----------------------------------------------------------------

_ENVELOPE: Final = re.compile(
    r"\s*([+-]?[0-9]{1,10})\s+([+-]?[0-9.]{1,40}(?:[eE][+-]?[0-9]{1,4})?)\s*"
)


@dataclass(frozen=True, slots=True)
class Stamp:
    """The count and the time of a message: usually its envelope, sometimes an object itself.

    Attributes:
        count: Number of the message at its sender.
        time_s: Seconds by the sender's clock, often since 1970.
    """

    count: int
    time_s: float

    def to_envelope(self) -> str:
        """Return the text beside a message; it resolves 10 us in times since 1970."""
        return f"{self.count:d} {self.time_s:.15g}"

    @classmethod
    def from_envelope(cls, text: str) -> Self:
        """Return the stamp that the text beside a message holds.

        Raises:
            DecodeError: It holds something else.
        """
        match = _ENVELOPE.fullmatch(text)
        try:
            if match is not None:
                return cls(int(match[1]), float(match[2]))
        except ValueError:  # such as 1.2.3
            pass
        _damaged("stamp", f"the envelope {text[:80]!r} is not a count and a time in seconds")

    def encode(self, dialect: Dialect = Dialect.V3) -> bytes:
        """Return the stamp as an object.

        Raises:
            EncodeError: The count is no int32.
        """
        return bottle.encode([self.count, float(self.time_s)], dialect)

    @classmethod
    def decode(cls, payload: Buffer, dialect: Dialect = Dialect.V3) -> Self:
        """Return the stamp in `payload`.

        Raises:
            DecodeError: It holds none.
        """
        match bottle.decode(payload, dialect):
            case [int() as count, float() as time_s] if math.isfinite(time_s):
                return cls(count, time_s)
            case other:
                _damaged("stamp", f"{len(other)} values are not a count and a time in seconds")


_SOUND: Final = struct.Struct("<12i")
_NO_MARKERS: Final = _TWO_I32.pack(LIST, 0)


@dataclass(frozen=True, slots=True)
class Sound:
    """A piece of sound in 16-bit samples.

    Attributes:
        frequency_hz: Samples of one channel in a second.
        channels: Their number.
        samples: Planar: all of channel 0, then all of channel 1, ...
        bytes_per_sample: What the microphone gave; on the wire samples always have 16 bits.
        markers: What YARP 4 appends, as it came; not sent to YARP 3, which has no such thing.
    """

    frequency_hz: int
    channels: int
    samples: array[int]
    bytes_per_sample: int = 2
    markers: bytes = _NO_MARKERS

    def encode(self, dialect: Dialect = Dialect.V3) -> bytes:
        """Return the sound in binary.

        Raises:
            EncodeError: The samples cannot be shared out among the channels.
        """
        length, rest = divmod(len(self.samples), self.channels) if self.channels > 0 else (0, 1)
        if rest:
            raise EncodeError(f"{len(self.samples)} samples are not {self.channels} equal channels")
        is_v4 = dialect is Dialect.V4
        header = _pack(
            "sound", _SOUND, LIST, 6 if is_v4 else 5, INT32, length, INT32, self.channels,
            INT32, self.bytes_per_sample, INT32, self.frequency_hz, LIST + INT16, len(self.samples),
        )  # fmt: skip
        return header + _as_bytes(_of_type("h", self.samples)) + (self.markers if is_v4 else b"")

    @classmethod
    def decode(cls, payload: Buffer, dialect: Dialect = Dialect.V3) -> Self:
        """Return the sound in `payload`.

        Raises:
            DecodeError: It holds none.
        """
        if len(payload) < _SOUND.size:
            _damaged("sound", f"{len(payload)} bytes are fewer than its header of {_SOUND.size}")
        (
            *form, length, tag1, channels, tag2, bytes_per_sample, tag3, frequency_hz,
            samples_tag, count,
        ) = _SOUND.unpack_from(payload)  # fmt: skip
        is_v4 = dialect is Dialect.V4
        if (*form, tag1, tag2, tag3, samples_tag) != (
            (LIST, 6 if is_v4 else 5, INT32, INT32, INT32, INT32, LIST + INT16)
        ):
            _damaged("sound", f"its header has not the form of {dialect}")
        end = _SOUND.size + 2 * count
        has_rest = len(payload) >= end + len(_NO_MARKERS) if is_v4 else len(payload) == end
        if count < 0 or channels < 1 or length * channels != count or not has_rest:
            _damaged(
                "sound",
                f"{length} samples x {channels} channels, {count} values announced, "
                f"{len(payload) - _SOUND.size} bytes",
            )
        samples = _filled(array("h"), memoryview(payload)[_SOUND.size : end])
        markers = bytes(payload[end:]) or _NO_MARKERS
        return cls(frequency_hz, channels, samples, bytes_per_sample, markers)


@dataclass(frozen=True, slots=True)
class Pair:
    """A streamed command: what to do, as a bottle such as `[dpo] 3`, and the numbers for it."""

    head: list[Value]
    body: Vector

    def encode(self, dialect: Dialect = Dialect.V3) -> bytes:
        """Return the pair in binary.

        Raises:
            EncodeError: The head has no form in this dialect.
        """
        head = bottle.encode(self.head, dialect)
        return _TWO_I32.pack(LIST, 2) + head + self.body.encode(dialect)

    @classmethod
    def decode(cls, payload: Buffer, dialect: Dialect = Dialect.V3) -> Self:
        """Return the pair in `payload`.

        Raises:
            DecodeError: It holds none.
        """
        if bytes(payload[:8]) != _TWO_I32.pack(LIST, 2):
            _damaged("pair", "it is no list of two")
        head, end = bottle.decode_prefix(payload, 8, dialect)
        return cls(head, Vector.decode(memoryview(payload)[end:], dialect))


# --- states of robots ------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class JointValues:
    """One number for each joint; `ok` tells whether the robot could measure them."""

    values: array[float] = field(default_factory=lambda: array("d"))
    ok: bool = False


@dataclass(frozen=True, slots=True)
class JointModes:
    """One word for each joint, such as `pos`; `ok` tells whether the robot could tell."""

    words: tuple[Vocab, ...] = ()
    ok: bool = False


_FLAGS: Final = {True: b"ok\0\0", False: b"fail"}


@dataclass(frozen=True, slots=True, kw_only=True)
class JointData:
    """What a control board streams on `stateExt:o`; the fields are in the order of the wire.

    Positions are in degrees, speeds in degrees per second, and so on. Only YARP 4 carries
    temperatures; it sends them and the duty cycle in single precision.
    """

    joint_position: JointValues = JointValues()
    joint_velocity: JointValues = JointValues()
    joint_acceleration: JointValues = JointValues()
    motor_position: JointValues = JointValues()
    motor_velocity: JointValues = JointValues()
    motor_acceleration: JointValues = JointValues()
    torque: JointValues = JointValues()
    pwm_dutycycle: JointValues = JointValues()
    current: JointValues = JointValues()
    control_mode: JointModes = JointModes()
    interaction_mode: JointModes = JointModes()
    temperature: JointValues = JointValues()

    def encode(self, dialect: Dialect = Dialect.V3) -> bytes:
        """Return the state in binary.

        Raises:
            EncodeError: A mode has more than four letters.
        """
        parts = [_TWO_I32.pack(LIST, 2 * len(_JOINT_FIELDS[dialect]))]
        for name in _JOINT_FIELDS[dialect]:
            item: JointValues | JointModes = getattr(self, name)
            if isinstance(item, JointModes):
                parts.append(_modes(item.words))
            elif dialect is Dialect.V4 and name in _SINGLE_PRECISION:
                parts.append(_vector(dialect.float32, "f", item.values))
            else:
                parts.append(_floats(item.values, dialect))
            parts.append(_I32.pack(VOCAB32) + _FLAGS[item.ok])
        return b"".join(parts)

    @classmethod
    def decode(cls, payload: Buffer, dialect: Dialect = Dialect.V3) -> Self:
        """Return the state in `payload`.

        Raises:
            DecodeError: It holds none.
        """
        names = _JOINT_FIELDS[dialect]
        values = bottle.decode(payload, dialect)
        if len(values) != 2 * len(names):
            _damaged("jointData", f"{len(values)} fields instead of {2 * len(names)} ({dialect})")
        items: dict[str, Any] = {
            name: _joint_item(name, numbers, flag)
            for name, numbers, flag in zip(names, values[::2], values[1::2], strict=True)
        }
        return cls(**items)


_MODES: Final = ("control_mode", "interaction_mode")
_SINGLE_PRECISION: Final = ("pwm_dutycycle", "temperature")
_ALL_JOINT_FIELDS: Final = tuple(JointData.__dataclass_fields__)
_JOINT_FIELDS: Final = {Dialect.V3: _ALL_JOINT_FIELDS[:-1], Dialect.V4: _ALL_JOINT_FIELDS}


def _modes(words: Sequence[Vocab]) -> bytes:
    try:
        return _vector(INT32, "i", array("i", [word.code for word in words]))
    except OverflowError:
        raise EncodeError(f"modes have at most four letters: {words!r}") from None


def _joint_item(name: str, numbers: Value, flag: Value) -> JointValues | JointModes:
    if flag not in ("ok", "fail"):
        _damaged("jointData", f"the flag of {name} is {flag!r}, neither ok nor fail")
    if name not in _MODES:
        return JointValues(_number_list("jointData", name, numbers), flag == "ok")
    if not isinstance(numbers, list) or any(type(code) is not int for code in numbers):
        _damaged("jointData", f"{name} is no list of int32")
    return JointModes(tuple(map(Vocab.from_code, numbers)), flag == "ok")


def _number_list(what: str, name: str, numbers: Value) -> array[float]:
    if isinstance(numbers, list):
        try:
            return array("d", numbers)
        except TypeError:  # something in it is no number
            pass
    _damaged(what, f"{name} is no list of numbers")


@dataclass(frozen=True, slots=True)
class Measurement:
    """What one sensor measured.

    Attributes:
        values: In the units of its kind.
        time_s: Seconds by the robot's clock.
    """

    values: array[float]
    time_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorData:
    """What a multi-analog-sensors server streams; the fields are in the order of the wire."""

    gyroscopes: tuple[Measurement, ...] = ()
    linear_accelerometers: tuple[Measurement, ...] = ()
    magnetometers: tuple[Measurement, ...] = ()
    orientations: tuple[Measurement, ...] = ()
    temperatures: tuple[Measurement, ...] = ()
    force_torques: tuple[Measurement, ...] = ()
    contact_load_cells: tuple[Measurement, ...] = ()
    encoder_arrays: tuple[Measurement, ...] = ()
    skin_patches: tuple[Measurement, ...] = ()
    positions: tuple[Measurement, ...] = ()
    linear_velocities: tuple[Measurement, ...] = ()
    angular_accelerometers: tuple[Measurement, ...] = ()

    def encode(self, dialect: Dialect = Dialect.V3) -> bytes:
        """Return the measurements in binary."""
        parts = [_TWO_I32.pack(LIST, len(_SENSOR_FIELDS))]
        for name in _SENSOR_FIELDS:
            measurements: tuple[Measurement, ...] = getattr(self, name)
            parts.append(_TWO_I32.pack(LIST, len(measurements)))
            for measurement in measurements:
                parts.append(_TWO_I32.pack(LIST, 2))
                parts.append(_floats(measurement.values, dialect))
                parts.append(struct.pack("<id", dialect.float64, measurement.time_s))
        return b"".join(parts)

    @classmethod
    def decode(cls, payload: Buffer, dialect: Dialect = Dialect.V3) -> Self:
        """Return the measurements in `payload`.

        Raises:
            DecodeError: It holds none.
        """
        values = bottle.decode(payload, dialect)
        if len(values) != len(_SENSOR_FIELDS):
            _damaged("SensorStreamingData", f"{len(values)} lists, not {len(_SENSOR_FIELDS)}")
        return cls(**dict(map(_measurements, _SENSOR_FIELDS, values)))


_SENSOR_FIELDS: Final = tuple(SensorData.__dataclass_fields__)


def _measurements(name: str, sensors: Value) -> tuple[str, tuple[Measurement, ...]]:
    if not isinstance(sensors, list):
        _damaged("SensorStreamingData", f"{name} is no list")
    return name, tuple(_measurement(name, sensor) for sensor in sensors)


def _measurement(name: str, sensor: Value) -> Measurement:
    match sensor:
        case [list() as values, float() as time_s]:
            return Measurement(_number_list("SensorStreamingData", name, values), time_s)
        case _:
            _damaged("SensorStreamingData", f"a sensor of {name} is not (values) and a time")


@dataclass(frozen=True, slots=True)
class LaserScan2D:
    """One sweep of a laser scanner.

    Attributes:
        angle_min_deg: Angle of the first range.
        angle_max_deg: Angle after the last range.
        range_min_m: Nearest distance that the scanner sees.
        range_max_m: Farthest distance that the scanner sees.
        ranges_m: Distances by rising angle.
        status: Of the device, in YARP's own numbers.
    """

    angle_min_deg: float
    angle_max_deg: float
    range_min_m: float
    range_max_m: float
    ranges_m: array[float]
    status: int

    def encode(self, dialect: Dialect = Dialect.V3) -> bytes:
        """Return the scan in binary."""
        limits = (self.angle_min_deg, self.angle_max_deg, self.range_min_m, self.range_max_m)
        head = b"".join([struct.pack("<id", dialect.float64, limit) for limit in limits])
        ranges = _floats(self.ranges_m, dialect)
        return _TWO_I32.pack(LIST, 6) + head + ranges + _pack("scan", _TWO_I32, INT32, self.status)

    @classmethod
    def decode(cls, payload: Buffer, dialect: Dialect = Dialect.V3) -> Self:
        """Return the scan in `payload`.

        Raises:
            DecodeError: It holds none.
        """
        match bottle.decode(payload, dialect):
            case [
                float() as angle_min, float() as angle_max,
                float() as range_min, float() as range_max,
                list() as ranges, int() as status,
            ]:  # fmt: skip
                numbers = _number_list("LaserScan2D", "ranges", ranges)
                return cls(angle_min, angle_max, range_min, range_max, numbers, status)
            case other:
                _damaged("LaserScan2D", f"these {len(other)} values are no scan")


_POINT_CLOUD: Final = struct.Struct("<iii?ii")


@dataclass(frozen=True, slots=True)
class PointCloud:
    """Points in space, as C++ structs.

    Attributes:
        width: Points of a row; all of them if they are not in rows.
        height: Number of rows.
        point_type: YARP's number, such as 2 for three float32 padded to 16 bytes.
        points: The structs one after the other.
        is_dense: No point is missing (NaN).
    """

    width: int
    height: int
    point_type: int
    points: Buffer
    is_dense: bool = True

    @property
    def point_bytes(self) -> int:
        """The size of one point, padding included; 0 if there is none."""
        count = self.width * self.height
        return memoryview(self.points).nbytes // count if count else 0

    def encode_parts(self, dialect: Dialect = Dialect.V3) -> list[Buffer]:
        """Return header and points, to be sent one after the other; the points are not copied.

        Raises:
            EncodeError: There are not width x height points of the same size.
        """
        count = self.width * self.height
        size = memoryview(self.points).nbytes
        if min(self.width, self.height) < 0 or self.point_bytes * count != size:
            raise EncodeError(f"{size} bytes are not {self.width} x {self.height} points")
        header = _pack(
            "point cloud", _POINT_CLOUD, self.width, self.height, self.point_type, self.is_dense,
            LIST + dialect.float64, count,
        )  # fmt: skip
        return [header, self.points]

    def encode(self, dialect: Dialect = Dialect.V3) -> bytes:
        """Return the point cloud in binary.

        Raises:
            EncodeError: As from `encode_parts`.
        """
        return b"".join(self.encode_parts(dialect))

    @classmethod
    def decode(cls, payload: Buffer, dialect: Dialect = Dialect.V3) -> Self:
        """Return the cloud in `payload`; its points are a view of that buffer.

        Raises:
            DecodeError: It holds none.
        """
        if len(payload) < _POINT_CLOUD.size:
            _damaged("point cloud", f"{len(payload)} bytes are too few")
        width, height, point_type, is_dense, tag, count = _POINT_CLOUD.unpack_from(payload)
        points = memoryview(payload)[_POINT_CLOUD.size :]
        if tag != LIST + dialect.float64:
            _damaged("point cloud", f"its points begin with {tag:#x}, not as in {dialect}")
        cloud = cls(width, height, point_type, points, is_dense)
        expected = _POINT_BYTES.get(point_type, cloud.point_bytes) * count
        if min(width, height) < 0 or width * height != count or len(points) != expected:
            _damaged(
                "point cloud",
                f"{width} x {height} points of type {point_type} announced, then {count}; "
                f"{len(points)} bytes follow",
            )
        return cloud


_POINT_BYTES: Final = {2: 16, 0x02000006: 32}


# --- what a stream carries -------------------------------------------------------------------

Kind = Literal[
    "bottle", "image", "joint_data", "point_cloud", "sensor_data", "sound", "unknown", "vector"
]

# Lists of so many elements may be these objects.
_KIND_BY_COUNT: Final[dict[int, Kind]] = {
    4: "image",
    5: "sound",
    6: "sound",
    12: "sensor_data",
    22: "joint_data",
    24: "joint_data",
}
_DECODERS: Final[dict[Kind, Callable[[Buffer, Dialect], object]]] = {
    "image": Image.decode,
    "joint_data": JointData.decode,
    "point_cloud": PointCloud.decode,
    "sensor_data": SensorData.decode,
    "sound": Sound.decode,
    "vector": Vector.decode,
}


def kind_of(payload: Buffer, dialect: Dialect = Dialect.V3) -> Kind:
    """Tell what a payload of unknown type is, as far as its bytes show it.

    Stamps, pairs, matrices and scans look like any bottle of such values and count as bottles. A
    bottle of nothing but float64 counts as a vector. Bottles themselves are not read to their end.
    """
    if len(payload) < 8:
        return "unknown"
    tag, count = _TWO_I32.unpack_from(payload)
    otherwise: Kind = "bottle" if tag & ~0xFF == LIST else "unknown"
    if tag == LIST:
        kind = _KIND_BY_COUNT.get(count, otherwise)
    elif tag == LIST + dialect.float64:
        kind = "vector"
    else:
        kind = "point_cloud" if otherwise == "unknown" else otherwise
    if kind not in _DECODERS:
        return kind
    try:
        _DECODERS[kind](payload, dialect)
    except DecodeError:
        return otherwise
    return kind
