"""Asking a YARP port which dialect it speaks, without touching what it does.

No version is said anywhere, but vocabs tell: YARP 3 cuts `[abcdef]` to four letters. So the port
is asked to drop a connection that nobody has, and its refusal repeats the word as it read it.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

from vertebra.errors import NotConnectedError, TransportError
from vertebra.yarp.naming.exchange import ask
from vertebra.yarp.protocol.dialect import Dialect

if TYPE_CHECKING:
    from vertebra.yarp.naming.names import Contact, NameClient

log = logging.getLogger(__name__)

PROBE_TIMEOUT_S: Final = 1.0
_KEEP_S: Final = 30.0  # a robot may come back at the same address with another YARP
_MAX_KEPT: Final = 1024
_WORD: Final = "abcdef"


class DialectFinder:
    """The dialects of YARP ports, each asked once in a while.

    A port that cannot be asked, or does not say, is taken for one of YARP 3; the log says so.

    Attributes:
        told: What somebody knows better, by the name of a port or of what its name begins with
            (`/icub/head` is `/icub/head/rpc:i`, too; the longest counts, `/` is for all).
    """

    def __init__(self, names: NameClient) -> None:
        self.told: Mapping[str, Dialect] = {}
        self._names = names
        self._found: dict[Contact, tuple[Dialect, float]] = {}

    def told_of(self, name: str) -> Dialect | None:
        """Return what `told` says of a port, without asking it."""
        path = f"{name}/"
        known = [begin for begin in self.told if path.startswith(f"{begin.rstrip('/')}/")]
        return self.told[max(known, key=len)] if known else None

    async def of(self, contact: Contact) -> Dialect:
        """Return what the port at `contact` speaks."""
        told = self.told_of(contact.name)
        if told is not None:
            return told
        dialect, until_s = self._found.get(contact, (Dialect.V3, 0.0))
        if time.monotonic() < until_s:
            return dialect
        try:
            lines = await ask(contact.host, contact.tcp_port, *self._question(contact),
                              PROBE_TIMEOUT_S)  # fmt: skip
        except NotConnectedError as error:  # whoever dials it next will say so, too
            log.debug("the dialect of %s is unknown: %s", contact, error)
            return Dialect.V3
        except TransportError as error:
            return _undecided(contact.name, str(error))
        found = _told(lines)
        if found is None:
            return _undecided(contact.name, f"it answered {lines!r:.200}")
        if len(self._found) == _MAX_KEPT:
            del self._found[next(iter(self._found))]
        self._found[contact] = found, time.monotonic() + _KEEP_S
        return found

    async def of_sender(self, name: str) -> Dialect:
        """Return what the port speaks that has dialled us under `name`."""
        told = self.told_of(name)
        if told is not None or not name.startswith("/"):
            return told or Dialect.V3  # else a tool, or a client without a port
        try:
            async with asyncio.timeout(PROBE_TIMEOUT_S):
                contact = await self._names.query(name)
        except (TransportError, TimeoutError) as error:
            return _undecided(name, str(error) or "the name server does not answer")
        if contact is None:
            log.info("%s is not registered and cannot be asked: %s is assumed", name, Dialect.V3)
            return Dialect.V3
        return await self.of(contact)

    def _question(self, contact: Contact) -> tuple[str, str]:
        if (contact.host, contact.tcp_port) == (self._names.host, self._names.tcp_port):
            return "d", f"check /root x [{_WORD}]"
        return "a", f"[del] [{_WORD}]"


def _told(lines: list[str]) -> Dialect | None:
    answer = " ".join(lines)
    if _WORD in answer:
        return Dialect.V4
    return Dialect.V3 if _WORD[:4] in answer else None


def _undecided(name: str, reason: str) -> Dialect:
    log.warning(
        "YARP port %s does not tell its dialect: %s; %s is assumed, set the dialect of its route "
        "if that is wrong",
        name,
        reason,
        Dialect.V3,
    )
    return Dialect.V3
