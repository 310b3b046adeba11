"""YARP ports against each other and against captured bytes over the carriers beside tcp."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest

from vertebra.testing.bus_suite import eventually
from vertebra.yarp import Incoming, NameClient, NameServer, Port, encode
from vertebra.yarp.packets import cut
from vertebra.yarp.wire import binary_message, command

TIMEOUT_S = 5.0
DATAGRAMS = ("udp", "mcast")


@pytest.fixture
async def server() -> AsyncIterator[NameServer]:
    async with await NameServer.start(tcp_port=0) as server:
        yield server


@pytest.fixture
def names(server: NameServer) -> NameClient:
    return server.client()


class Inbox:
    """Takes messages and lets a test wait for them."""

    def __init__(self) -> None:
        self.got: list[Incoming] = []

    def __call__(self, incoming: Incoming) -> None:
        self.got.append(incoming)

    async def wait(self, count: int) -> list[Incoming]:
        await eventually(lambda: len(self.got) >= count)
        return self.got


def message(payload: bytes, envelope: str = "") -> list[bytes]:
    return [*cut(binary_message(command("D", envelope), (payload,)))]


# --- datagrams ---


@pytest.mark.parametrize("carrier", DATAGRAMS)
async def test_messages_pass_as_datagrams(names: NameClient, carrier: str) -> None:
    inbox = Inbox()
    async with (
        await Port.open("/in", names, on_data=inbox) as reader,
        await Port.open("/out", names, delivery="queue") as writer,
    ):
        link = await writer.connect("/in", carrier)
        await eventually(lambda: bool(reader.inputs))
        writer.write(encode([1, "a b"]), envelope="41 1234.5")
        writer.write(encode([]))
        first, second = await inbox.wait(2)
        assert (first.bottle(), first.envelope) == ([1, "a b"], "41 1234.5")
        assert (first.sender, first.carrier, second.bottle()) == ("/out", carrier, [])
        assert link.counters.messages == writer.sent.messages == reader.received.messages == 2
        assert await writer.disconnect("/in")
        await eventually(lambda: not reader.inputs)


@pytest.mark.parametrize("carrier", DATAGRAMS)
async def test_an_image_passes_whole_as_fifteen_datagrams(names: NameClient, carrier: str) -> None:
    inbox = Inbox()
    pixels = bytes(range(256)) * 3600
    async with (
        await Port.open("/in", names, on_data=inbox) as reader,
        await Port.open("/out", names, delivery="queue") as writer,
    ):
        await writer.connect("/in", carrier)
        await eventually(lambda: bool(reader.inputs))
        for _ in range(5):
            writer.write(pixels)
        got = await inbox.wait(5)
        assert all(bytes(incoming.payload) == pixels for incoming in got)
        assert reader.received.lost == 0
