"""Arrays of numbers, laser scans, point clouds, and the sensors that have no message."""

from __future__ import annotations

import dataclasses
import math
from array import array
from typing import Any, Final

from vertebra.errors import DecodeError, EncodeError
from vertebra.messages import Array, LaserScan, Message, Native, PointCloud, Tensor
from vertebra.yarp import Vocab, objects
from vertebra.yarp.objects import JointData, JointModes, JointValues, Measurement, SensorData
from vertebra.yarp.objects.parts import filled

_CODES: Final = {"<f8": "d", "<f4": "f", "<i8": "q", "<i4": "i", "<i2": "h", "|i1": "b"}
_DTYPES: Final = {code: dtype for dtype, code in _CODES.items()}


# --- arrays ----------------------------------------------------------------------------------


def tensor(yarp: objects.Vector | objects.VectorOf | objects.Matrix) -> Message:
    """Return a vector or matrix as an array."""
    values = yarp.values
    shape: tuple[int, ...] = (len(values),)
    if isinstance(yarp, objects.Matrix):
        shape = (yarp.rows, yarp.columns)
    return Tensor(array=Array(values, _DTYPES[values.typecode], shape))


def from_tensor(message: Tensor) -> objects.VectorOf | objects.Matrix:
    """Return an array as a vector of its type, or as a matrix."""
    given = message.array
    if message.axes:
        raise EncodeError(f"YARP has no names for axes {message.axes}; leave them out")
    code = _CODES.get(given.dtype)
    if code == "d" and len(given.shape) == 2:
        return objects.Matrix(*given.shape, filled(array("d"), given.data))
    if code is None or len(given.shape) != 1 or not given.nbytes:
        raise EncodeError(
            "YARP has non-empty vectors of "
            f"{', '.join(_CODES)} and matrices of '<f8', not {given.dtype!r} of shape "
            f"{given.shape}"
        )
    return objects.VectorOf(filled(array(code), given.data))


# --- laser scans -----------------------------------------------------------------------------

_IN_USE: Final = 1
_FAULTS: Final = {2: "a general error", 3: "a timeout"}


def laser_scan(yarp: objects.LaserScan2D) -> Message:
    """Return a sweep in radians and float32."""
    if yarp.status in _FAULTS:
        raise DecodeError(f"the laser scanner reports {_FAULTS[yarp.status]}")
    if not yarp.ranges_m:
        raise DecodeError("a laser scan without ranges has no steps between them")
    span_deg = yarp.angle_max_deg - yarp.angle_min_deg
    ranges = array("f", yarp.ranges_m)
    return LaserScan(
        ranges_m=Array(ranges, "<f4", (len(ranges),)),
        angle_min_rad=math.radians(yarp.angle_min_deg),
        angle_increment_rad=math.radians(span_deg) / len(ranges),
        range_min_m=yarp.range_min_m,
        range_max_m=yarp.range_max_m,
    )


def from_laser_scan(message: LaserScan) -> objects.LaserScan2D:
    """Return a sweep in degrees and float64."""
    ranges = filled(array("f"), message.ranges_m.data)
    if message.intensities is not None:
        raise EncodeError("YARP's laser scans have no intensities; leave them out")
    if not ranges:
        raise EncodeError("a YARP laser scan has at least one range")
    angle_max = message.angle_min_rad + len(ranges) * message.angle_increment_rad
    return objects.LaserScan2D(
        math.degrees(message.angle_min_rad),
        math.degrees(angle_max),
        message.range_min_m,
        message.range_max_m,
        array("d", ranges),
        _IN_USE,
    )


# --- point clouds ----------------------------------------------------------------------------

_XYZ: Final = 2
_XYZRGBA: Final = 0x02000006
_FLOATS_OF_POINT: Final = {_XYZ: 4, _XYZRGBA: 8}
_COLOR_AT: Final = 16  # bytes b g r a
_OPAQUE: Final = 255


