"""Golden frames (golden_frames.py): identical bytes out, the stated values in, damage refused."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vertebra.codec import FrameCodec, encoding_of, to_json_value
from vertebra.errors import CodecError, CodecNotFoundError, DecodeError, EncodeError
from vertebra.messages import (
    MESSAGES,
    Array,
    Foreign,
    Header,
    Image,
    Message,
    Native,
    Tensor,
    item_bytes,
)

from . import golden_frames
from .golden_frames import Case

WRITTEN = golden_frames.cases()
FOREIGN = golden_frames.cases("foreign")
DAMAGED = golden_frames.cases("damaged")
TYPES = {message.schema(): message for message in MESSAGES}
CODEC = FrameCodec()


def name(case: Case) -> str:
    return case.name


def notate(value: Any) -> Any:
    """Return a decoded value in the notation of the cases."""
    match value:
        case None | bool() | str():
            return value
        case int():
            return {"$int": str(value)}
        case float():
            return {"$float": golden_frames.number(value)}
        case bytes():
            return {"$bytes": value.hex(" ")}
        case Array():
            shape = [str(length) for length in value.shape]
            if value.dtype[1:] not in golden_frames.LETTERS:
                content: dict[str, Any] = {"bytes": value.data.hex(" ")}
            else:
                content = {"items": golden_frames.items_of(bytes(value.data), value.dtype)}
            return {"$array": {"dtype": value.dtype, "shape": shape, **content}}
        case Foreign():
            return {"$foreign": {"tag": value.tag, "plain": notate(value.plain)}}
        case list() | tuple():
            return [notate(item) for item in value]
        case dict():
            if all(isinstance(key, str) for key in value):
                return {key: notate(item) for key, item in value.items()}
            return {"$map": [[notate(key), notate(item)] for key, item in value.items()]}
        case msgspec.Struct():
            return {field: notate(getattr(value, field)) for field in type(value).__struct_fields__}
    raise TypeError(f"{value!r} is no value of a message")


def value_of(notation: Any) -> Any:
    """Return the plain values, arrays and foreign values that a notation stands for."""
    match notation:
        case {"$int": digits}:
            return int(digits)
        case {"$float": digits}:
            return float(digits)
        case {"$bytes": digits}:
            return bytes.fromhex(digits)
        case {"$map": pairs}:
            return {value_of(key): value_of(item) for key, item in pairs}
        case {"$array": array}:
            shape = tuple(int(length) for length in array["shape"])
            return Array(golden_frames.bytes_of(array), array["dtype"], shape)
        case {"$foreign": foreign}:
            return Foreign(tag=foreign["tag"], plain=value_of(foreign["plain"]))
        case dict():
            return {key: value_of(item) for key, item in notation.items()}
        case list():
            return [value_of(item) for item in notation]
    return notation


def message_of(document: Mapping[str, Any]) -> Message:
    plain = value_of(document["message"])
    if document["schema"] == Native.schema():
        return Native(**plain)  # convert() would take a Foreign apart
    return msgspec.convert(plain, TYPES[document["schema"]], dec_hook=lambda _, value: value)


def header_of(document: Mapping[str, Any]) -> Header:
    return msgspec.convert(document["header"], Header, strict=False)


def is_refused_or_read(payload: bytes) -> bool:
    """Return whether a decoder took `payload` for a message; any other error escapes."""
    try:
        message, _ = CODEC.decode(payload)
    except (DecodeError, CodecNotFoundError):
        return False
    assert isinstance(message, Message)
    return True


@pytest.mark.parametrize("case", WRITTEN + FOREIGN + DAMAGED, ids=name)
def test_committed_frame_is_what_the_specification_says(case: Case) -> None:
    assert golden_frames.frame_of(case.document) == case.frame


def test_every_frame_has_its_case() -> None:
    frames = {path.with_suffix("") for path in golden_frames.FOLDER.rglob("*.bin")}
    assert frames == {case.path.with_suffix("") for case in WRITTEN + FOREIGN + DAMAGED}


def test_every_message_type_and_item_type_has_a_case() -> None:
    assert {case.document["schema"] for case in WRITTEN} == set(TYPES)
    tensors = [message_of(case.document) for case in WRITTEN if case.name.startswith("Tensor")]
    kinds = {
        tensor.array.dtype.partition("[")[0] for tensor in tensors if isinstance(tensor, Tensor)
    }
    numbers = {f"{'|' if kind[1] == '1' else '<'}{kind}" for kind in golden_frames.LETTERS}
    assert kinds >= numbers | {">f4", "<f2", "<c8", "<c16", "<M8", "<m8", "|S5", "<U3", "|V4"}


@pytest.mark.parametrize("case", WRITTEN, ids=name)
def test_encode_gives_identical_bytes(case: Case) -> None:
    message = message_of(case.document)
    frame = CODEC.encode(message, header_of(case.document))
    assert bytes(frame) == case.frame
    assert frame.nbytes == len(case.frame)
    assert encoding_of(message) == case.document["encoding"]


@pytest.mark.parametrize("case", WRITTEN + FOREIGN, ids=name)
def test_decode_gives_the_stated_values(case: Case) -> None:
    message, header = CODEC.decode(case.frame)
    assert message.schema() == case.document["schema"]
    assert notate(message) == case.document["message"]
    assert header == header_of(case.document)


@pytest.mark.parametrize("case", DAMAGED, ids=name)
def test_damage_is_refused_with_its_reason(case: Case) -> None:
    error = {"DecodeError": DecodeError, "CodecNotFoundError": CodecNotFoundError}
    with pytest.raises(error[case.document["error"]]) as caught:
        CODEC.decode(case.frame)
    assert case.document["reason"] in str(caught.value)


SMALL = [case for case in WRITTEN if len(case.frame) < 8192]
"""Longer ones are the same byte over and over, which only makes the test slow."""


@pytest.mark.parametrize("case", SMALL, ids=name)
def test_frame_cut_or_extended_anywhere_is_refused(case: Case) -> None:
    for length in range(len(case.frame)):
        with pytest.raises(DecodeError):
            CODEC.decode(case.frame[:length])
    with pytest.raises(DecodeError):
        CODEC.decode(case.frame + b"\0")


@pytest.mark.parametrize("case", SMALL, ids=name)
def test_flipped_bits_are_a_codec_error_or_another_value(case: Case) -> None:
    for offset in range(len(case.frame)):
        for bit in range(8):
            damaged = bytearray(case.frame)
            damaged[offset] ^= 1 << bit
            is_refused_or_read(bytes(damaged))


@pytest.mark.parametrize("offset", range(4))
def test_every_other_magic_and_version_is_refused(offset: int) -> None:
    frame = bytearray(bytes(CODEC.encode(Native(value=1), Header())))
    right = frame[offset]
    for byte in range(256):
        frame[offset] = byte
        assert is_refused_or_read(bytes(frame)) == (byte == right)


def test_frame_above_the_limit_is_refused_before_it_is_read() -> None:
    frame = bytes(CODEC.encode(Tensor(array=Array.of(bytes(1000))), Header()))
    FrameCodec(max_bytes=len(frame)).decode(frame)
    with pytest.raises(DecodeError, match=f"a frame of {len(frame)} bytes exceeds the limit"):
        FrameCodec(max_bytes=len(frame) - 1).decode(frame)


def test_arrays_are_views_into_the_payload() -> None:
    frame = bytes(CODEC.encode(Tensor(array=Array.of(bytes(1000))), Header()))
    message, _ = CODEC.decode(frame)
    assert isinstance(message, Tensor)
    assert message.array.data.obj is frame
    assert message.array.data.readonly


def test_value_nested_too_deeply_is_refused_on_both_sides() -> None:
    deep: list[Any] = []
    for _ in range(100_000):
        deep = [deep]
    with pytest.raises(EncodeError):
        CODEC.encode(Native(value=deep), Header())
    fields = b"\x81\xa5value" + b"\x91" * 100_000 + b"\xc0"
    head = b"\x82\xa6schema\xb1vertebra/Native/1\xa6fields" + fields
    with pytest.raises(DecodeError, match="recursion"):
        CODEC.decode(b"VTB\x01" + len(head).to_bytes(4, "little") + head)


DTYPES = [
    "|b1", "|i1", "|u1", "<i2", "<u2", "<i4", "<u4", "<i8", "<u8", "<f2", "<f4", "<f8",
    ">f4", ">i8", "<c8", "<c16", "<M8[ns]", "|S5", "<U3", "|V4",
]  # fmt: skip


@st.composite
def arrays(draw: st.DrawFn) -> Array:
    dtype = draw(st.sampled_from(DTYPES))
    shape = tuple(draw(st.lists(st.integers(0, 4), max_size=3)))
    nbytes = item_bytes(dtype) * math.prod(shape)
    return Array(draw(st.binary(min_size=nbytes, max_size=nbytes)), dtype, shape)


SCALARS = (
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats(allow_nan=False)
    | st.text()
    | st.binary()
    | arrays()
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)
HEADERS = st.builds(
    Header,
    captured_ns=st.integers(-(2**63), 2**63 - 1),
    sequence=st.integers(0, 2**63),
    origin=st.text(),
    hops=st.integers(0, 100),
)


@given(value=VALUES, header=HEADERS)
def test_any_nesting_comes_back(value: Any, header: Header) -> None:
    message = Native(value=value)
    assert CODEC.decode(bytes(CODEC.encode(message, header))) == (message, header)


@settings(max_examples=300)
@given(value=VALUES, data=st.data())
def test_damage_to_any_nesting_is_a_codec_error_or_another_value(
    value: Any, data: st.DataObject
) -> None:
    frame = bytearray(bytes(CODEC.encode(Native(value=value), Header())))
    for _ in range(data.draw(st.integers(1, 4))):
        offset = data.draw(st.integers(4, len(frame) - 1))
        frame[offset] = data.draw(st.integers(0, 255))
    is_refused_or_read(bytes(frame))


@given(payload=st.binary(max_size=200))
def test_rubbish_is_refused(payload: bytes) -> None:
    assert not is_refused_or_read(payload)
    assert not is_refused_or_read(b"VTB\x01" + payload)


def test_value_without_a_form_is_refused() -> None:
    with pytest.raises(CodecNotFoundError, match="no codec plugin for values of type"):
        CODEC.encode(Native(value=object()), Header())
    with pytest.raises(CodecError, match="has no frame"):
        CODEC.encode(Native(value=2**64), Header())


def test_image_of_another_layout_is_no_image() -> None:
    with pytest.raises(ValueError, match="rgb8 pixels are"):
        Image(pixels=Array.of(bytes(12)), pixel_format="rgb8")


def test_foreign_value_is_sent_on_unchanged_and_shown_in_json() -> None:
    (case,) = [case for case in WRITTEN if case.name == "Native-foreign"]
    message, header = CODEC.decode(case.frame)
    assert bytes(CODEC.encode(message, header)) == case.frame
    assert to_json_value(message)["value"][0]["tag"] == "some_library.Value"


def test_empty_array_with_a_long_axis_is_not_unrolled_into_json() -> None:
    with pytest.raises(EncodeError, match="has more than 65536 items"):
        to_json_value(Tensor(array=Array(b"", "<f4", (10**18, 0))))


def test_values_nested_500_deep_are_read() -> None:
    fields = b"\x81\xa5value" + b"\x91" * 499 + b"\xc0"
    head = b"\x82\xa6schema\xb1vertebra/Native/1\xa6fields" + fields
    message, _ = CODEC.decode(b"VTB\x01" + len(head).to_bytes(4, "little") + head)
    assert isinstance(message, Native)
