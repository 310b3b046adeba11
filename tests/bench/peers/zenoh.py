"""Zenoh by hand, in the mode of our bus: same router, links and shared memory, the same copies.

An array becomes bytes (the binding takes nothing else), these go into shared memory, and the
callback makes an array of what it gets, in Zenoh's thread.
"""

from __future__ import annotations

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

KEY = "bench/zenoh"
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
        publisher = session.declare_publisher(KEY, express=not shared)
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
    with open_session(stream) as session:
        ended = threading.Event()
        arrivals = Arrivals(ended.set)

        def arrived(sample: zenoh.Sample) -> None:
            arrivals.add(stream.array(sample.payload.to_bytes()))

        session.declare_subscriber(KEY, arrived)
        arrivals.listen()
        ended.wait()


def serve(stream: Stream) -> None:
    with open_session(stream) as session:
        ended = threading.Event()

        def arrived(query: zenoh.Query) -> None:
            with query:
                query.reply(KEY, b"" if query.payload is None else query.payload.to_bytes())

        session.declare_queryable(KEY, arrived, complete=True)
        Arrivals(ended.set).listen()
        ended.wait()


def call(stream: Stream) -> None:
    with open_session(stream) as session:
        payload = bytes(stream.memory())

        def perform(order: Order) -> list[int]:
            round_trips_ns = []
            for _ in range(order.count):
                began_ns = time.monotonic_ns()
                for reply in session.get(KEY, payload=payload, timeout=WAIT_S, express=True):
                    assert reply.ok is not None
                    reply.ok.payload.to_bytes()
                round_trips_ns.append(time.monotonic_ns() - began_ns)
            return round_trips_ns

        follow_orders(perform)


if __name__ == "__main__":
    main({"send": send, "receive": receive, "serve": serve, "call": call})
