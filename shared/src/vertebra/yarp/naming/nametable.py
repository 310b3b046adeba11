"""The table of a YARP name server: what is registered, and the replies about it byte for byte.

A request is a bottle. Its reply is text for the eyes of people and old programs, closed by a mark
("*** end of message"), or a bottle: to those who begin with `bot`, and about persistent
connections. Pure: no I/O, no clock.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

from vertebra.yarp.naming.conf import DEFAULT_TCP_PORT
from vertebra.yarp.naming.names import CHOOSE_FOR_ME, END_OF_MESSAGE, Contact, NameClient
from vertebra.yarp.naming.subscriptions import Match, Subscriptions
from vertebra.yarp.protocol.bottle import Value, Vocab
from vertebra.yarp.protocol.text import from_text, to_text
from vertebra.yarp.protocol.wire import text_line

log = logging.getLogger(__name__)

_TEMPORARY: Final = "/tmp/port/"  # noqa: S108 -- a port name
_MAX_PORTS: Final = 9998  # as many TCP ports as YARP's server gives away: its own + 2 ... + 9999
_MAX_PROPERTIES: Final = 100
_MAX_PROPERTY_CHARACTERS: Final = 16 * 1024  # of all properties of a port
_WORD: Final = re.compile(r"""[^\s"'(){}\[\]\\,\x00-\x1f\x7f]{1,1000}""")
"""What can be a name, a host or a carrier; anything else would break the lines of replies."""

