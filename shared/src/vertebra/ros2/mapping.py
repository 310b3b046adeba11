"""What ROS 2 records mean on the backbone, and back; no I/O.

A type that is listed here becomes the message it means, in our units: joint angles and angular
velocities of an `Imu` in degrees. Every other record is a `Native` and goes back as it came.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple, get_args

import numpy as np

from vertebra.errors import DecodeError, EncodeError
from vertebra.messages import (
    PIXELS,
    Array,
    CompressedImage,
    Image,
    Imu,
    JointState,
    LaserScan,
    Message,
    Native,
    Odometry,
    PixelFormat,
    PointCloud,
    Pose,
    Quaternion,
    Text,
    Twist,
    Vector3,
)

Record = Mapping[str, Any]

ROS_FORMATS: Final[dict[str, PixelFormat]] = {
    **{name: name for name in get_args(PixelFormat) if name != "depth32f"},
    "32FC1": "depth32f",
    "8UC1": "mono8",
    "16UC1": "mono16",
}
"""`Image.encoding` of ROS and our pixel formats."""
CLOCKS_AGREE_WITHIN_NS: Final = 3600 * 10**9

_ENCODINGS: Final = {"depth32f": "32FC1"}
_FLOAT32: Final = 7
_POINT_BYTES: Final = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""`PointField.datatype` and NumPy's types."""


def captured_ns(record: Record, received_ns: int) -> int:
    """Return when a record was true: its stamp, unless that is from another clock or not set.

    A stamp more than an hour away from our clock (simulated time, or none) says nothing here.
    """
    header = record.get("header", record)
    stamp = header.get("stamp") if isinstance(header, Mapping) else None
    if not isinstance(stamp, Mapping) or stamp.keys() != {"sec", "nanosec"}:
        return received_ns
    stamped_ns: int = stamp["sec"] * 10**9 + stamp["nanosec"]
    return stamped_ns if abs(stamped_ns - received_ns) < CLOCKS_AGREE_WITHIN_NS else received_ns


def to_message(record: Record, type_name: str) -> Message:
    """Return the message that a record means; raise `DecodeError` if its values do not fit."""
    pair = _PAIRS.get(type_name)
    if pair is None:
        return Native(value=record)
    try:
        return pair.to_message(record)
    except ValueError as error:
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


class _Pair(NamedTuple):
    message: type[Message]
    to_message: Callable[[Record], Message]
    to_record: Callable[[Any, int], Record]


def _header(frame_id: str, stamp_ns: int) -> Record:
    return {
        "stamp": {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9},
        "frame_id": frame_id,
    }


def _text(record: Record) -> Text:
    return Text(text=record["data"])


def _of_text(message: Text, _: int) -> Record:
    return {"data": message.text}


def _image(record: Record) -> Image:
    pixel_format = ROS_FORMATS.get(record["encoding"])
    if pixel_format is None:
        raise DecodeError(
            f"images of encoding {record['encoding']!r} have no message; "
            f"known: {', '.join(ROS_FORMATS)}"
        )
    dtype, channels = PIXELS[pixel_format]
    height, width, step = record["height"], record["width"], record["step"]
    item = np.dtype(dtype)
    row_bytes = width * channels * item.itemsize
    pixels = np.asarray(record["data"])
    if step < row_bytes or pixels.size != height * step:
        raise DecodeError(
            f"{pixels.size} bytes are no {width} x {height} image of {pixel_format} "
            f"with rows of {step} bytes"
        )
    if step != row_bytes:
        pixels = np.ascontiguousarray(pixels.reshape(height, step)[:, :row_bytes]).ravel()
    if record["is_bigendian"] and item.itemsize > 1:
        pixels = pixels.view(item).byteswap().view(np.uint8)
    shape = (height, width) + ((channels,) if channels > 1 else ())
    return Image(
        pixels=Array(pixels.data if pixels.size else b"", dtype, shape),
        pixel_format=pixel_format,
        frame_id=record["header"]["frame_id"],
    )


