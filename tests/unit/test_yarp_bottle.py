from __future__ import annotations

import struct
import tracemalloc
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vertebra.errors import DecodeError, EncodeError
from vertebra.yarp.protocol.bottle import (
    Dict,
    Float32,
    Incomplete,
    Int8,
    Int16,
    Int64,
    Limits,
    Value,
    Vocab,
    Vocab64,
    decode,
    decode_prefix,
    encode,
)
from vertebra.yarp.protocol.dialect import Dialect


def typed(value: object) -> object:
    """Return a value that equals another one only if the types agree as well, NaN included."""
    if isinstance(value, list):
        return (type(value), [typed(item) for item in value])
    if isinstance(value, float):
        return (type(value), struct.pack("<d", value))
    return (type(value), value)


def integers(bits: int) -> st.SearchStrategy[int]:
    return st.integers(-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)


def words(size: int) -> st.SearchStrategy[str]:
    raw = st.binary(min_size=1, max_size=size).filter(lambda raw: raw[-1] != 0 and raw != b"1")
    return raw.map(lambda raw: raw.decode("utf-8", "surrogateescape"))


def strings() -> st.SearchStrategy[str]:
    return st.text() | st.binary().map(lambda raw: raw.decode("utf-8", "surrogateescape"))


def values(dialect: Dialect) -> st.SearchStrategy[list[Value]]:
    """Bottles of every type, each value as the decoder gives it."""
    scalars: list[st.SearchStrategy[Value]] = [
        integers(32),
        integers(64).map(Int64),
        integers(16).map(Int16),
        integers(8).map(Int8),
        st.floats(),
        st.floats(width=32, allow_nan=False).map(Float32),
        strings(),
        st.binary(),
        st.booleans(),
        words(4).map(Vocab),
    ]
    if dialect is Dialect.V4:
        scalars.append(words(8).map(Vocab64))
    alike = st.one_of([st.lists(scalar, max_size=6) for scalar in scalars])
    return st.recursive(
        st.lists(st.one_of(scalars), max_size=6) | alike,
        lambda inner: st.lists(inner | inner.map(Dict) | st.one_of(scalars), max_size=4),
        max_leaves=12,
    )


@pytest.mark.parametrize("dialect", Dialect)
@given(data=st.data())
def test_values_come_back_with_their_types(dialect: Dialect, data: st.DataObject) -> None:
    bottle = data.draw(values(dialect))

    assert typed(decode(encode(bottle, dialect), dialect)) == typed(bottle)


@given(values(Dialect.V3), st.binary(max_size=9), st.binary(max_size=9))
def test_a_bottle_in_a_stream_ends_where_it_says(
    bottle: list[Value], before: bytes, after: bytes
) -> None:
    payload = encode(bottle)

    got, end = decode_prefix(memoryview(before + payload + after), len(before))

    assert typed(got) == typed(bottle)
    assert end == len(before) + len(payload)


@given(values(Dialect.V4))
def test_a_reader_that_fetches_what_is_missing_never_reads_too_far(bottle: list[Value]) -> None:
    payload = encode(bottle, Dialect.V4)
    have = 0
    while have < len(payload):
        with pytest.raises(Incomplete) as caught:
            decode_prefix(payload[:have], 0, Dialect.V4)
        have += caught.value.missing_bytes

    assert have == len(payload)


@given(st.binary(max_size=200), st.sampled_from(Dialect))
def test_rubbish_is_refused_or_a_bottle(rubbish: bytes, dialect: Dialect) -> None:
    for payload in (rubbish, b"\0\1\0\0" + rubbish, struct.pack("<ii", 256, 3) + rubbish):
        try:
            got = decode(payload, dialect)
        except DecodeError:
            continue
        encode(got, dialect)


