"""Every mapping there and back, from both ends and in both dialects; what is lost is refused."""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vertebra.errors import DecodeError, EncodeError
from vertebra.messages import (
    Array,
    AudioChunk,
    Box,
    CompressedImage,
    Face,
    Faces,
    Image,
    Imu,
    JointCommand,
    JointState,
    LaserScan,
    Message,
    Native,
    Odometry,
    PointCloud,
    Pose,
    Status,
    Tensor,
    Text,
    Twist,
)
from vertebra.yarp import Dialect, Dict, Vocab, encode, objects
from vertebra.yarp.ports.outputs import parts_of
from vertebra_yarp.mapping import to_message, to_payload
from vertebra_yarp.mapping.media import OTHER_PIXELS
from vertebra_yarp.routes import StreamType

every_dialect = pytest.mark.parametrize("dialect", Dialect, ids=str)

finite = st.floats(-1e6, 1e6)
singles = st.floats(-1e6, 1e6, width=32)
triples = st.tuples(finite, finite, finite)
int32 = st.integers(-(2**31), 2**31 - 1)
words = st.text(max_size=8)


def there_and_back(
    message: Message, wanted: StreamType, dialect: Dialect, **how: Any
) -> tuple[Message, bytes]:
    frame_id = how.pop("frame_id", "")
    raw = b"".join(parts_of(to_payload(message, frame_id=frame_id), dialect))
    return to_message(raw, wanted, dialect=dialect, frame_id=frame_id, **how), raw


def check_both_ways(message: Message, wanted: StreamType, dialect: Dialect, **how: Any) -> None:
    back, raw = there_and_back(message, wanted, dialect, **how)
    assert back == message
    frame_id = how.get("frame_id", "")
    assert b"".join(parts_of(to_payload(back, frame_id=frame_id), dialect)) == raw


def array_of(code: str, values: Sequence[float]) -> Array:
    return Array.of(array(code, values))


# --- media -----------------------------------------------------------------------------------


@every_dialect
@given(instants=st.integers(0, 20), channels=st.integers(1, 4), data=st.data())
def test_sounds(dialect: Dialect, instants: int, channels: int, data: st.DataObject) -> None:
    size = 2 * instants * channels
    samples = Array(data.draw(st.binary(min_size=size, max_size=size)), "<i2", (instants, channels))
    check_both_ways(AudioChunk(samples=samples, rate_hz=16000), "AudioChunk", dialect)


@pytest.mark.parametrize(
    ("sound", "reason"),
    [
        (objects.Sound(8000, 1, array("h", [1]), bytes_per_sample=1), "of 8 bits has no message"),
        (objects.Sound(8000, 1, array("h", [1]), markers=bytes(12)), "markers has no message"),
    ],
)
def test_sounds_that_no_message_holds(sound: objects.Sound, reason: str) -> None:
    raw = sound.encode(Dialect.V4)
    with pytest.raises(DecodeError, match=reason):
        to_message(raw, "AudioChunk", dialect=Dialect.V4)


def test_sounds_that_yarp_would_round() -> None:
    samples = Array(bytes(8), "<f4", (1, 2))
    with pytest.raises(EncodeError, match="16 bits"):
        to_payload(AudioChunk(samples=samples, rate_hz=8000))


@every_dialect
@pytest.mark.parametrize("code", OTHER_PIXELS)
def test_pixels_without_a_format_of_ours(dialect: Dialect, code: str) -> None:
    width, height = 3, 2
    size = objects.row_bytes(width, objects.PIXEL_BYTES[code], 8) * height
    raw = objects.Image(code, width, height, bytes(size)).encode()
    for wanted in ("auto", "Image", "Native"):
        message = to_message(raw, wanted, dialect=dialect)
        assert isinstance(message, Native)
        assert message.value["pixel_code"] == code
        assert message.value["pixels"].shape[:2] == (height, width)
        check_both_ways(message, wanted, dialect)


def test_pixels_of_another_type_than_their_code() -> None:
    with pytest.raises(EncodeError, match="pixels of code 'int' are '<i4'"):
        to_payload(Native(value={"pixel_code": "int", "pixels": array_of("f", [1.0])}))


# --- numbers ---------------------------------------------------------------------------------


@every_dialect
@given(code=st.sampled_from("bhiq"), values=st.lists(st.integers(-128, 127), min_size=1))
def test_vectors_of_integers(dialect: Dialect, code: str, values: list[int]) -> None:
    check_both_ways(Tensor(array=array_of(code, values)), "Tensor", dialect)