def _of_image(message: Image, stamp_ns: int) -> Record:
    pixels = message.pixels
    return {
        "header": _header(message.frame_id, stamp_ns),
        "height": message.height,
        "width": message.width,
        "encoding": _ENCODINGS.get(message.pixel_format, message.pixel_format),
        "is_bigendian": 0,
        "step": pixels.nbytes // message.height if message.height else 0,
        "data": pixels.data,
    }


def _compressed(record: Record) -> CompressedImage:
    words = record["format"].lower()
    kind = next((name for name in ("jpeg", "png", "tiff", "webp") if name in words), "")
    if not kind:
        kind = "jpeg" if "jpg" in words else ""
    if not kind:
        raise DecodeError(f"a compressed image of format {record['format']!r} is not known here")
    return CompressedImage(
        data=record["data"], media_type=f"image/{kind}", frame_id=record["header"]["frame_id"]
    )


def _of_compressed(message: CompressedImage, stamp_ns: int) -> Record:
    return {
        "header": _header(message.frame_id, stamp_ns),
        "format": message.media_type.removeprefix("image/"),
        "data": message.data,
    }


def _degrees(values: Array) -> tuple[float, ...]:
    return tuple(map(math.degrees, values.tolist()))


def _radians(values: Sequence[float]) -> list[float]:
    return list(map(math.radians, values))


def _joints(record: Record) -> JointState:
    return JointState(
        names=tuple(record["name"]),
        positions_deg=_degrees(record["position"]),
        velocities_deg_s=_degrees(record["velocity"]),
        efforts_nm=tuple(record["effort"].tolist()),
    )


def _of_joints(message: JointState, stamp_ns: int) -> Record:
    sliding = [kind == "prismatic" for kind in message.kinds] or [False] * len(message.names)

    def si(values: Sequence[float]) -> list[float]:
        pairs = zip(values, sliding, strict=True) if values else ()
        return [value if slides else math.radians(value) for value, slides in pairs]

    return {
        "header": _header("", stamp_ns),
        "name": list(message.names),
        "position": si(message.positions_deg),
        "velocity": si(message.velocities_deg_s),
        "effort": list(message.efforts_nm),
    }


def _vector(record: Record) -> Vector3:
    return (record["x"], record["y"], record["z"])


def _of_vector(vector: Vector3) -> Record:
    return dict(zip("xyz", vector, strict=True))


def _quaternion(record: Record) -> Quaternion:
    return (record["x"], record["y"], record["z"], record["w"])


def _of_quaternion(quaternion: Quaternion) -> Record:
    return dict(zip("xyzw", quaternion, strict=True))


def _measured(record: Record, part: str) -> bool:
    """Say whether an IMU measures a part: -1 in its covariance says that it does not."""
    covariance = record[f"{part}_covariance"].tolist()
    return bool(covariance[0] != -1)


def _imu(record: Record) -> Imu:
    x, y, z = map(math.degrees, _vector(record["angular_velocity"]))
    return Imu(
        orientation_xyzw=(
            _quaternion(record["orientation"]) if _measured(record, "orientation") else None
        ),
        angular_velocity_deg_s=(x, y, z) if _measured(record, "angular_velocity") else None,
        linear_acceleration_m_s2=(
            _vector(record["linear_acceleration"])
            if _measured(record, "linear_acceleration")
            else None
        ),
        frame_id=record["header"]["frame_id"],
    )


def _of_imu(message: Imu, stamp_ns: int) -> Record:
    record: dict[str, Any] = {"header": _header(message.frame_id, stamp_ns)}
    angular, linear = message.angular_velocity_deg_s, message.linear_acceleration_m_s2
    if message.orientation_xyzw is not None:
        record["orientation"] = _of_quaternion(message.orientation_xyzw)
    if angular is not None:
        x, y, z = map(math.radians, angular)
        record["angular_velocity"] = _of_vector((x, y, z))
    if linear is not None:
        record["linear_acceleration"] = _of_vector(linear)
    for part in ("orientation", "angular_velocity", "linear_acceleration"):
        if part not in record:
            record[f"{part}_covariance"] = [-1.0, *([0.0] * 8)]
    record.setdefault("orientation", _of_quaternion((0.0, 0.0, 0.0, 1.0)))
    return record


