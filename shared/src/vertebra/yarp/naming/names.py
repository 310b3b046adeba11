"""YARP port names, and asking a name server about them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from vertebra.errors import (
    CommandRefusedError,
    DeadlineError,
    NameMappingError,
    NotConnectedError,
    TransportError,
)
from vertebra.yarp.naming.exchange import ask
from vertebra.yarp.naming.probe import DialectFinder
from vertebra.yarp.protocol.bottle import Value
from vertebra.yarp.protocol.text import from_text, to_text

END_OF_MESSAGE: Final = "*** end of message"
CHOOSE_FOR_ME: Final = "..."

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
        dialects: What the registered ports speak.
    """

    def __init__(self, host: str, tcp_port: int, *, timeout_s: float = 5.0) -> None:
        self.host = host
        self.tcp_port = tcp_port
        self.timeout_s = timeout_s
        self.others: Sequence[NameClient] = ()
        self.dialects = DialectFinder(self)

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

    async def subscribe(self, source: str, dest: str, mode: str = "") -> None:
        """Have the server connect `source` to `dest` (or `carrier://dest`) whenever both are there.

        With mode `from` or `to` that ends with the source or with the dest.

        Raises:
            CommandRefusedError: The server does not do it.
        """
        reply = await self._ask("subscribe", source, dest, *([mode] if mode else []))
        if reply != ["[ok]"]:
            raise CommandRefusedError(
                f"the {self._server} does not keep the connection from {source} to {dest}: {reply}"
            )

    async def unsubscribe(self, source: str, dest: str) -> None:
        """Have the server keep that connection no longer; one that exists stays."""
        await self._ask("unsubscribe", source, dest)

    async def subscriptions(self, name: str = "") -> list[tuple[str, str]]:
        """Return source and dest of the connections that the server keeps, of one port or all."""
        lines = await self._ask("subscribe", *([name] if name else []))
        found = []
        for entry in from_text(lines[0])[1:] if lines else []:
            match entry:
                case ["subscription", ["src", source], ["dest", dest], *_]:
                    found.append((str(source), str(dest)))
        return found

    async def collect_garbage(self) -> str:
        """Give the server a chance to tidy up, and return what it says."""
        return "".join(await self._ask("gc"))

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
            lines = await ask(contact.host, contact.tcp_port, "a", "[ver]", self.timeout_s)
        except TransportError:
            return False
        return any(line.startswith("[ver]") for line in lines)

    @property
    def _server(self) -> str:
        return f"YARP name server at {self.host}:{self.tcp_port}"

    async def _ask(self, *words: Value) -> list[str]:
        """Return the lines of the reply, without the mark at its end."""
        try:
            lines = await ask(
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


async def ping(contact: Contact, *, timeout_s: float) -> list[str]:
    """Return how a YARP port describes itself and its connections, as `yarp ping` shows it.

    Raises:
        NotConnectedError: Nobody listens there, or it is no YARP port.
        DeadlineError: It does not answer.
    """
    return await ask(contact.host, contact.tcp_port, "*", None, timeout_s, sender="<ping>")
