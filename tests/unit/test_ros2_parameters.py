"""Parameters of ROS nodes as plain values, and back."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vertebra.errors import EncodeError
from vertebra.ros2.cdr import Cdr
from vertebra.ros2.definitions import Types
from vertebra.ros2.parameters import KINDS, SERVICES, kind_of, plain_of, value_of
from vertebra_ros2.parameter_server import parameters_of
from vertebra_ros2.settings import Ros2Settings

TYPES = Types.standard()
VALUE = "rcl_interfaces/msg/ParameterValue"
INTEGERS = st.integers(-(2**63), 2**63 - 1)
NUMBERS = st.floats(allow_nan=False)
TEXT = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]))
PLAIN = st.one_of(
    st.none(),
    st.booleans(),
    INTEGERS,
    NUMBERS,
    TEXT,
    st.lists(st.booleans(), min_size=1),
    st.lists(INTEGERS, min_size=1),
    st.lists(NUMBERS, min_size=1),
    st.lists(TEXT, min_size=1),
)


@given(PLAIN)
def test_plain_value_survives_the_bytes(plain: Any) -> None:
    cdr = Cdr(TYPES)
    record = cdr.decode(cdr.encode(value_of(plain), VALUE), VALUE)
    found = plain_of(record)
    assert found == plain
    assert type(found) is type(plain)
    assert record["type"] == kind_of(plain)


@pytest.mark.parametrize(
    ("plain", "kind", "told"),
    [
        (1, "double", 1.0),
        ([1, 2], "double array", [1.0, 2.0]),
        ([1, 2], "byte array", [1, 2]),
        ([1, 2.5], "not set", [1.0, 2.5]),
        *(([], kind, []) for kind in KINDS if "array" in kind),
    ],
)
def test_plain_value_takes_the_kind_of_the_parameter(plain: Any, kind: str, told: Any) -> None:
    value = value_of(plain, KINDS.index(kind))
    if kind != "not set":
        assert KINDS[value["type"]] == kind
    assert plain_of(value) == told
    assert str(plain_of(value)) == str(told)


@pytest.mark.parametrize(
    ("plain", "kind", "told"),
    [
        (1.5, "integer", "1.5 is double, the parameter is integer"),
        ("1", "integer", "'1' is string, the parameter is integer"),
        (1, "boolean", "1 is integer, the parameter is boolean"),
        (True, "integer", "True is boolean, the parameter is integer"),
        ([1, "a"], "not set", "is no value of a parameter"),
        ([[1]], "not set", "is no value of a parameter"),
        ([], "not set", "is no value of a parameter"),
        ({}, "not set", "is no value of a parameter"),
    ],
)
def test_value_that_does_not_fit_is_refused(plain: Any, kind: str, told: str) -> None:
    with pytest.raises(EncodeError, match=told):
        value_of(plain, KINDS.index(kind))


def test_unknown_kind_is_not_set() -> None:
    assert plain_of({"type": 77}) is None


def test_every_service_of_parameters_is_known() -> None:
    for type_name in SERVICES.values():
        assert f"{type_name}_Request" in TYPES


def test_settings_are_parameters() -> None:
    found = parameters_of(Ros2Settings(domain_id=7, peers=("10.0.0.1",)))
    plain = {name: plain_of(one.value) for name, one in found.items()}
    assert plain["domain_id"] == 7
    assert plain["peers"] == ["10.0.0.1"]
    assert plain["types"] == []
    assert plain["automatic"] is True
    assert plain["routes"] is None
    assert plain["use_sim_time"] is False
    assert found["router"].remedy == "set VERTEBRA_ROUTER and restart the service"
    cdr = Cdr(TYPES)
    for one in found.values():
        cdr.encode(one.value, VALUE)