@every_dialect
@given(code=st.sampled_from("fd"), values=st.lists(singles, min_size=1, max_size=9))
def test_vectors_of_floats(dialect: Dialect, code: str, values: list[float]) -> None:
    check_both_ways(Tensor(array=array_of(code, values)), "Tensor", dialect)


@every_dialect
@given(rows=st.integers(0, 4), columns=st.integers(0, 4))
def test_matrices(dialect: Dialect, rows: int, columns: int) -> None:
    values = array("d", map(float, range(rows * columns)))
    matrix = Tensor(array=Array(values, "<f8", (rows, columns)))
    check_both_ways(matrix, "Tensor", dialect)


@pytest.mark.parametrize(
    "tensor",
    [
        Tensor(array=Array(b"", "<f8", (0,))),
        Tensor(array=Array(bytes(8), "<f4", (1, 2))),
        Tensor(array=Array(bytes(1), "|u1", (1,))),
        Tensor(array=Array(bytes(8), "<f8", (1,)), axes=("x",)),
    ],
)
def test_arrays_that_yarp_does_not_have(tensor: Tensor) -> None:
    with pytest.raises(EncodeError):
        to_payload(tensor)


# --- motion ----------------------------------------------------------------------------------


@every_dialect
@given(positions=st.lists(finite, min_size=1, max_size=6))
def test_joint_states(dialect: Dialect, positions: list[float]) -> None:
    names = tuple(f"joint_{number}" for number, _ in enumerate(positions))
    state = JointState(names=names, positions_deg=tuple(positions))
    check_both_ways(state, "JointState", dialect, names=names)


def test_joint_states_with_more_than_positions() -> None:
    state = JointState(names=("a",), positions_deg=(1.0,), velocities_deg_s=(1.0,))
    with pytest.raises(EncodeError, match="no velocities"):
        to_payload(state)


@st.composite
def rotations(draw: st.DrawFn) -> tuple[float, float, float, float]:
    parts = draw(st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: math.hypot(*q) > 0.1))
    length = math.hypot(*parts)
    x, y, z, w = (part / length for part in parts)
    return (x, y, z, w)


def assert_same_rotation(a: Sequence[float], b: Sequence[float], within: float) -> None:
    cosine = abs(sum(x * y for x, y in zip(a, b, strict=True)))  # q and -q are one rotation
    assert 1 - cosine < within


@every_dialect
@given(
    rotation=st.none() | rotations(),
    others=st.tuples(st.none() | triples, st.none() | triples, st.none() | triples),
)
def test_inertial_measurements(dialect: Dialect, rotation: Any, others: Any) -> None:
    acceleration, gyroscope, field = others
    message = Imu(
        orientation_xyzw=rotation,
        linear_acceleration_m_s2=acceleration,
        angular_velocity_deg_s=gyroscope,
        magnetic_field_ut=field,
    )
    back, _ = there_and_back(message, "Imu", dialect)
    assert isinstance(back, Imu)
    assert msgspec.structs.replace(back, orientation_xyzw=rotation) == message
    if rotation is None:
        assert back.orientation_xyzw is None
    else:
        assert back.orientation_xyzw is not None
        assert_same_rotation(back.orientation_xyzw, rotation, 1e-9)


@pytest.mark.parametrize("pitch", [-1.0, 1.0])
@given(turn=st.floats(-math.pi, math.pi))
def test_looking_straight_up_or_down_keeps_its_turn(pitch: float, turn: float) -> None:
    half, cosine, sine = math.sqrt(0.5), math.cos(turn), math.sin(turn)
    rotation = (half * sine, half * pitch * cosine, -half * pitch * sine, half * cosine)
    back, _ = there_and_back(Imu(orientation_xyzw=rotation), "Imu", Dialect.V3)
    assert isinstance(back, Imu)
    assert back.orientation_xyzw is not None
    assert_same_rotation(back.orientation_xyzw, rotation, 1e-9)


def test_a_quaternion_that_is_no_rotation_is_refused() -> None:
    for message in (
        Imu(orientation_xyzw=(0, 0, 0, 2)),
        Pose(position_m=(0, 0, 0), orientation_xyzw=(0, 0, 0, 0)),
    ):
        with pytest.raises(EncodeError, match="is no rotation"):
            to_payload(message)


