"""What a YARP port answers to the tools: `yarp connect`, `disconnect`, `exists`, `ping`, `admin`.

The texts are those of YARP, since its tools and managers look into them.
"""

from __future__ import annotations

import os
import platform
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from vertebra.errors import CommandRefusedError, EncodeError, TransportError
from vertebra.yarp.ports.link import Link, PortNotFoundError
from vertebra.yarp.protocol.bottle import Dict, Value, Vocab
from vertebra.yarp.protocol.wire import CARRIERS

if TYPE_CHECKING:
    from vertebra.yarp.ports.switchboard import Switchboard

_PROTOCOL_VERSION: Final = (1, 2, 3)
_MAX_PROPERTIES: Final = 100

_HELP: Final = (
    "[help]                  # give this help",
    "[ver]                   # report protocol version information",
    "[add] $portname         # add an output connection",
    "[add] $portname $car    # add an output with a given protocol",
    "[del] $portname         # remove an input or output connection",
    "[list] [in]             # list input connections",
    "[list] [out]            # list output connections",
    "[list] [in]  $portname  # give details for input",
    "[list] [out] $portname  # give details for output",
    "[prop] [get]            # get all user-defined port properties",
    "[prop] [get] $prop      # get a user-defined port property (prop, val)",
    "[prop] [set] $prop $val # set a user-defined port property (prop, val)",
    "[prop] [get] $portname  # get Qos properties of a connection to/from a port",
    "[prop] [set] $portname  # set Qos properties of a connection to/from a port",
    (
        "[prop] [get] $cur_port  # get information about current process "
        "(e.g., scheduling priority, pid)"
    ),
    (
        "[prop] [set] $cur_port  # set properties of the current process "
        "(e.g., scheduling priority, pid)"
    ),
    "[atch] [out] $prop      # attach a portmonitor plug-in to the port's output",
    "[atch] [in]  $prop      # attach a portmonitor plug-in to the port's input",
    "[dtch] [out]            # detach portmonitor plug-in from the port's output",
    "[dtch] [in]             # detach portmonitor plug-in from the port's input",
)

TEXT_HELP: Final = (
    "This is a YARP port.  Here are the commands it responds to:",
    "*       Gives a description of this port",
    "d       Signals the beginning of input for the port's owner",
    'do      The same as "d" except replies should be suppressed ("data-only")',
    "q       Disconnects",
    "r       Reverse connection type to be a reader",
    "/port   Requests to send output to /port",
    "!/port  Requests to stop sending output to /port",
    "~/port  Requests to stop receiving input from /port",
    "a       Signals the beginning of an administrative message",
    "?       Gives this help",
)
NOT_UNDERSTOOD: Final = (
    "Port command not understood.",
    "Type d to send data to the port's owner.",
    "Type ? for help.",
)


def fail(reason: str) -> list[Value]:
    """Return the reply by which YARP programs say no."""
    return [Vocab("fail"), reason]


async def administer(board: Switchboard, request: Sequence[Value]) -> list[Value]:
    """Return the reply to an administrative message."""
    match [_word(value) for value in request[:3]]:
        case ["help", *_]:
            return [Vocab("many"), *_HELP]
        case ["ver", *_]:
            return [Vocab("ver"), *_PROTOCOL_VERSION]
        case ["add", dest, *carrier]:
            return _said(*await connect(board, dest, *carrier))
        case ["del", peer, *_]:
            return _said(*_disconnect(board, peer))
        case ["list", direction, peer]:
            return _details(board, direction, peer)
        case ["list", *direction]:
            return [link.peer for link in _links(board, *direction)]
        case ["prop", "get", *key]:
            return _property(board, *key)
        case ["prop", "set", key] if len(request) > 3:
            return _set_property(board, key, request[3:])
        case ["prop"] | ["prop", _]:
            return fail("property action not known")
        case ["get" | "set" as verb, "in" | "out" as direction, *peer]:
            return _parameters(board, verb, direction, *peer)
        case ["get" | "set" as verb, *_]:
            return fail(f"{verb} command must be followed by [out] or [in]")
        case ["atch" | "dtch", "in" | "out", *_]:
            return fail("portmonitor plug-ins are for the C++ library of YARP; there are none here")
        case ["atch", *_]:
            return fail("attach command must be followed by [out] or [in]")
        case ["dtch", *_]:
            return fail("detach command must be followed by [out] or [in]")
    return fail("send [help] for list of valid commands")


def describe(board: Switchboard) -> list[str]:
    """Return the lines that `yarp ping` shows."""
    where = board.contact
    lines = [f"This is {board.name} at {where.carrier}://{where.host}:{where.tcp_port}/"]
    lines += [
        f"There is an output connection from {board.name} to {link.peer} using {link.carrier}"
        for link in board.outputs
    ] or ["There are no outgoing connections"]
    lines += [
        f"There is an input connection from {link.peer} to {board.name} using {link.carrier}"
        for link in board.inputs
    ] or ["There are no incoming connections"]
    return lines


async def obey(board: Switchboard, command: str) -> list[str]:
    """Return the lines that answer what a person types on a text carrier."""
    if command == "*":
        return describe(board)
    if command in ("?", "h"):
        return [*TEXT_HELP]
    if command.startswith("/"):
        return [_line(await connect(board, command))]
    if command.startswith("!/"):
        return [_line(disconnect_output(board, command[1:]))]
    if command.startswith("~/"):
        return [_line(disconnect_input(board, command[1:]))]
    return [*NOT_UNDERSTOOD]


