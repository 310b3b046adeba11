"""What ROS 2 records mean, and back, through their bytes."""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
import pytest

from vertebra.errors import DecodeError, EncodeError
from vertebra.messages import (
    Array,
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


POSE = Pose(position_m=(1.0, 2.0, 3.0), orientation_xyzw=(0.0, 0.0, 0.6, 0.8), frame_id="odom")
TWIST = Twist(linear_m_s=(1.0, 0.0, 0.0), angular_rad_s=(0.0, 0.0, 0.5), frame_id="base")
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
        CompressedImage(data=Array(b"\xff\xd8", "|u1", (2,)), media_type="image/jpeg"),
    ),
    ("geometry_msgs/msg/PoseStamped", POSE),
    ("geometry_msgs/msg/TwistStamped", TWIST),
    ("geometry_msgs/msg/Twist", Twist(linear_m_s=(0.1, 0.2, 0.3))),
    (
        "nav_msgs/msg/Odometry",
        Odometry(pose=POSE, twist=TWIST, child_frame_id="base"),
    ),
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
    ("sensor_msgs/msg/Imu", Imu(linear_acceleration_m_s2=(0.0, 0.0, 9.8), frame_id="imu")),
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


def test_joints_without_positions_are_refused() -> None:
    record = CDR.decode(
        CDR.encode({"name": ["a"], "effort": [1.0]}, "sensor_msgs/msg/JointState"),
        "sensor_msgs/msg/JointState",
    )
    with pytest.raises(DecodeError, match="positions_deg has 0 values for 1 joints"):
        mapping.to_message(record, "sensor_msgs/msg/JointState")


def test_angular_velocity_is_radians_in_ros() -> None:
    imu = Imu(orientation_xyzw=(0.0, 0.0, 0.0, 1.0), angular_velocity_deg_s=(0.0, 0.0, 180.0))
    record = mapping.to_record(imu, "sensor_msgs/msg/Imu", STAMP_NS)
    assert record["angular_velocity"]["z"] == pytest.approx(math.pi)
    assert record["linear_acceleration_covariance"][0] == -1.0
    back = there_and_back(imu, "sensor_msgs/msg/Imu")
    assert isinstance(back, Imu)
    assert back.linear_acceleration_m_s2 is None
    assert back.angular_velocity_deg_s == pytest.approx((0.0, 0.0, 180.0))


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
        ({"encoding": "yuv422"}, "encoding 'yuv422' have no message"),
        ({"step": 1}, "rows of 1 bytes"),
        ({"height": 3}, "4 bytes are no 2 x 3 image"),
        ({"height": 2**32 - 1, "width": 2**32 - 1, "step": 2**32 - 1}, "4 bytes are no"),
    ],
)
def test_image_that_does_not_fit_is_refused(fields: dict[str, Any], told: str) -> None:
    with pytest.raises(DecodeError, match=told):
        mapping.to_message(image(**fields), "sensor_msgs/msg/Image")


def cloud(**fields: Any) -> dict[str, Any]:
    xyz = [{"name": name, "offset": 4 * i, "datatype": 7} for i, name in enumerate("xyz")]
    given: dict[str, Any] = {
        "height": 1, "width": 1, "fields": xyz, "point_step": 12, "row_step": 12,
        "data": bytes(12),
    }  # fmt: skip
    name = "sensor_msgs/msg/PointCloud2"
    return CDR.decode(CDR.encode(given | fields, name), name)


@pytest.mark.parametrize(
    ("fields", "told"),
    [
        ({"fields": []}, "has x, y and z"),
        ({"row_step": 5}, "rows of 5 bytes"),
        ({"data": bytes(11)}, "11 bytes are no"),
        ({"point_step": 8, "row_step": 8, "data": bytes(8)}, "'z' is not within the 8 bytes"),
        ({"fields": [{"name": n, "datatype": 99} for n in "xyz"]}, "has no known type"),
    ],
)
def test_cloud_that_does_not_fit_is_refused(fields: dict[str, Any], told: str) -> None:
    with pytest.raises(DecodeError, match=told):
        mapping.to_message(cloud(**fields), "sensor_msgs/msg/PointCloud2")


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
