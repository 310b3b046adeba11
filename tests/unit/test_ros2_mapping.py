"""What ROS 2 records mean, and back, through their bytes."""

from __future__ import annotations

import math
import struct
from typing import Any

import msgspec
import numpy as np
import pytest

from vertebra.errors import DecodeError, EncodeError
from vertebra.messages import (
    PIXELS,
    Array,
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
from vertebra.ros2 import mapping
from vertebra.ros2.cdr import Cdr
from vertebra.ros2.definitions import Types
from vertebra.ros2.mapping.media import COMPRESSED_DEPTH

CDR = Cdr(Types.standard())
STAMP_NS = 1_700_000_000_123_456_789


def there_and_back(message: Message, type_name: str) -> Message:
    payload = CDR.encode(mapping.to_record(message, type_name, STAMP_NS), type_name)
    record = CDR.decode(payload, type_name)
    if "header" in record:
        assert mapping.captured_ns(record, STAMP_NS + 5) == STAMP_NS
    return mapping.to_message(record, type_name)


def floats(*values: float) -> Array:
    return Array(struct.pack(f"<{len(values)}f", *values), "<f4", (len(values),))


def floats_of(*shape: int) -> Array:
    return Array(floats(*range(math.prod(shape))).data, "<f4", shape)


POSE = Pose(position_m=(1.0, 2.0, 3.0), orientation_xyzw=(0.0, 0.0, 0.6, 0.8), frame_id="odom")
TWIST = Twist(linear_m_s=(1.0, 0.0, 0.0), angular_rad_s=(0.0, 0.0, 0.5), frame_id="base")
COVARIANCE = tuple(index / 10 for index in range(36))
SURE_POSE = msgspec.structs.replace(POSE, covariance_m_rad=COVARIANCE)
SURE_TWIST = msgspec.structs.replace(TWIST, covariance_m_s_rad_s=COVARIANCE)
HERE = {"frame_id": ""}
MESSAGES: list[tuple[str, Message]] = [
    ("std_msgs/msg/String", Text(text="hello")),
    (
        "sensor_msgs/msg/Image",
        Image(pixels=Array(bytes(range(24)), "|u1", (2, 4, 3)), pixel_format="rgb8", frame_id="c"),
    ),
    (
        "sensor_msgs/msg/Image",
        Image(pixels=Array(bytes(range(32)), "<f4", (2, 4)), pixel_format="depth32f"),
    ),
    ("sensor_msgs/msg/Image", Image(pixels=Array(b"", "|u1", (0, 0)), pixel_format="mono8")),
    (
        "sensor_msgs/msg/CompressedImage",
        CompressedImage(
            data=Array(b"\xff\xd8\xff\xe0", "|u1", (4,)),
            media_type="image/jpeg",
            frame_id="camera",
            format="rgb8; jpeg compressed bgr8",
        ),
    ),
    ("geometry_msgs/msg/PoseStamped", POSE),
    ("geometry_msgs/msg/TwistStamped", TWIST),
    ("geometry_msgs/msg/Twist", Twist(linear_m_s=(0.1, 0.2, 0.3))),
    ("geometry_msgs/msg/PoseWithCovarianceStamped", SURE_POSE),
    ("geometry_msgs/msg/PoseWithCovariance", msgspec.structs.replace(SURE_POSE, **HERE)),
    ("geometry_msgs/msg/TwistWithCovarianceStamped", SURE_TWIST),
    ("geometry_msgs/msg/TwistWithCovariance", msgspec.structs.replace(SURE_TWIST, **HERE)),
    ("nav_msgs/msg/Odometry", Odometry(pose=POSE, twist=TWIST, child_frame_id="base")),
    ("nav_msgs/msg/Odometry", Odometry(pose=SURE_POSE, twist=SURE_TWIST, child_frame_id="base")),
    (
        "sensor_msgs/msg/LaserScan",
        LaserScan(
            ranges_m=floats(1.0, 2.0, math.inf),
            angle_min_rad=-1.0,
            angle_increment_rad=0.5,
            range_min_m=0.125,
            range_max_m=8.0,
            intensities=floats(1.0, 2.0, 3.0),
            frame_id="laser",
            angle_max_rad=0.25,
            time_increment_s=0.5,
            scan_time_s=1.5,
        ),
    ),
    (
        "sensor_msgs/msg/PointCloud2",
        PointCloud(points_m=Array(floats(*range(6)).data, "<f4", (2, 3)), frame_id="depth"),
    ),
    (
        "sensor_msgs/msg/PointCloud2",
        PointCloud(
            points_m=Array(floats(*range(12)).data, "<f4", (2, 2, 3)),
            colors_rgb=Array(bytes(range(12)), "|u1", (2, 2, 3)),
        ),
    ),
    ("sensor_msgs/msg/PointCloud2", PointCloud(points_m=Array(b"", "<f4", (0, 3)))),
    (
        "sensor_msgs/msg/PointCloud2",
        PointCloud(
            points_m=Array(floats(*range(6)).data, "<f4", (2, 3)),
            channels={
                "intensity": floats(0.5, 1.5),
                "ring": Array(bytes([1, 0, 2, 0]), "<u2", (2,)),
                "normal": Array(floats(*range(6)).data, "<f4", (2, 3)),
            },
        ),
    ),
    ("sensor_msgs/msg/Imu", Imu(linear_acceleration_m_s2=(0.0, 0.0, 9.8), frame_id="imu")),
    (
        "sensor_msgs/msg/Imu",
        Imu(
            orientation_xyzw=(0.0, 0.0, 0.6, 0.8),
            linear_acceleration_m_s2=(0.0, 0.0, 9.8),
            orientation_covariance_rad2=COVARIANCE[:9],
            linear_acceleration_covariance_m2_s4=COVARIANCE[9:18],
        ),
    ),
    ("sensor_msgs/msg/JointState", JointState(names=(), positions_deg=(), frame_id="base")),
]


@pytest.mark.parametrize(("type_name", "message"), MESSAGES)
def test_message_comes_back(type_name: str, message: Message) -> None:
    assert there_and_back(message, type_name) == message


def test_joints_are_radians_in_ros() -> None:
    joints = JointState(
        names=("pan", "lift"), positions_deg=(90.0, 0.25), kinds=("revolute", "prismatic")
    )
    record = mapping.to_record(joints, "sensor_msgs/msg/JointState", STAMP_NS)
    assert record["position"] == [math.pi / 2, 0.25]
    back = there_and_back(
        JointState(names=("pan",), positions_deg=(180.0,), velocities_deg_s=(9.0,)),
        "sensor_msgs/msg/JointState",
    )
    assert isinstance(back, JointState)
    assert back.positions_deg == pytest.approx((180.0,))
    assert back.velocities_deg_s == pytest.approx((9.0,))


def test_joints_without_positions_go_as_they_came() -> None:
    name = "sensor_msgs/msg/JointState"
    payload = CDR.encode({"name": ["a"], "effort": [1.0]}, name)
    message = mapping.to_message(CDR.decode(payload, name), name)
    assert isinstance(message, Native)
    assert CDR.encode(mapping.to_record(message, name, 0), name) == payload


def test_joints_that_do_not_fit_are_refused() -> None:
    name = "sensor_msgs/msg/JointState"
    record = CDR.decode(CDR.encode({"name": ["a"], "position": [1.0, 2.0]}, name), name)
    with pytest.raises(DecodeError, match=f"{name}: positions_deg has 2 values for 1 joints"):
        mapping.to_message(record, name)


def test_angular_velocity_is_radians_in_ros() -> None:
    imu = Imu(
        orientation_xyzw=(0.0, 0.0, 0.0, 1.0),
        angular_velocity_deg_s=(0.0, 0.0, 180.0),
        angular_velocity_covariance_deg2_s2=(180.0**2, *[0.0] * 8),
    )
    record = mapping.to_record(imu, "sensor_msgs/msg/Imu", STAMP_NS)
    assert record["angular_velocity"]["z"] == pytest.approx(math.pi)
    assert record["angular_velocity_covariance"][0] == pytest.approx(math.pi**2)
    assert record["linear_acceleration_covariance"][0] == -1.0
    back = there_and_back(imu, "sensor_msgs/msg/Imu")
    assert isinstance(back, Imu)
    assert back.linear_acceleration_m_s2 is None
    assert back.angular_velocity_deg_s == pytest.approx((0.0, 0.0, 180.0))
    assert back.angular_velocity_covariance_deg2_s2[0] == pytest.approx(180.0**2)


def image(**fields: Any) -> dict[str, Any]:
    given = {"height": 2, "width": 2, "encoding": "mono8", "step": 2, "data": bytes(4)} | fields
    return CDR.decode(CDR.encode(given, "sensor_msgs/msg/Image"), "sensor_msgs/msg/Image")


def test_image_is_not_copied_on_its_way_in() -> None:
    payload = CDR.encode(
        {"height": 1, "width": 4, "encoding": "mono8", "step": 4, "data": b"abcd"},
        "sensor_msgs/msg/Image",
    )
    message = mapping.to_message(
        CDR.decode(payload, "sensor_msgs/msg/Image"), "sensor_msgs/msg/Image"
    )
    assert isinstance(message, Image)
    assert np.shares_memory(np.asarray(message.pixels), np.frombuffer(payload, "u1"))


def test_padding_of_rows_goes() -> None:
    message = mapping.to_message(image(step=4, data=bytes(range(8))), "sensor_msgs/msg/Image")
    assert isinstance(message, Image)
    assert bytes(message.pixels.data) == bytes([0, 1, 4, 5])


def test_big_endian_pixels_are_turned() -> None:
    message = mapping.to_message(
        image(width=1, encoding="mono16", is_bigendian=1, data=b"\x01\x02\x03\x04"),
        "sensor_msgs/msg/Image",
    )
    assert isinstance(message, Image)
    assert bytes(message.pixels.data) == b"\x02\x01\x04\x03"


@pytest.mark.parametrize(
    ("fields", "told"),
    [
        ({"step": 1}, "rows of 1 bytes"),
        ({"height": 3}, "4 bytes are no 2 x 3 image"),
        ({"height": 2**32 - 1, "width": 2**32 - 1, "step": 2**32 - 1}, "4 bytes are no"),
    ],
)
def test_image_that_does_not_fit_is_refused(fields: dict[str, Any], told: str) -> None:
    with pytest.raises(DecodeError, match=told):
        mapping.to_message(image(**fields), "sensor_msgs/msg/Image")


XYZ: list[dict[str, Any]] = [
    {"name": name, "offset": 4 * index, "datatype": 7} for index, name in enumerate("xyz")
]


def cloud(**fields: Any) -> dict[str, Any]:
    given: dict[str, Any] = {
        "height": 1, "width": 1, "fields": XYZ, "point_step": 12, "row_step": 12,
        "data": bytes(12),
    }  # fmt: skip
    name = "sensor_msgs/msg/PointCloud2"
    return CDR.decode(CDR.encode(given | fields, name), name)


def there_as_it_came(record: dict[str, Any], type_name: str) -> None:
    """Hold that a record is a Native, and the same bytes again."""
    payload = CDR.encode(record, type_name)
    message = mapping.to_message(CDR.decode(payload, type_name), type_name)
    assert isinstance(message, Native)
    assert CDR.encode(mapping.to_record(message, type_name, 0), type_name) == payload


@pytest.mark.parametrize("encoding", ["nv21", "8UC5", "depth32f", "32FC", "made up", ""])
def test_image_of_another_encoding_goes_as_it_came(encoding: str) -> None:
    record = {"height": 2, "width": 2, "encoding": encoding, "step": 2, "data": bytes(6)}
    there_as_it_came(record, "sensor_msgs/msg/Image")


ENCODINGS = sorted({"32FC1", *PIXELS} - {"depth32f"})


@pytest.mark.parametrize("is_bigendian", [0, 1])
@pytest.mark.parametrize("padding", [0, 3])
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_every_encoding_goes_back_with_its_values(
    encoding: str, padding: int, is_bigendian: int
) -> None:
    dtype, channels = PIXELS["depth32f" if encoding == "32FC1" else encoding]
    item = np.dtype(dtype).newbyteorder(">" if is_bigendian else "<")
    values = np.arange(2 * 4 * channels).reshape(2, 4 * channels).astype(item)
    rows = b"".join(row.tobytes() + bytes(padding) for row in values)
    step = len(rows) // 2
    name = "sensor_msgs/msg/Image"
    given = image(
        width=4, encoding=encoding, is_bigendian=is_bigendian, step=step, data=rows,
    )  # fmt: skip
    message = mapping.to_message(given, name)
    assert isinstance(message, Image)
    assert np.array_equal(np.asarray(message.pixels).reshape(2, -1), values)
    back = mapping.to_record(message, name, 0)
    assert (back["encoding"], back["is_bigendian"], back["step"]) == (encoding, 0, step - padding)
    assert np.array_equal(np.frombuffer(back["data"], dtype).reshape(2, -1), values)


@pytest.mark.parametrize(
    ("words", "data", "media_type"),
    [
        ("rgb8; jpeg compressed bgr8", b"\xff\xd8\xff\xdb", "image/jpeg"),
        ("", b"\xff\xd8\xff\xdb", "image/jpeg"),
        ("jpeg", b"\x89PNG\r\n\x1a\n", "image/png"),  # what the data says counts
        ("jpg", b"?", "image/jpeg"),
        ("mono16; png compressed ", b"?", "image/png"),
        ("bgr8; tiff compressed ", b"II*\0", "image/tiff"),
        ("webp", b"RIFF", "image/webp"),
        ("h264", b"\0\0\0\1", "video/h264"),
        ("hevc", b"\0\0\0\1", "video/h265"),
        ("16UC1; compressedDepth png", bytes(12), COMPRESSED_DEPTH),
        ("32FC1; compressedDepth rvl", b"\xff\xd8\xff\xdb", COMPRESSED_DEPTH),
        ("zstd", b"", "application/octet-stream"),
    ],
)
def test_compressed_image_of_any_format(words: str, data: bytes, media_type: str) -> None:
    name = "sensor_msgs/msg/CompressedImage"
    payload = CDR.encode({"format": words, "data": data}, name)
    message = mapping.to_message(CDR.decode(payload, name), name)
    assert isinstance(message, CompressedImage)
    assert message.media_type == media_type
    if words:
        assert CDR.encode(mapping.to_record(message, name, 0), name) == payload


def test_compressed_image_of_ours_says_its_format() -> None:
    message = CompressedImage(data=Array(b"x", "|u1", (1,)), media_type="image/png")
    record = mapping.to_record(message, "sensor_msgs/msg/CompressedImage", 0)
    assert record["format"] == "png"


@pytest.mark.parametrize(
    ("fields", "told"),
    [
        ({"row_step": 5}, "rows of 5 bytes"),
        ({"data": bytes(11)}, "11 bytes are no"),
        ({"point_step": 8, "row_step": 8, "data": bytes(8)}, "is not within the 8 bytes"),
        ({"fields": [*XYZ, {"name": "t", "datatype": 99}]}, "'t' has no known type"),
        (
            {"fields": [*XYZ, {"name": "t", "datatype": 2, "count": 2**32 - 1}]},
            "'t' is not within the 12 bytes",
        ),
    ],
)
def test_cloud_that_does_not_fit_is_refused(fields: dict[str, Any], told: str) -> None:
    with pytest.raises(DecodeError, match=told):
        mapping.to_message(cloud(**fields), "sensor_msgs/msg/PointCloud2")


@pytest.mark.parametrize(
    "fields",
    [
        [],
        [{"name": "range", "datatype": 7}],
        [{**field, "datatype": 8, "offset": 0} for field in XYZ],  # doubles would be cut short
        [*XYZ, XYZ[0]],
        [*XYZ[:2], {**XYZ[2], "count": 2}],
    ],
)
def test_cloud_that_has_no_message_goes_as_it_came(fields: list[dict[str, Any]]) -> None:
    record = {
        "height": 1, "width": 1, "fields": fields, "point_step": 12, "row_step": 12,
        "data": bytes(12),
    }  # fmt: skip
    there_as_it_came(record, "sensor_msgs/msg/PointCloud2")


def test_cloud_as_a_lidar_sends_it() -> None:
    point = np.dtype(
        {
            "names": ["x", "y", "z", "rgb", "intensity", "ring"],
            "formats": [">f4", ">f4", ">f4", ">u4", ">f4", ">u2"],
            "offsets": [0, 4, 8, 12, 20, 24],
            "itemsize": 32,
        }
    )
    points = np.zeros((2, 3), point)
    for name in ("x", "y", "z", "intensity", "ring"):
        points[name] = np.arange(6).reshape(2, 3) + ord(name[0])
    points["rgb"] = 0x00102030
    fields = [
        {"name": name, "offset": offset, "datatype": 4 if name == "ring" else 7, "count": 1}
        for name, offset in zip(point.names or (), (0, 4, 8, 12, 20, 24), strict=True)
    ]
    record = cloud(
        height=2, width=3, fields=fields, is_bigendian=True, point_step=32, row_step=96,
        data=points.tobytes(),
    )  # fmt: skip
    message = mapping.to_message(record, "sensor_msgs/msg/PointCloud2")
    assert isinstance(message, PointCloud)
    assert np.array_equal(np.asarray(message.points_m)[..., 2], points["z"])
    assert np.asarray(message.colors_rgb)[1, 2].tolist() == [0x10, 0x20, 0x30]
    assert {name: array.dtype for name, array in message.channels.items()} == {
        "intensity": "<f4",
        "ring": "<u2",
    }
    back = there_and_back(message, "sensor_msgs/msg/PointCloud2")
    assert back == message


def test_points_alone_are_not_copied() -> None:
    points = PointCloud(points_m=floats_of(100, 3))
    record = mapping.to_record(points, "sensor_msgs/msg/PointCloud2", 0)
    assert np.shares_memory(np.asarray(points.points_m), np.frombuffer(record["data"], "u1"))
    payload = CDR.encode(record, "sensor_msgs/msg/PointCloud2")
    back = mapping.to_message(
        CDR.decode(payload, "sensor_msgs/msg/PointCloud2"), "sensor_msgs/msg/PointCloud2"
    )
    assert isinstance(back, PointCloud)
    assert np.shares_memory(np.asarray(back.points_m), np.frombuffer(payload, "u1"))


@pytest.mark.parametrize(
    ("channels", "told"),
    [
        ({"x": floats(1.0)}, "'x' .* is no field"),
        ({"when": Array(bytes(8), "<i8", (1,))}, "'when' of '<i8'"),
        ({"far": floats(1.0, 2.0)}, r"'far' has shape \(2,\), the points \(1,\)"),
        ({"deep": Array(bytes(4), "<f4", (1, 1, 1))}, "'deep' .* is no field"),
    ],
)
def test_channel_that_is_no_field_is_refused(channels: dict[str, Array], told: str) -> None:
    message = PointCloud(points_m=floats_of(1, 3), channels=channels)
    with pytest.raises(EncodeError, match=told):
        mapping.to_record(message, "sensor_msgs/msg/PointCloud2", 0)


CHUNK = AudioChunk(
    samples=Array(bytes(range(12)), "<i2", (3, 2)), rate_hz=16000, frame_id="microphone"
)
SOUND = mapping.Sound(rate_hz=16000, channels=2)


@pytest.mark.parametrize("name", ["AudioData", "AudioDataStamped"])
def test_sound_of_ros_drivers_is_what_the_route_says(name: str) -> None:
    type_name = f"audio_common_msgs/msg/{name}"
    payload = CDR.encode(mapping.to_record(CHUNK, type_name, STAMP_NS), type_name)
    record = CDR.decode(payload, type_name)
    message = mapping.to_message(record, type_name, SOUND)
    assert message == (
        CHUNK if name.endswith("Stamped") else msgspec.structs.replace(CHUNK, **HERE)
    )
    bytes_alone = mapping.to_message(record, type_name)
    assert isinstance(bytes_alone, Native)
    assert CDR.encode(mapping.to_record(bytes_alone, type_name, 0), type_name) == payload
    with pytest.raises(DecodeError, match=r"12 bytes are no samples '<f4' of 2 channels"):
        mapping.to_message(record, type_name, mapping.Sound(rate_hz=1, channels=2, format="F32LE"))


def test_sound_says_what_it_is_in_a_topic_of_its_own() -> None:
    record = mapping.to_record(CHUNK, "audio_common_msgs/msg/AudioInfo", 0)
    assert CDR.decode(
        CDR.encode(record, "audio_common_msgs/msg/AudioInfo"), "audio_common_msgs/msg/AudioInfo"
    ) == {
        "channels": 2,
        "sample_rate": 16000,
        "sample_format": "S16LE",
        "bitrate": 512000,
        "coding_format": "wave",
    }


MGONZS13 = {
    "AudioData": "float32[] float32_data\nint32[] int32_data\nint16[] int16_data\n"
    "int8[] int8_data\nuint8[] uint8_data",
    "AudioInfo": "int32 format\nint32 channels\nint32 rate\nint32 chunk",
    "Audio": "AudioData audio_data\nAudioInfo info",
    "AudioStamped": "std_msgs/Header header\nAudio audio",
}


@pytest.fixture(scope="module")
def mgonzs13(tmp_path_factory: pytest.TempPathFactory) -> Cdr:
    """Return what reads the types of a lab that has the other audio_common_msgs."""
    root = tmp_path_factory.mktemp("ros")
    folder = root / "audio_common_msgs" / "msg"
    folder.mkdir(parents=True)
    for name, text in MGONZS13.items():
        (folder / f"{name}.msg").write_text(text)
    return Cdr(Types.standard(root))


@pytest.mark.parametrize("dtype", ["<i2", "<f4"])
@pytest.mark.parametrize("name", ["Audio", "AudioStamped"])
def test_sound_of_mgonzs13(mgonzs13: Cdr, name: str, dtype: str) -> None:
    type_name = f"audio_common_msgs/msg/{name}"
    shape = (12 // (2 * int(dtype[2])), 2) if dtype == "<i2" else (3, 1)
    chunk = AudioChunk(
        samples=Array(bytes(range(12)), dtype, shape),
        rate_hz=44100,
        frame_id="ear" if name == "AudioStamped" else "",
    )
    payload = mgonzs13.encode(mapping.to_record(chunk, type_name, STAMP_NS), type_name)
    assert mapping.to_message(mgonzs13.decode(payload, type_name), type_name) == chunk


def test_sound_of_mgonzs13_in_other_samples_goes_as_it_came(mgonzs13: Cdr) -> None:
    name = "audio_common_msgs/msg/Audio"
    record = {"audio_data": {"uint8_data": [1, 2]}, "info": {"format": 32, "channels": 1}}
    payload = mgonzs13.encode(record, name)
    message = mapping.to_message(mgonzs13.decode(payload, name), name)
    assert isinstance(message, Native)
    assert mgonzs13.encode(mapping.to_record(message, name, 0), name) == payload


def test_sound_of_mgonzs13_without_channels_is_refused(mgonzs13: Cdr) -> None:
    name = "audio_common_msgs/msg/Audio"
    record = mgonzs13.decode(mgonzs13.encode({"info": {"format": 8}}, name), name)
    with pytest.raises(DecodeError, match="of 0 channels"):
        mapping.to_message(record, name)


@pytest.mark.parametrize(
    ("name", "record"),
    [
        ("geometry_msgs/msg/PoseArray", {"poses": [{"position": {"x": 1.0}}, {}]}),
        (
            "tf2_msgs/msg/TFMessage",
            {"transforms": [{"child_frame_id": "base", "transform": {"rotation": {"w": 1.0}}}]},
        ),
        ("sensor_msgs/msg/CameraInfo", {"d": [0.1, 0.2], "k": [1.0] * 9}),
        ("std_msgs/msg/Empty", {}),
        ("hri_msgs/msg/Skeleton2D", {"skeleton": [{"x": 0.5}] * 18}),
    ],
)
def test_types_without_a_message_go_as_they_came(name: str, record: dict[str, Any]) -> None:
    there_as_it_came(record, name)


def test_record_of_another_type_goes_back_as_it_came() -> None:
    name = "diagnostic_msgs/msg/DiagnosticArray"
    payload = CDR.encode({"status": [{"name": "motor", "values": [{"key": "temp"}]}]}, name)
    message = mapping.to_message(CDR.decode(payload, name), name)
    assert isinstance(message, Native)
    assert CDR.encode(mapping.to_record(message, name, 0), name) == payload


def test_record_of_a_known_type_is_taken_as_it_is() -> None:
    record = {"data": "hello"}
    assert mapping.to_record(Native(value=record), "std_msgs/msg/String", 0) == record


def test_message_of_another_kind_is_refused() -> None:
    with pytest.raises(EncodeError, match="is made of Text or that, not of Pose"):
        mapping.to_record(POSE, "std_msgs/msg/String", 0)
    with pytest.raises(EncodeError, match="a Native with its fields, not of Pose"):
        mapping.to_record(POSE, "std_msgs/msg/Empty", 0)


def test_stamp_of_another_clock_says_nothing() -> None:
    record = {"header": {"stamp": {"sec": 12, "nanosec": 5}, "frame_id": ""}}
    assert mapping.captured_ns(record, STAMP_NS) == STAMP_NS
    assert mapping.captured_ns(record, 12 * 10**9) == 12 * 10**9 + 5
    assert mapping.captured_ns({"header": {"sec": 1}}, STAMP_NS) == STAMP_NS


def test_type_that_a_message_goes_out_as() -> None:
    assert mapping.type_of(Pose) == "geometry_msgs/msg/PoseStamped"
    assert mapping.type_of(Native) is None