async def connect(board: Switchboard, dest: str, carrier: str = "") -> tuple[bool, str]:
    """Connect to `tcp://name` or `/name`; return success and the text about it."""
    before, separator, after = dest.partition("://")
    name, carrier = (f"/{after}", before) if separator else (dest, carrier)
    target = f"{carrier}:/{name}" if carrier else name
    try:
        await board.connect(name, carrier or "tcp")
    except CommandRefusedError as error:
        return False, f"{error}\r\n"
    except EncodeError as error:
        return False, f"Cannot connect to {target}: {error}\r\n"
    except PortNotFoundError:
        return False, f"Do not know how to connect to {target}\r\n"
    except TransportError as error:
        return False, f"Cannot connect to {target}: {error}\r\n"
    return True, f"Added connection from {board.name} to {target}\r\n"


def disconnect_output(board: Switchboard, peer: str) -> tuple[bool, str]:
    """Drop the output to `peer`; return success and the text about it."""
    if board.drop_output(peer):
        return True, f"Removed connection from {board.name} to {peer}\r\n"
    return False, f"Could not find an outgoing connection to {peer}\r\n"


def disconnect_input(board: Switchboard, peer: str) -> tuple[bool, str]:
    """Drop the input from `peer`; return success and the text about it."""
    if board.drop_input(peer):
        return True, f"Removing connection from {peer} to {board.name}\r\n"
    return False, f"Could not find an incoming connection from {peer}\r\n"


def _disconnect(board: Switchboard, peer: str) -> tuple[bool, str]:
    done, about_output = disconnect_output(board, peer)
    if done:
        return done, about_output
    done, about_input = disconnect_input(board, peer)
    return done, about_input if done else about_output + about_input


def _line(said: tuple[bool, str]) -> str:
    return said[1].removesuffix("\r\n")


def _said(success: bool, text: str) -> list[Value]:  # noqa: FBT001 -- made of what connect returns
    return [0 if success else -1, text]


def _word(value: Value) -> str:
    # The words of a request come as vocabs or as strings.
    return value if isinstance(value, str) else ""


def _links(board: Switchboard, direction: str = "out") -> Sequence[Link]:
    return board.inputs if direction == "in" else board.outputs


def _named(links: Sequence[Link], peer: str) -> Link | None:
    return next((link for link in links if link.peer == peer), None)


def _parameters(board: Switchboard, verb: str, direction: str, peer: str = "") -> list[Value]:
    """Answer for the parameters of a carrier; ours have none."""
    word = "from" if direction == "in" else "to"
    if not peer:
        return [-1, "target port is not specified.\r\n"]
    if peer == board.name:
        return fail("no portmonitor plug-in is attached")
    if not _named(_links(board, direction), peer):
        return [-1, f"Could not find an incoming connection {word} {peer}\r\n"]
    return [Dict()] if verb == "get" else [0, f"Configured connection {word} {peer}\r\n"]


def _details(board: Switchboard, direction: str, peer: str) -> list[Value]:
    link = _named(_links(board, direction), peer)
    if link is None:
        return []
    ends = (peer, board.name) if direction == "in" else (board.name, peer)
    details: list[Value] = [["from", ends[0]], ["to", ends[1]], ["carrier", link.carrier]]
    carrier = CARRIERS[link.carrier.partition("+")[0]]
    if carrier.is_connectionless:
        details.append(["connectionless", 1])
    if not carrier.is_push:
        details.append(["push", 0])
    return details


def _property(board: Switchboard, key: str = "") -> list[Value]:
    if not key:
        return [[name, value] for name, value in board.properties.items()]
    if key == board.name:
        return _process(board)
    if _named([*board.inputs, *board.outputs], key):
        unknown: list[Value] = [["policy", -1], ["priority", -1], ["tid", -1]]
        return [["sched", Dict(unknown)], ["qos", Dict([["tos", 0]])]]
    if key.startswith("/"):
        return fail(f"cannot find any connection to/from {key}")
    return [board.properties[key]] if key in board.properties else []


def _set_property(board: Switchboard, key: str, values: Sequence[Value]) -> list[Value]:
    if key.startswith("/"):
        # Scheduling and QoS of threads and sockets that ours do not have one by one.
        return [Vocab("fail")]
    if key not in board.properties and len(board.properties) == _MAX_PROPERTIES:
        return fail(f"a port keeps at most {_MAX_PROPERTIES} properties")
    board.properties[key] = values[0]
    return [Vocab("ok")]


def _process(board: Switchboard) -> list[Value]:
    # Without the arguments: who can reach the port need not know them.
    scheduling: list[Value] = [["policy", 0], ["priority", 0]]
    is_input = int(board.on_data is not None or board.on_call is not None)
    is_rpc = int(board.on_call is not None)
    return [
        ["sched", Dict([*scheduling, ["tid", threading.get_native_id()]])],
        [
            "process",
            Dict([["arguments", ""], ["name", Path(sys.argv[0]).name], ["pid", os.getpid()],
                  *scheduling]),
        ],
        ["platform", Dict([["hostname", platform.node()], ["os", platform.system()]])],
        [
            "port",
            Dict([["is_input", is_input], ["is_output", int(board.sends)], ["is_rpc", is_rpc],
                  ["type", ""]]),
        ],
    ]  # fmt: skip
