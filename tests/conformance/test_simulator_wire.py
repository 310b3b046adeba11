"""The simulated robot answers and streams in the form of the robots that were captured."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from vertebra.yarp import Value, Vocab, decode, decode_prefix, encode
from vertebra.yarp.objects import JointData, Pair
from vertebra_simulator import grabber
from vertebra_simulator.board import ControlBoard
from vertebra_simulator.body import Body, Mode
from vertebra_simulator.scene import Camera

CAPTURED = json.loads(
    (Path(__file__).parent / "yarp" / "captured-3.12.json").read_text(encoding="utf-8")
)
HEAD_CALLS = CAPTURED["calls"][:49]
CAMERA_CALLS = CAPTURED["calls"][49:]


def form(value: Value) -> object:
    """Return what must be alike: words exactly, of the rest the types and counts."""
    if isinstance(value, list):
        return [form(item) for item in value]
    if isinstance(value, bool):
        return "word"  # a vocab whose code is 0: the fake robot knows no interaction mode
    if isinstance(value, Vocab):
        return "word" if value == "stif" else value
    return type(value).__name__


def captured_reply(call: dict[str, str]) -> list[Value]:
    return decode_prefix(bytes.fromhex(call["reply"]), 0)[0]


def test_head_answers_every_captured_request_in_the_captured_form() -> None:
    board = ControlBoard(Body())
    for call in HEAD_CALLS:
        request = decode(bytes.fromhex(call["request"]))
        captured = captured_reply(call)
        reply = board.answer(request, 1795354651.5)
        assert decode(encode(reply)) == reply, call["command"]
        assert form(reply) == form(captured), call["command"]
        if Vocab("tsta") in captured:  # stamps count up by the same rules
            assert reply[-3] == captured[-3], call["command"]
    assert len(HEAD_CALLS) == 49


@pytest.mark.parametrize("call", CAMERA_CALLS, ids=lambda call: call["command"])
def test_camera_answers_exactly_as_captured(call: dict[str, Any]) -> None:
    reply = grabber.answer(decode(bytes.fromhex(call["request"])), Camera(width=320))
    assert reply == captured_reply(call)


def test_state_has_the_form_of_the_captured_one() -> None:
    payload = bytes.fromhex(
        next(stream["payload"] for stream in CAPTURED["streams"] if stream["type"] == "jointData")
    )
    captured, ours = JointData.decode(payload), ControlBoard(Body()).state()
    assert len(ours.encode()) == len(payload)
    assert JointData.decode(ours.encode()) == ours
    assert ours.control_mode == captured.control_mode
    for name in ("joint_position", "joint_velocity", "joint_acceleration"):
        assert getattr(ours, name).ok == getattr(captured, name).ok
        assert len(getattr(ours, name).values) == len(getattr(captured, name).values)


def test_captured_command_moves_the_joint() -> None:
    stream = next(stream for stream in CAPTURED["streams"] if stream["type"] == "pair")
    pair = Pair.decode(bytes.fromhex(stream["payload"]))
    body = Body()
    board = ControlBoard(body)
    body.joints[0].set_mode(Mode.POSITION_DIRECT)
    board.command(pair.head, pair.body.values)
    body.advance_to(2.0)
    assert body.positions[0] == 12.5
    request: list[Value] = [Vocab("get"), Vocab("enc"), 0]
    assert board.answer(request, 3.5) == [
        Vocab("is"), Vocab("enc"), 12.5, Vocab("tsta"), 0, 3.5, Vocab("ok"),
    ]  # fmt: skip
