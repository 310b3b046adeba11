"""Records of every shape: types that are made up, against the slow and obvious serialiser."""

from __future__ import annotations

import contextlib
from typing import Any

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from vertebra.errors import DecodeError, EncodeError
from vertebra.messages import Array
from vertebra.ros2.cdr import Cdr
from vertebra.ros2.definitions import Types
from vertebra.ros2.interface_files import PRIMITIVES, Field

from .golden_ros2 import LETTERS, reference
from .test_ros2_golden import plain

SLOW = settings(deadline=None, suppress_health_check=list(HealthCheck))
TEXTS = ("string", "wstring")
CHARACTERS = st.characters(exclude_categories=["Cs"], exclude_characters="\0")
PLURALS = st.sampled_from(["one", "one", "one", "array", "bounded", "sequence"])


@st.composite
def fields(draw: st.DrawFn, name: str, known: tuple[str, ...]) -> Field:
    kind = draw(st.sampled_from([*PRIMITIVES, *known]))
    plural: Any = draw(PLURALS)
    count = draw(st.integers(1, 4)) if plural in ("array", "bounded") else 0
    bound = draw(st.sampled_from([0, 0, 3])) if kind in TEXTS else 0
    return Field(name, kind, plural, count, bound)


@st.composite
def shapes(draw: st.DrawFn) -> tuple[Types, str]:
    """Make a type, maybe of others, maybe of nothing."""
    types = Types()
    known: tuple[str, ...] = ()
    for number in range(draw(st.integers(1, 3))):
        name = f"lab/msg/Shape{number}"
        members = [draw(fields(f"f{index}", known)) for index in range(draw(st.integers(0, 5)))]
        types.add_text(name, "\n".join(map(str, members)), f"Shape{number}.msg")
        assert types.definition(name) == tuple(members) or not members
        known = (*known, name)
    return types, known[-1]


def value_of(draw: st.DrawFn, types: Types, field: Field) -> Any:
    if field.plural == "one":
        return one_of(draw, types, field)
    most = {"array": field.count, "bounded": field.count, "sequence": 3}[field.plural]
    count = field.count if field.plural == "array" else draw(st.integers(0, most))
    return [one_of(draw, types, field) for _ in range(count)]


def one_of(draw: st.DrawFn, types: Types, field: Field) -> Any:
    kind = field.type
    if kind in TEXTS:
        text = draw(st.text(CHARACTERS, max_size=field.max_text or 6))
        fits = len(text.encode("utf-16-le")) // 2 if kind == "wstring" else len(text.encode())
        return text if not field.max_text or fits <= field.max_text else ""
    if kind == "bool":
        return draw(st.booleans())
    if kind.startswith("float"):
        return draw(st.floats(width=32 if kind == "float32" else 64, allow_nan=False))
    if kind in LETTERS:
        bits = int(kind.lstrip("uint") or 8) if kind != "byte" else 8
        low = -(1 << (bits - 1)) if kind.startswith("int") else 0
        return draw(st.integers(low, low + (1 << bits) - 1))
    return record_of(draw, types, kind)


def record_of(draw: st.DrawFn, types: Types, name: str) -> dict[str, Any]:
    return {field.name: value_of(draw, types, field) for field in types.definition(name)}


@given(shapes(), st.data())
@SLOW
def test_records_of_every_shape_go_there_and_back(shape: tuple[Types, str], data: Any) -> None:
    types, name = shape
    record = record_of(data.draw, types, name)
    cdr = Cdr(types)
    payload = cdr.encode(record, name)
    slow = reference(types, name, record)
    assert payload == slow + bytes(-len(slow) % 4)
    assert plain(cdr.decode(payload, name)) == record
    assert plain(cdr.decode(reference(types, name, record, ">"), name)) == record
    assert cdr.encode(cdr.decode(payload, name), name) == payload  # arrays as they are


@given(shapes(), st.data())
@SLOW
def test_damage_of_every_shape_is_a_record_or_a_decode_error(
    shape: tuple[Types, str], data: Any
) -> None:
    types, name = shape
    cdr = Cdr(types)
    payload = bytearray(cdr.encode(record_of(data.draw, types, name), name))
    for _ in range(data.draw(st.integers(1, 3))):
        payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(payload)))
    with contextlib.suppress(DecodeError):
        record = cdr.decode(bytes(payload[:cut]), name)
        assert record.keys() == {field.name for field in types.definition(name)}


ANYTHING = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=3)
    | st.binary(max_size=3)
    | st.just(Array(bytes(8), "<i8", (1,)))
    | st.just(10**400)
    | st.just("\ud800"),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.tuples(inner)
        | st.dictionaries(st.sampled_from(["f0", "f1", "x", 5]), inner, max_size=3)
    ),
    max_leaves=6,
)


@given(shapes(), st.dictionaries(st.sampled_from(["f0", "f1", "f2", "f3", "no"]), ANYTHING))
@SLOW
def test_anything_is_bytes_or_an_encode_error(
    shape: tuple[Types, str], record: dict[str, Any]
) -> None:
    types, name = shape
    cdr = Cdr(types)
    with contextlib.suppress(EncodeError):
        payload = cdr.encode(record, name)
        assert record.keys() <= cdr.decode(payload, name).keys()
