"""Fixtures that many live tests share."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest

from vertebra.yarp import NameClient, NameServer


@pytest.fixture
async def server() -> AsyncIterator[NameServer]:
    """A YARP name server on a free tcp_port."""
    async with await NameServer.start(tcp_port=0) as server:
        yield server


@pytest.fixture
def names(server: NameServer) -> NameClient:
    """A client of that name server."""
    return server.client()
