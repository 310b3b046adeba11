"""What a real port (`yarp write /c/a` of YARP 3.12.3) answered to administrative requests.

All were asked in this order, over text_ack, while the port had no connections.
"""

from __future__ import annotations

import json
from pathlib import Path

from vertebra.yarp.naming.names import Contact
from vertebra.yarp.naming.nametable import NameTable, TableClient
from vertebra.yarp.ports.admin import TEXT_HELP, administer, obey
from vertebra.yarp.ports.switchboard import Switchboard
from vertebra.yarp.protocol.dialect import Dialect
from vertebra.yarp.protocol.text import from_text, to_text
from vertebra.yarp.protocol.wire import DEFAULT_LIMITS

REPLIES = json.loads((Path(__file__).parent / "yarp" / "admin-3.12.json").read_text())

INCOMPLETE = ("[add]", "[del]", "[get]", "[set]")
"""YARP takes them for requests about a port without a name; ours says that something is missing."""
PROPERTY_OF_NOBODY = "[prop] [set] /nope (qos ((tos 0)))"
"""YARP says [fail], and keeps the property nevertheless; ours says why and does not."""


def board_of_nobody() -> Switchboard:
    return Switchboard(
        Contact("/c/a", "tcp", "127.0.0.1", 10002),
        TableClient(NameTable()),
        on_data=None,
        on_call=None,
        delivery="latest",
        depth=1,
        dialect=Dialect.V3,
        limits=DEFAULT_LIMITS,
    )


async def test_help_is_asked_for_by_two_letters() -> None:
    for letter in ("?", "h"):
        assert await obey(board_of_nobody(), letter) == [*TEXT_HELP]


async def test_a_port_answers_tools_in_the_words_of_yarp() -> None:
    board = board_of_nobody()
    for request, reply in REPLIES:
        said = to_text(await administer(board, from_text(request)), Dialect.V3)
        if request in INCOMPLETE:
            assert said.startswith("[fail] ")
        elif request == PROPERTY_OF_NOBODY:
            assert said.startswith("[fail]")
        elif request == "[prop] [get]":
            assert said == reply.replace('("/nope" (qos ((tos 0)))) ', "")
        else:
            assert (request, said) == (request, reply)
