"""Zenoh by hand, in the mode of our bus: same router, links and shared memory, the same copies.

An array becomes bytes (the binding takes nothing else), and these go into shared memory. What
arrives is used in the callback, in Zenoh's thread, or, with option `asyncio`, in an event loop.
"""

from __future__ import annotations

import asyncio
import json
import threading
import time
from typing import Any

import zenoh
import zenoh.shm
from numpy.typing import NDArray

from vertebra.bus.links import LINK_SETTINGS
from vertebra.bus.shared_memory import THRESHOLD_BYTES

from .peer import Arrivals, Order, Stream, follow_orders, main, send_paced

POOL_BYTES = 32 << 20
WAIT_S = 30.0


def open_session(stream: Stream) -> zenoh.Session:
    config = zenoh.Config()
    for path, value in {
        **LINK_SETTINGS,
        "mode": "client",
        "connect/endpoints": [stream.endpoint],
        "transport/shared_memory/enabled": True,
    }.items():
        config.insert_json5(path, json.dumps(value))
    return zenoh.open(config)


def send(stream: Stream) -> None:
    with open_session(stream) as session:
        values = stream.array(stream.memory())
        shared = values.nbytes >= THRESHOLD_BYTES
        publisher = session.declare_publisher(stream.key, express=not shared)
        pool = zenoh.shm.ShmProvider.default_backend(POOL_BYTES) if shared else None

        def put(array: NDArray[Any]) -> None:
            payload = array.tobytes()
            publisher.put(payload if pool is None else hold(pool, payload))

        follow_orders(lambda order: send_paced(order, values, put))


def hold(pool: zenoh.shm.ShmProvider, payload: bytes) -> zenoh.shm.ZShmMut:
    """Return shared memory with the payload in it."""
    try:
        segment = pool.alloc(len(payload))
    except zenoh.ZError:
        pool.garbage_collect()
        segment = pool.alloc(len(payload))
    segment[0 : len(payload)] = payload
    return segment


def receive(stream: Stream) -> None:
    if stream.option == "asyncio":
        asyncio.run(_receive_in_event_loop(stream))
        return
    with open_session(stream) as session:
        ended = threading.Event()
        arrivals = Arrivals(ended.set)

        def arrived(sample: zenoh.Sample) -> None:
            arrivals.add(stream.array(sample.payload.to_bytes()))

        session.declare_subscriber(stream.key, arrived)
        arrivals.listen()
        ended.wait()


async def _receive_in_event_loop(stream: Stream) -> None:
    loop = asyncio.get_running_loop()
    coming: asyncio.Queue[bytes | None] = asyncio.Queue()

    def hand_over(payload: bytes | None) -> None:
        loop.call_soon_threadsafe(coming.put_nowait, payload)

    def arrived(sample: zenoh.Sample) -> None:
        hand_over(sample.payload.to_bytes())

    with open_session(stream) as session:
        arrivals = Arrivals(lambda: hand_over(None))
        session.declare_subscriber(stream.key, arrived)
        arrivals.listen()
        while (payload := await coming.get()) is not None:
            arrivals.add(stream.array(payload))


def serve(stream: Stream) -> None:
    with open_session(stream) as session:
        ended = threading.Event()

        def arrived(query: zenoh.Query) -> None:
            with query:
                query.reply(stream.key, b"" if query.payload is None else query.payload.to_bytes())

        session.declare_queryable(stream.key, arrived, complete=True)
        Arrivals(ended.set).listen()
        ended.wait()


def call(stream: Stream) -> None:
    with open_session(stream) as session:
        payload = bytes(stream.memory())

        def perform(order: Order) -> list[int]:
            round_trips_ns = []
            for _ in range(order.count):
                began_ns = time.monotonic_ns()
                for reply in session.get(stream.key, payload=payload, timeout=WAIT_S, express=True):
                    assert reply.ok is not None
                    reply.ok.payload.to_bytes()
                round_trips_ns.append(time.monotonic_ns() - began_ns)
            return round_trips_ns

        follow_orders(perform)


if __name__ == "__main__":
    main({"send": send, "receive": receive, "serve": serve, "call": call})