def point_cloud(yarp: objects.PointCloud) -> Message:
    """Return a cloud without the padding of its points."""
    stride = _FLOATS_OF_POINT.get(yarp.point_type)
    if stride is None:
        raise DecodeError(
            f"point clouds of type {yarp.point_type:#x} have no message, only XYZ and XYZRGBA"
        )
    shape = (yarp.height, yarp.width, 3) if yarp.height > 1 else (yarp.width, 3)
    floats = filled(array("f"), yarp.points)
    points = array("f", bytes(12 * (len(floats) // stride)))
    for axis in range(3):
        points[axis::3] = floats[axis::stride]
    colors = None
    if yarp.point_type == _XYZRGBA:
        colors = Array(_colors(memoryview(yarp.points)), "|u1", shape)
    return PointCloud(points_m=Array(points, "<f4", shape), colors_rgb=colors)


def _colors(points: memoryview) -> bytearray:
    bgra = [bytes(points[_COLOR_AT + byte :: 32]) for byte in range(4)]
    if len(set(bgra[3])) > 1:
        raise DecodeError("a point cloud of different transparencies has no message")
    colors = bytearray(3 * len(bgra[0]))
    for channel in range(3):
        colors[channel::3] = bgra[2 - channel]
    return colors


def from_point_cloud(message: PointCloud) -> objects.PointCloud:
    """Return a cloud of XYZ or XYZRGBA, padded as C++ wants it."""
    *leading, _ = message.points_m.shape
    height, width = (1, *leading)[-2:]
    point_type = _XYZ if message.colors_rgb is None else _XYZRGBA
    stride = _FLOATS_OF_POINT[point_type]
    points = filled(array("f"), message.points_m.data)
    floats = array("f", bytes(4 * stride * (len(points) // 3)))
    for axis in range(3):
        floats[axis::stride] = points[axis::3]
    raw = bytearray(floats.tobytes())
    if message.colors_rgb is not None:
        rgb = bytes(message.colors_rgb.data)
        for channel in range(3):
            raw[_COLOR_AT + 2 - channel :: 32] = rgb[channel::3]
        raw[_COLOR_AT + 3 :: 32] = bytes([_OPAQUE]) * (len(rgb) // 3)
    is_dense = not any(map(math.isnan, points))
    return objects.PointCloud(width, height, point_type, bytes(raw), is_dense)


# --- objects without a message: a Native of their fields --------------------------------------

_SENSORS: Final = frozenset(SensorData.__dataclass_fields__)
_JOINTS: Final = frozenset(JointData.__dataclass_fields__)


def sensors(data: SensorData) -> Message:
    """Return all sensors by kind, each as `{"values": Array, "time_s": float}`."""
    return Native(
        value={
            kind: [
                {"values": Array.of(sensor.values), "time_s": sensor.time_s}
                for sensor in getattr(data, kind)
            ]
            for kind in SensorData.__dataclass_fields__
        }
    )


def joints(data: JointData) -> Message:
    """Return all fields of `stateExt:o`, as `{"values": Array or words, "ok": bool}`."""
    value: dict[str, Any] = {}
    for field in dataclasses.fields(data):
        item: JointValues | JointModes = getattr(data, field.name)
        value[field.name] = {"values": _plain(item), "ok": item.ok}
    return Native(value=value)


def _plain(item: JointValues | JointModes) -> list[str] | Array:
    return [*map(str, item.words)] if isinstance(item, JointModes) else Array.of(item.values)


def object_of(value: object) -> SensorData | JointData | None:
    """Return what `sensors` or `joints` made a `Native` of, None if this is something else."""
    if not isinstance(value, dict):
        return None
    try:
        if value.keys() == _SENSORS:
            return SensorData(**{kind: tuple(map(_measurement, value[kind])) for kind in value})
        if value.keys() == _JOINTS:
            items: dict[str, Any] = {name: _joint_item(name, value[name]) for name in value}
            return JointData(**items)
    except (KeyError, TypeError, AttributeError) as error:
        raise EncodeError(f"these are no values of sensors or joints: {error!r}") from error
    return None


def _measurement(given: dict[str, Any]) -> Measurement:
    return Measurement(_doubles(given["values"]), given["time_s"])


def _joint_item(name: str, given: dict[str, Any]) -> JointValues | JointModes:
    if name in ("control_mode", "interaction_mode"):
        return JointModes(tuple(map(Vocab, given["values"])), given["ok"])
    return JointValues(_doubles(given["values"]), given["ok"])


def _doubles(values: Array) -> array[float]:
    if values.dtype != "<f8":
        raise EncodeError(f"YARP's measurements are '<f8', not {values.dtype!r}")
    return filled(array("d"), values.data)