def _pose(record: Record, frame_id: str = "") -> Pose:
    return Pose(
        position_m=_vector(record["position"]),
        orientation_xyzw=_quaternion(record["orientation"]),
        frame_id=frame_id,
    )


def _of_pose(message: Pose, _: int = 0) -> Record:
    return {
        "position": _of_vector(message.position_m),
        "orientation": _of_quaternion(message.orientation_xyzw),
    }


def _pose_stamped(record: Record) -> Pose:
    return _pose(record["pose"], record["header"]["frame_id"])


def _of_pose_stamped(message: Pose, stamp_ns: int) -> Record:
    return {"header": _header(message.frame_id, stamp_ns), "pose": _of_pose(message)}


def _twist(record: Record, frame_id: str = "") -> Twist:
    return Twist(
        linear_m_s=_vector(record["linear"]),
        angular_rad_s=_vector(record["angular"]),
        frame_id=frame_id,
    )


def _of_twist(message: Twist, _: int = 0) -> Record:
    return {
        "linear": _of_vector(message.linear_m_s),
        "angular": _of_vector(message.angular_rad_s),
    }


def _twist_stamped(record: Record) -> Twist:
    return _twist(record["twist"], record["header"]["frame_id"])


def _of_twist_stamped(message: Twist, stamp_ns: int) -> Record:
    return {"header": _header(message.frame_id, stamp_ns), "twist": _of_twist(message)}


def _odometry(record: Record) -> Odometry:
    child = record["child_frame_id"]
    return Odometry(
        pose=_pose(record["pose"]["pose"], record["header"]["frame_id"]),
        twist=_twist(record["twist"]["twist"], child),
        child_frame_id=child,
    )


def _of_odometry(message: Odometry, stamp_ns: int) -> Record:
    return {
        "header": _header(message.pose.frame_id, stamp_ns),
        "child_frame_id": message.child_frame_id,
        "pose": {"pose": _of_pose(message.pose)},
        "twist": {"twist": _of_twist(message.twist)},
    }


def _scan(record: Record) -> LaserScan:
    intensities: Array = record["intensities"]
    return LaserScan(
        ranges_m=record["ranges"],
        angle_min_rad=record["angle_min"],
        angle_increment_rad=record["angle_increment"],
        range_min_m=record["range_min"],
        range_max_m=record["range_max"],
        intensities=intensities if intensities.nbytes else None,
        frame_id=record["header"]["frame_id"],
    )


def _of_scan(message: LaserScan, stamp_ns: int) -> Record:
    steps = max(message.ranges_m.shape[0] - 1, 0)
    return {
        "header": _header(message.frame_id, stamp_ns),
        "angle_min": message.angle_min_rad,
        "angle_max": message.angle_min_rad + steps * message.angle_increment_rad,
        "angle_increment": message.angle_increment_rad,
        "range_min": message.range_min_m,
        "range_max": message.range_max_m,
        "ranges": message.ranges_m,
        "intensities": [] if message.intensities is None else message.intensities,
    }


