"""One YARP port among many: all read from it (option `out`), or all write to it (option `in`).

The stream's shape is (how many, bytes of each message). Everything is strict: what a queue cannot
take is lost, and counts as lost.
"""

from __future__ import annotations

import asyncio
import time
from contextlib import AsyncExitStack, suppress

from vertebra.errors import BusyError
from vertebra.yarp import Incoming, Port, Reader, encode

from .peer import STAMP, Arrivals, Order, Sent, Stream, answer, due_times, main, orders
from .yarp import names_of, serve_names

ONE = "/crowd/one"
CARRIER = "tcp"
DEPTH = 50
"""A second at 50 Hz."""


def send(stream: Stream) -> None:
    asyncio.run(_send(stream))


async def _send(stream: Stream) -> None:
    size, _ = stream.shape
    names = names_of(stream)
    async with AsyncExitStack() as stack:
        opened = [ONE] if stream.option == "out" else [f"/crowd/{n}" for n in range(size)]
        ports = [
            await stack.enter_async_context(
                await Port.open(name, names, delivery="queue", depth=DEPTH)
            )
            for name in opened
        ]
        answer("ready")
        coming = orders(Order)
        while (order := await asyncio.to_thread(next, coming, None)) is not None:
            if stream.option == "in" and order.run == 1:  # the one that reads is there by now
                for port in ports:
                    await port.connect(ONE, CARRIER)
            answer(await _send_paced(ports, stream, order))


async def _send_paced(ports: list[Port], stream: Stream, order: Order) -> Sent:
    size, nbytes = stream.shape
    memory = bytearray(nbytes)
    began_s = time.monotonic()
    for number, wait_s in due_times(order):
        await asyncio.sleep(wait_s)
        for port in ports:
            STAMP.pack_into(memory, 0, time.monotonic_ns(), order.run, number)
            with suppress(BusyError):  # lost, as the runner will see
                port.write(encode([bytes(memory)]))
    return Sent(count=order.count * size, seconds=time.monotonic() - began_s)


def receive(stream: Stream) -> None:
    asyncio.run(_receive(stream))


async def _receive(stream: Stream) -> None:
    size, _ = stream.shape
    names = names_of(stream)
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    arrivals = Arrivals(lambda: loop.call_soon_threadsafe(ended.set))

    def take(incoming: Incoming) -> None:
        (payload,) = incoming.bottle()
        arrivals.add(payload)

    async with AsyncExitStack() as stack:
        if stream.option == "in":
            await stack.enter_async_context(await Port.open(ONE, names, on_data=take))
        else:
            for number in range(size):
                reader = await Reader.dial(
                    ONE, names, on_data=take, reader_name=f"/crowd/{number}", carrier=CARRIER
                )
                stack.push_async_callback(reader.close)
        arrivals.listen()
        await ended.wait()


if __name__ == "__main__":
    main({"names": serve_names, "send": send, "receive": receive})
