"""What a YARP peer sends, cut into events; without any I/O."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, TypeAlias

from vertebra.errors import DecodeError
from vertebra.yarp.protocol.bottle import Incomplete, Value, decode_prefix
from vertebra.yarp.protocol.dialect import Dialect
from vertebra.yarp.protocol.mjpeg import comment_of
from vertebra.yarp.protocol.text import is_complete, join_lines
from vertebra.yarp.protocol.wire import (
    ACK,
    GROUP_BYTES,
    HTTP,
    INDEX,
    LETTERS,
    MAX_NAME_BYTES,
    MCAST,
    MJPEG,
    NAME_SER,
    SMALL_BYTES,
    Carrier,
    PeerLimits,
    choose_carrier,
    decoded,
    parse_group,
    parse_number,
    parse_sender,
)

_I32 = struct.Struct("<i")


@dataclass(frozen=True, slots=True)
class Greeting:
    """A peer has chosen its carrier and said its name.

    Attributes:
        group: Multicast address and UDP port to join, on mcast.
    """

    carrier: Carrier
    sender: str
    modifiers: list[str]
    group: tuple[str, int] = ("", 0)


@dataclass(slots=True)
class Message:
    """One message; on text carriers also a line that is not one, such as `Welcome` or `<ACK>`.

    Attributes:
        command: Letter and what follows it, such as `D` or `D 41 1234.5`.
        payload: The object in binary, or the text of a bottle.
    """

    command: str
    payload: memoryview | str

    @property
    def envelope(self) -> str:
        """The text beside the payload."""
        return self.command[2:]


@dataclass(frozen=True, slots=True)
class Number:
    """A YARP number between messages: the answer to a greeting, or an ack (0)."""

    value: int


@dataclass(frozen=True, slots=True)
class CallReply:
    """The reply to a call, None where there was only an ack."""

    values: list[Value] | None


@dataclass(frozen=True, slots=True)
class Lost:
    """Something that the peer sent did not arrive."""

    reason: str
    count: int = 1


@dataclass(frozen=True, slots=True)
class Request:
    """What a browser asks over http.

    Attributes:
        method: Such as `GET`.
        target: Path and query.
        headers: By their names in small letters.
        body: What a form sends.
    """

    method: str
    target: str
    headers: dict[str, str]
    body: str


Event: TypeAlias = Greeting | Message | Number | CallReply | Lost | Request

_SCRATCH_BYTES: Final = 64 * 1024
_MAX_COMMAND_BYTES: Final = 64 * 1024
_UNPROVEN_BYTES: Final = 128 * 1024
_GROWTH: Final = 8
"""Of the buffer of a large message: memory goes to peers that send, not to those that announce."""
_MAX_CONTINUED_LINES: Final = 100
_MAX_HEAD_BYTES: Final = 16 * 1024
_MAX_HEAD_LINES: Final = 100
_MAX_LENGTH_DIGITS: Final = 12
_BROWSER: Final = "web"  # what YARP calls whoever comes by HTTP


class Receiver:
    """Cuts what a peer sends into events.

    Fill `get_buffer()`, say how much with `buffer_updated()`, then take `next_event()` until it
    is None. A large message is received into a buffer of its own, which its payload then is.
    All methods that parse raise DecodeError on what breaks the stream.

    Args:
        limits: What the peer may send.
        dialled: The carrier of a connection that we opened; None if the peer greets us.
    """

    def __init__(self, limits: PeerLimits, dialled: Carrier | None = None) -> None:
        self._limits = limits
        self._scratch = bytearray(_SCRATCH_BYTES)
        self._view = memoryview(self._scratch)
        self._begin = self._end = 0  # of what lies unread in the scratch
        self._large: bytearray | None = None
        self._announced = 0  # bytes of the large message
        self._proven = _UNPROVEN_BYTES  # or the largest message so far, if that was larger
        self._filled = 0
        self._pending = bytearray()  # the begin of a line or of a reply
        self._text_command: str | None = None  # of which the payload line has not come yet
        self._text_payload = ""
        self._text_lines = 0
        self._head_lines: list[str] = []
        self._request: Request | None = None  # of which the body has not come yet
        self._body_bytes = 0
        self._reply_dialect = Dialect.V3
        self._step: Callable[[], Event | None] = self._greeting
        if dialled is not None:
            self._step = self._stream_head if dialled is MJPEG else self._spoken(dialled)

    @property
    def full(self) -> bool:
        """Nothing more can be received before events are taken."""
        if self._large is not None:
            return self._filled == len(self._large)
        return self._end - self._begin == _SCRATCH_BYTES

    def get_buffer(self) -> memoryview:
        """Return where the next bytes belong; do not call it when `full`."""
        if self._large is not None:
            return memoryview(self._large)[self._filled :]
        if self._begin == self._end:
            self._begin = self._end = 0
        elif _SCRATCH_BYTES - self._end < _SCRATCH_BYTES // 2:
            rest = self._scratch[self._begin : self._end]
            self._begin, self._end = 0, len(rest)
            self._view[: self._end] = rest
        return self._view[self._end :]

    def buffer_updated(self, count: int) -> None:
        """Note that `count` bytes were written into the buffer."""
        if self._large is not None:
            self._filled += count
        else:
            self._end += count

    def next_event(self) -> Event | None:
        """Return what came next, or None until there is more."""
        return self._step()

    def expect_replies(self, dialect: Dialect) -> None:
        """Read the replies to our calls from now on."""
        self._reply_dialect = dialect
        self._step = self._reply

    def _greeting(self) -> Event | None:
        have = self._end - self._begin
        if have < 8:
            return None
        carrier = choose_carrier(bytes(self._view[self._begin : self._begin + 8]))
        if carrier is NAME_SER:
            self._begin += 8
            self._step = self._name_ser
            return Greeting(carrier, "anon", [])
        if carrier is HTTP:
            self._step = self._request_head
            return Greeting(carrier, _BROWSER, [])
        if carrier is MJPEG:
            self._step = self._stream_request
            return self._stream_request()
        if carrier is MCAST:
            return self._greeted_by_group(have)
        name = self._greeting_line() if carrier.is_text else self._greeting_block(have)
        if name is None:
            return None
        self._step = self._spoken(carrier)
        return Greeting(carrier, *parse_sender(name))

    def _spoken(self, carrier: Carrier) -> Callable[[], Event | None]:
        return self._text if carrier.is_text else self._binary

    def _greeted_by_group(self, have: int) -> Greeting | None:
        name = self._greeting_block(have - GROUP_BYTES)
        if name is None:
            return None
        group = parse_group(self._view[self._begin : self._begin + GROUP_BYTES])
        self._begin += GROUP_BYTES
        return Greeting(MCAST, *parse_sender(name), group)

    def _greeting_line(self) -> bytes | None:
        begin = self._begin + 8
        end = self._scratch.find(b"\n", begin, self._end)
        if end - begin >= MAX_NAME_BYTES or (end < 0 and self._end - begin > MAX_NAME_BYTES):
            raise DecodeError(f"the sender name is longer than {MAX_NAME_BYTES} bytes")
        if end < 0:
            return None
        self._begin = end + 1
        return bytes(self._view[begin:end]).rstrip(b"\r")

    def _greeting_block(self, have: int) -> bytes | None:
        if have < 12:
            return None
        (length,) = _I32.unpack_from(self._scratch, self._begin + 8)
        if not 1 <= length <= MAX_NAME_BYTES:
            raise DecodeError(
                f"the sender announces a name of {length} bytes; 1 to {MAX_NAME_BYTES} can be"
            )
        if have < 12 + length:
            return None
        begin = self._begin + 12
        self._begin = begin + length
        return bytes(self._view[begin : begin + length]).partition(b"\0")[0]

    def _binary(self) -> Event | None:
        if self._large is not None:
            large = self._take_large(self._large)
            return None if large is None else parse_message(large)
        scratch, begin = self._scratch, self._begin
        have = self._end - begin
        if have < 8:
            return None
        if not scratch.startswith(INDEX, begin):
            return self._number()
        if have < 18:
            return None
        blocks, outputs = scratch[begin + 8], scratch[begin + 9]
        start = begin + 18 + 4 * (blocks + outputs)
        if self._end < start:
            return None
        sizes = struct.unpack_from(f"<{blocks}i", scratch, begin + 18)
        total = message_size(sizes, self._limits)
        end = start + total
        if end <= self._end:
            self._begin = end
            return parse_message(bytes(self._view[start:end]))
        if total > SMALL_BYTES:
            self._receive_large(total, start)
        return None

    def _number(self) -> Number:
        value = parse_number(self._scratch, self._begin)
        if value is None:
            raw = bytes(self._view[self._begin : self._begin + 8])
            raise DecodeError(f"a message must begin with a YARP number, not with {raw!r}")
        self._begin += 8
        return Number(value)

    def _receive_large(self, total: int, start: int) -> None:
        self._announced = total
        self._large = bytearray(min(total, self._proven))
        self._filled = self._end - start
        self._large[: self._filled] = self._view[start : self._end]
        self._begin = self._end = 0

    def _take_large(self, large: bytearray) -> bytearray | None:
        """Return the large message when all of it has come; until then its buffer grows."""
        if self._filled < len(large):
            return None
        if self._filled < self._announced:
            self._large = bytearray(min(_GROWTH * self._filled, self._announced))
            self._large[: self._filled] = large
            return None
        self._large = None
        self._proven = max(self._proven, self._filled)
        return large

    def _line(self) -> str | None:
        end = self._scratch.find(b"\n", self._begin, self._end)
        stop = self._end if end < 0 else end
        self._pending += self._view[self._begin : stop]
        self._begin = stop
        if len(self._pending) > self._limits.max_text_bytes:
            raise DecodeError(
                f"a line is longer than max_text_bytes, {self._limits.max_text_bytes}"
            )
        if end < 0:
            return None
        self._begin += 1
        line = decoded(self._pending).removesuffix("\r")
        self._pending.clear()
        return line

    def _text(self) -> Event | None:
        while (line := self._line()) is not None:
            if self._text_command is None:
                if line[:1] not in ("D", "d", "a"):
                    return Message(line, "")
                self._text_command = line
                continue
            joined = join_lines(self._text_payload, line) if self._text_lines else line
            self._text_lines += 1
            if not is_complete(joined):
                self._continue_text(joined)
                continue
            message = Message(self._text_command, joined)
            self._text_command, self._text_payload, self._text_lines = None, "", 0
            return message
        return None

    def _continue_text(self, text: str) -> None:
        # A limit on lines as well, since every line is a look at all before it.
        if self._text_lines > _MAX_CONTINUED_LINES or len(text) > self._limits.max_text_bytes:
            raise DecodeError(
                f"a bottle is still open after {self._text_lines} lines, {len(text)} characters"
            )
        self._text_payload = text

    def _name_ser(self) -> Event | None:
        line = self._line()
        if line is None:
            return None
        # The eight bytes of the header have gone from the first line.
        return Message("d", line.removeprefix("VER ").removeprefix("NAME_SERVER "))

    # --- http and mjpeg ---

    def _head(self) -> list[str] | None:
        """Return the lines before the next empty one."""
        while (line := self._line()) is not None:
            if not line:
                lines, self._head_lines = self._head_lines, []
                return lines
            self._head_lines.append(line)
            size = sum(map(len, self._head_lines))
            if len(self._head_lines) > _MAX_HEAD_LINES or size > _MAX_HEAD_BYTES:
                raise DecodeError(
                    f"an HTTP head has {len(self._head_lines)} lines, {size} bytes and no end; "
                    f"{_MAX_HEAD_LINES} lines, {_MAX_HEAD_BYTES} bytes can be"
                )
        return None

    def _stream_request(self) -> Event | None:
        if self._head() is None:
            return None
        self._step = self._nothing
        return Greeting(MJPEG, _BROWSER, [])

    def _request_head(self) -> Event | None:
        lines = self._head()
        if lines is None:
            return None
        method, target, *_ = [*(lines[0] if lines else "").split(), "", ""]
        headers = _headers(lines[1:])
        self._body_bytes = _content_length(headers, self._limits.max_text_bytes)
        self._request = Request(method, target, headers, "")
        self._step = self._request_body
        return self._request_body()

    def _request_body(self) -> Event | None:
        body = self._take(self._body_bytes)
        if body is None or self._request is None:
            return None
        self._step = self._nothing
        return replace(self._request, body=decoded(body))

    def _stream_head(self) -> Event | None:
        lines = self._head()
        if lines is None:
            return None
        version, status, *_ = [*(lines[0] if lines else "").split(), "", ""]
        if not version.startswith("HTTP/") or status != "200":
            raise DecodeError(f"no stream of images, but {lines[:1]}")
        self._step = self._part_head
        return Message("Welcome", "")

    def _part_head(self) -> Event | None:
        while (lines := self._head()) is not None:
            if not lines:  # before the boundary
                continue
            headers = _headers(lines)
            if "content-length" not in headers:
                raise DecodeError(f"a part of the stream tells no length: {lines!r:.200}")
            self._body_bytes = _content_length(headers, self._limits.max_message_bytes)
            self._step = self._part
            return self._part()
        return None

    def _part(self) -> Event | None:
        jpeg = self._take(self._body_bytes)
        if jpeg is None:
            return None
        self._step = self._part_head
        envelope = comment_of(jpeg)
        return Message(f"D {envelope}" if envelope else "D", memoryview(jpeg).toreadonly())

    def _take(self, size: int) -> bytes | bytearray | None:
        """Return the next `size` bytes when all have come; large ones get a buffer of their own."""
        if self._large is not None:
            return self._take_large(self._large)
        end = self._begin + size
        if end <= self._end:
            raw = bytes(self._view[self._begin : end])
            self._begin = end
            return raw
        if size > SMALL_BYTES:
            self._receive_large(size, self._begin)
        return None

    def _nothing(self) -> None:
        """Let pass what is no longer of interest."""
        self._begin = self._end

    def _reply(self) -> Event | None:
        pending = self._pending
        pending += self._view[self._begin : self._end]
        self._begin = self._end
        limit = self._limits.max_message_bytes
        if len(pending) > limit:
            raise DecodeError(f"a reply is longer than max_message_bytes, {limit}")
        # The ack ends a reply; looking for it first spares parsing at every arrival.
        if not pending.endswith(ACK):
            return None
        if len(pending) == len(ACK):
            pending.clear()
            return CallReply(None)
        try:
            values, end = decode_prefix(pending, 0, self._reply_dialect)
        except Incomplete:
            return None  # the reply holds the bytes of an ack
        if end == len(pending):
            return None  # it ends in them, and its own ack is to come
        if end != len(pending) - len(ACK):
            raise DecodeError(
                f"a reply of {end} bytes should be followed by an ack, but "
                f"{len(pending) - end} bytes came"
            )
        pending.clear()
        return CallReply(values)


def _headers(lines: Sequence[str]) -> dict[str, str]:
    pairs = (line.partition(":") for line in lines)
    return {name.strip().lower(): value.strip() for name, _, value in pairs}


def _content_length(headers: Mapping[str, str], limit: int) -> int:
    text = headers.get("content-length", "0")
    if not text.isdecimal() or len(text) > _MAX_LENGTH_DIGITS or int(text) > limit:
        raise DecodeError(f"a body of {text:.40} bytes announced; at most {limit} can be")
    return int(text)


def message_size(sizes: Sequence[int], limits: PeerLimits) -> int:
    """Return how many bytes the blocks of a message have that announces these sizes.

    Raises:
        DecodeError: It cannot be, or is more than we take.
    """
    if min(sizes, default=0) < 0:
        raise DecodeError(f"a message announces a block of {min(sizes)} bytes")
    total = sum(sizes)
    if total < 8:
        raise DecodeError(f"a message of {total} bytes has no room for its command")
    limit = limits.max_message_bytes
    if total > limit:
        raise DecodeError(f"a message announces {total} bytes; max_message_bytes is {limit}")
    return total


def parse_message(raw: bytes | bytearray, start: int = 0) -> Message:
    """Return the message whose blocks begin at `start`; its payload is a view of `raw`.

    Raises:
        DecodeError: It does not begin with a port command.
    """
    if raw[start + 4] != 0x7E:
        begin = bytes(raw[start : start + 8])
        raise DecodeError(f"a message must begin with a port command, not with {begin!r}")
    code = raw[start + 5]
    if code:
        return Message(LETTERS.get(code) or chr(code), memoryview(raw).toreadonly()[start + 8 :])
    end = raw.find(0, start + 8, start + 8 + _MAX_COMMAND_BYTES)
    if end < 0:
        raise DecodeError(f"a port command does not end within {_MAX_COMMAND_BYTES} bytes")
    return Message(decoded(raw[start + 8 : end]), memoryview(raw).toreadonly()[end + 1 :])
