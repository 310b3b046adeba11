"""Our YARP ports on both sides: images and bottles over real sockets, calls to an RPC port."""

from __future__ import annotations

import asyncio
import time

from vertebra.yarp import Incoming, NameClient, NameServer, Payload, Port, Reader, Reply, RpcClient
from vertebra.yarp.objects import Image

from .peer import (
    STAMP,
    Arrivals,
    Order,
    Sent,
    Stream,
    answer,
    due_times,
    follow_orders,
    main,
    orders,
)

OUTPUT = "/bench/out"
RPC = "/bench/rpc"
DEPTH = 16
CALL_TIMEOUT_S = 30.0


def names_of(stream: Stream) -> NameClient:
    """Return a client of the name server at the endpoint."""
    host, _, tcp_port = stream.endpoint.partition(":")
    return NameClient(host, int(tcp_port))


def serve_names(stream: Stream) -> None:
    asyncio.run(_serve_names(stream))


async def _serve_names(stream: Stream) -> None:
    tcp_port = int(stream.endpoint.partition(":")[2])
    async with await NameServer.start(tcp_port=tcp_port):
        ended = asyncio.Event()
        loop = asyncio.get_running_loop()
        Arrivals(lambda: loop.call_soon_threadsafe(ended.set)).listen()
        await ended.wait()


def send(stream: Stream) -> None:
    asyncio.run(_send(stream))


async def _send(stream: Stream) -> None:
    memory = stream.memory()
    async with await Port.open(OUTPUT, names_of(stream), delivery="queue", depth=DEPTH) as port:
        answer("ready")
        coming = orders(Order)
        while (order := await asyncio.to_thread(next, coming, None)) is not None:
            answer(await _send_paced(port, stream, memory, order))


async def _send_paced(port: Port, stream: Stream, memory: bytearray, order: Order) -> Sent:
    began_s = time.monotonic()
    count = 0
    for number, wait_s in due_times(order):
        if wait_s:
            await asyncio.sleep(wait_s)
        STAMP.pack_into(memory, 0, time.monotonic_ns(), order.run, number)
        payload = bytes(memory)  # what a port is given must not change: it may be sent later
        if len(stream.shape) == 3:
            height, width, _ = stream.shape
            message: Payload = Image.from_packed("rgb", width, height, payload)
        else:
            message = [payload]
        await port.wait_for_room()
        port.write(message)
        count += 1
    return Sent(count=count, seconds=time.monotonic() - began_s)


def receive(stream: Stream) -> None:
    asyncio.run(_receive(stream))


async def _receive(stream: Stream) -> None:
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    arrivals = Arrivals(lambda: loop.call_soon_threadsafe(ended.set))

    def on_image(incoming: Incoming) -> None:
        arrivals.add(stream.array(Image.decode(incoming.payload).packed_pixels()))

    def on_bottle(incoming: Incoming) -> None:
        (payload,) = incoming.bottle()
        assert isinstance(payload, bytes)
        arrivals.add(payload)

    reader = await Reader.dial(
        OUTPUT,
        names_of(stream),
        on_data=on_image if len(stream.shape) == 3 else on_bottle,
        reader_name="/bench/in",
        carrier=stream.option,
    )
    arrivals.listen()
    await ended.wait()
    await reader.close()


def serve(stream: Stream) -> None:
    asyncio.run(_serve(stream))


async def _serve(stream: Stream) -> None:
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()

    async def echo(incoming: Incoming) -> Reply:
        return incoming.bottle()

    async with await Port.open(RPC, names_of(stream), on_call=echo):
        Arrivals(lambda: loop.call_soon_threadsafe(ended.set)).listen()
        await ended.wait()


def call(stream: Stream) -> None:
    with asyncio.Runner() as runner:
        client = runner.run(RpcClient.connect(RPC, names_of(stream)))
        payload = bytes(stream.memory())

        async def perform(order: Order) -> list[int]:
            round_trips_ns = []
            for _ in range(order.count):
                began_ns = time.monotonic_ns()
                await client.call([payload], timeout_s=CALL_TIMEOUT_S)
                round_trips_ns.append(time.monotonic_ns() - began_ns)
            return round_trips_ns

        follow_orders(lambda order: runner.run(perform(order)))
        runner.run(client.close())


if __name__ == "__main__":
    main({"names": serve_names, "send": send, "receive": receive, "serve": serve, "call": call})