@every_dialect
@given(position=triples, rotation=rotations())
def test_poses(dialect: Dialect, position: Any, rotation: Any) -> None:
    message = Pose(position_m=position, orientation_xyzw=rotation, frame_id="base")
    back, _ = there_and_back(message, "Pose", dialect, frame_id="base")
    assert isinstance(back, Pose)
    assert back.position_m == position
    assert back.frame_id == "base"
    assert_same_rotation(back.orientation_xyzw, rotation, 1e-12)


@pytest.mark.parametrize(
    "rows",
    [
        [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
        [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]],
        [[1, 0, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
        [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 1, 1]],
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        [[math.nan] * 4] * 4,
    ],
)
def test_matrices_that_are_no_poses(rows: list[list[float]]) -> None:
    values = array("d", [float(value) for row in rows for value in row])
    matrix = objects.Matrix(len(rows), len(rows[0]), values)
    with pytest.raises(DecodeError):
        to_message(matrix.encode(), "Pose")


@every_dialect
@given(linear=triples, angular=triples)
def test_velocities(dialect: Dialect, linear: Any, angular: Any) -> None:
    back, _ = there_and_back(Twist(linear_m_s=linear, angular_rad_s=angular), "Twist", dialect)
    assert isinstance(back, Twist)
    assert back.linear_m_s == linear
    assert back.angular_rad_s == pytest.approx(angular, rel=1e-12)


@every_dialect
@given(x=finite, y=finite, yaw=st.floats(-179, 179), forward=finite, left=finite, turn=finite)
def test_odometry(  # noqa: PLR0917 -- one for each field of it
    dialect: Dialect, x: float, y: float, yaw: float, forward: float, left: float, turn: float
) -> None:
    cosine, sine = math.cos(math.radians(yaw)), math.sin(math.radians(yaw))
    data = objects.OdometryData(
        odom_x=x, odom_y=y, odom_theta=yaw,
        base_vel_x=forward, base_vel_y=left, base_vel_theta=turn,
        odom_vel_x=cosine * forward - sine * left, odom_vel_y=sine * forward + cosine * left,
        odom_vel_theta=turn,
    )  # fmt: skip
    message = to_message(data.encode(dialect), "Odometry", dialect=dialect, frame_id="odom")
    assert isinstance(message, Odometry)
    assert message.pose.frame_id == "odom"
    assert message.pose.position_m == (x, y, 0.0)
    assert message.twist.linear_m_s == (forward, left, 0.0)
    again = to_payload(message, frame_id="odom")
    assert isinstance(again, objects.OdometryData)
    for name in objects.OdometryData.__dataclass_fields__:
        assert getattr(again, name) == pytest.approx(getattr(data, name), rel=1e-9, abs=1e-6)


def test_odometry_that_leaves_the_floor() -> None:
    flat = Odometry(pose=Pose(position_m=(1.0, 2.0, 0.0)), twist=Twist())
    for message, reason in (
        (msgspec.structs.replace(flat, pose=Pose(position_m=(0.0, 0.0, 1.0))), "leaves the floor"),
        (msgspec.structs.replace(flat, child_frame_id="base"), "no child_frame_id"),
    ):
        with pytest.raises(EncodeError, match=reason):
            to_payload(message)


# --- sensing ---------------------------------------------------------------------------------


@every_dialect
@given(
    ranges=st.lists(st.floats(0, 100, width=32) | st.just(math.inf), min_size=1, max_size=9),
    begin=st.floats(-4, 4),
    step=st.floats(0.001, 0.1),
)
def test_laser_scans(dialect: Dialect, ranges: list[float], begin: float, step: float) -> None:
    message = LaserScan(
        ranges_m=array_of("f", ranges),
        angle_min_rad=begin,
        angle_increment_rad=step,
        range_min_m=0.1,
        range_max_m=30.0,
        frame_id="laser",
    )
    back, _ = there_and_back(message, "LaserScan", dialect, frame_id="laser")
    assert isinstance(back, LaserScan)
    assert back.ranges_m == message.ranges_m
    assert back.angle_min_rad == pytest.approx(begin, abs=1e-12)
    assert back.angle_increment_rad == pytest.approx(step, abs=1e-12)
    assert (back.range_min_m, back.range_max_m, back.frame_id) == (0.1, 30.0, "laser")


def test_laser_scans_that_cannot_cross() -> None:
    scan = LaserScan(
        ranges_m=array_of("f", [1.0]), angle_min_rad=0.0, angle_increment_rad=0.1,
        range_min_m=0.1, range_max_m=30.0,
    )  # fmt: skip
    with pytest.raises(EncodeError, match="no intensities"):
        to_payload(msgspec.structs.replace(scan, intensities=scan.ranges_m))
    with pytest.raises(EncodeError, match="at least one range"):
        to_payload(msgspec.structs.replace(scan, ranges_m=array_of("f", [])))
    yarp = to_payload(scan)
    assert isinstance(yarp, objects.LaserScan2D)
    for broken, reason in (
        (replace(yarp, status=2), "a general error"),
        (replace(yarp, status=3), "a timeout"),
        (replace(yarp, ranges_m=array("d")), "without ranges"),
    ):
        with pytest.raises(DecodeError, match=reason):
            to_message(broken.encode(), "LaserScan")


@every_dialect
@given(height=st.integers(1, 3), width=st.integers(0, 4), colored=st.booleans(), data=st.data())
def test_point_clouds(
    dialect: Dialect, height: int, width: int, colored: bool, data: st.DataObject
) -> None:  # fmt: skip
    count = 3 * height * width
    shape = (height, width, 3) if height > 1 else (width, 3)
    points = array("f", data.draw(st.lists(singles, min_size=count, max_size=count)))
    colors = data.draw(st.binary(min_size=count, max_size=count))
    message = PointCloud(
        points_m=Array(points, "<f4", shape),
        colors_rgb=Array(colors, "|u1", shape) if colored else None,
    )
    check_both_ways(message, "PointCloud", dialect)


def test_point_clouds_that_have_no_message() -> None:
    with pytest.raises(DecodeError, match="of type 0x8 have no message"):
        to_message(objects.PointCloud(1, 1, 8, bytes(4)).encode(), "PointCloud")
    points = bytearray(64)
    points[19] = 1
    with pytest.raises(DecodeError, match="different transparencies"):
        to_message(objects.PointCloud(2, 1, 0x02000006, bytes(points)).encode(), "PointCloud")


measurements = st.lists(
    st.tuples(st.lists(finite, max_size=3), finite).map(
        lambda sensor: objects.Measurement(array("d", sensor[0]), sensor[1])
    ),
    max_size=2,
).map(tuple)


@every_dialect
@given(sensors=st.lists(measurements, min_size=12, max_size=12))
def test_all_sensors_as_a_native(dialect: Dialect, sensors: list[Any]) -> None:
    names = objects.SensorData.__dataclass_fields__
    raw = objects.SensorData(**dict(zip(names, sensors, strict=True))).encode(dialect)
    for wanted in ("auto", "Native"):
        message = to_message(raw, wanted, dialect=dialect)
        assert isinstance(message, Native)
        assert b"".join(parts_of(to_payload(message), dialect)) == raw


def test_the_imu_among_the_sensors() -> None:
    def sensor(*values: float) -> tuple[objects.Measurement, ...]:
        return (objects.Measurement(array("d", values), 1.0),)

    data = objects.SensorData(
        gyroscopes=sensor(1, 2, 3),
        linear_accelerometers=sensor(4, 5, 6),
        orientations=sensor(0, 0, 90),
        temperatures=sensor(36.5),
        magnetometers=sensor(1e-6, 2e-6, 3e-6),
    )
    message = to_message(data.encode(), "Imu", frame_id="head")
    assert isinstance(message, Imu)
    assert message.angular_velocity_deg_s == pytest.approx((1, 2, 3))
    assert message.linear_acceleration_m_s2 == pytest.approx((4, 5, 6))
    assert message.magnetic_field_ut == pytest.approx((1, 2, 3))  # of tesla
    half = math.sqrt(0.5)
    assert message.orientation_xyzw == pytest.approx((0, 0, half, half))
    assert message.frame_id == "head"
    with pytest.raises(DecodeError, match="an inertial sensor gives 3 numbers, not 1"):
        to_message(objects.SensorData(gyroscopes=sensor(1)).encode(), "Imu")


@every_dialect
def test_the_state_of_joints_as_a_native(dialect: Dialect) -> None:
    data = objects.JointData(
        joint_position=objects.JointValues(array("d", [1.5, -2.0]), ok=True),
        control_mode=objects.JointModes((Vocab("pos"), Vocab("vel")), ok=True),
    )
    raw = data.encode(dialect)
    message = to_message(raw, "auto", dialect=dialect)
    assert isinstance(message, Native)
    assert message.value["joint_position"]["values"].tolist() == [1.5, -2.0]
    assert message.value["control_mode"] == {"values": ["pos", "vel"], "ok": True}
    assert b"".join(parts_of(to_payload(message), dialect)) == raw


# --- words and fields ------------------------------------------------------------------------


@every_dialect
@given(text=words, language=st.sampled_from(["", "en", "pt-BR"]))
def test_texts(dialect: Dialect, text: str, language: str) -> None:
    check_both_ways(Text(text=text, language=language), "Text", dialect)


plain = st.recursive(
    st.booleans()
    | int32
    | st.integers(-(2**63), 2**63 - 1)
    | finite
    | words
    | st.binary(max_size=8)
    | st.lists(singles, max_size=4).map(lambda values: array_of("f", values)),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(words, inner, max_size=3),
    max_leaves=10,
)


@every_dialect
@given(value=st.dictionaries(words, plain, max_size=4))
def test_natives_are_properties(dialect: Dialect, value: dict[str, Any]) -> None:
    check_both_ways(Native(value=value), "Native", dialect)


def test_a_native_may_have_a_schema_of_its_own() -> None:
    schemas: list[object] = [[], {}, "mine", 7]
    for schema in schemas:
        check_both_ways(Native(value={"schema": schema}), "Native", Dialect.V3)


@pytest.mark.parametrize(
    "value",
    [
        [1, 2],
        7,
        {"a": None},
        {1: "x"},
        {"a": {"dtype": 1, "shape": 2, "data": 3}},
        {"a": object()},
        {"schema": "vertebra/Text/1"},
    ],
)
def test_natives_that_are_no_properties(value: object) -> None:
    with pytest.raises(EncodeError):
        to_payload(Native(value=value))


@pytest.mark.parametrize(
    "values",
    [
        [1],
        [["a", 1, 2]],
        [["a", 1], ["a", 2]],
        [["a", Vocab("set")]],
        [["a", Dict([["dtype", "x"], ["shape", 1], ["data", 2]])]],
    ],
)
def test_properties_that_are_no_natives(values: Any) -> None:
    with pytest.raises(DecodeError):
        to_message(encode(values), "Native")
    assert to_message(encode(values), "Bottle").values == to_message(encode(values), "auto").values  # type: ignore[attr-defined]


OTHERS: list[Message] = [
    CompressedImage(
        data=Array(b"\xff\xd8", "|u1", (2,)), media_type="image/jpeg", frame_id="camera"
    ),
    JointCommand(names=("a", "b"), positions_deg=(1.0, 2.0), mode="direct"),
    Faces(
        faces=(
            Face(
                track_id=7, box=Box(x=1.0, y=2.0, width=3.0, height=4.0), score=0.5,
                landmarks={"nose": (1.5, 2.5)},
            ),
        ),
        image_width=320, image_height=240, backend="x",
    ),
    Status(level="ok", text="fine", values={"a": 1, "b": 1.5, "c": "x"}),
]  # fmt: skip


@every_dialect
@pytest.mark.parametrize("message", OTHERS, ids=lambda message: type(message).__name__)
def test_messages_without_an_object_are_properties_of_their_fields(
    dialect: Dialect, message: Message
) -> None:
    check_both_ways(message, "auto", dialect)


def test_fields_that_do_not_fit_are_refused() -> None:
    raw = encode([["schema", "vertebra/Status/1"], ["level", "great"]])
    with pytest.raises(DecodeError, match="no fields of vertebra/Status/1"):
        to_message(raw, "auto")


# --- coordinate frames -----------------------------------------------------------------------


@pytest.mark.parametrize(
    "message",
    [
        Imu(frame_id="camera"),
        Pose(position_m=(0.0, 0.0, 0.0), frame_id="camera"),
        Twist(frame_id="camera"),
        Odometry(pose=Pose(position_m=(0.0, 0.0, 0.0), frame_id="camera"), twist=Twist()),
        Image(pixels=Array(b"a", "|u1", (1, 1)), pixel_format="mono8", frame_id="camera"),
    ],
    ids=lambda message: type(message).__name__,
)
@every_dialect
def test_the_route_carries_the_coordinate_frame(message: Message, dialect: Dialect) -> None:
    wanted: Any = type(message).__name__
    with pytest.raises(EncodeError, match="set `frame_id: camera` at the route"):
        to_payload(message)
    back, _ = there_and_back(message, wanted, dialect, frame_id="camera")
    assert back == message
