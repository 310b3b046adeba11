"""One suite for both drivers of the YARP adapter: our own, and the official YARP bindings."""

from __future__ import annotations

import asyncio
import contextlib
import sys
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from vertebra.errors import BusyError, ConfigError, DeadlineError, NotConnectedError
from vertebra.testing.bus_suite import eventually
from vertebra.yarp import Incoming, NameServer, Port, Reader, RpcClient, Value, Vocab, objects
from vertebra_yarp.driver import NativeDriver, Transport, Writer
from vertebra_yarp.driver_bindings import bindings_driver, load_bindings

WITHIN_S = 5.0


class TransportSuite(ABC):
    """What the adapter may rely on, against ports of our own on the other side."""

    @abstractmethod
    def driver(self, server: NameServer) -> contextlib.AbstractAsyncContextManager[Transport]:
        """Open the driver on a name server."""

    @pytest.fixture
    async def server(self) -> AsyncIterator[NameServer]:
        async with await NameServer.start(tcp_port=0) as server:
            yield server

    @pytest.fixture
    async def transport(self, server: NameServer) -> AsyncIterator[Transport]:
        async with self.driver(server) as transport:
            yield transport

    async def test_a_stream_is_read_with_its_envelopes(self, transport: Transport) -> None:
        arrived: asyncio.Queue[Incoming] = asyncio.Queue()
        image = objects.Image.from_packed("rgb", 30, 20, bytes(range(200)) * 9)
        async with await Port.open("/robot/out", transport.names, delivery="queue") as port:
            link = await transport.read("/robot/out", "/mine/reader", arrived.put_nowait)
            await eventually(lambda: bool(port.outputs))
            port.write([1, 2.5, "x", Vocab("set"), [True, b"\0\xff"]], envelope="41 1234.5")
            port.write(objects.Vector.of([1.0, -2.0]))
            port.write(image)
            values, vector, picture = [
                await asyncio.wait_for(arrived.get(), WITHIN_S) for _ in range(3)
            ]
            assert values.bottle() == [1, 2.5, "x", Vocab("set"), [True, b"\0\xff"]]
            stamp = objects.Stamp.from_envelope(values.envelope)
            assert (stamp.count, stamp.time_s) == (41, 1234.5)
            assert [*objects.Vector.decode(vector.payload, vector.dialect).values] == [1.0, -2.0]
            assert bytes(objects.Image.decode(picture.payload).packed_pixels()) == bytes(
                image.packed_pixels()
            )
            await link.close()
            await eventually(lambda: not port.outputs)

    async def test_the_end_of_a_stream_is_told(self, transport: Transport) -> None:
        async with await Port.open("/robot/out", transport.names) as port:
            link = await transport.read("/robot/out", "/mine/reader", lambda _: None)
            await eventually(lambda: bool(port.outputs))
        assert await asyncio.wait_for(link.wait_closed(), WITHIN_S)
        await link.close()
        await link.close()

    async def test_an_absent_port_is_told(self, transport: Transport) -> None:
        with pytest.raises(NotConnectedError, match="/nobody"):
            await transport.read("/nobody", "/mine/reader", lambda _: None)
        with pytest.raises(NotConnectedError, match="/nobody"):
            await transport.dial("/nobody")
        with pytest.raises(NotConnectedError, match="/nobody"):
            await transport.send_to("/nobody", "/mine/sender")

    async def test_an_rpc_port_is_called(self, transport: Transport) -> None:
        async def add(incoming: Incoming) -> list[Value]:
            return [Vocab("is"), sum(it for it in incoming.bottle() if isinstance(it, int)), 0.5]

        async with await Port.open("/robot/rpc", transport.names, on_call=add):
            caller = await transport.dial("/robot/rpc")
            assert await caller.call([1, 2], timeout_s=WITHIN_S) == [Vocab("is"), 3, 0.5]
            assert await caller.call([3], timeout_s=WITHIN_S) == [Vocab("is"), 3, 0.5]
            await caller.close()

    async def test_a_call_that_is_not_answered_ends_in_time(self, transport: Transport) -> None:
        async def sleep(_: Incoming) -> list[Value]:
            await asyncio.sleep(0.6)
            return []

        async with await Port.open("/robot/rpc", transport.names, on_call=sleep):
            caller = await transport.dial("/robot/rpc")
            with pytest.raises(DeadlineError, match="/robot/rpc"):
                await caller.call([1], timeout_s=0.2)
            with pytest.raises(NotConnectedError):
                await caller.call([1], timeout_s=0.2)
            await caller.close()

    async def test_a_writer_is_read_by_others(self, transport: Transport) -> None:
        arrived: asyncio.Queue[Incoming] = asyncio.Queue()
        writer = await transport.open_writer("/mine/out", delivery="queue", depth=16)
        reader = await Reader.dial(
            "/mine/out", transport.names, on_data=arrived.put_nowait, reader_name="/robot/reader"
        )
        async with asyncio.timeout(WITHIN_S):
            while arrived.empty():
                writer.write(["hello", 1.5], envelope="7 8.5")
                await asyncio.sleep(0.02)
        incoming = arrived.get_nowait()
        assert incoming.bottle() == ["hello", 1.5]
        assert objects.Stamp.from_envelope(incoming.envelope).count == 7
        assert writer.sent.messages > 0
        await reader.close()
        await writer.close()
        assert await transport.names.query("/mine/out") is None

    async def test_a_name_that_is_alive_is_not_taken(self, transport: Transport) -> None:
        async def answer(_: Incoming) -> list[Value]:
            return []

        async with await Port.open("/theirs", transport.names) as port:
            with pytest.raises(NotConnectedError, match="another program's"):
                await transport.open_writer("/theirs", delivery="latest", depth=1)
            with pytest.raises(NotConnectedError, match="another program's"):
                await transport.open_server("/theirs", answer)
            assert await transport.names.query("/theirs") == port.contact

    async def test_a_server_answers_others(self, transport: Transport) -> None:
        async def echo(incoming: Incoming) -> list[Value]:
            return [*incoming.bottle(), "indeed"]

        server = await transport.open_server("/mine/rpc", echo)
        async with await RpcClient.connect("/mine/rpc", transport.names) as client:
            for number in range(3):
                reply = await client.call([number, "yes"], timeout_s=WITHIN_S)
                assert reply == [number, "yes", "indeed"]
        await server.close()

    async def test_commands_reach_an_input_port(self, transport: Transport) -> None:
        arrived: list[list[Value]] = []
        async with await Port.open(
            "/robot/in", transport.names, on_data=lambda it: arrived.append(it.bottle())
        ) as port:
            sink = await transport.send_to("/robot/in", "/mine/sender", carrier="tcp", depth=8)
            for number in range(5):
                sink.write([Vocab("dpo"), number])
            assert await asyncio.wait_for(sink.wait_taken(), WITHIN_S)
            await eventually(lambda: len(arrived) == 5)
            assert arrived == [[Vocab("dpo"), number] for number in range(5)]
            assert [link.peer for link in port.inputs] == ["/mine/sender"]
            await sink.close()
            await eventually(lambda: not port.inputs)

    async def test_a_full_queue_refuses_and_latest_replaces(self, transport: Transport) -> None:
        slow = await transport.open_writer("/mine/queue", delivery="queue", depth=2)
        newest = await transport.open_writer("/mine/latest", delivery="latest", depth=1)
        reading = [
            await asyncio.open_connection(contact.host, contact.tcp_port)
            for writer in ("/mine/queue", "/mine/latest")
            if (contact := await transport.names.query(writer))
        ]
        for number, (_, stream) in enumerate(reading):  # reverse connections that never read
            name = f"/robot/asleep{number}\0".encode()
            hello = b"YA\x64\x1e\0\0RP" + len(name).to_bytes(4, "little") + name
            index = b"YA\x0a\0\0\0RP\x01\x01" + b"\xff" * 8 + (8).to_bytes(4, "little") + bytes(4)
            stream.write(hello + index + b"\0\0\0\0~r\0\x01")
        payload = bytes(1 << 22)
        with pytest.raises(BusyError):
            await write_until_refused(slow, payload)
        async with asyncio.timeout(WITHIN_S):
            while not newest.sent.dropped:
                newest.write([payload])
                await asyncio.sleep(0.005)
        assert slow.sent.refused == 1
        for _, stream in reading:
            stream.transport.abort()
        await slow.close()
        await newest.close()


