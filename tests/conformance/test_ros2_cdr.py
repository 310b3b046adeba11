"""CDR against bytes seen on the wire, against another serialiser, and against damage."""

from __future__ import annotations

import struct
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from vertebra.errors import CodecError, DecodeError, EncodeError
from vertebra.messages import Array
from vertebra.ros2.cdr import Cdr
from vertebra.ros2.definitions import Types
from vertebra.ros2.interface_files import Definition, Field

JAZZY = get_typestore(Stores.ROS2_JAZZY)
TYPES = Types.standard()
CDR = Cdr(TYPES)
RANGES = {
    "int8": (-(2**7), 2**7 - 1), "uint8": (0, 2**8 - 1), "byte": (0, 2**8 - 1),
    "int16": (-(2**15), 2**15 - 1), "uint16": (0, 2**16 - 1),
    "int32": (-(2**31), 2**31 - 1), "uint32": (0, 2**32 - 1),
    "int64": (-(2**63), 2**63 - 1), "uint64": (0, 2**64 - 1),
}  # fmt: skip
LETTERS = {
    "int8": "b", "uint8": "B", "byte": "B", "int16": "h", "uint16": "H", "int32": "i",
    "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d", "bool": "?",
}  # fmt: skip
DTYPES = {
    "int8": "|i1", "uint8": "|u1", "byte": "|u1", "int16": "<i2", "uint16": "<u2",
    "int32": "<i4", "uint32": "<u4", "int64": "<i8", "uint64": "<u8", "float32": "<f4",
    "float64": "<f8", "bool": "|b1",
}  # fmt: skip
TEXT = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=6)


def one(field: Field) -> st.SearchStrategy[Any]:
    if field.type in RANGES:
        return st.integers(*RANGES[field.type])
    if field.type in ("float32", "float64"):
        return st.floats(width=32 if field.type == "float32" else 64, allow_nan=False)
    if field.type == "bool":
        return st.booleans()
    if field.type == "string":
        return TEXT.filter(lambda text: not field.max_text or len(text.encode()) <= field.max_text)
    if field.type == "wstring":
        return TEXT
    return records(TYPES.definition(field.type))


def value(field: Field) -> st.SearchStrategy[Any]:
    if field.plural == "one":
        return one(field)
    least, most = (field.count, field.count) if field.plural == "array" else (0, 2)
    if field.plural == "bounded":
        most = min(most, field.count)
    items = st.lists(one(field), min_size=least, max_size=most)
    if field.type not in LETTERS:
        return items
    form, dtype = LETTERS[field.type], DTYPES[field.type]
    return items.map(
        lambda numbers: Array(
            struct.pack(f"<{len(numbers)}{form}", *numbers), dtype, (len(numbers),)
        )
    )


def records(definition: Definition) -> st.SearchStrategy[dict[str, Any]]:
    return st.fixed_dictionaries({field.name: value(field) for field in definition})


def unpadded(payload: bytes) -> bytes:
    return bytes(payload) + bytes(-len(payload) % 4)


@pytest.mark.parametrize("name", sorted(JAZZY.fielddefs))
def test_every_standard_message_is_what_the_other_serialiser_writes(name: str) -> None:
    @settings(max_examples=8, suppress_health_check=list(HealthCheck), database=None)
    @given(records(TYPES.definition(name)))
    def check(record: dict[str, Any]) -> None:
        payload = CDR.encode(record, name)
        theirs = JAZZY.deserialize_cdr(payload, name)
        assert unpadded(bytes(JAZZY.serialize_cdr(theirs, name, little_endian=True))) == payload
        assert CDR.decode(payload, name) == record
        big = bytes(JAZZY.serialize_cdr(theirs, name, little_endian=False))
        assert CDR.decode(big, name) == record

    check()


STRING = (
    b"\x00\x01\x00\x00"  # XCDR1, little endian
    b"\x06\x00\x00\x00hello\x00"  # length with NUL
    b"\x00\x00"  # to a multiple of 4
)


