"""Remove the names of YARP ports that are dead, as `yarp clean` does, and of no others.

A program that is killed leaves its names behind. A port is dead when nobody accepts a connection
at its address, twice, and its name still has that address then: it may have started again.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Final, Literal

from vertebra.yarp.naming.names import Contact, NameClient

_AT_ONCE: Final = 16
_PAUSE_S: Final = 0.2


@dataclass(frozen=True, slots=True)
class Probed:
    """What became of a registered name; `skipped` is what cannot be dialled, or the server."""

    contact: Contact
    verdict: Literal["alive", "removed", "skipped"]


async def clean(names: NameClient, *, timeout_s: float = 1.0) -> AsyncIterator[Probed]:
    """Dial all registered ports, remove the dead, and yield each in the order of the names.

    Args:
        names: The name server.
        timeout_s: How long a port may take to accept a connection.

    Raises:
        NotConnectedError, DeadlineError: The name server does not answer.
    """
    gate = asyncio.Semaphore(_AT_ONCE)

    async def judge(contact: Contact) -> Probed:
        async with gate:
            return await _judge(contact, names, timeout_s)

    tasks = [asyncio.create_task(judge(contact)) for contact in await names.list_ports()]
    try:
        for task in tasks:
            yield await task
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _judge(contact: Contact, names: NameClient, timeout_s: float) -> Probed:
    is_server = (contact.host, contact.tcp_port) == (names.host, names.tcp_port)
    if is_server or contact.carrier == "mcast" or not contact.name.startswith("/"):
        return Probed(contact, "skipped")
    if await _accepts(contact, timeout_s):
        return Probed(contact, "alive")
    await asyncio.sleep(_PAUSE_S)  # one that is just starting, or a machine that was asleep
    if await _accepts(contact, timeout_s) or await names.query(contact.name) != contact:
        return Probed(contact, "alive")
    await names.unregister(contact.name)
    return Probed(contact, "removed")


async def _accepts(contact: Contact, timeout_s: float) -> bool:
    try:
        async with asyncio.timeout(timeout_s):
            _, writer = await asyncio.open_connection(contact.host, contact.tcp_port)
    except (OSError, TimeoutError):
        return False
    writer.close()
    with contextlib.suppress(OSError):
        await writer.wait_closed()
    return True
