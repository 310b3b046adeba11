"""The built-in YARP name server: a YARP port that keeps the registrations in memory.

`NameTable` knows the requests and their replies, in the words of `yarpserver`; it has no I/O.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import Final, Self

from vertebra.yarp.bottle import Value, Vocab
from vertebra.yarp.incoming import Incoming, Reply
from vertebra.yarp.names import (
    CHOOSE_FOR_ME,
    DEFAULT_TCP_PORT,
    END_OF_MESSAGE,
    Contact,
    NameClient,
)
from vertebra.yarp.port import Port
from vertebra.yarp.text import from_text, to_text
from vertebra.yarp.wire import DEFAULT_LIMITS, PeerLimits, text_line

log = logging.getLogger(__name__)

ROOT: Final = "/root"
_TEMPORARY: Final = "/tmp/port/"  # noqa: S108 -- a port name
_MAX_PORTS: Final = 10_000
_MAX_PROPERTIES: Final = 100
_MAX_GROUPS: Final = 250

_HELP: Final = (
    "Here are some ways to use the name server:",
    "+ help",
    "+ list [$prefix]",
    "+ register $portname",
    "+ register $portname $carrier $ipAddress $portNumber",
    "  (if you want a field set automatically, write '...')",
    "+ unregister $portname",
    "+ query $portname",
    "+ set $portname $property $value",
    "+ get $portname $property",
    "+ check $portname $property",
    "+ route $port1 $port2",
    "+ runners",
    "  (to get a list of the yarprun ports)",
)


@dataclass(slots=True)
class _Record:
    contact: Contact
    properties: dict[str, list[str]] = field(default_factory=dict)


class NameTable:
    """Registrations of YARP ports, and the answers about them."""

    def __init__(self) -> None:
        self._records: dict[str, _Record] = {}
        self._first_tcp_port = DEFAULT_TCP_PORT + 2  # two above that of the server
        self._allocations = 0
        self._given: dict[int, str] = {}  # TCP ports, and the names that had them last

    def answer(self, request: Sequence[Value], requester_host: str) -> Reply:
        """Return the reply: lines of text, or a bottle to those who ask with `bot`."""
        words = [*request]
        if words[:1] == ["NAME_SERVER"]:
            del words[0]
        if words[:1] == ["bot"]:
            return self._bottle([_text(word) for word in words[1:]])
        if words[:1] == ["announce"]:
            return [Vocab("ok")]
        lines = self._lines([_text(word) for word in words], requester_host)
        return b"".join(map(text_line, (*lines, END_OF_MESSAGE)))

    def _lines(self, words: Sequence[str], requester_host: str) -> Iterable[str]:
        match words:
            case ["register", *arguments]:
                return self._register(arguments, requester_host)
            case ["unregister", name]:
                self._records.pop(name, None)
            case ["query", name]:
                return [_registration(record.contact) for record in self._named(name)]
            case ["list", *prefix]:
                return [_registration(contact) for contact in self._below(*prefix[:1])]
            case ["runners"]:
                return [
                    _registration(contact)
                    for contact in self._below()
                    if "yarprun" in self._records[contact.name].properties
                ]
            case ["set", name, key, *values]:
                return self._set(name, key, values)
            case ["get", name, key]:
                return [
                    _property(name, key, record.properties.get(key, ()))
                    for record in self._named(name)
                ]
            case ["check", name, key, value]:
                return [
                    f"port {name} property {key} value {value} present "
                    + ("true" if value in record.properties.get(key, ()) else "false")
                    for record in self._named(name)
                ]
            case ["route", source, dest]:
                return [f"port {source} route {dest} = tcp:/{dest}"]
            case ["gc"]:
                return ["garbage collection done."]  # there is none to collect
            case ["help"]:
                return _HELP
        return []

    def _bottle(self, words: Sequence[str]) -> list[Value]:
        match words:
            case ["query", name]:
                found = self._records.get(name)
                if found is None:
                    return ["port", ["error", -2, "port not known"]]
                return ["port", *_fields(found.contact)]
            case ["list", *prefix]:
                found_below = self._below(*prefix[:1])
                return ["ports", *(["port", *_fields(contact)] for contact in found_below)]
            case ["set", name, key, *values]:
                self._set(name, key, values)
                return self._values(name, key)
            case ["get", name, key]:
                return self._values(name, key)
        return []

    def _named(self, name: str) -> list[_Record]:
        return [self._records[name]] if name in self._records else []

    def _below(self, prefix: str = "") -> list[Contact]:
        prefix = prefix.rstrip("/")
        return [
            record.contact
            for name, record in sorted(self._records.items())
            if not prefix or name == prefix or name.startswith(f"{prefix}/")
        ]

    # --- registering ---

    def _register(self, arguments: Sequence[str], requester_host: str) -> list[str]:
        # Name, carrier, host, TCP port, and a type that nobody reads; later ones may be left out.
        wanted = [None if word == CHOOSE_FOR_ME else word for word in arguments]
        name, carrier, host, tcp_port = (*wanted, None, None, None, None)[:4]
        if name is None or name.startswith("="):
            name = self._free_name(name or "")
        if name not in self._records and len(self._records) >= _MAX_PORTS:
            log.error("%s is not registered: the name server holds %d ports", name, _MAX_PORTS)
            return []
        carrier = carrier or "tcp"
        if host is None:
            host = self._free_group() if carrier == "mcast" else requester_host
        number = self._tcp_port(name, tcp_port)
        if number is None:
            log.error("%s is not registered: no TCP port for %r", name, tcp_port)
            return []
        contact = Contact(name, carrier, host, number)
        if name == ROOT and ROOT not in self._records and number + 2 + _MAX_PORTS <= 65536:
            self._first_tcp_port = number + 2
        self._records[name] = _Record(contact)
        return [_registration(contact)]

    def _free_name(self, suffix: str) -> str:
        taken = {name.partition("=")[0] for name in self._records}
        number = 1
        while f"{_TEMPORARY}{number}" in taken:
            number += 1
        return f"{_TEMPORARY}{number}{suffix}"

    def _free_group(self) -> str:
        taken = {record.contact.host for record in self._records.values()}
        for number in range(3, _MAX_GROUPS):
            if f"224.1.1.{number}" not in taken:
                return f"224.1.1.{number}"
        return "224.1.1.2"  # shared from here on

    def _tcp_port(self, name: str, wanted: str | None) -> int | None:
        if wanted is not None:
            return int(wanted) if wanted.isdecimal() and 0 < int(wanted) < 65536 else None
        taken = {record.contact.tcp_port for record in self._records.values()}
        for number, owner in self._given.items():
            if owner == name and number not in taken:
                return number
        for offset in range(_MAX_PORTS):
            number = self._first_tcp_port + (self._allocations + offset) % _MAX_PORTS
            if number not in taken:
                self._allocations += offset + 1
                self._given[number] = name
                return number
        return None

    # --- properties ---

    def _set(self, name: str, key: str, values: Sequence[str]) -> list[str]:
        if name not in self._records:
            return []
        properties = self._records[name].properties
        if key not in properties and len(properties) >= _MAX_PROPERTIES:
            log.error("%s has %d properties already; %s is not set", name, _MAX_PROPERTIES, key)
            return []
        properties[key] = sorted(values)
        return [_property(name, key, properties[key])]

    def _values(self, name: str, key: str) -> list[Value]:
        words = [word for record in self._named(name) for word in record.properties.get(key, ())]
        return from_text(" ".join(words))


class NameServer:
    """A running name server; `async with await NameServer.start() as server`."""

    def __init__(self, port: Port) -> None:
        self._port = port

    @classmethod
    async def start(
        cls,
        *,
        bind_host: str = "127.0.0.1",
        tcp_port: int = DEFAULT_TCP_PORT,
        advertise_host: str | None = None,
        limits: PeerLimits = DEFAULT_LIMITS,
    ) -> Self:
        """Listen on `bind_host:tcp_port` (0: any free one, see `contact`) and answer requests.

        Raises:
            ConfigError: The address is in use or not ours.
        """
        table = NameTable()

        async def answer(incoming: Incoming) -> Reply:
            return table.answer(incoming.bottle(), incoming.sender_host)

        port = await Port.open(
            ROOT,
            _OwnTable(table),
            on_call=answer,
            bind_host=bind_host,
            advertise_host=advertise_host,
            tcp_port=tcp_port,
            limits=limits,
        )
        return cls(port)

    @property
    def contact(self) -> Contact:
        """Where the server listens."""
        return self._port.contact

    def client(self) -> NameClient:
        """Return a client of this server."""
        return NameClient(self.contact.host, self.contact.tcp_port)

    async def close(self) -> None:
        """Stop listening and close all connections."""
        await self._port.close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self.close()


class _OwnTable(NameClient):
    """Lets the server's own port register without a connection."""

    def __init__(self, table: NameTable) -> None:
        super().__init__("127.0.0.1", 0)
        self._table = table

    async def _ask(self, *words: Value) -> list[str]:
        reply = self._table.answer(words, self.host)
        lines = reply.decode().splitlines() if isinstance(reply, bytes) else []
        return [line for line in lines if line != END_OF_MESSAGE]


def _text(word: Value) -> str:
    if isinstance(word, str):
        return str(word)
    return to_text(word) if isinstance(word, list) else to_text([word])


def _registration(contact: Contact) -> str:
    return (
        f"registration name {contact.name} ip {contact.host} port {contact.tcp_port} "
        f"type {contact.carrier}"
    )


def _fields(contact: Contact) -> list[Value]:
    return [
        ["name", contact.name],
        ["ip", contact.host],
        ["port_number", contact.tcp_port],
        ["carrier", contact.carrier],
    ]


def _property(name: str, key: str, values: Iterable[str]) -> str:
    return " ".join((f"port {name} property {key} =", *values))
