"""The YARP adapter as the fleet runs it; `option` is the address of the name server."""

from __future__ import annotations

import asyncio

from vertebra.service import run_service
from vertebra_yarp.adapter import serve
from vertebra_yarp.settings import YarpSettings

from .peer import Arrivals, Stream, main


def adapt(stream: Stream) -> None:
    asyncio.run(_adapt(stream))


async def _adapt(stream: Stream) -> None:
    settings = YarpSettings(router=stream.endpoint, name_server=stream.option)
    service = asyncio.create_task(run_service("yarp", settings, serve))
    loop = asyncio.get_running_loop()
    Arrivals(lambda: loop.call_soon_threadsafe(service.cancel)).listen()
    await asyncio.wait([service])


if __name__ == "__main__":
    main({"adapt": adapt})
