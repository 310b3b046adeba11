"""Requests and streamed commands of the simulated control board."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vertebra.errors import CommandRefusedError
from vertebra.yarp import Value, Vocab, encode, from_text, to_text
from vertebra_simulator.board import FAIL, NAK, OK, ControlBoard
from vertebra_simulator.body import Body, Mode


class Bench:
    """A board whose body lives from request to request."""

    def __init__(self) -> None:
        self.body = Body()
        self.board = ControlBoard(self.body)

    def ask(self, text: str) -> list[Value]:
        return self.board.answer(from_text(text), 1.0)

    def get(self, text: str) -> Value:
        reply = self.ask(f"[get] {text}")
        assert reply[0] == Vocab("is"), reply
        assert reply[-1] == OK
        return reply[2]

    def pass_time(self, seconds: float) -> None:
        self.body.advance_to(self.body.time_s + seconds)


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.mark.parametrize("words", ["[set] [pos] 2 20", "set pos 2 20.0", "[set] [rel] 2 20"])
def test_a_move_is_told_until_it_has_arrived(bench: Bench, words: str) -> None:
    assert bench.ask(words) == [OK]
    assert bench.get("[pos] 2") == 20
    assert bench.get("[don] 2") == 0
    assert bench.get("[don] 1") == 1
    assert bench.get("[dons]") == 0
    bench.pass_time(0.2)
    velocity = bench.get("[esp] 2")
    assert isinstance(velocity, float)
    assert velocity > 0
    bench.pass_time(2)
    assert bench.get("[dons]") == 1
    assert bench.get("[encs]") == [0, 0, 20, 0, 0, 0]


def test_all_some_and_relative_moves(bench: Bench) -> None:
    assert bench.ask("[set] [poss] (1 2 3 4 5 6)") == [OK]
    bench.pass_time(2)
    assert bench.get("[encs]") == [1, 2, 3, 4, 5, 6]
    assert bench.ask("[set] [rels] (1 1 1 1 1 1)") == [OK]
    bench.pass_time(2)
    assert bench.ask("[set] [relg] 2 (0 5) (-2.5 10)") == [OK]
    assert bench.ask("[set] [posg] 1 (3) (-5)") == [OK]
    assert bench.get("[dong] 2 (0 1)") == 0
    assert bench.get("[dong] 2 (1 2)") == 1
    bench.pass_time(2)
    assert bench.get("[posg] 3 (0 5 3)") == [-0.5, 17, -5]
    assert bench.get("[encs]") == [-0.5, 3, 4, -5, 6, 17]


def test_a_position_beyond_the_limits_is_clamped(bench: Bench) -> None:
    assert bench.ask("[set] [pos] 0 -90") == [OK]
    assert bench.get("[pos] 0") == -30
    assert bench.ask("[get] [llim] 0")[2:4] == [-30, 22]
    assert bench.ask("[get] [vlim] 0")[2:4] == [0, 100]


def test_speeds_and_accelerations_are_set_and_clamped(bench: Bench) -> None:
    assert bench.ask("[set] [vel] 1 12.5") == [OK]
    assert bench.ask("[set] [vels] (1 2 3 4 5 9999)") == [OK]
    assert bench.get("[vels]") == [1, 2, 3, 4, 5, 180]
    assert bench.ask("[set] [velg] 1 (0) (7)") == [OK]
    assert bench.get("[velg] 2 (0 1)") == [7, 2]
    assert bench.ask("[set] [accs] (1 2 3 4 5 99999)") == [OK]
    assert bench.ask("[set] [acc] 0 50") == [OK]
    assert bench.get("[accs]") == [50, 2, 3, 4, 5, 1800]
    assert bench.ask("[set] [vel] 0 0") == [FAIL]


def test_stop(bench: Bench) -> None:
    bench.ask("[set] [poss] (20 10 30 20 20 20)")
    bench.pass_time(0.3)
    assert bench.ask("[set] [sto] 2") == [OK]
    assert bench.ask("[set] [stog] 2 (0 1)") == [OK]
    bench.pass_time(0.2)
    assert bench.get("[don] 2") == bench.get("[don] 0") == 1
    assert bench.get("[don] 4") in (0, 1)
    assert bench.ask("[set] [stos]") == [OK]
    bench.pass_time(0.2)
    assert bench.get("[dons]") == 1
    assert bench.get("[poss]") == bench.get("[encs]")


def test_control_modes(bench: Bench) -> None:
    assert bench.ask("[set] [icmd] [cmod] 2 [vel]") == [OK]
    assert bench.ask("[get] [icmd] [cmod] 2")[:3] == [Vocab("is"), 2, Vocab("vel")]
    assert bench.ask("[set] [pos] 2 10") == [FAIL]
    assert bench.ask("[set] [icmd] [cmds] ([vel] [vel] [vel] [vel] [vel] [mix])") == [OK]
    assert bench.ask("[set] [vmos] (1 2 3 4 5 6)") == [OK]
    assert bench.get("[vmo] 5") == 6
    assert bench.ask("[set] [icmd] [cmog] 2 (0 1) ([fidl] [posd])") == [OK]
    assert bench.ask("[get] [icmd] [cmog] 3 (0 1 5)")[2] == ["idl", "posd", "mix"]
    assert bench.get("[asta]") == [0, 1, 1, 1, 1, 1]
    assert bench.ask("[set] [aen] 0") == [OK]
    assert bench.ask("[set] [adi] 1") == [OK]
    assert bench.ask("[get] [icmd] [cmog] 2 (0 1)")[2] == ["pos", "idl"]
    for mode in ("torq", "ipwm", "icur", "nope"):
        assert bench.ask(f"[set] [icmd] [cmod] 0 [{mode}]") == [FAIL]


def test_the_head_is_always_stiff(bench: Bench) -> None:
    assert bench.ask("[set] [intm] [mode] 0 [stif]") == [OK]
    assert bench.ask("[set] [intm] [mods] ([stif] [stif] [stif] [stif] [stif] [stif])") == [OK]
    assert bench.ask("[set] [intm] [mode] 0 [comp]") == [FAIL]
    assert bench.ask("[get] [intm] [mode] 0")[0] == Vocab("stif")


@pytest.mark.parametrize(
    "text",
    [
        "[get] [enc]",
        "[get] [enc] 6",
        "[get] [enc] -1",
        "[get] [enc] 1.5",
        '[get] [enc] "1"',
        "[get] [enc] true",
        "[get] [name] 6",
        "[get] [type] 6",
        "[get] [posg] 2 (0)",
        "[get] [posg] 1 (6)",
        "[get] [icmd]",
        "[get] [icmd] [cmod] 9",
        "[get] [intm] [mode] 9",
        "[get] [torq] [trq]",
        "[get] [torq]",
        "[get] 5",
        "[get] ()",
        "[set] [pos] 0",
        "[set] [pos] 0 1 2",
        "[set] [pos] 0 x",
        "[set] [pos] 0 nan",
        "[set] [pos] 9 1",
        "[set] [poss] (1 2 3)",
        "[set] [poss] (1 2 3 4 5 true)",
        "[set] [poss] 1 2 3 4 5 6",
        "[set] [posg] 2 (0 1) (1)",
        "[set] [posg] 1 (0 1) (1 2)",
        "[set] [vmo] 0 5",  # only streamed, as in YARP 3.12
        "[set] [dpos] (1 2 3 4 5 6)",
        "[set] [ere] 0",
        "[set] [llim] 0 -1 1",
        "[set] [icmd] [cmds] ([pos])",
        "[set] [icmd] [cmog] 2 (0) ([pos])",
        "[set] [sto] 7",
        "[set] [nope] 1",
        "[jump] [now]",
        "5 6",
    ],
)
def test_what_cannot_be_done_fails_and_changes_nothing(bench: Bench, text: str) -> None:
    assert bench.ask(text) == [FAIL]
    assert not any(joint.moving for joint in bench.body.joints)
    assert all(joint.mode is Mode.POSITION for joint in bench.body.joints)


@pytest.mark.parametrize("text", ["", "[get]", "help", "5"])
def test_what_is_no_request_is_not_acknowledged(bench: Bench, text: str) -> None:
    assert bench.ask(text) == [NAK]


words = st.sampled_from(
    ["get", "set", "pos", "poss", "posg", "icmd", "cmds", "cmog", "intm", "mods", "torq", "vels"]
).map(Vocab)
numbers = st.one_of(st.integers(-3, 8), st.floats(), st.booleans())
values: st.SearchStrategy[Value] = st.recursive(
    st.one_of(words, numbers, st.text(max_size=5), st.binary(max_size=3)),
    lambda inner: st.lists(inner, max_size=7),
    max_leaves=12,
)


@given(st.lists(values, max_size=7))
def test_any_bottle_gets_an_answer_that_can_be_sent(request: list[Value]) -> None:
    bench = Bench()
    reply = bench.board.answer(request, 1.0)
    assert reply in ([OK], [FAIL], [NAK]) or reply[-1] == OK
    assert encode(reply)
    assert to_text(reply)


@pytest.mark.parametrize(
    ("mode", "head", "body", "joint", "expected"),
    [
        (Mode.POSITION_DIRECT, "[dpo] 2", [10], 2, 10.0),
        (Mode.POSITION_DIRECT, "[dpos]", [1, 2, 3, 4, 5, 6], 5, 6.0),
        (Mode.POSITION_DIRECT, "[dpog] 2 (4 1)", [7, 8], 1, 8.0),
        (Mode.POSITION, "[poss]", [1, 2, 3, 4, 5, 6], 3, 4.0),
        (Mode.VELOCITY, "[vmo] 2", [1e9], 2, 50.0),
        (Mode.VELOCITY, "[vmos]", [0, 0, 0, 0, 0, 90], 5, 50.0),
        (Mode.VELOCITY, "[vmog] 1 (0)", [-90], 0, -30.0),
    ],
)
def test_streamed_commands(
    mode: Mode, head: str, body: list[float], joint: int, expected: float
) -> None:
    bench = Bench()
    for each in bench.body.joints:
        each.set_mode(mode)
    bench.board.command(from_text(head), body)
    bench.pass_time(5)
    assert bench.body.positions[joint] == expected


@pytest.mark.parametrize(
    ("head", "body", "reason"),
    [
        ("[dpo] 2", [1], "set 'posd' first"),
        ("[vmo] 2", [1], "set 'vel' or 'mix' first"),
        ("[poss]", [1], "1 values for 6 joints"),
        ("[vmog] 2 (0)", [1, 2], "1 values for 2 joints"),
        ("[dpo] 6", [1], "no joint 6"),
        ("[dpo]", [1], "joint number"),
        ("[dtqs]", [0] * 6, "unknown"),
        ("[ipwm] [ref] 0", [0], "unknown"),
        ("", [], "unknown"),
    ],
)
def test_streamed_commands_that_do_not_fit_are_refused(
    bench: Bench, head: str, body: list[float], reason: str
) -> None:
    with pytest.raises(CommandRefusedError, match=reason):
        bench.board.command(from_text(head), body)


def test_what_is_not_measured_says_so(bench: Bench) -> None:
    state = bench.board.state()
    for unmeasured in (state.torque, state.current, state.pwm_dutycycle):
        assert not unmeasured.ok
    assert bench.get("[torq] [trqs]") == [0] * 6
    assert bench.ask("[get] [ipwm] [pwms]") == [Vocab("is"), Vocab("ipwm"), [0.0] * 6, OK]
