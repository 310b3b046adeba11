"""Zenoh by hand, in the mode of our bus: same router, same shared memory, one copy on each side.

The fastest that a Python program can do: the image lies in a bytearray, which goes into shared
memory with one copy (the binding takes nothing else), and the callback works in Zenoh's thread.
"""

from __future__ import annotations

import json
import threading
import time
from typing import Any

import zenoh
import zenoh.shm

from .peer import Arrivals, Order, Stream, follow_orders, main, send_paced

KEY = "bench/zenoh"
POOL_BYTES = 32 << 20
SHARED_FROM_BYTES = 16 << 10
WAIT_S = 30.0


def open_session(stream: Stream) -> zenoh.Session:
    config = zenoh.Config()
    for path, value in {
        "mode": "client",
        "connect/endpoints": [stream.endpoint],
        "scouting/multicast/enabled": False,
        "transport/shared_memory/enabled": True,
        "transport/shared_memory/transport_optimization/enabled": False,
    }.items():
        config.insert_json5(path, json.dumps(value))
    return zenoh.open(config)


def send(stream: Stream) -> None:
    with open_session(stream) as session:
        memory = stream.memory()
        publisher = session.declare_publisher(KEY, express=len(memory) < SHARED_FROM_BYTES)

        def put(_: Any) -> None:
            publisher.put(bytes(memory))

        if len(memory) >= SHARED_FROM_BYTES:
            pool = zenoh.shm.ShmProvider.default_backend(POOL_BYTES)

            def put(_: Any) -> None:
                try:
                    segment = pool.alloc(len(memory))
                except zenoh.ZError:
                    pool.garbage_collect()
                    segment = pool.alloc(len(memory))
                segment[0 : len(memory)] = memory
                publisher.put(segment)

        follow_orders(lambda order: send_paced(order, stream.array(memory), put))


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
