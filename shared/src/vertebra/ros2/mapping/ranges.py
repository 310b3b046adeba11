"""Laser scans and point clouds."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from vertebra.errors import DecodeError, EncodeError
from vertebra.messages import Array, LaserScan, PointCloud
from vertebra.ros2.mapping.parts import Record, frame_id, header

_TYPES: Final = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""`PointField.datatype` and NumPy's types."""
_NUMBERS: Final = {np.dtype(kind).newbyteorder("<"): number for number, kind in _TYPES.items()}
_FLOAT32: Final = 7
_COLORS: Final = ("rgb", {6, 7})
"""The field in which PCL packs red, green and blue, and the types that it says of it."""
_Shape = tuple[int, ...]


def scan(record: Record) -> LaserScan:
    """Read a `LaserScan`."""
    intensities: Array = record["intensities"]
    return LaserScan(
        ranges_m=record["ranges"],
        angle_min_rad=record["angle_min"],
        angle_increment_rad=record["angle_increment"],
        range_min_m=record["range_min"],
        range_max_m=record["range_max"],
        intensities=intensities if intensities.nbytes else None,
        frame_id=frame_id(record),
        angle_max_rad=record["angle_max"],
        time_increment_s=record["time_increment"],
        scan_time_s=record["scan_time"],
    )


def of_scan(message: LaserScan, stamp_ns: int) -> Record:
    """Make a `LaserScan`."""
    last = message.angle_max_rad
    if last is None:
        steps = max(message.ranges_m.shape[0] - 1, 0)
        last = message.angle_min_rad + steps * message.angle_increment_rad
    return {
        "header": header(message.frame_id, stamp_ns),
        "angle_min": message.angle_min_rad,
        "angle_max": last,
        "angle_increment": message.angle_increment_rad,
        "time_increment": message.time_increment_s,
        "scan_time": message.scan_time_s,
        "range_min": message.range_min_m,
        "range_max": message.range_max_m,
        "ranges": message.ranges_m,
        "intensities": [] if message.intensities is None else message.intensities,
    }


class _Points:
    """The bytes of a `PointCloud2`, looked at field by field."""

    def __init__(self, record: Record) -> None:
        height, width, step = record["height"], record["width"], record["point_step"]
        self._data: memoryview = record["data"].data
        if record["row_step"] != width * step or self._data.nbytes != height * width * step:
            raise DecodeError(
                f"{self._data.nbytes} bytes are no {width} x {height} points of {step} bytes in "
                f"rows of {record['row_step']} bytes"
            )
        self.shape: _Shape = (height, width) if height != 1 else (width,)
        self._strides: _Shape = (width * step, step) if height != 1 else (step,)
        self._step = step
        self._order = ">" if record["is_bigendian"] else "<"
        self.fields: dict[str, Record] = {field["name"]: field for field in record["fields"]}

    def view(self, name: str, kind: str, count: int) -> np.ndarray[Any, Any]:
        """Return a field of all points; more than one item of each makes another axis."""
        offset = self.fields[name]["offset"]
        dtype = np.dtype(self._order + kind)
        if offset + count * dtype.itemsize > self._step:
            raise DecodeError(f"the field {name!r} is not within the {self._step} bytes of a point")
        inner, strides = ((count,), (dtype.itemsize,)) if count != 1 else ((), ())
        shape = (*self.shape, *inner)
        if not self._data.nbytes:
            return np.empty(shape, dtype)
        return np.ndarray(shape, dtype, self._data, offset, (*self._strides, *strides))

    def array(self, name: str) -> Array:
        """Return a field as it is, copied unless its items lie side by side."""
        field = self.fields[name]
        kind = _TYPES.get(field["datatype"])
        if kind is None:
            raise DecodeError(f"the field {name!r} has no known type")
        return _little(self.view(name, kind, field["count"] or 1))


def _little(values: np.ndarray[Any, Any]) -> Array:
    dtype = values.dtype.newbyteorder("<")
    packed = np.ascontiguousarray(values, dtype)
    return Array(packed.reshape(-1).view(np.uint8).data, dtype.str, values.shape)