@pytest.mark.parametrize(
    ("bottle", "expected"),
    [
        ([], "00010000 00000000"),
        ([1, "x"], "00010000 02000000 01000000 01000000 04000000 01000000 78"),
        ([1, 2, 3], "01010000 03000000 01000000 02000000 03000000"),
        ([Vocab("get"), Vocab("axes")], "09010000 02000000 67657400 61786573"),
        ([True, False], "09010000 02000000 31000000 00000000"),
        ([[]], "00010000 01000000 00010000 00000000"),
        (
            [[1, 2], [3]],
            "00010000 02000000 01010000 02000000 01000000 02000000 01010000 01000000 03000000",
        ),
        (
            ["x", Dict([["k", 1.5]])],
            (
                "00010000 02000000 04000000 01000000 78 00030000 00010000 01000000"
                "00010000 02000000 04000000 01000000 6b 0a000000 000000000000f83f"
            ),
        ),
        ([2**31 - 1], "01010000 01000000 ffffff7f"),
        ([2**31], "11010000 01000000 0000008000000000"),
        ([1, 2**31], "00010000 02000000 01000000 01000000 11000000 0000008000000000"),
        (((1, 2),), "00010000 01000000 01010000 02000000 01000000 02000000"),
    ],
)
def test_bytes_of_the_reference(bottle: Sequence[Value], expected: str) -> None:
    assert encode(bottle) == bytes.fromhex(expected)


def test_dicts_repeat_the_bottle_header_and_lists_do_not() -> None:
    entries: list[Value] = [["k", 1.5]]
    bottle = encode(entries)
    before = encode(["x", []])[:-8]  # what comes before the second value
    assert encode(["x", entries]) == before + bottle  # its header is the tag of the value
    assert encode(["x", Dict(entries)]) == before + b"\0\3\0\0" + bottle
    for value in (entries, Dict(entries)):
        assert typed(decode(encode(["x", value]))) == typed(["x", value])


def test_lists_of_one_type_omit_the_tags_and_lists_of_lists_never_do() -> None:
    ints, lists = encode([1, 2]), encode([[1], [2]])
    assert ints == struct.pack("<iiii", 0x101, 2, 1, 2)
    assert lists == struct.pack("<ii", 0x100, 2) + encode([1]) + encode([2])
    assert decode(lists) == [[1], [2]]


@pytest.mark.parametrize(
    ("payload", "bottle"),
    [
        ("00010000 02000000 01000000 05000000 01000000 06000000", [5, 6]),
        ("00010000 01000000 00010000 01000000 0a000000 0000000000000440", [[2.5]]),
        ("0a010000 00000000", []),
        ("00010000 01000000 00030000 00010000 00000000", [Dict()]),
    ],
)
def test_bottles_in_other_than_the_shortest_form_are_read(
    payload: str, bottle: list[Value]
) -> None:
    assert typed(decode(bytes.fromhex(payload))) == typed(bottle)


def test_the_dialects_disagree_on_floats() -> None:
    assert encode([1.5], Dialect.V3)[:4] == b"\x0a\x01\0\0"
    assert encode([1.5], Dialect.V4)[:4] == b"\x14\x01\0\0"
    with pytest.raises(DecodeError, match="unknown type tag 20"):
        decode(encode([1.5], Dialect.V4), Dialect.V3)
    with pytest.raises(DecodeError, match="8 bytes follow"):
        decode(encode([1.5, 2.5], Dialect.V3), Dialect.V4)


def test_subclasses_of_plain_types_are_sent_as_these() -> None:
    class Joint(int):
        pass

    assert encode([Joint(3), "x"]) == encode([3, "x"])


def test_words_and_their_codes() -> None:
    assert Vocab("pos").code == 0x736F70
    assert Vocab.from_code(0x736F70) == "pos"
    assert repr(Vocab("pos")) == "Vocab('pos')"
    assert encode([Vocab("abcdefgh")], Dialect.V4) == encode([Vocab64("abcdefgh")], Dialect.V4)


