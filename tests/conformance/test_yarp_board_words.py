"""The words for control boards against what YARP 3.12.3 took and answered on the wire."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Final

import pytest

from vertebra.yarp import Value, decode, encode
from vertebra_yarp.words import Request, Vocabs

WORDS: Final = Vocabs()
PAIRS: Final = json.loads((Path(__file__).parent / "yarp" / "board-rpc.json").read_text())["pairs"]
REQUESTS: Final[dict[str, Request | None]] = {
    "axes": WORDS.axes(),
    "positions": WORDS.positions(),
    "name": WORDS.name(0),
    "position_limits": WORDS.position_limits(0),
    "velocity_limits": WORDS.velocity_limits(0),
    "speeds": WORDS.speeds(),
    "modes": WORDS.modes(),
}
VALUES: Final[dict[str, list[Value]]] = {
    "axes": [6],
    "positions": [0.0] * 6,
    "name": ["neck_pitch"],
    "modes": ["pos"] * 6,
}


@pytest.mark.parametrize("pair", PAIRS, ids=[pair["what"] for pair in PAIRS])
def test_requests_and_answers_are_those_of_a_real_board(pair: dict[str, str]) -> None:
    request = REQUESTS[pair["what"]]
    assert request is not None
    assert encode(request).hex() == pair["request"]
    values = WORDS.answer(decode(bytes.fromhex(pair["reply"])), request)
    assert values == VALUES.get(pair["what"], values)
    if "limits" in pair["what"]:
        assert len([value for value in values if isinstance(value, float)]) == 2


def test_every_request_was_captured() -> None:
    assert {pair["what"] for pair in PAIRS} == set(REQUESTS)