def test_string_as_a_ros_node_writes_it() -> None:
    assert CDR.encode({"data": "hello"}, "std_msgs/msg/String") == STRING
    assert CDR.decode(STRING, "std_msgs/msg/String") == {"data": "hello"}


def test_fields_as_a_ros_client_sends_them() -> None:
    name = "example_interfaces/srv/AddTwoInts_Request"
    payload = bytes.fromhex("00010000 2800000000000000 0200000000000000")
    assert CDR.encode({"a": 40, "b": 2}, name) == payload
    assert CDR.decode(payload, name) == {"a": 40, "b": 2}


def test_alignment_starts_behind_the_header() -> None:
    payload = CDR.encode({"x": 1.0, "y": 2.0, "theta": 3.0}, "geometry_msgs/msg/Pose2D")
    assert payload == b"\x00\x01\x00\x00" + struct.pack("<3d", 1, 2, 3)


def test_empty_sequence_adds_no_padding() -> None:
    payload = CDR.encode({"data": []}, "std_msgs/msg/Float64MultiArray")
    # layout.dim: count 0; data_offset: 0; data: count 0, and no padding to 8 behind it
    assert payload == bytes.fromhex("00010000 00000000 00000000 00000000")


def test_image_is_looked_at_in_place() -> None:
    name = "sensor_msgs/msg/Image"
    payload = CDR.encode({"height": 2, "width": 3, "step": 9, "data": bytes(range(18))}, name)
    data = CDR.decode(payload, name)["data"]
    assert data.data.obj is payload
    assert bytes(data.data) == bytes(range(18))


