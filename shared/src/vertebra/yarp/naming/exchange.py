"""One question to a YARP port or name server, over a text_ack connection of its own."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Final

from vertebra.errors import DeadlineError, NotConnectedError
from vertebra.yarp.protocol.wire import TEXT_ACK, TEXT_ACK_LINE, greeting, text_line

_MAX_REPLY_BYTES: Final = 16 * 1024 * 1024


async def ask(
    host: str,
    tcp_port: int,
    letter: str,
    payload: str | None,
    timeout_s: float,
    *,
    sender: str = "admin",
) -> list[str]:
    """Send one text_ack message to a YARP port and return the lines before its ack.

    Letters such as `*` have no payload.

    Raises:
        NotConnectedError: Nobody listens there, or it is no YARP port.
        DeadlineError: No answer in time.
    """
    where = f"{host}:{tcp_port}"
    try:
        async with asyncio.timeout(timeout_s), _stream(host, tcp_port) as (reader, writer):
            lines = (letter,) if payload is None else (letter, payload)
            writer.write(greeting(TEXT_ACK, sender) + b"".join(map(text_line, lines)))
            return [line async for line in _lines_before_ack(reader, where)][1:]
    except TimeoutError:
        raise DeadlineError(where, timeout_s) from None
    except OSError as error:
        raise NotConnectedError(str(error)) from error


@contextlib.asynccontextmanager
async def _stream(
    host: str, tcp_port: int
) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    reader, writer = await asyncio.open_connection(host, tcp_port)
    try:
        yield reader, writer
    finally:
        writer.close()
        with contextlib.suppress(OSError):  # lost instead of closed: it is over either way
            await writer.wait_closed()


async def _lines_before_ack(reader: asyncio.StreamReader, where: str) -> AsyncIterator[str]:
    size = 0
    while True:
        try:
            raw = await reader.readline()
        except ValueError as error:  # longer than the reader's limit
            raise NotConnectedError(f"{where} sent a line without end: {error}") from error
        line = raw.decode("utf-8", "surrogateescape").rstrip("\r\n")
        if size == 0 and raw and not line.startswith("Welcome"):
            raise NotConnectedError(f"{where} is no YARP port, it answered {line!r:.200}")
        size += len(raw)
        if size > _MAX_REPLY_BYTES:
            raise NotConnectedError(f"{where} answered more than {_MAX_REPLY_BYTES} bytes")
        if not raw:
            raise NotConnectedError(f"{where} closed the connection before its answer was complete")
        if line == TEXT_ACK_LINE:
            return
        yield line
