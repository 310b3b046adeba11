"""YARP port names, and asking a name server about them."""

from __future__ import annotations

import asyncio
import contextlib
import re
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass
from typing import Final

from vertebra.errors import (
    DeadlineError,
    NameMappingError,
    NotConnectedError,
    TransportError,
)
from vertebra.yarp.bottle import Value
from vertebra.yarp.text import from_text, to_text
from vertebra.yarp.wire import TEXT_ACK, TEXT_ACK_LINE, greeting, text_line

END_OF_MESSAGE: Final = "*** end of message"
CHOOSE_FOR_ME: Final = "..."

_MAX_REPLY_BYTES: Final = 16 * 1024 * 1024
_NOT_IN_NAMES: Final = re.compile(r"""[\s"'(){}\[\]\\,\x00-\x1f\x7f]""")


@dataclass(frozen=True, slots=True)
class Contact:
    """Where a YARP port listens."""

    name: str
    carrier: str
    host: str
    tcp_port: int


def check_name(name: str) -> str:
    """Return `name` if it can be that of a YARP port.

    Raises:
        NameMappingError: It cannot.
    """
    if not name.startswith("/"):
        raise NameMappingError(name, 0, "a YARP port name begins with a slash")
    found = _NOT_IN_NAMES.search(name)
    if found:
        raise NameMappingError(
            name, found.start(), f"a YARP port name cannot hold {found[0]!r}; leave it out"
        )
    return name


# --- requests --------------------------------------------------------------------------------


class NameClient:
    """Ask a YARP name server; each request has its own connection and deadline.

    Every method raises NotConnectedError (nobody listens there, or no name server) or
    DeadlineError (no answer in time).

    Attributes:
        others: Name servers of further namespaces, asked in turn for names that this one does
            not know; new names go to this one.
    """

    def __init__(self, host: str, tcp_port: int, *, timeout_s: float = 5.0) -> None:
        self.host = host
        self.tcp_port = tcp_port
        self.timeout_s = timeout_s
        self.others: Sequence[NameClient] = ()

    async def query(self, name: str) -> Contact | None:
        """Return where `name` listens, or None when it is not registered."""
        found = self._contacts(await self._ask("query", name))
        if found:
            return found[0]
        for other in self.others:
            contact = await other.query(name)
            if contact is not None:
                return contact
        return None

    async def register(
        self,
        name: str,
        *,
        carrier: str = "tcp",
        host: str | None = None,
        tcp_port: int | None = None,
    ) -> Contact:
        """Register `name`, replacing an older registration, and return what was granted.

        The server chooses what is None: the host from which this request comes, a free TCP port.
        The name `...` asks for a fresh one.
        """
        name = name if name == CHOOSE_FOR_ME else check_name(name)
        place = (host or CHOOSE_FOR_ME, CHOOSE_FOR_ME if tcp_port is None else tcp_port)
        lines = await self._ask("register", name, carrier, *place)
        found = self._contacts(lines)
        if not found:
            raise NotConnectedError(f"{self._server} did not register {name}: {lines}")
        return found[0]

    async def unregister(self, name: str) -> None:
        """Forget `name`; unknown names are fine."""
        await self._ask("unregister", name)

    async def announce(self, name: str) -> None:
        """Tell the server that `name` accepts connections from now on."""
        await self._ask("announce", name)

    async def set_property(self, name: str, key: str, *values: str) -> None:
        """Store a property of a registered port; the server sorts the values."""
        await self._ask("set", name, key, *values)

    async def get_property(self, name: str, key: str) -> list[str]:
        """Return the words of a property, none when port or property are unknown."""
        lines = await self._ask("get", name, key)
        return lines[0].partition(" =")[2].split() if lines else []

    async def list_ports(self, prefix: str = "") -> list[Contact]:
        """Return all registered ports below `prefix` (whole path components), sorted by name."""
        return self._contacts(await self._ask("list", *([prefix] if prefix else [])))

    async def exists(self, name: str) -> bool:
        """Say whether `name` is registered and a YARP port answers there."""
        contact = await self.query(name)
        if contact is None:
            return False
        try:
            lines = await _request(contact.host, contact.tcp_port, "a", "[ver]", self.timeout_s)
        except TransportError:
            return False
        return any(line.startswith("[ver]") for line in lines)

    @property
    def _server(self) -> str:
        return f"YARP name server at {self.host}:{self.tcp_port}"

    async def _ask(self, *words: Value) -> list[str]:
        """Return the lines of the reply, without the mark at its end."""
        try:
            lines = await _request(
                self.host, self.tcp_port, "d", " ".join(map(_typed, words)), self.timeout_s
            )
        except NotConnectedError as error:
            raise NotConnectedError(
                f"cannot reach the {self._server}: {error}; start `yarpserver`, or correct the "
                "address in the settings or in yarp.conf"
            ) from error
        except DeadlineError as error:
            raise DeadlineError(self._server, self.timeout_s) from error
        return [line for line in lines if line != END_OF_MESSAGE]

    def _contacts(self, lines: list[str]) -> list[Contact]:
        return [self._contact(line) for line in lines]

    def _contact(self, line: str) -> Contact:
        contact = parse_registration(line)
        if contact is None:
            raise NotConnectedError(
                f"{self._server} answered {line!r:.200} instead of a registration"
            )
        return contact


def parse_registration(line: str) -> Contact | None:
    """Return what a line of a name server says, or None if it does not speak of a port."""
    # registration name NAME ip HOST port TCP_PORT type CARRIER
    words = line.split()
    if len(words) != 9 or words[0] != "registration" or not words[6].isdecimal():
        return None
    return Contact(words[2], words[8], words[4], int(words[6]))


def _typed(word: Value) -> str:
    """Return a word as people type it, in quotes only where it needs them."""
    bare = isinstance(word, str) and from_text(word) == [word]
    return str(word) if bare else to_text([word])


async def _request(
    host: str, tcp_port: int, letter: str, payload: str, timeout_s: float
) -> list[str]:
    """Send one text_ack message to a YARP port and return the lines before its ack."""
    where = f"{host}:{tcp_port}"
    try:
        async with asyncio.timeout(timeout_s), _stream(host, tcp_port) as (reader, writer):
            message = greeting(TEXT_ACK, "admin") + text_line(letter) + text_line(payload)
            writer.write(message)
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
