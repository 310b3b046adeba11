"""Vertebra as its services use it: typed messages, frames, bus, event loop."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from vertebra.bus import Delivery, Priority, Reply, Request, ZenohBus
from vertebra.codec import CodecRegistry
from vertebra.messages import Array, Image, Message, Tensor
from vertebra.service import MessagePublisher, MessageReader

from .peer import (
    Arrivals,
    Order,
    Stream,
    follow_orders,
    main,
    send_paced,
)

DEPTH = 1000  # as many as ZeroMQ keeps
WAIT_S = 30.0


def send(stream: Stream) -> None:
    with asyncio.Runner() as runner:
        bus = runner.run(ZenohBus.open(stream.endpoint, timeout_s=WAIT_S))
        values = stream.array(stream.memory())
        put: Callable[[Any], None]
        if len(stream.shape) == 1:
            plain = bus.publisher(stream.key, encoding="")
            put = lambda array: plain.put(array.tobytes())  # noqa: E731
        else:
            publisher = MessagePublisher(
                bus, CodecRegistry.installed(), stream.key, priority=Priority.BULK
            )
            message = as_image if len(stream.shape) == 3 else as_tensor
            put = lambda array: publisher.publish(message(array))  # noqa: E731
        follow_orders(lambda order: send_paced(order, values, put))
        runner.run(bus.close())


def as_image(array: Any) -> Message:
    return Image(pixels=Array.of(array), pixel_format="rgb8")


def as_tensor(array: Any) -> Message:
    return Tensor(array=Array.of(array))


def receive(stream: Stream) -> None:
    asyncio.run(_receive(stream))


async def _receive(stream: Stream) -> None:
    loop = asyncio.get_running_loop()
    bus = await ZenohBus.open(stream.endpoint, timeout_s=WAIT_S)
    subscription = bus.subscribe(stream.key, Delivery.queue(DEPTH))
    arrivals = Arrivals(lambda: loop.call_soon_threadsafe(subscription.close))
    arrivals.listen()
    codecs = CodecRegistry.installed()
    if len(stream.shape) == 1:
        async for sample in subscription:
            arrivals.add(sample.payload)
    elif len(stream.shape) == 3:
        async for image in MessageReader(subscription, codecs, Image):
            arrivals.add(np.asarray(image.message.pixels))
    else:
        async for tensor in MessageReader(subscription, codecs, Tensor):
            arrivals.add(np.asarray(tensor.message.array))
    await bus.close()


def serve(stream: Stream) -> None:
    asyncio.run(_serve(stream))


async def _serve(stream: Stream) -> None:
    bus = await ZenohBus.open(stream.endpoint, timeout_s=WAIT_S)
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()

    async def echo(request: Request) -> Reply:
        return Reply(payload=request.payload, encoding="")

    bus.serve(stream.key, echo)
    Arrivals(lambda: loop.call_soon_threadsafe(ended.set)).listen()
    await ended.wait()
    await bus.close()


def call(stream: Stream) -> None:
    with asyncio.Runner() as runner:
        bus = runner.run(ZenohBus.open(stream.endpoint, timeout_s=WAIT_S))
        payload = bytes(stream.memory())

        async def perform(order: Order) -> list[int]:
            round_trips_ns = []
            for _ in range(order.count):
                began_ns = time.monotonic_ns()
                await bus.call(stream.key, payload, timeout_s=WAIT_S)
                round_trips_ns.append(time.monotonic_ns() - began_ns)
            return round_trips_ns

        follow_orders(lambda order: runner.run(perform(order)))
        runner.run(bus.close())


if __name__ == "__main__":
    main({"send": send, "receive": receive, "serve": serve, "call": call})
