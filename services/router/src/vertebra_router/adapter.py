"""The router's work: it routes, and takes part in its own backbone to tell how it is doing."""

from __future__ import annotations

import asyncio
from contextlib import AbstractContextManager

from vertebra.bus.router import running_router
from vertebra.service import Context
from vertebra_router.settings import RouterSettings


def route(settings: RouterSettings) -> AbstractContextManager[None]:
    """Route while the block runs; see `running_router`."""
    return running_router(settings.listen, settings.connect)


async def serve(context: Context[RouterSettings]) -> None:
    """Be ready as soon as the router has let its own service in."""
    context.ready()
    await asyncio.get_running_loop().create_future()
