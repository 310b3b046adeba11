"""The YARP adapter as the fleet runs it; `option` is the address of the name server.

It notes how long it has each message of `key` itself: from when the socket has the last of it until
the bus has taken it. Other processes and the kernel have their part before and after.
"""

from __future__ import annotations

import asyncio
import time
from typing import Any
from unittest import mock

from vertebra.bus import zenoh_bus
from vertebra.service import run_service
from vertebra.yarp.ports.link import Connection
from vertebra_yarp.adapter import serve
from vertebra_yarp.settings import YarpSettings

from .peer import STAMP, Arrivals, Stream, main

RUN = 1


def adapt(stream: Stream) -> None:
    asyncio.run(_adapt(stream))


async def _adapt(stream: Stream) -> None:
    settings = YarpSettings(router=stream.endpoint, name_server=stream.option)
    loop = asyncio.get_running_loop()
    arrivals = Arrivals(lambda: loop.call_soon_threadsafe(service.cancel))
    get_buffer, put = Connection.get_buffer, zenoh_bus._Publisher.put
    began_ns = 0

    def timed_get_buffer(connection: Connection, sizehint: int) -> memoryview:
        nonlocal began_ns
        began_ns = time.monotonic_ns()
        return get_buffer(connection, sizehint)

    def timed_put(publisher: Any, *arguments: Any, **options: Any) -> None:
        put(publisher, *arguments, **options)
        if publisher.key == stream.key:
            arrivals.add(STAMP.pack(began_ns, RUN, 0))

    with (
        mock.patch.object(Connection, "get_buffer", timed_get_buffer),
        mock.patch.object(zenoh_bus._Publisher, "put", timed_put),
    ):
        service = asyncio.create_task(run_service("yarp", settings, serve))
        arrivals.listen()
        await asyncio.wait([service])


if __name__ == "__main__":
    main({"adapt": adapt})