@given(integers(32))
def test_every_int32_is_the_code_of_a_word(code: int) -> None:
    assert Vocab.from_code(code).code == code


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (2**63, "does not fit"),
        (Int8(200), "does not fit a YARP Int8"),
        (Float32(1e300), "does not fit"),
        ("\ud800", "does not fit"),
        (Vocab("abcde"), "send a str"),
        (Vocab64("ab"), "send a str"),
        (None, "cannot hold a NoneType"),
        ({"a": 1}, "cannot hold a dict"),
    ],
)
def test_values_without_a_form_are_refused(value: Value, message: str) -> None:
    with pytest.raises(EncodeError, match=message):
        encode([1, [value]])


def test_words_beyond_eight_bytes_are_refused() -> None:
    with pytest.raises(EncodeError, match="at most 8"):
        encode([Vocab("abcdefghi")], Dialect.V4)


def test_a_list_that_holds_itself_is_refused() -> None:
    endless: list[Value] = []
    endless.append(endless)

    with pytest.raises(EncodeError, match="deeper than 64"):
        encode(endless)


@pytest.mark.parametrize(
    ("payload", "message"),
    [
        ("59410000 00005250", "first word is 0x4159"),
        ("00030000 00000000", "first word is 0x300"),
        ("00010000 ffffffff", "element count before byte 8 is negative"),
        ("00010000 01000000 63000000 00", "unknown type tag 99 before byte 12"),
        ("00010000 01000000 04000000 ffffffff", "length before byte 16 is negative"),
        ("63010000 01000000 00000000", "unknown type tag 99"),
        ("00010000 00000000 00", "1 bytes follow"),
        ("00010000 01000000 00020000 00000000", "unknown type tag 512"),
    ],
)
def test_damage_is_named_with_its_place(payload: str, message: str) -> None:
    with pytest.raises(DecodeError, match=message):
        decode(bytes.fromhex(payload))


@pytest.mark.parametrize(
    "payload",
    [
        "0a010000 ffffff7f",
        "20010000 ffffff7f",
        "00010000 ffffff7f",
        "04010000 01000000 ffffff7f",
        "0c010000 01000000 ffffff7f",
        "00010000 01000000 0a010000 ffffff7f",
        "00010000 01000000 00030000 00010000 ffffff7f",
    ],
)
def test_two_gigabytes_are_refused_before_they_are_allocated(payload: str) -> None:
    raw = bytes.fromhex(payload)
    tracemalloc.start()
    try:
        with pytest.raises(DecodeError, match="limit") as caught:
            decode_prefix(raw, 0)
        _, peak_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()

    assert not isinstance(caught.value, Incomplete)  # no use to wait for the rest
    assert peak_bytes < 100_000


def test_counts_are_checked_against_what_is_there_before_anything_is_allocated() -> None:
    raw = struct.pack("<ii", 256 + 32, 900_000) + bytes(100)
    tracemalloc.start()
    try:
        with pytest.raises(Incomplete) as caught:
            decode_prefix(raw, 0)
        _, peak_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()

    assert caught.value.missing_bytes == 900_000 - 100
    assert peak_bytes < 100_000


def nested(depth: int) -> bytes:
    return struct.pack("<ii", 256, 1) * depth + struct.pack("<ii", 256, 0)


def test_limits_hold_for_the_whole_bottle() -> None:
    assert decode(nested(64))
    with pytest.raises(DecodeError, match="deeper than 64"):
        decode(nested(65))
    with pytest.raises(DecodeError, match="deeper than 64"):
        decode(nested(100_000))
    with pytest.raises(DecodeError, match="limit of a whole bottle is 5"):
        decode(encode([[1, 2, 3], [4]]), limits=Limits(max_elements=5))
    with pytest.raises(DecodeError, match="limit of a whole bottle is 20"):
        decode(encode(["a" * 5, "b" * 5]), limits=Limits(max_bytes=20))


def test_what_is_missing_is_counted_from_the_end_of_the_buffer() -> None:
    whole = encode(["hello"])

    with pytest.raises(Incomplete) as caught:
        decode_prefix(b"??" + whole[:-3], 2)

    assert caught.value.missing_bytes == 3
