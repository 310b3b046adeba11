"""NumPy values through the suite of all codec plugins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from vertebra.codec import FrameCodec, ValueCodecs
from vertebra.errors import DecodeError
from vertebra.messages import Array, Header, Native
from vertebra.testing.codec_suite import ValueCodecSuite
from vertebra_numpy.values import ArrayCodec, ScalarCodec

GOLDENS = Path(__file__).parent / "goldens"
POINT = np.dtype([("x", "<f4"), ("y", "<f4")])
RECORD = np.dtype(
    [("name", "<U3"), ("at", POINT), ("when", "<M8[ms]"), ("m", ">i2", (2, 2))], align=True
)


def record_array() -> np.ndarray[Any, np.dtype[Any]]:
    value = np.zeros((2,), RECORD)
    value["name"] = ["a", "häß"]
    value["at"]["x"] = [0.5, -1.5]
    value["when"] = np.datetime64("2026-11-22T12:00:00.001")
    value["m"] = [[1, 2], [3, -4]]
    return value


class TestNumpyArrays(ValueCodecSuite):
    tag = "numpy.ndarray"
    release = "0.1.0"
    folder = GOLDENS / "numpy.ndarray"
    values: ClassVar[Mapping[str, Any]] = {
        "b1": np.array([True, False]),
        "i1": np.array([[-128], [127]], "i1"),
        "u2": np.arange(6, dtype="<u2").reshape(2, 3),
        "i8": np.array([-(2**63), 2**63 - 1]),
        "big-u4": np.array([1, 2**32 - 1], ">u4"),
        "f2": np.array([0.5, np.inf, np.nan], "<f2"),
        "f8": np.array([[0.1, -0.0], [1e300, np.nan]]),
        "c8": np.array([1 + 2j], "<c8"),
        "c16": np.array([[1 - 2j]], ">c16"),
        "M8ns": np.array(["2026-11-22T12:00:00.123456789", "NaT"], "<M8[ns]"),
        "M8D": np.array(["1969-07-20"], "<M8[D]"),
        "m8-25us": np.array([3, -7], "<m8[25us]"),
        "S": np.array([b"abc", b""]),
        "U": np.array(["grün", "\N{ROBOT FACE}"]),
        "V": np.frombuffer(b"rawbytes", "|V4"),
        "0-d": np.array(7.5, "<f4"),
        "empty": np.zeros((3, 0, 2), "<i4"),
        "fortran": np.asfortranarray(np.arange(6, dtype="<i2").reshape(2, 3)),
        "structured": record_array(),
        "structured-0-d": record_array()[0:1].reshape(()),
        "structured-title": np.zeros((1,), [(("a title", "name"), "<i4")]),
        "structured-empty": np.zeros((0,), POINT),
        "structured-fortran": np.asfortranarray(np.zeros((2, 3), POINT)),
    }
    refused: ClassVar[Sequence[tuple[Any, str]]] = [
        (np.array([object()]), "never travel.*tolist"),
        (np.array([("a", None)], [("a", "U1"), ("o", "O")]), "never travel"),
        (np.array(["a", "bc"], np.dtypes.StringDType()), r"astype\('U'\)"),
        (np.zeros(2, np.longdouble), r"astype\('f8'\)"),
        (np.zeros(2, np.clongdouble), r"astype\('c16'\)"),
        (np.ma.masked_array([1, 2], [True, False]), "more than its numbers"),
        (np.zeros(2, [((5, "name"), "<i4")]), "title 5; use a text"),
    ]
    hostile: ClassVar[Sequence[Any]] = [
        Array(bytes(8), "<M8[no]", (1,)),
        Array(b"", "<f4", (2**62, 2**62, 0)),
        {"array": 1},
        {"array": Array(bytes(8), "<f8", (1,)), "unknown": 1},
        {"array": Array(bytes(8), "<f8", (1,)), "fields": []},
        {"array": Array(bytes(8), "|V8", (1,)), "fields": 5},
        {"array": Array(bytes(8), "|V8", (1,)), "fields": [5]},
        {"array": Array(bytes(8), "|V8", (1,)), "fields": [{"name": "a", "offset": 0}]},
        {"array": Array(bytes(8), "|V8", (1,)), "order": "K"},
        {"array": Array(bytes(8), "<f8", (1,)), "order": ["F"]},
        *(
            {"array": Array(bytes(8), "|V8", (1,)), "fields": [{"name": "a", "offset": 0, **entry}]}
            for entry in (
                {"type": "O"},
                {"type": "<f8,O"},
                {"type": 5},
                {"type": "<f8", "offset": 1},
                {"type": "<f8", "offset": -8},
                {"type": "<f8", "offset": 2**70},
                {"type": "<f8", "name": 5},
                {"type": "<f8", "shape": [2]},
                {"type": "<f8", "shape": [-1]},
                {"type": "<f8", "shape": [2**62, 2**62]},
                {"type": "<f8", "shape": "x"},
                {"type": "<f8", "title": "a"},
                {"type": "<f8", "title": []},
                {"fields": [], "itemsize": "8"},
                {"fields": [], "itemsize": 2**62},
            )
        ),
        {
            "array": Array(bytes(8), "|V8", (1,)),
            "fields": [{"name": "a", "offset": 0, "type": "<i4"}] * 2,
        },
        Array(b"\0\0\x11\0", "<U1", (1,)),
        Array(b"\xff\xff\xff\xff", ">U1", (1,)),
    ]

    def same(self, value: Any, other: Any) -> bool:
        return (
            type(value) is type(other) is np.ndarray
            and value.dtype == other.dtype
            and value.dtype.isnative == other.dtype.isnative
            and value.shape == other.shape
            and value.flags.f_contiguous == other.flags.f_contiguous
            and value.tobytes() == other.tobytes()
        )

    def any_value(self) -> st.SearchStrategy[Any]:
        plain = hnp.scalar_dtypes().filter(carried)
        nested = hnp.nested_dtypes(plain, max_leaves=4, max_itemsize=64).filter(
            lambda dtype: dtype.subdtype is None
        )
        shapes = hnp.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4)
        arrays = hnp.arrays(plain | nested, shapes)
        return arrays | arrays.map(np.asfortranarray)

    def touch(self, value: Any) -> None:
        if isinstance(value, np.ndarray):
            value.tolist()
            repr(value.dtype)


def carried(dtype: np.dtype[Any]) -> bool:
    return not (dtype.kind == "f" and dtype.itemsize > 8) and not (
        dtype.kind == "c" and dtype.itemsize > 16
    )


class TestNumpyScalars(ValueCodecSuite):
    tag = "numpy.generic"
    release = "0.1.0"
    folder = GOLDENS / "numpy.generic"
    values: ClassVar[Mapping[str, Any]] = {
        "bool": np.True_,
        "float16": np.float16(0.5),
        "float32": np.float32(0.1),
        "float64": np.float64("nan"),
        "uint8": np.uint8(255),
        "int64": np.int64(-(2**63)),
        "complex64": np.complex64(1 + 2j),
        "complex128": np.complex128(-1j),
        "str_": np.str_("grün"),
        "str_-empty": np.str_(""),
        "bytes_": np.bytes_(b"ab"),
        "void": np.void(b"raw"),
        "datetime64": np.datetime64("2026-11-22T12", "h"),
        "timedelta64": np.timedelta64(5),
        "structured": record_array()[1],
    }
    refused: ClassVar[Sequence[tuple[Any, str]]] = [
        (np.longdouble(1), r"astype\('f8'\)"),
        (np.array([("a", None)], [("a", "U1"), ("o", "O")])[0], "never travel"),
    ]
    hostile: ClassVar[Sequence[Any]] = [
        Array(bytes(8), "<f8", (1,)),
        {"array": Array(b"", "<f8", (0,)), "order": "F"},
    ]

    def same(self, value: Any, other: Any) -> bool:
        return (
            type(value) is type(other)
            and value.dtype == other.dtype
            and value.tobytes() == other.tobytes()
        )

    def any_value(self) -> st.SearchStrategy[Any]:
        dtypes = hnp.scalar_dtypes().filter(carried)
        arrays = dtypes.flatmap(lambda dtype: hnp.arrays(dtype, ()))
        return arrays.map(lambda array: array[()])

    def touch(self, value: Any) -> None:
        if isinstance(value, np.generic):
            value.item()


def test_a_decoded_array_is_a_read_only_view_into_the_payload() -> None:
    frames = FrameCodec(values=ValueCodecs(()))
    packed = ArrayCodec().pack(np.arange(100))
    frame = bytes(frames.encode(Native(value=packed), Header()))
    message, _ = frames.decode(frame)
    assert isinstance(message, Native)
    value = ArrayCodec().unpack(message.value)
    assert not value.flags.writeable
    assert np.shares_memory(value, np.frombuffer(frame, "u1"))


def test_packing_a_contiguous_array_copies_nothing() -> None:
    for value in (np.arange(100.0).reshape(4, 25), np.asfortranarray(np.ones((4, 25)))):
        packed = ArrayCodec().pack(value)
        array = packed["array"] if isinstance(packed, dict) else packed
        assert np.shares_memory(np.asarray(array), value)


def test_a_strided_array_is_copied_into_order() -> None:
    value = np.arange(24).reshape(4, 6)[::2, ::-1]
    assert np.array_equal(ArrayCodec().unpack(ArrayCodec().pack(value)), value)


def test_a_scalar_has_no_axes() -> None:
    with pytest.raises(DecodeError, match=r"has the shape \(2,\)"):
        ScalarCodec().unpack(Array(bytes(16), "<f8", (2,)))


def test_deeply_nested_fields_are_refused() -> None:
    fields: list[dict[str, Any]] = [{"name": "a", "offset": 0, "type": "|u1"}]
    for _ in range(100):
        fields = [{"name": "a", "offset": 0, "itemsize": 1, "fields": fields}]
    with pytest.raises(DecodeError, match="deeper than 32"):
        ArrayCodec().unpack({"array": Array(b"\0", "|V1", (1,)), "fields": fields})
