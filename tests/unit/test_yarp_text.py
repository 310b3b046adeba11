from __future__ import annotations

import math
import string

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vertebra.errors import DecodeError, EncodeError
from vertebra.yarp.protocol.bottle import (
    Dict,
    Float32,
    Int8,
    Int64,
    Value,
    Vocab,
    Vocab64,
    decode,
    encode,
)
from vertebra.yarp.protocol.dialect import Dialect
from vertebra.yarp.protocol.text import from_text, is_complete, join_lines, to_text


def lossless_values() -> st.SearchStrategy[list[Value]]:
    """Bottles that survive being printed; see the tests below for what does not."""
    words = st.text(string.ascii_letters + string.digits + "_", min_size=1, max_size=4)
    scalars: st.SearchStrategy[Value] = st.one_of(
        st.integers(-(2**31), 2**31 - 1),
        st.integers(2**31, 2**63 - 1).map(Int64),
        st.floats(allow_nan=False),
        st.text().filter(lambda text: text not in ("null", "inf", "nan")),
        st.binary(),
        st.booleans(),
        words.filter(lambda word: word != "1").map(Vocab),
    )
    return st.recursive(
        st.lists(scalars, max_size=5), lambda inner: st.lists(inner | scalars, max_size=4)
    )


@given(lossless_values())
def test_what_is_printed_reads_back(bottle: list[Value]) -> None:
    assert encode(from_text(to_text(bottle))) == encode(bottle)


@given(lossless_values())
def test_what_is_printed_is_complete(bottle: list[Value]) -> None:
    assert is_complete(to_text(bottle))


@given(st.text())
def test_any_text_is_a_bottle(text: str) -> None:
    is_complete(text)
    for dialect in Dialect:
        encode(from_text(text, dialect), dialect)


@given(st.text("()[]{}\"\\ ,\n0123456789xXeE+-.naif'é", max_size=40))
def test_any_punctuation_is_a_bottle(text: str) -> None:
    is_complete(text)
    for dialect in Dialect:
        encode(from_text(text, dialect), dialect)


@pytest.mark.parametrize(
    ("bottle", "expected"),
    [
        ([], ""),
        ([5.0, 0.1, -0.0], "5.0 0.100000000000000005551 -0.0"),
        ([1e300, 1e21, 1e20], "1.0000000000000000525e+300 1e+21 100000000000000000000.0"),
        ([math.inf, -math.inf, math.nan], "inf -inf nan"),
        ([Float32(1.5), Int8(-5), Int64(5)], "1.5 -5 5"),
        ([Vocab("set"), True, False, Vocab("1"), Vocab("")], "[set] true false true false"),
        (["", "a", "a.b-c_9", "9a", ".a", "-a"], '"" a a.b-c_9 "9a" ".a" "-a"'),
        (["/c/a", "true", "a b", "été"], '"/c/a" "true" "a b" "été"'),
        (['a"b\\c', "a\nb\rc\0d\te"], '"a\\"b\\\\c" "a\\nb\\rc\\0d\te"'),
        ([b"\x01\x02\xff", b""], "{1 2 255} {}"),
        ([[1, [2, ()]], Dict([["k", 1.5]])], "(1 (2 ())) ((k 1.5))"),
    ],
)
def test_printing(bottle: list[Value], expected: str) -> None:
    assert to_text(bottle) == expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1,2\t3\r\n4", [1, 2, 3, 4]),
        (" , ,, ", []),
        ("+1 -1 007 010 08", [1, -1, 7, 8, 0]),
        ("0x1F 0X1f -0x10 0x 0x123456789", [31, 31, -16, 0, "0x123456789"]),
        ("- + 1-2 --1 -+1 1+", [0, 0, 1, "--1", "-+1", 1]),
        ("2147483647 -2147483648", [2147483647, -2147483648]),
        ("99999999999999999999 -99999999999999999999", [2**63 - 1, -(2**63)]),
        ("1. .5 -.5e-3 1E5 1e 1e5-3 -.", [1.0, 0.5, -0.0005, 1e5, 0.0, 0.0, 0.0]),
        ("1e999 -1e999 inf -inf +inf", [math.inf, -math.inf, math.inf, -math.inf, "+inf"]),
        ("0x1.8 00x1.8", [1.5, 0.0]),
        (". .. 1.2.3 E5 e5 12abc 1;2 #c", [".", "..", "1.2.3", "E5", "e5", "12abc", "1;2", "#c"]),
        ('true false tru\\e "true" True', [True, False, True, "true", "True"]),
        ('null "null" [null]', [Vocab("null"), "null", Vocab("null")]),
        ("[set] [abcdef] [1]", [Vocab("set"), Vocab("abcd"), True]),
        ("[] [ [x]y", [False, False, Vocab("x]")]),
        ("[ab\\] c", [Vocab("ab\\"), "c"]),
        ('a\\ b "a\\"b" "\\n\\r\\0\\\\\\x"', ["a b", 'a"b', "\n\r\0\\x"]),
        ('"a"b ""', ['a"', ""]),
        ("() (1 (2) x)", [[], [1, [2], "x"]]),
        ("{1 2 255} {} {256 -1 x 1.9 [b] true (1)}", [b"\1\2\xff", b"", b"\0\xff\0\1b1\0"]),
        ("a(b c)d", ["a(b c)d"]),
        ("(1 2)x 3", [[1], 3]),
        ("1 (2 3", [1]),
        ('1 "2 3', [1]),
        ("1 ) 2", [1]),
        ("1 a\\", [1]),
        ("'a b'", ["'a", "b'"]),
    ],
)
def test_reading(text: str, expected: list[Value]) -> None:
    assert encode(from_text(text)) == encode(expected)