def cloud(record: Record) -> PointCloud | None:
    """Read a `PointCloud2` with x, y and z as floats."""
    points = _Points(record)
    fields = points.fields
    if len(fields) != len(record["fields"]) or any(
        axis not in fields or fields[axis]["datatype"] != _FLOAT32 or fields[axis]["count"] > 1
        for axis in "xyz"
    ):
        return None
    name, types = _COLORS
    has_colors = name in fields and fields[name]["datatype"] in types
    taken = {"x", "y", "z"} | ({name} if has_colors else set())
    return PointCloud(
        points_m=_positions(points),
        colors_rgb=_colors(points.view(name, "u4", 1)) if has_colors else None,
        frame_id=frame_id(record),
        channels={name: points.array(name) for name in fields if name not in taken},
    )


def _positions(points: _Points) -> Array:
    offsets = [points.fields[axis]["offset"] for axis in "xyz"]
    for axis in "yz":
        points.view(axis, "f4", 1)  # is within the point
    if offsets == [offsets[0], offsets[0] + 4, offsets[0] + 8]:
        return _little(points.view("x", "f4", 3))
    return _little(np.stack([points.view(axis, "f4", 1) for axis in "xyz"], axis=-1))


def _colors(packed: np.ndarray[Any, Any]) -> Array:
    colors = np.empty((*packed.shape, 3), np.uint8)
    for channel, shift in enumerate((16, 8, 0)):
        colors[..., channel] = packed >> shift
    return _little(colors)


def of_cloud(message: PointCloud, stamp_ns: int) -> Record:
    """Make a `PointCloud2`; the fields of a point lie side by side."""
    points = np.asarray(message.points_m)
    shape = points.shape[:-1]
    columns: dict[str, np.ndarray[Any, Any]] = {
        axis: points[..., index] for index, axis in enumerate("xyz")
    }
    if message.colors_rgb is not None:
        red, green, blue = np.moveaxis(np.asarray(message.colors_rgb).astype("<u4"), -1, 0)
        columns["rgb"] = red << 16 | green << 8 | blue
    for name, channel in message.channels.items():
        _check_channel(name, channel, columns.keys(), shape)
        columns[name] = np.asarray(channel)
    form = np.dtype(
        [(name, values.dtype, values.shape[len(shape) :]) for name, values in columns.items()]
    )
    data: memoryview | bytes = message.points_m.data
    if len(columns) > len("xyz"):
        packed = np.empty(shape, form)
        for name, values in columns.items():
            packed[name] = values
        data = packed.tobytes() if not packed.size else packed.reshape(-1).view(np.uint8).data
    return {
        "header": header(message.frame_id, stamp_ns),
        "height": shape[0] if len(shape) > 1 else 1,
        "width": shape[-1],
        "fields": [_field(name, form) for name in columns],
        "point_step": form.itemsize,
        "row_step": form.itemsize * shape[-1],
        "data": data,
        "is_dense": bool(np.isfinite(points).all()),
    }


def _check_channel(name: str, channel: Array, taken: Any, shape: _Shape) -> None:
    if name in taken or np.dtype(channel.dtype) not in _NUMBERS or len(channel.shape) > (
        len(shape) + 1
    ):  # fmt: skip
        raise EncodeError(
            f"the channel {name!r} of {channel.dtype!r} and shape {channel.shape} is no field of "
            "a PointCloud2"
        )
    if channel.shape[: len(shape)] != shape:
        raise EncodeError(f"the channel {name!r} has shape {channel.shape}, the points {shape}")


def _field(name: str, form: np.dtype[Any]) -> Record:
    kind, offset = form.fields[name][:2] if form.fields is not None else (form, 0)
    base, shape = kind.subdtype or (kind, ())
    number = _FLOAT32 if name == "rgb" else _NUMBERS[base]
    return {"name": name, "offset": offset, "datatype": number, "count": math.prod(shape)}