_QUESTIONS: Final = frozenset({"check", "get", "help", "list", "query", "route", "runners"})
_HELP: Final = (
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
    announced: bool = False
    properties: dict[str, list[str]] = field(default_factory=dict)


class NameTable:
    """Registrations of YARP ports, and the answers about them.

    Args:
        on_match: Told about ports that are to be connected now.
    """

    def __init__(self, on_match: Callable[[Match], None] = lambda _: None) -> None:
        self._on_match = on_match
        self._records: dict[str, _Record] = {}
        self._subscriptions = Subscriptions(self._is_live)
        self._first_tcp_port = DEFAULT_TCP_PORT + 2
        self._allocations = 0
        self._given: dict[int, str] = {}  # TCP ports, and the names that had them last

    def give_tcp_ports_from(self, tcp_port: int) -> None:
        """Give away TCP ports from here on, if there are enough of them."""
        if tcp_port + _MAX_PORTS <= 65536:
            self._first_tcp_port = tcp_port

    def answer(self, request: Sequence[Value], requester_host: str) -> bytes | list[Value]:
        """Return the reply: lines of text as they are sent, or a bottle."""
        words = [*request]
        if words[:1] == ["NAME_SERVER"]:
            del words[0]
        about_connections = self._about_connections(words)
        if about_connections is not None:
            return about_connections
        as_bottle = _wants_json(words)
        if words[:1] == ["bot"]:
            as_bottle = True
            del words[0]
        return self._about_names(words, requester_host, as_bottle=as_bottle)

    def _about_names(
        self, words: Sequence[Value], requester_host: str, *, as_bottle: bool
    ) -> bytes | list[Value]:
        first, second, third, *_ = [*(_string(word) for word in words), "", "", ""]
        match first:
            case "register":
                name = self._register(words[1:], requester_host)
                return _lines(self._query(name, as_bottle=as_bottle))
            case "unregister":
                self._unregister(second)
                return _lines(self._query(second, as_bottle=as_bottle))
            case "query":
                reply = self._query(second, as_bottle=as_bottle)
            case "list":
                reply = self._listed(self._below(second), as_bottle=as_bottle)
            case "runners":
                reply = self._listed(self._runners(), as_bottle=as_bottle)
            case "set":
                key = _text_at(words, 2)
                self._set(second, key, [*map(_text, words[3:])])
                reply = self._property(second, key, as_bottle=as_bottle)
            case "get":
                reply = self._property(second, _text_at(words, 2), as_bottle=as_bottle)
            case "check":
                return _lines(self._check(second, _text_at(words, 2), _text_at(words, 3)))
            case "route":
                return _lines([["port", second, "route", third, "=", f"tcp:/{third}"]])
            case "gc":
                return _lines(["garbage collection done."])  # YARP's server has none either
            case "help":
                heading = [] if as_bottle else ["Here are some ways to use the name server:"]
                reply = [*heading, *_HELP]
            case _:
                return _lines([])
        return reply if as_bottle else _lines(reply)

    # --- registrations ---

    def _query(self, name: str, *, as_bottle: bool) -> list[Value]:
        # `/net=192.168/port` asks for the address of the port in that network.
        network = ""
        if name[:5].lower() == "/net=":
            network, _, rest = name[5:].partition("/")
            name = f"/{rest}"
        record = self._records.get(name)
        if record is None:
            return ["port", ["error", -2, "port not known"]] if as_bottle else []
        contact = record.contact
        for address in record.properties.get("ips", ()) if network else ():
            if address.startswith(network):
                contact = Contact(name, contact.carrier, address, contact.tcp_port)
                break
        return ["port", *_fields(contact)] if as_bottle else [_registration(contact)]

    def _listed(self, contacts: Iterable[Contact], *, as_bottle: bool) -> list[Value]:
        if as_bottle:
            return ["ports", *(["port", *_fields(contact)] for contact in contacts)]
        return [*map(_registration, contacts)]

    def _below(self, prefix: str) -> list[Contact]:
        stem = prefix.rstrip("/")
        return [
            record.contact
            for name, record in sorted(self._records.items())
            if not stem or name == stem or name.startswith(f"{stem}/")
        ]

    def _runners(self) -> list[Contact]:
        return [
            contact
            for contact in self._below("")
            if "true" in self._records[contact.name].properties.get("yarprun", ())
        ]

    def _register(self, arguments: Sequence[Value], requester_host: str) -> str:
        """Register and return the name, empty where that cannot be."""
        # Name, carrier, host, TCP port, and a type that nobody reads; later ones may be left out.
        name, carrier, host, *_ = [*map(_string, arguments), *[CHOOSE_FOR_ME] * 3]
        wanted = arguments[3] if len(arguments) > 3 else CHOOSE_FOR_ME
        carrier = "tcp" if carrier == CHOOSE_FOR_ME else carrier
        if name == CHOOSE_FOR_ME or name.startswith("="):
            name = self._free_name(name.removeprefix(CHOOSE_FOR_ME))
        if host == CHOOSE_FOR_ME:
            host = self._free_group() if carrier == "mcast" else requester_host
        if not all(map(_WORD.fullmatch, (name, carrier, host))):
            return _refuse(name, f"{name!r}, {carrier!r} or {host!r} cannot be in a reply")
        if name not in self._records and len(self._records) >= _MAX_PORTS:
            return _refuse(name, f"there are {_MAX_PORTS}; `yarp clean` removes dead ones")
        self._subscriptions.forget(name)
        number = self._tcp_port(name, wanted)
        if number is None:
            return _refuse(name, f"there is no TCP port {_text(wanted)}")
        self._records[name] = _Record(Contact(name, carrier, host, number))
        return name

    def _unregister(self, name: str) -> None:
        going = [name]
        while going:
            name = going.pop()
            self._subscriptions.forget(name)
            record = self._records.pop(name, None)
            if record is not None:
                going += record.properties.get("owns", ())

    def _free_name(self, suffix: str) -> str:
        taken = {name.partition("=")[0] for name in self._records}
        number = 1
        while f"{_TEMPORARY}{number}" in taken:
            number += 1
        return f"{_TEMPORARY}{number}{suffix}"

    def _free_group(self) -> str:
        taken = {record.contact.host for record in self._records.values()}
        number = 2  # where YARP begins
        while (group := f"224.1.{number // 255 + 1}.{number % 255 + 1}") in taken:
            number += 1
        return group

    def _tcp_port(self, name: str, wanted: Value) -> int | None:
        if isinstance(wanted, int) and wanted not in (0, -1):
            return wanted if 0 < wanted < 65536 else None
        taken = {
            record.contact.tcp_port for other, record in self._records.items() if other != name
        }
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

    def _set(self, name: str, key: str, values: Sequence[str]) -> None:
        record = self._records.get(name)
        if record is None:
            return
        others = {other: kept for other, kept in record.properties.items() if other != key}
        size = sum(len(word) for kept in (values, *others.values()) for word in kept)
        if len(others) >= _MAX_PROPERTIES or size + len(key) > _MAX_PROPERTY_CHARACTERS:
            log.error(
                "%s keeps at most %d properties of %d characters together; %.40r is not set",
                name, _MAX_PROPERTIES, _MAX_PROPERTY_CHARACTERS, key,
            )  # fmt: skip
            return
        record.properties[key] = sorted(values)

    def _property(self, name: str, key: str, *, as_bottle: bool) -> list[Value]:
        record = self._records.get(name)
        if record is None:
            return []
        values = record.properties.get(key, [])
        if as_bottle:
            return [_parsed(text) for text in values]
        return [["port", name, "property", key, "=", *values]]

    def _check(self, name: str, key: str, value: str) -> list[Value]:
        record = self._records.get(name)
        if record is None:
            return []
        present = "true" if value in record.properties.get(key, ()) else "false"
        return [["port", name, "property", key, "value", value, "present", present]]

    # --- persistent connections ---

    def _about_connections(self, words: Sequence[Value]) -> list[Value] | None:
        first, second, third, fourth, *_ = [*map(_string, words), "", "", "", ""]
        kept = self._subscriptions
        match first:
            case "subscribe" if third:
                done = kept.subscribe(second, third, fourth)
                self._match(kept.matches_of(second, third))
                return _code(success=done)
            case "subscribe":
                return kept.listed(second)
            case "unsubscribe":
                kept.unsubscribe(second, third)
                return _code()
            case "announce":
                # `announce /x 0` says that /x seems dead; whoever asks for it finds out himself.
                if second in self._records and words[2:3] != [0]:
                    self._records[second].announced = True
                    self._match(kept.matches(second, afresh=True))
                return _code()
            case "topic" if second:
                done = kept.add_topic(second)
                self._match(kept.matches(second, afresh=False))
                return _code(success=done)
            case "topic":
                return kept.topics()
            case "untopic":
                kept.remove_topic(second)
                return _code()
        return None

    def _is_live(self, name: str) -> bool:
        return name in self._records and self._records[name].announced

    def _match(self, matches: Iterable[Match]) -> None:
        for each in matches:
            self._on_match(each)


def is_question(request: Sequence[Value]) -> bool:
    """Tell whether a request changes nothing."""
    words = (_string(word) for word in request)
    return next((word for word in words if word not in ("NAME_SERVER", "bot")), "") in _QUESTIONS


class TableClient(NameClient):
    """A client of a table in the same process."""

    def __init__(self, table: NameTable, host: str = "127.0.0.1", tcp_port: int = 0) -> None:
        super().__init__(host, tcp_port)
        self._table = table

    async def _ask(self, *words: Value) -> list[str]:
        reply = self._table.answer(words, self.host)
        lines = reply.decode().splitlines() if isinstance(reply, bytes) else []
        return [line for line in lines if line != END_OF_MESSAGE]


def _lines(values: Iterable[Value]) -> bytes:
    """Return a reply of the old kind: each list a line, without quotes."""
    lines = (
        to_text(value).replace('"', "") if isinstance(value, list) else str(_text(value))
        for value in values
    )
    return b"".join(map(text_line, (*lines, END_OF_MESSAGE)))


def _wants_json(words: Sequence[Value]) -> bool:
    pairs = [[*pair] for pair in pairwise(words)]
    return ["format", "json"] in (*words, *pairs)


def _refuse(name: str, reason: str) -> str:
    log.error("the YARP name server does not register %.80r: %s", name, reason)
    return ""


def _code(*, success: bool = True) -> list[Value]:
    return [Vocab("ok" if success else "fail")]


def _string(word: Value) -> str:
    return str(word) if isinstance(word, str) else ""


def _text(word: Value) -> str:
    if isinstance(word, str):
        return str(word)
    return to_text(word) if isinstance(word, list) else to_text([word])


def _text_at(words: Sequence[Value], index: int) -> str:
    return _text(words[index]) if index < len(words) else ""


def _parsed(text: str) -> Value:
    values = from_text(text)
    return values[0] if len(values) == 1 else text


def _registration(contact: Contact) -> list[Value]:
    return [
        "registration", "name", contact.name, "ip", contact.host, "port", contact.tcp_port,
        "type", contact.carrier,
    ]  # fmt: skip


def _fields(contact: Contact) -> list[Value]:
    return [
        ["name", contact.name],
        ["ip", contact.host],
        ["port_number", contact.tcp_port],
        ["carrier", contact.carrier],
    ]
