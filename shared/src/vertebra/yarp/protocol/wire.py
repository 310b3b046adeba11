"""What travels on a YARP connection, without any I/O.

Whoever opens a TCP connection sends eight bytes that choose the carrier, and its name. From then
on it sends messages; the other side sends acknowledgements and replies.

    binary   -> header(8) . i32 length . name . 00        <- number(own TCP port)
             -> number(10) . blocks(1) . outputs(1) . ff*8 . i32 per block . i32 per output
                command . payload                         <- [reply] [number(0) on tcp]
    text     -> "CONNECT name" or "CONNACK name"          <- "Welcome name"
             -> command line . payload line               <- [reply line] ["<ACK>" on text_ack]
    name_ser -> "NAME_SERVER payload" on each line        <- reply lines
    udp      -> as binary; the TCP connection ends        <- number(UDP port)
    mcast    -> as binary, then group . u16 UDP port; the TCP connection ends
    mjpeg    -> "GET /?action=stream"                     <- JPEGs as parts of one HTTP response

A number is `YA . i32 . RP`. A binary command is `i32 length . ~ . letter . 00 . 01`; where the
letter is 00, a NUL-terminated text follows that begins with the letter. A reply is the bare
object: it has neither index nor length.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from ipaddress import IPv4Address
from typing import Final, TypeAlias

from vertebra.errors import DecodeError, EncodeError

Buffer: TypeAlias = bytes | bytearray | memoryview


@dataclass(frozen=True, slots=True, kw_only=True)
class PeerLimits:
    """What a peer may cost us; beyond it the peer is refused and everybody else lives on.

    Attributes:
        max_message_bytes: Largest announced message or reply.
        max_text_bytes: Longest message on the text carriers, also where a payload becomes text.
        max_connections: Connections that one YARP port accepts at the same time; when it is
            full, the one that has been silent longest since it was made leaves first.
        greeting_timeout_s: How long a peer may take to choose its carrier.
        connect_timeout_s: How long dialling another port may take, its greeting included.
        reply_timeout_s: How long `on_call` may take before the caller gets `[fail]`.
        datagram_silence_s: After such a time without datagrams a writer by udp or mcast is asked
            whether it still writes to us; nothing else would tell.
    """

    max_message_bytes: int = 64 * 1024 * 1024
    max_text_bytes: int = 256 * 1024
    max_connections: int = 256
    greeting_timeout_s: float = 30.0
    connect_timeout_s: float = 5.0
    reply_timeout_s: float = 10.0
    datagram_silence_s: float = 10.0


DEFAULT_LIMITS: Final = PeerLimits()


# --- numbers and carriers --------------------------------------------------------------------

_NUMBER = struct.Struct("<2si2s")
_I32 = struct.Struct("<i")
_BINARY_CARRIERS: Final = 7777  # number of a binary carrier, plus its code
_WITH_ACK: Final = 128  # bit of the code


def yarp_number(value: int) -> bytes:
    """Return `value` as the eight bytes that YARP uses for headers, answers and acks."""
    return _NUMBER.pack(b"YA", value, b"RP")


def parse_number(raw: Buffer, offset: int = 0) -> int | None:
    """Return the number that the eight bytes at `offset` spell, or None."""
    before, value, after = _NUMBER.unpack_from(raw, offset)
    return int(value) if (before, after) == (b"YA", b"RP") else None


ACK: Final = yarp_number(0)
TEXT_ACK_LINE: Final = "<ACK>"
INDEX: Final = yarp_number(10)


@dataclass(frozen=True, slots=True)
class Carrier:
    """How the messages of one connection are written.

    Attributes:
        name: As people say it in `yarp connect a b NAME`.
        header: The eight bytes that choose it.
        acks: The receiver acknowledges every message.
        is_text: Messages are lines of text.
        is_connectionless: Messages travel as datagrams, after a greeting over TCP.
        is_push: The side that writes dials; otherwise the one that reads.
    """

    name: str
    header: bytes
    acks: bool
    is_text: bool
    is_connectionless: bool = False
    is_push: bool = True


TCP: Final = Carrier("tcp", yarp_number(_BINARY_CARRIERS + 3 + _WITH_ACK), acks=True, is_text=False)
FAST_TCP: Final = Carrier("fast_tcp", yarp_number(_BINARY_CARRIERS + 3), acks=False, is_text=False)
TEXT: Final = Carrier("text", b"CONNECT ", acks=False, is_text=True)
TEXT_ACK: Final = Carrier("text_ack", b"CONNACK ", acks=True, is_text=True)
NAME_SER: Final = Carrier("name_ser", b"NAME_SER", acks=False, is_text=True)
UDP: Final = Carrier("udp", yarp_number(_BINARY_CARRIERS), acks=False, is_text=False,
                     is_connectionless=True)  # fmt: skip
MCAST: Final = Carrier("mcast", yarp_number(_BINARY_CARRIERS + 1), acks=False, is_text=False,
                       is_connectionless=True)  # fmt: skip
MJPEG: Final = Carrier("mjpeg", b"GET /?ac", acks=False, is_text=False, is_push=False)
HTTP: Final = Carrier("http", b"GET /", acks=False, is_text=True, is_push=False)

OUTPUT_CARRIERS: Final = {
    carrier.name: carrier for carrier in (TCP, FAST_TCP, UDP, MCAST, TEXT, TEXT_ACK)
}
CARRIERS: Final = {
    **OUTPUT_CARRIERS, **{carrier.name: carrier for carrier in (NAME_SER, MJPEG, HTTP)}
}  # fmt: skip
_SPOKEN: Final = ", ".join(CARRIERS)
_DIALLED: Final = {**OUTPUT_CARRIERS, MJPEG.name: MJPEG}
_DIALLED_NAMES: Final = ", ".join(_DIALLED)

_HEADERS: Final = {
    **{carrier.header: carrier for carrier in (TEXT, TEXT_ACK, NAME_SER, MJPEG)}, b"POST /fo": HTTP
}  # fmt: skip
_FOREIGN_HEADERS: Final = {
    b"GET /?ws": "websocket",
    b"UNIX_STR": "unix_stream",
    b"HUMANITY": "human",
}
_BY_CODE: Final = {0: UDP, 1: MCAST, 3: FAST_TCP}  # the code's low four bits
_FOREIGN_CODES: Final = {14: "shmem"}

UNKNOWN_HEADER_ANSWER: Final = (
    b"* Error. Protocol not found.\r\n"
    b"* Hello. You appear to be trying to communicate with a YARP Port.\r\n"
    b"* The first 8 bytes sent to a YARP Port are critical for identifying the\r\n"
    b"* protocol you wish to speak.\r\n"
    b"* The first 8 bytes you sent were not associated with any particular protocol.\r\n"
    b'* If you are a human, try typing "CONNECT foo" followed by a <RETURN>.\r\n'
    b'* The 8 bytes "CONNECT " correspond to a simple text-mode protocol.\r\n'
    b"* Goodbye.\r\n"
)
_NO_WEBSOCKET: Final = (
    b"HTTP/1.0 501 Not Implemented\r\nConnection: close\r\nContent-Type: text/plain\r\n\r\n"
)


class UnknownCarrierError(DecodeError):
    """The first eight bytes choose no carrier that we speak.

    Attributes:
        answer: What to send before the end, so that the other side learns why.
    """

    def __init__(self, reason: str, answer: bytes = UNKNOWN_HEADER_ANSWER) -> None:
        super().__init__(reason)
        self.answer = answer


def choose_carrier(header: bytes) -> Carrier:
    """Return the carrier that the first eight bytes of a connection choose.

    Raises:
        UnknownCarrierError: None that we speak.
    """
    if header in _HEADERS:
        return _HEADERS[header]
    if header in _FOREIGN_HEADERS:
        raise _foreign(_FOREIGN_HEADERS[header])
    if header.startswith(HTTP.header):
        return HTTP
    number = parse_number(header)
    if number is None:
        raise UnknownCarrierError(f"the first 8 bytes {header!r} choose no YARP carrier")
    code = number - _BINARY_CARRIERS
    if code % 16 in _BY_CODE:
        carrier = _BY_CODE[code % 16]
        return TCP if carrier is FAST_TCP and code & _WITH_ACK else carrier
    if code % 16 in _FOREIGN_CODES:
        raise _foreign(_FOREIGN_CODES[code % 16])
    raise UnknownCarrierError(f"the first 8 bytes choose a YARP carrier of unknown code {code}")


def _foreign(name: str) -> UnknownCarrierError:
    reason = f"carrier {name} is not spoken here; use one of {_SPOKEN}"
    answer = f"* Error. The {reason}.\r\n".encode()
    return UnknownCarrierError(reason, _NO_WEBSOCKET + answer if name == "websocket" else answer)


def parse_carrier(text: str) -> tuple[Carrier, list[str]]:
    """Return the carrier and the modifiers of a text such as `tcp+log.in`.

    Raises:
        EncodeError: We cannot connect over it.
    """
    name, *modifiers = text.split("+")
    if name not in _DIALLED:
        raise EncodeError(f"cannot connect over carrier {name!r}; use one of {_DIALLED_NAMES}")
    for modifier in modifiers:
        if modifier.partition(".")[0] in ("recv", "send", "log"):
            raise EncodeError(f"carrier modifier {modifier!r} needs a YARP plug-in; leave it out")
    return _DIALLED[name], modifiers


# --- greetings -------------------------------------------------------------------------------

MAX_NAME_BYTES: Final = 1000
GROUP_BYTES: Final = 6
_MODIFIER: Final = re.compile(r"\(([^()]*)\)")


def greeting(carrier: Carrier, sender: str, modifiers: Sequence[str] = ()) -> bytes:
    """Return what the side that opens the connection sends first.

    Raises:
        EncodeError: The name is too long for a greeting, or holds control characters.
    """
    if carrier is MJPEG:
        return b"GET /?action=stream HTTP/1.0\r\n\r\n"
    lists = [f" ({modifier.replace('.', ' ', 1)})" for modifier in modifiers]
    name = line_bytes(sender + "".join(lists), "sender name")
    if not 0 < len(name) < MAX_NAME_BYTES:
        raise EncodeError(f"a sender name has 1 to {MAX_NAME_BYTES - 1} bytes, not {len(name)}")
    if carrier.is_text:
        return carrier.header + name + b"\r\n"
    return carrier.header + _I32.pack(len(name) + 1) + name + b"\0"


def welcome(carrier: Carrier, sender: str, own_port: int) -> bytes:
    """Return the answer to a greeting; by udp `own_port` is the UDP port to send to."""
    if carrier is NAME_SER:
        return b""
    return text_line(f"Welcome {sender}") if carrier.is_text else yarp_number(own_port)


def group_bytes(group: tuple[str, int]) -> bytes:
    """Return what follows a greeting by mcast: the address of the group to join."""
    return IPv4Address(group[0]).packed + struct.pack(">H", group[1])


def parse_group(raw: Buffer) -> tuple[str, int]:
    """Return the group that these `GROUP_BYTES` name."""
    return str(IPv4Address(bytes(raw[:4]))), int.from_bytes(raw[4:6], "big")


def parse_sender(raw: bytes) -> tuple[str, list[str]]:
    """Return name and modifiers of a sender that calls itself `/name (key value) (key)`."""
    text = decoded(raw)
    modifiers = [".".join(words.split()) for words in _MODIFIER.findall(text)]
    return text.partition(" ")[0], modifiers


# --- messages --------------------------------------------------------------------------------

_REVERSE: Final = "r"
_QUIT: Final = "q"
SMALL_BYTES: Final = 16 * 1024


def _short_command(letter: str) -> bytes:
    return struct.pack("<i4s", 0, b"~" + letter.encode() + b"\0\1")


def _long_command(text: bytes) -> bytes:
    return struct.pack("<i4s", len(text) + 1, b"~\0\0\1") + text + b"\0"


_SHORT_COMMANDS: Final = {letter: _short_command(letter) for letter in ("D", "d", "a", _REVERSE)}
LETTERS: Final = {ord(letter): letter for letter in _SHORT_COMMANDS}


def command(letter: str, envelope: str = "") -> bytes:
    """Return the block that begins a binary message: `D` data, `d` call, `a` administration.

    Raises:
        EncodeError: The envelope holds control characters, which YARP would cut it at.
    """
    if not envelope:
        return _SHORT_COMMANDS[letter]
    return _long_command(line_bytes(f"{letter} {envelope}", "envelope"))


def binary_message(command_block: bytes, payload: Sequence[Buffer]) -> list[Buffer]:
    """Return the buffers to send; small ones are joined, large ones are those of the caller.

    Raises:
        EncodeError: The payload is larger than a YARP message can be.
    """
    size = sum(map(len, payload))
    if size >= 2**31:
        raise EncodeError(f"a YARP message has at most {2**31 - 1} bytes, not {size}")
    sizes = (len(command_block), size) if size else (len(command_block),)
    index = struct.pack(f"<8s2s8s{len(sizes) + 1}i", INDEX, bytes((len(sizes), 1)), b"\xff" * 8,
                        *sizes, 0)  # fmt: skip
    buffers: list[Buffer] = []
    small: list[Buffer] = [index, command_block]
    for part in payload:
        if len(part) <= SMALL_BYTES:
            small.append(part)
        else:
            buffers += (b"".join(small), part) if small else (part,)
            small = []
    return [*buffers, b"".join(small)] if small else buffers


def quit_message(carrier: Carrier) -> bytes:
    """Return the message with which a writer leaves, empty where it has to do so by other means."""
    if carrier.is_connectionless or not carrier.is_push:
        return b""
    if carrier.is_text:
        return b"q\r\n"
    return b"".join(binary_message(_long_command(_QUIT.encode()), ()))


def reverse_message() -> bytes:
    """Return the binary message that asks an output port to send over this connection."""
    return b"".join(binary_message(_SHORT_COMMANDS[_REVERSE], ()))


def text_line(text: str) -> bytes:
    """Return a line as the text carriers send it."""
    return text.encode("utf-8", "surrogateescape") + b"\r\n"


def text_message(letter: str, envelope: str, text: str) -> bytes:
    """Return a message of the text carriers."""
    begin = line_bytes(f"{letter} {envelope}" if envelope else letter, "envelope")
    return begin + b"\r\n" + text_line(text)


def line_bytes(text: str, what: str) -> bytes:
    """Return text that must not hold control characters, or raise EncodeError."""
    if not text.isprintable():
        for character in text:
            if character < " ":
                raise EncodeError(f"the {what} {text!r} holds the control character {character!r}")
    return text.encode("utf-8", "surrogateescape")


def decoded(raw: Buffer) -> str:
    """Return bytes as text, whatever they are; `text_line` gives them back unchanged."""
    return str(raw, "utf-8", "surrogateescape")
