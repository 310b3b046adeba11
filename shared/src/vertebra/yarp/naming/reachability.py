"""Whether the address under which our YARP ports are registered is one where others reach them.

A name server connects ports that subscribe to each other (`subscribe`), and for that it dials
them. So we register a listener under a made-up name, subscribe it to itself, and see whether
somebody comes. All of it is taken back.
"""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import dataclass

from vertebra.yarp.naming.names import CHOOSE_FOR_ME, NameClient


@dataclass(frozen=True, slots=True)
class Reachability:
    """How a name server finds us.

    Attributes:
        told: The address that it tells others.
        seen: The address from which it sees our requests come.
        reached: It has reached a port of ours at `told`.
    """

    told: str
    seen: str
    reached: bool


async def check_reachability(
    names: NameClient, *, bind_host: str, advertise_host: str | None, timeout_s: float = 2.0
) -> Reachability:
    """Register as a YARP port of ours would, and have the name server dial.

    Raises:
        NotConnectedError, DeadlineError: The name server does not answer.
        CommandRefusedError: It keeps no subscriptions: nothing can be said.
        OSError: Nothing can listen on `bind_host`.
    """
    dialled = asyncio.Event()

    async def on_connection(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        dialled.set()
        writer.close()

    async with await asyncio.start_server(on_connection, bind_host, 0) as listener:
        tcp_port = listener.sockets[0].getsockname()[1]
        seen = await names.register(CHOOSE_FOR_ME)
        await names.unregister(seen.name)
        told = await names.register(CHOOSE_FOR_ME, host=advertise_host, tcp_port=tcp_port)
        try:
            await names.announce(told.name)
            await names.subscribe(told.name, told.name)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(timeout_s):
                    await dialled.wait()
            await names.unsubscribe(told.name, told.name)
        finally:
            await names.unregister(told.name)
    return Reachability(told.host, seen.host, dialled.is_set())