def _cloud(record: Record) -> PointCloud:
    height, width, step = record["height"], record["width"], record["point_step"]
    order = ">" if record["is_bigendian"] else "<"
    fields = {field["name"]: field for field in record["fields"]}
    if not {"x", "y", "z"} <= fields.keys():
        raise DecodeError(f"a point cloud has x, y and z, this one has {', '.join(fields)}")
    data = np.asarray(record["data"])
    if record["row_step"] != width * step or data.size != height * width * step:
        raise DecodeError(
            f"{data.size} bytes are no {width} x {height} points of {step} bytes in rows of "
            f"{record['row_step']} bytes"
        )
    shape = (height, width) if height != 1 else (width,)

    def column(name: str, dtype: str) -> np.ndarray[Any, Any]:
        offset = fields[name]["offset"]
        if offset + np.dtype(dtype).itemsize > step:
            raise DecodeError(f"the field {name!r} is not within the {step} bytes of a point")
        return np.ndarray(
            shape, dtype, data, offset, (width * step, step) if height != 1 else (step,)
        )

    points = np.empty((*shape, 3), "<f4")
    colors = np.empty((*shape, 3), "|u1") if "rgb" in fields else None
    if data.size:
        for axis, name in enumerate("xyz"):
            kind = _POINT_BYTES.get(fields[name]["datatype"])
            if kind is None:
                raise DecodeError(f"the field {name!r} has no known type")
            points[..., axis] = column(name, order + kind)
        if colors is not None:
            packed = column("rgb", order + "u4")
            for channel, shift in enumerate((16, 8, 0)):
                colors[..., channel] = packed >> shift
    return PointCloud(
        points_m=Array.of(points.data) if points.size else Array(b"", "<f4", points.shape),
        colors_rgb=(
            None
            if colors is None
            else Array.of(colors.data)
            if colors.size
            else Array(b"", "|u1", colors.shape)
        ),
        frame_id=record["header"]["frame_id"],
    )


def _of_cloud(message: PointCloud, stamp_ns: int) -> Record:
    shape = message.points_m.shape[:-1]
    names = ["x", "y", "z"] + (["rgb"] if message.colors_rgb is not None else [])
    cloud = np.empty(
        math.prod(shape), [(name, "<u4" if name == "rgb" else "<f4") for name in names]
    )
    points = np.asarray(message.points_m).reshape(-1, 3)
    for axis, name in enumerate("xyz"):
        cloud[name] = points[:, axis]
    if message.colors_rgb is not None:
        red, green, blue = np.asarray(message.colors_rgb).reshape(-1, 3).astype("<u4").T
        cloud["rgb"] = red << 16 | green << 8 | blue
    width = shape[-1]
    step = cloud.dtype.itemsize
    return {
        "header": _header(message.frame_id, stamp_ns),
        "height": shape[0] if len(shape) > 1 else 1,
        "width": width,
        "fields": [
            {"name": name, "offset": 4 * index, "datatype": _FLOAT32, "count": 1}
            for index, name in enumerate(names)
        ],
        "point_step": step,
        "row_step": step * width,
        "data": cloud.tobytes(),
        "is_dense": bool(np.isfinite(points).all()),
    }


_PAIRS: Final[dict[str, _Pair]] = {
    "std_msgs/msg/String": _Pair(Text, _text, _of_text),
    "sensor_msgs/msg/Image": _Pair(Image, _image, _of_image),
    "sensor_msgs/msg/CompressedImage": _Pair(CompressedImage, _compressed, _of_compressed),
    "sensor_msgs/msg/JointState": _Pair(JointState, _joints, _of_joints),
    "sensor_msgs/msg/Imu": _Pair(Imu, _imu, _of_imu),
    "geometry_msgs/msg/PoseStamped": _Pair(Pose, _pose_stamped, _of_pose_stamped),
    "geometry_msgs/msg/Pose": _Pair(Pose, _pose, _of_pose),
    "geometry_msgs/msg/Twist": _Pair(Twist, _twist, _of_twist),
    "geometry_msgs/msg/TwistStamped": _Pair(Twist, _twist_stamped, _of_twist_stamped),
    "nav_msgs/msg/Odometry": _Pair(Odometry, _odometry, _of_odometry),
    "sensor_msgs/msg/LaserScan": _Pair(LaserScan, _scan, _of_scan),
    "sensor_msgs/msg/PointCloud2": _Pair(PointCloud, _cloud, _of_cloud),
}
"""The first type of a message is the one it goes out as."""
