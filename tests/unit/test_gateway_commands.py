"""Commands are held to their schema and to the robot's limits."""

from __future__ import annotations

import contextlib
import json
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vertebra.errors import CommandRefusedError, DecodeError
from vertebra_gateway.commands import InputCheck, read_limits
from vertebra_gateway.problems import InputRefusedError
from vertebra_gateway.profile import LimitFields, LimitSource, Resource

SOURCE = LimitSource(
    source="limits",
    fields={
        "positions_deg": LimitFields(min="min_deg", max="max_deg", unit="deg"),
        "velocity_deg_s": LimitFields(max="speed", unit="deg/s"),
    },
)
ANSWER: dict[str, Any] = {
    "joints": [
        {"name": "pan", "min_deg": -40, "max_deg": 40.0, "speed": 90},
        {"name": "tilt", "min_deg": -20.5, "max_deg": 10, "speed": 50, "colour": "red"},
    ]
}
LIMITS = read_limits(json.dumps(ANSWER).encode(), SOURCE)
MOVE = Resource(
    path="move",
    kind="call",
    key="r/move",
    input={
        "type": "object",
        "required": ["positions_deg"],
        "additionalProperties": False,
        "properties": {
            "positions_deg": {"type": "object", "additionalProperties": {"type": "number"}},
            "velocity_deg_s": {"type": "number", "exclusiveMinimum": 0},
        },
    },
)
CHECK = InputCheck(MOVE)


@pytest.mark.parametrize(
    "body",
    [
        {"positions_deg": {}},
        {"positions_deg": {"pan": 40}},
        {"positions_deg": {"pan": -40, "tilt": -20.5}, "velocity_deg_s": 50},
        {"positions_deg": {"pan": 0}, "velocity_deg_s": 90},
    ],
)
def test_what_is_within_passes(body: dict[str, Any]) -> None:
    CHECK.check(body, LIMITS)


@pytest.mark.parametrize(
    ("body", "says", "more"),
    [
        (
            {"positions_deg": {"pan": 0, "tilt": 10.1}},
            "positions_deg of tilt = 10.1 deg is outside its limit (min -20.5, max 10 deg)",
            {
                "joint": "tilt",
                "value": 10.1,
                "limit": {"min": -20.5, "max": 10.0, "unit": "deg"},
            },
        ),
        (
            {"positions_deg": {"tilt": 0}, "velocity_deg_s": 51},
            "velocity_deg_s of tilt = 51 deg/s is outside its limit (max 50 deg/s)",
            {"joint": "tilt", "value": 51, "limit": {"max": 50.0, "unit": "deg/s"}},
        ),
        (
            {"positions_deg": {"roll": 0}},
            "there is no joint 'roll'; known: pan, tilt",
            {"joint": "roll", "known": ["pan", "tilt"]},
        ),
        (
            {"positions_deg": {"pan": math.nan}},
            "positions_deg/pan is nan, not a number",
            {"path": "positions_deg/pan"},
        ),
        (
            {"positions_deg": {"pan": "far"}},
            "positions_deg/pan: 'far' is not of type 'number'",
            {"path": "positions_deg/pan"},
        ),
        ({"positions_deg": {"pan": True}}, "True is not of type 'number'", None),
        ({"velocity_deg_s": 1}, "'positions_deg' is a required property", {"path": ""}),
        ({"positions_deg": {}, "speed": 1}, "'speed' was unexpected", {"path": ""}),
        ({"positions_deg": {}, "velocity_deg_s": 0}, "less than or equal to the minimum", None),
        ([math.inf], "0 is inf", {"path": "0"}),
        ([], "is not of type 'object'", None),
        (None, "None is not of type 'object'", None),
    ],
)
def test_what_is_not_is_refused_with_what_helps(
    body: Any, says: str, more: dict[str, Any] | None
) -> None:
    with pytest.raises(InputRefusedError) as caught:
        CHECK.check(body, LIMITS)
    assert says in str(caught.value)
    assert more is None or caught.value.more == more


def test_a_call_without_input_takes_nothing() -> None:
    check = InputCheck(Resource(path="stop", kind="call", key="r/stop"))
    check.check({}, {})
    with pytest.raises(InputRefusedError):
        check.check({"hard": True}, {})


@given(
    st.dictionaries(
        st.sampled_from(["pan", "tilt"]), st.floats(allow_nan=True, allow_infinity=True)
    )
)
def test_nothing_outside_the_limits_passes(targets: dict[str, float]) -> None:
    within = all(
        LIMITS["positions_deg"][joint].holds(value) and math.isfinite(value)
        for joint, value in targets.items()
    )
    try:
        CHECK.check({"positions_deg": targets}, LIMITS)
    except CommandRefusedError:
        assert not within
    else:
        assert within


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(["positions_deg", "velocity_deg_s", "pan", "x"]), inner, max_size=3
        )
    ),
    max_leaves=8,
)


@given(JSON)
def test_any_input_passes_or_is_refused(body: Any) -> None:
    with contextlib.suppress(CommandRefusedError):
        CHECK.check(body, LIMITS)


@pytest.mark.parametrize(
    "answer",
    [
        b"",
        b"[]",
        b"{}",
        b'{"joints": 1}',
        b'{"joints": [1]}',
        b'{"joints": [{"min_deg": 0, "max_deg": 1, "speed": 1}]}',
        b'{"joints": [{"name": "pan", "max_deg": 1, "speed": 1}]}',
        b'{"joints": [{"name": "pan", "min_deg": "0", "max_deg": 1, "speed": 1}]}',
        b'{"joints": [{"name": "pan", "min_deg": 1e999, "max_deg": 1, "speed": 1}]}',
    ],
)
def test_limits_in_another_form_are_an_error(answer: bytes) -> None:
    with pytest.raises(DecodeError):
        read_limits(answer, SOURCE)


def test_limit_that_the_robot_does_not_know_bounds_nothing() -> None:
    answer = b'{"joints": [{"name": "pan", "min_deg": null, "max_deg": 1, "speed": null}]}'
    limits = read_limits(answer, SOURCE)
    ((field, by_joint), *_) = limits.items()
    assert by_joint["pan"].min is None, field