def test_fields_that_are_not_given_are_zero_or_empty() -> None:
    name = "nav_msgs/msg/Odometry"
    whole = CDR.decode(CDR.encode({}, name), name)
    assert whole["header"] == {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    assert whole["pose"]["covariance"].tolist() == [0.0] * 36


def test_wide_text() -> None:
    types = Types()
    types.add_text("lab/msg/Wide", "wstring<=4 text\nuint8 last", "Wide.msg")
    cdr = Cdr(types)
    payload = cdr.encode({"text": "aé😀", "last": 7}, "lab/msg/Wide")
    assert payload == bytes.fromhex(
        "00010000 04000000 61000000 e9000000 3dd80000 00de0000 07000000"
    )
    assert cdr.decode(payload, "lab/msg/Wide") == {"text": "aé😀", "last": 7}
    with pytest.raises(EncodeError, match="at most 4"):
        cdr.encode({"text": "abcde"}, "lab/msg/Wide")


@pytest.mark.parametrize("units", ["00dc0000", "00000100", "ffffffff"])
def test_wide_text_that_is_none_is_refused(units: str) -> None:
    with pytest.raises(DecodeError, match="is not UTF-16"):
        CDR.decode(bytes.fromhex(f"00010000 01000000 {units}"), "example_interfaces/msg/WString")


def test_bounds_are_held() -> None:
    types = Types()
    types.add_text("lab/msg/Few", "uint8[<=2] few\nstring<=3 word", "Few.msg")
    cdr = Cdr(types)
    with pytest.raises(EncodeError, match=r"lab/msg/Few\.few: has at most 2 items, not 3"):
        cdr.encode({"few": [1, 2, 3]}, "lab/msg/Few")
    with pytest.raises(EncodeError, match=r"lab/msg/Few\.word"):
        cdr.encode({"word": "four"}, "lab/msg/Few")
    three = bytes.fromhex("00010000 03000000 010203 00 01000000 00000000")
    with pytest.raises(DecodeError, match=r"lab/msg/Few\.few: 3 items where at most 2 may be"):
        cdr.decode(three, "lab/msg/Few")


JOINTS = {
    "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "base"},
    "name": ["neck_pitch", "neck_yaw"],
    "position": [0.1, 0.2],
    "velocity": [],
    "effort": [1.0, 2.0],
}


@pytest.mark.parametrize(
    ("record", "told"),
    [
        ({"header": {"stamp": {"sec": "1"}}}, "JointState.header.stamp.sec: is int32, not '1'"),
        ({"name": ["a", 5]}, "JointState.name[1]: is text, not 5"),
        ({"name": "a"}, "JointState.name: is a list, not str"),
        ({"position": 5}, "JointState.position: is a list of numbers, not int"),
        ({"position": ["x"]}, "JointState.position: "),
        ({"header": []}, "JointState.header: is a map of stamp, frame_id, not list"),
        ({"positions": []}, "JointState: there is no field 'positions'; known: header, name"),
        ({"position": Array(b"1", "|u1", (1,))}, "is an array of '<f8', not of '|u1'"),
        ({"header": {"stamp": {"nanosec": -1}}}, "JointState.header.stamp.nanosec: "),
        ({"header": {"stamp": {"nanosec": True}}}, "is uint32, not True"),
        ({"header": {"frame_id": "\ud800"}}, "JointState.header.frame_id: "),
    ],
)
def test_value_that_does_not_fit_is_named(record: dict[str, Any], told: str) -> None:
    with pytest.raises(EncodeError) as caught:
        CDR.encode(record, "sensor_msgs/msg/JointState")
    assert told in str(caught.value)


def test_every_cut_is_a_decode_error() -> None:
    payload = CDR.encode(JOINTS, "sensor_msgs/msg/JointState")
    for length in range(len(payload)):
        with pytest.raises(DecodeError):
            CDR.decode(payload[:length], "sensor_msgs/msg/JointState")


@pytest.mark.parametrize("value", [0x00, 0x01, 0x7F, 0xFF])
def test_damage_at_every_byte_is_a_value_or_a_decode_error(value: int) -> None:
    name = "sensor_msgs/msg/JointState"
    payload = CDR.encode(JOINTS, name)
    for position in range(len(payload)):
        damaged = payload[:position] + bytes([value]) + payload[position + 1 :]
        try:
            record = CDR.decode(damaged, name)
        except CodecError:
            continue
        assert record.keys() == JOINTS.keys()


@given(st.binary(max_size=200), st.sampled_from(sorted(TYPES)))
@settings(suppress_health_check=list(HealthCheck))
def test_noise_is_a_record_or_a_decode_error(noise: bytes, name: str) -> None:
    try:
        record = CDR.decode(b"\x00\x01\x00\x00" + noise, name)
    except DecodeError:
        return
    assert record.keys() == {field.name for field in TYPES.definition(name)}


@pytest.mark.parametrize(
    ("payload", "told"),
    [
        (b"", "nothing is no header"),
        (b"\x00\x07\x00\x00", "00 07 00 00 is no header of XCDR1"),
        (STRING + bytes(4), "follow the message"),
        (bytes.fromhex("00010000 ffffffff 00"), "a length of 4294967295 at byte 0"),
        (bytes.fromhex("00010000 02000000 6161"), "does not end with NUL"),
        (bytes.fromhex("00010000 02000000 ff00"), "is not UTF-8"),
    ],
)
def test_damage_is_told(payload: bytes, told: str) -> None:
    with pytest.raises(DecodeError, match=told):
        CDR.decode(payload, "std_msgs/msg/String")


def test_the_size_of_a_message_is_known_whatever_follows() -> None:
    assert CDR.size(STRING, "std_msgs/msg/String") == len(STRING.rstrip(b"\0")) + 1
    assert CDR.size(STRING + b"rest", "std_msgs/msg/String") == len(STRING.rstrip(b"\0")) + 1
    with pytest.raises(DecodeError):
        CDR.size(STRING[:-4], "std_msgs/msg/String")


def test_the_other_serialiser_knows_the_same_types() -> None:
    assert int(Nodetype.NAME) == 2  # what `definitions` reads from rosbags' numbers
    assert set(JAZZY.fielddefs) <= set(TYPES)
