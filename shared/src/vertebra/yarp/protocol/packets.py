"""Messages as datagrams, for the carriers udp and mcast; without any I/O.

    datagram -> u32 crc . i32 sequence . bytes         at most 65499 bytes
    message  -> the bytes of datagrams 0, 1, 2, ... : index and blocks as on tcp

The crc is that of the bytes after these eight. Sequence -1 wakes a reader and means nothing.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterable, Iterator
from typing import Final

from vertebra.errors import DecodeError
from vertebra.yarp.protocol.receiver import Message, message_size, parse_message
from vertebra.yarp.protocol.wire import INDEX, Buffer, PeerLimits

MAX_DATAGRAM_BYTES: Final = 65499

_HEADER = struct.Struct("<Ii")
_NO_MESSAGE: Final = -1
_INDEX_BYTES: Final = 18  # with the counts of blocks and outputs, before their lengths


def cut(buffers: Iterable[Buffer]) -> Iterator[bytes]:
    """Yield the datagrams of one message."""
    parts: list[Buffer] = []
    room = MAX_DATAGRAM_BYTES - _HEADER.size
    sequence = 0
    for buffer in buffers:
        rest = memoryview(buffer)
        while len(rest) >= room:
            yield _datagram(sequence, [*parts, rest[:room]])
            parts, rest = [], rest[room:]
            room = MAX_DATAGRAM_BYTES - _HEADER.size
            sequence += 1
        parts.append(rest)
        room -= len(rest)
    if any(map(len, parts)):
        yield _datagram(sequence, parts)


def _datagram(sequence: int, parts: list[Buffer]) -> bytes:
    crc = 0
    for part in parts:
        crc = zlib.crc32(part, crc)
    return b"".join((_HEADER.pack(crc, sequence), *parts))


class Reassembly:
    """Makes messages of datagrams; what is not whole is never delivered, but counted.

    Holds at most one message, of at most `max_message_bytes`.

    Args:
        limits: What the peer may send.
        on_message: Gets the messages that are whole.
        on_lost: Gets the reason, once for each message of which something was missing.
    """

    def __init__(
        self,
        limits: PeerLimits,
        on_message: Callable[[Message], None],
        on_lost: Callable[[str], None],
    ) -> None:
        self._limits = limits
        self._on_message = on_message
        self._on_lost = on_lost
        self._raw = bytearray()
        self._total: int | None = None  # bytes of index and blocks, as soon as it is known
        self._start = 0  # of the blocks
        self._next = 0  # the sequence number that goes on with the message
        self._skipped: int | None = None  # the last one of a message given up

    def feed(self, datagram: bytes) -> None:
        """Take what came next."""
        if len(datagram) <= _HEADER.size:
            self._on_lost(f"a datagram of {len(datagram)} bytes is no part of a message")
            return
        crc, sequence = _HEADER.unpack_from(datagram)
        if zlib.crc32(memoryview(datagram)[_HEADER.size :]) != crc:
            self._give_up(f"the checksum of datagram {sequence} is wrong", sequence)
        elif sequence == 0:
            if self._next:
                self._give_up(f"it ended after {self._next} datagrams, {len(self._raw)} bytes", 0)
            self._skipped = None
            self._add(datagram)
        elif sequence == self._next:
            self._add(datagram)
        elif sequence != _NO_MESSAGE:
            self._give_up(f"datagram {sequence} came where {self._next} should be", sequence)

    def _add(self, datagram: bytes) -> None:
        sequence = self._next
        self._next += 1
        try:
            if sequence == 0 and self._is_whole(datagram):
                message = parse_message(datagram, _HEADER.size + self._start)
            else:
                self._raw += memoryview(datagram)[_HEADER.size :]
                if not self._is_whole(self._raw, 0):
                    return
                message = parse_message(self._raw, self._start)
        except DecodeError as error:
            self._give_up(str(error), sequence)
            return
        self._begin_again()
        self._on_message(message)

    def _is_whole(self, raw: bytes | bytearray, begin: int = _HEADER.size) -> bool:
        size = len(raw) - begin
        if self._total is None:
            self._total = self._announced(raw, begin, size)
        if self._total is not None and size > self._total:
            raise DecodeError(f"{size} bytes came where {self._total} were announced")
        return size == self._total

    def _announced(self, raw: bytes | bytearray, begin: int, size: int) -> int | None:
        if size < _INDEX_BYTES:
            return None
        if not raw.startswith(INDEX, begin):
            wrong = bytes(raw[begin : begin + 8])
            raise DecodeError(f"a message must begin with an index, not with {wrong!r}")
        blocks, outputs = raw[begin + 8], raw[begin + 9]
        self._start = _INDEX_BYTES + 4 * (blocks + outputs)
        if size < self._start:
            return None
        sizes = struct.unpack_from(f"<{blocks}i", raw, begin + _INDEX_BYTES)
        return self._start + message_size(sizes, self._limits)

    def _give_up(self, reason: str, sequence: int) -> None:
        # What follows of a message that was given up is no further loss.
        if self._skipped is None or sequence <= self._skipped:
            self._on_lost(reason)
        self._skipped = sequence
        self._begin_again()

    def _begin_again(self) -> None:
        self._raw = bytearray()
        self._next = 0
        self._total = None
