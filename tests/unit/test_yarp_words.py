"""What is said to control boards of YARP 3 and 4, and what their answers mean."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vertebra.errors import RemoteError
from vertebra.yarp import Dialect, Value, decode, encode, from_text, to_text
from vertebra_yarp.words import Request, Thrift, Vocabs, Words, number, numbers_of, words_of

V3, V4 = words_of(Dialect.V3), words_of(Dialect.V4)


def said(request: Request | None) -> str:
    assert request is not None
    return to_text(request)


def test_generation_chooses_the_words() -> None:
    assert isinstance(V3, Vocabs)
    assert isinstance(V4, Thrift)


@pytest.mark.parametrize(
    ("request_", "text"),
    [
        (V3.axes(), "[get] [axes]"),
        (V3.name(2), "[get] [name] 2"),
        (V3.position_limits(2), "[get] [llim] 2"),
        (V3.velocity_limits(2), "[get] [vlim] 2"),
        (V3.positions(), "[get] [encs]"),
        (V3.speeds(), "[get] [vels]"),
        (V3.modes(), "[get] [icmd] [cmds]"),
        (V3.arrived([0, 2]), "[get] [dong] 2 (0 2)"),
        (V3.move([0, 2], [1.5, 2.0]), "[set] [posg] 2 (0 2) (1.5 2.0)"),
        (V3.set_modes([2], ["vel"]), "[set] [icmd] [cmog] 1 (2) ([vel])"),
        (V3.stop([1, 2]), "[set] [stog] 2 (1 2)"),
        (V3.stop_all(), "[set] [stos]"),
        (V3.direct_head([1]), "[dpog] 1 (1)"),
        (V3.velocity_head([1]), "[vmog] 1 (1)"),
        (V4.axes(), "getAxesRPC"),
        (V4.name(2), "getAxisNameRPC 2"),
        (V4.position_limits(2), "getPosLimitsRPC 2"),
        (V4.velocity_limits(2), "getVelLimitsRPC 2"),
        (V4.positions(), "getEncoderAllRPC"),
        (V4.speeds(), "getTrajSpeedsAllRPC"),
        (V4.arrived([0, 2]), "checkMotionDoneGroupRPC (0 2)"),
        (V4.move([0, 2], [1.5, 2.0]), "positionMoveGroupRPC (0 2) (1.5 2.0)"),
        (
            V4.set_modes([2], ["vel"]),
            f"setControlModeGroupRPC (2) ({int.from_bytes(b'vel', 'little')})",
        ),
        (V4.stop([1, 2]), "stopGroupRPC (1 2)"),
        (V4.stop_all(), "stopAllRPC"),
        (V4.direct_head([1]), "[ipod] [dpog] 1 (1)"),
        (V4.velocity_head([1]), "[ivel] [vmog] 1 (1)"),
    ],
)
def test_requests(request_: Request, text: str) -> None:
    assert said(request_) == text


def test_speeds_are_set_one_by_one_or_as_a_group() -> None:
    assert [*map(said, V3.set_speeds([0, 2], [1.5, 2.0]))] == [
        "[set] [vel] 0 1.5",
        "[set] [vel] 2 2.0",
    ]
    assert [*map(said, V4.set_speeds([0, 2], [1.5, 2.0]))] == [
        "setTrajSpeedGroupRPC (0 2) (1.5 2.0)"
    ]


def test_only_state_ext_tells_modes_in_yarp_4() -> None:
    assert V4.modes() is None


@pytest.mark.parametrize(
    ("words", "reply", "values"),
    [
        (V3, "[is] [axes] 6 [tsta] 0 1795354651.596 [ok]", [6]),
        (V3, "[is] axes 6 [tsta] 1 1795354651.6 [ok]", [6]),
        (V3, "[is] [encs] (0.5 1.5) [tsta] 2 1.5 [ok]", [0.5, 1.5]),
        (V3, "[is] [llim] -30.0 22.0 [tsta] 7 1234.5 [ok]", [-30.0, 22.0]),
        (V3, "[is] [ipwm] 33.0 [ok]", [33.0]),
        (V3, "[is] 0 [pos] [tsta] 2 1.5 [ok]", ["pos"]),
        (V3, "[ok]", []),
        (V4, "[ok]", []),
        (V4, "([ok]) 6", [6]),
        (V4, "([ok]) -30.0 22.0", [-30.0, 22.0]),
        (V4, "([ok]) (0.5 1.5)", [0.5, 1.5]),
        (V4, "([ok]) neck_pitch", ["neck_pitch"]),
    ],
)
def test_answers(words: Words, reply: str, values: list[Value]) -> None:
    assert words.answer(from_text(reply), ["x"]) == values


@pytest.mark.parametrize(
    ("words", "reply"),
    [
        (V3, "[fail]"),
        (V3, "[nak]"),
        (V3, ""),
        (V4, "[err5]"),
        (V4, "([err5]) 0.0"),
        (V4, ""),
        (V4, "[fail]"),
    ],
)
def test_refusals_tell_question_and_answer(words: Words, reply: str) -> None:
    with pytest.raises(RemoteError, match=r"\[get\] \[axes\]") as caught:
        words.answer(from_text(reply), V3.axes())
    assert (reply or "nothing") in caught.value.detail


@given(
    st.lists(st.tuples(st.integers(0, 40), st.floats(-1e3, 1e3)), min_size=1, max_size=20),
    st.sampled_from(Dialect),
)
def test_moves_survive_the_wire(targets: list[tuple[int, float]], dialect: Dialect) -> None:
    joints, degrees = [joint for joint, _ in targets], [value for _, value in targets]
    request = words_of(dialect).move(joints, degrees)
    assert decode(encode(request, dialect), dialect) == request


def test_numbers() -> None:
    assert numbers_of(from_text("1 2.5 [ok] [fail]"), 4) == [1.0, 2.5, 1.0, 0.0]
    with pytest.raises(RemoteError, match="2 values where 3 belong"):
        numbers_of([1, 2], 3)
    with pytest.raises(RemoteError, match="'x' where a number"):
        number("x")
