"""Messages: arrays are views, shapes and lengths are checked where a message is made."""

from __future__ import annotations

import array
import gc
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from vertebra import errors
from vertebra.errors import EncodeError
from vertebra.messages import (
    MESSAGES,
    PIXELS,
    Array,
    AudioChunk,
    Image,
    JointCommand,
    JointState,
    item_bytes,
)

PLAIN_DTYPES = ["|b1", "|i1", "|u1", "<i2", "<u2", "<i4", "<u4", "<i8", "<u8", "<f4", "<f8"]


@st.composite
def numpy_arrays(draw: st.DrawFn) -> Any:  # NumPy tells mypy of its buffers only from 3.12 on
    dtype = np.dtype(draw(st.sampled_from(PLAIN_DTYPES)))
    shape = draw(arrays.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=5))
    return draw(arrays.arrays(dtype, shape))


@given(numpy_arrays())
def test_an_array_shows_the_same_items_in_place(value: Any) -> None:
    seen = np.asarray(Array.of(value))
    assert (seen.dtype, seen.shape) == (value.dtype, value.shape)
    assert seen.tobytes() == value.tobytes()
    if value.nbytes:
        assert np.shares_memory(seen, value)


@given(numpy_arrays())
def test_items_come_as_nested_lists(value: Any) -> None:
    listed = Array.of(value).tolist()
    assert listed == value.tolist() or math.isnan(np.sum(value))


def test_a_view_keeps_what_it_looks_at_alive() -> None:
    payload = bytearray(b"header" + bytes(range(12)))
    seen = np.asarray(Array(memoryview(payload)[6:].toreadonly(), "<u2", (2, 3)))
    del payload
    gc.collect()
    assert seen.tobytes() == bytes(range(12))
    assert not seen.flags.writeable


def test_an_array_that_is_not_contiguous_is_copied_once() -> None:
    value: Any = np.arange(12, dtype="<i4").reshape(3, 4)[:, ::2]
    seen = Array.of(value)
    assert seen.tolist() == value.tolist()


def test_arrays_of_the_standard_library_are_arrays_too() -> None:
    assert Array.of(array.array("d", [1.5, 2.5])) == Array(
        array.array("d", [1.5, 2.5]), "<f8", (2,)
    )
    assert Array.of(b"abc").tolist() == [97, 98, 99]


def test_arrays_compare_by_type_shape_and_bytes() -> None:
    one = Array(b"\1\2", "|u1", (2,))
    assert one == Array(b"\1\2", "|u1", (2,))
    assert hash(one) == hash(Array(b"\1\2", "|u1", (2,)))
    assert one != Array(b"\1\2", "|i1", (2,))
    assert one != Array(b"\1\2", "|u1", (1, 2))
    assert one != b"\1\2"


@pytest.mark.parametrize(
    ("data", "dtype", "shape"),
    [
        (b"abc", "|u1", (4,)), (b"abc", "<u2", (1,)), (b"ab", "|u1", (-1, -2)), (b"", "|O8", (0,)),
        (b"ab", "u1", (2,)), (b"ab", "|u1, ", (2,)), (b"", "|u1", (0,) * 65),
    ],
)  # fmt: skip
def test_an_array_of_another_length_or_type_is_refused(
    data: bytes, dtype: str, shape: tuple[int, ...]
) -> None:
    with pytest.raises(ValueError, match="array"):
        Array(data, dtype, shape)


@pytest.mark.parametrize("kind", ["<f8", "|u1", "<M8[ns]", "<U5", "|S7", "<c16"])
def test_the_bytes_of_an_item_are_those_of_numpy(kind: str) -> None:
    assert item_bytes(kind) == np.dtype(kind).itemsize


def test_what_has_no_plain_form_is_refused() -> None:
    foreign: Any = np.array([1j])
    with pytest.raises(EncodeError, match="item format"):
        Array.of(foreign)
    with pytest.raises(EncodeError, match="need NumPy"):
        Array(b"\0" * 8, "<M8[ns]", (1,)).tolist()
    with pytest.raises(EncodeError, match="need NumPy"):
        Array(b"\0" * 8, ">f8", (1,)).tolist()


@pytest.mark.parametrize("pixel_format", PIXELS)
def test_pixels_fit_their_format(pixel_format: Any) -> None:
    dtype, channels = PIXELS[pixel_format]
    shape = (4, 6) if channels == 1 else (4, 6, channels)
    pixels = Array(bytes(item_bytes(dtype) * math.prod(shape)), dtype, shape)
    image = Image(pixels=pixels, pixel_format=pixel_format)
    assert (image.height, image.width) == (4, 6)
    with pytest.raises(ValueError, match=r"pixels are .* of shape"):
        Image(pixels=Array(bytes(30), "|u1", (5, 6, 1)), pixel_format=pixel_format)


def test_samples_of_sound_have_two_axes() -> None:
    AudioChunk(samples=Array(bytes(8), "<i2", (4, 1)), rate_hz=16000)
    for samples in (Array(bytes(8), "<i2", (4,)), Array(bytes(4), "|u1", (4, 1))):
        with pytest.raises(ValueError, match="samples are"):
            AudioChunk(samples=samples, rate_hz=16000)


def test_joints_and_their_values_are_as_many() -> None:
    JointState(names=("a", "b"), positions_deg=(1.0, 2.0), efforts_nm=(0.0, 0.0))
    for field in ("positions_deg", "velocities_deg_s", "efforts_nm"):
        values: Any = {"positions_deg": (1.0, 2.0)} | {field: (1.0,)}
        with pytest.raises(ValueError, match=f"{field} has 1 values for 2 joints"):
            JointState(names=("a", "b"), **values)


@pytest.mark.parametrize(
    ("values", "match"),
    [
        ({}, "either"),
        ({"positions_deg": (1.0,), "velocities_deg_s": (1.0,)}, "either"),
        ({"positions_deg": (1.0, 2.0)}, "2 values were given for 1"),
    ],
)
def test_a_joint_command_says_one_thing(values: dict[str, Any], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        JointCommand(names=("a",), **values)


def test_every_message_has_a_schema_of_its_own() -> None:
    schemas = [message.schema() for message in MESSAGES]
    assert sorted(set(schemas)) == sorted(schemas)
    assert "vertebra/Image/1" in schemas


def test_errors_build_their_text_from_their_values() -> None:
    late = errors.DeadlineError("vizzy/head/move", 2.5)
    assert (str(late), late.timeout_s) == ("no answer from vizzy/head/move within 2.5 s", 2.5)
    busy = errors.BusyError("vizzy/head/move", 64)
    assert "64 requests are waiting" in str(busy)
    remote = errors.RemoteError("CommandRefusedError", "too far")
    assert (str(remote), remote.kind) == ("CommandRefusedError: too far", "CommandRefusedError")


def test_errors_are_what_the_standard_library_calls_them() -> None:
    assert issubclass(errors.DeadlineError, TimeoutError)
    assert issubclass(errors.NotConnectedError, ConnectionError)
    assert issubclass(errors.CodecError, ValueError)
    assert issubclass(errors.CodecNotFoundError, LookupError)
    for name, error in vars(errors).items():
        if name.endswith("Error"):
            assert issubclass(error, errors.VertebraError)
            assert name in str(errors.__doc__)