def test_floats_have_21_digits_in_text() -> None:
    assert to_text([0.1, 1 / 3]) == "0.100000000000000005551 0.33333333333333331483"
    assert from_text(to_text([0.1, 1 / 3])) == [0.1, 1 / 3]


def test_null_and_booleans_are_vocabs() -> None:
    assert encode(from_text("null true")) == encode([Vocab("null"), Vocab("1")])
    assert encode([True, False]) == encode([Vocab("1"), Vocab("")])
    assert [type(value) for value in decode(encode(from_text("null true")))] == [Vocab, bool]


def test_long_words_are_vocabs_of_eight_bytes_in_yarp_4() -> None:
    bottle = from_text("[abcde] [abcdefghij] [abcd]", Dialect.V4)

    assert bottle == [Vocab64("abcde"), Vocab64("abcdefgh"), Vocab("abcd")]
    assert [type(value) for value in bottle] == [Vocab64, Vocab64, Vocab]
    assert to_text(bottle, Dialect.V4) == "[abcde] [abcdefgh] [abcd]"


def test_integers_beyond_32_bits_say_so() -> None:
    assert [type(value) for value in from_text("2147483647 2147483648 -2147483649")] == [
        int,
        Int64,
        Int64,
    ]


@pytest.mark.parametrize("value", [Vocab("abcde"), Vocab64("ab"), None, {}, 2**63])
def test_values_without_a_text_are_refused(value: Value) -> None:
    with pytest.raises(EncodeError):
        to_text([[value]])


def test_lone_surrogates_in_a_vocab_are_refused() -> None:
    with pytest.raises(DecodeError, match="no text"):
        from_text("[\ud800]")


@pytest.mark.parametrize(("opening", "closing"), [("(", ")"), ("{", "}")])
def test_lists_that_nest_too_deep_are_refused(opening: str, closing: str) -> None:
    with pytest.raises(DecodeError, match="deeper than 64"):
        from_text(opening * 10_000 + closing * 10_000)


@pytest.mark.parametrize("text", ["0" * 1_000_000 + "y", "9" * 1_000_000, "-" * 1_000_000])
def test_long_numbers_cost_one_pass(text: str) -> None:
    assert len(from_text(text)) == 1


@pytest.mark.parametrize("text", ["(1", "((1)", '"a', "{1 2", "1 )", 'a "b\\"', "a \\", "\\\\"])
def test_text_that_goes_on_in_the_next_line(text: str) -> None:
    assert not is_complete(text)


@pytest.mark.parametrize("text", ["", "1", "(1)", '"("', "\\(", 'a\\"', "a\\ ", "[x"])
def test_text_that_ends_here(text: str) -> None:
    assert is_complete(text)


def test_lines_are_joined_as_yarp_joins_them() -> None:
    assert join_lines("(1", "2)") == "(1\n2)"
    assert join_lines("one \\", "two") == "one two"
    assert from_text(join_lines('"a', 'b"')) == ["a\nb"]
