"""YARP objects become messages and go back, without loss or with a reason."""

from __future__ import annotations

import math
from array import array

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vertebra.errors import DecodeError, EncodeError
from vertebra.messages import (
    PIXELS,
    Array,
    Bottle,
    Image,
    Imu,
    JointState,
    Message,
    Tensor,
    Text,
    item_bytes,
)
from vertebra.yarp import Dialect, Dict, Float32, Int8, Int16, Int64, Value, Vocab, encode, objects
from vertebra.yarp.ports.outputs import parts_of
from vertebra_yarp.mapping import (
    PIXEL_FORMATS,
    captured_ns,
    plain_of,
    to_message,
    to_payload,
    values_of,
)

NOW_NS = 1_795_000_000 * 10**9

finite = st.floats(allow_nan=False, width=64)
scalars: st.SearchStrategy[Value] = st.one_of(
    st.booleans(),
    st.integers(-(2**31), 2**31 - 1),
    st.integers(-(2**63), 2**63 - 1).map(Int64),
    st.integers(-128, 127).map(Int8),
    st.integers(-(2**15), 2**15 - 1).map(Int16),
    finite,
    st.floats(allow_nan=False, width=32).map(Float32),
    st.text(max_size=8),
    st.binary(max_size=8),
    st.text("abcdefgh", min_size=1, max_size=4).map(Vocab),
)
bottles: st.SearchStrategy[list[Value]] = st.lists(
    st.recursive(
        scalars,
        lambda inner: st.one_of(
            st.lists(inner, max_size=4),
            st.lists(st.tuples(st.text(max_size=4), inner).map(list), max_size=3).map(Dict),
        ),
        max_leaves=12,
    ),
    max_size=6,
)


def raw(message: Message, dialect: Dialect = Dialect.V3) -> bytes:
    return b"".join(parts_of(to_payload(message), dialect))


def types_of(value: object) -> object:
    if isinstance(value, list):
        return (type(value), [types_of(item) for item in value])
    return type(value)


@given(bottles)
def test_bottles_survive_with_their_types(values: list[Value]) -> None:
    back = values_of(plain_of(values))
    assert back == values
    assert types_of(back) == types_of(values)
    assert encode(back) == encode(values)


@pytest.mark.parametrize("bad", [None, {"vocab": 5}, {"what": 1}, {"a": 1, "b": 2}, object()])
def test_values_without_a_place_in_a_bottle_are_refused(bad: object) -> None:
    with pytest.raises(EncodeError):
        values_of([1, [bad]])


@pytest.mark.parametrize("code", sorted(PIXEL_FORMATS))
@given(width=st.integers(1, 9), height=st.integers(1, 5))
def test_images_of_every_pixel_format_lose_their_padding_and_nothing_else(
    code: str, width: int, height: int
) -> None:
    dtype, channels = PIXELS[PIXEL_FORMATS[code]]
    row = width * channels * item_bytes(dtype)
    padded = objects.row_bytes(width, channels * item_bytes(dtype), 8)
    rows = [bytes((7 * y + x) % 256 for x in range(row)) for y in range(height)]
    pixels = b"".join(line + b"\xee" * (padded - row) for line in rows)
    payload = objects.Image(code, width, height, pixels).encode()

    message = to_message(payload, "auto")
    assert isinstance(message, Image)
    assert message.pixel_format == PIXEL_FORMATS[code]
    assert (message.height, message.width) == (height, width)
    assert bytes(message.pixels.data) == b"".join(rows)

    again = to_message(raw(message), "Image")
    assert again == message


def test_image_without_padding_is_not_copied() -> None:
    payload = bytearray(objects.Image("rgb", 8, 2, bytes(48)).encode())
    message = to_message(payload, "Image")
    assert isinstance(message, Image)
    payload[-1] = 99
    assert message.pixels.data[-1] == 99


@given(st.lists(finite, min_size=1, max_size=8))
def test_vectors_are_tensors(values: list[float]) -> None:
    payload = objects.Vector.of(values).encode()
    message = to_message(payload, "auto")
    assert isinstance(message, Tensor)
    assert message.array.tolist() == values
    assert raw(message) == payload


def test_joint_state_needs_as_many_names_as_values() -> None:
    payload = objects.Vector.of([1.0, 2.0]).encode()
    assert to_message(payload, "JointState", names=["a", "b"]) == JointState(
        names=("a", "b"), positions_deg=(1.0, 2.0)
    )
    with pytest.raises(DecodeError, match="2 positions for the 3 joints"):
        to_message(payload, "JointState", names=["a", "b", "c"])


@given(
    st.floats(-179, 179),
    st.floats(-89, 89),
    st.floats(-179, 179),
    st.lists(finite, min_size=9, max_size=9),
)
def test_inertial_vector_survives(roll: float, pitch: float, yaw: float, rest: list[float]) -> None:
    payload = objects.Vector.of([roll, pitch, yaw, *rest]).encode()
    message = to_message(payload, "Imu")
    assert isinstance(message, Imu)
    assert message.orientation_xyzw is not None
    assert math.isclose(math.hypot(*message.orientation_xyzw), 1.0)
    back = objects.Vector.decode(raw(message)).values
    assert list(back[3:]) == rest
    for got, wanted in zip(back[:3], (roll, pitch, yaw), strict=True):
        assert math.isclose(got, wanted, abs_tol=1e-6)


def test_planar_sound_becomes_interleaved() -> None:
    payload = objects.Sound(16000, 2, array("h", [1, 2, 3, -1, -2, -3])).encode()
    message = to_message(payload, "auto")
    assert message.samples.tolist() == [[1, -1], [2, -2], [3, -3]]  # type: ignore[attr-defined]
    assert message.rate_hz == 16000  # type: ignore[attr-defined]


def test_text_is_one_string() -> None:
    assert to_message(encode(["hello"]), "Text") == Text(text="hello")
    assert raw(Text(text="hello")) == encode(["hello"])
    with pytest.raises(DecodeError):
        to_message(encode(["a", "b", "c"]), "Text")


def test_unknown_bytes_stay_what_they_are() -> None:
    message = to_message(b"\x01\x02\x03", "auto")
    assert isinstance(message, Tensor)
    assert bytes(message.array.data) == b"\x01\x02\x03"


def test_what_yarp_cannot_say_is_refused() -> None:
    with pytest.raises(EncodeError, match=r"not '<u2' of shape \(1,\)"):
        to_payload(Tensor(array=Array.of(array("H", [1]))))
    with pytest.raises(EncodeError):
        to_payload(Bottle(values=[None]))


@pytest.mark.parametrize(
    ("envelope", "expected"),
    [
        ("", NOW_NS),
        (f"7 {NOW_NS / 1e9 - 0.25:.15g}", NOW_NS - 250_000_000),
        ("7 12.5", NOW_NS),  # a simulation's clock
        ("7 nan", NOW_NS),
        ("hello", NOW_NS),
    ],
)
def test_stamps_of_our_clock_are_the_capture_time(envelope: str, expected: int) -> None:
    assert captured_ns(envelope, NOW_NS) == expected