async def write_until_refused(writer: Writer, payload: bytes) -> None:
    async with asyncio.timeout(WITHIN_S):
        while True:
            writer.write([payload])
            await asyncio.sleep(0.005)


class TestNative(TransportSuite):
    @contextlib.asynccontextmanager
    async def driver(self, server: NameServer) -> AsyncIterator[Transport]:
        yield NativeDriver(server.client(), bind_host="127.0.0.1", advertise_host=None)


class TestBindings(TransportSuite):
    @contextlib.asynccontextmanager
    async def driver(self, server: NameServer) -> AsyncIterator[Transport]:
        try:
            load_bindings()
        except ConfigError:
            pytest.skip(
                "there are no YARP Python bindings; put the folder of yarp.py on PYTHONPATH"
            )
        async with bindings_driver(server.client()) as transport:
            yield transport


def test_bindings_that_are_missing_are_told_with_the_remedy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "yarp", None)
    with pytest.raises(ConfigError, match=r"PYTHONPATH.*VERTEBRA_YARP_DRIVER at native"):
        load_bindings()


def test_the_yarp_of_pypi_is_told_from_yarp(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    stranger: Any = ModuleType("yarp")
    stranger.__file__ = str(tmp_path / "yarp.py")
    monkeypatch.setitem(sys.modules, "yarp", stranger)
    with pytest.raises(ConfigError, match="PyPI's package `yarp` is another project"):
        load_bindings()
