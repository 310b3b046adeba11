"""Wrapyfi over ZeroMQ, used as its own benchmark (`benchmarking_native_object.py`) uses it.

Its listener never waits: `listen()` polls with a timeout of 0 and gives None, so its benchmark asks
in a loop, and so does this. The publisher starts Wrapyfi's broker and monitor processes; two TCP
ports in the environment (see `latency`) keep it away from others of its kind.
"""

from __future__ import annotations

import logging
import threading
import time
from typing import Any

from wrapyfi.connect.wrapper import MiddlewareCommunicator

from .peer import Arrivals, Stream, follow_orders, main, send_paced


def communicator(stream: Stream) -> Any:
    """Return a Wrapyfi class instance whose method `exchange` carries an array of this stream."""
    image = len(stream.shape) == 3
    size = {"width": stream.shape[1], "height": stream.shape[0]} if image else {}

    class Bench(MiddlewareCommunicator):  # type: ignore[misc]
        @MiddlewareCommunicator.register(  # type: ignore[untyped-decorator]
            "Image" if image else "NativeObject",
            "zeromq",
            "Bench",
            "/bench/stream",
            carrier="tcp",
            should_wait=True,
            **size,
        )
        def exchange(self, array: Any = None) -> tuple[Any]:
            if image:
                return (array,)
            return ({"count": 0, "timestamp": time.time(), "numpy": array},)

    return Bench()


def send(stream: Stream) -> None:
    bench = communicator(stream)
    bench.activate_communication(bench.exchange, mode="publish")
    values = stream.array(stream.memory())
    follow_orders(lambda order: send_paced(order, values, bench.exchange))


def receive(stream: Stream) -> None:
    bench = communicator(stream)
    bench.activate_communication(bench.exchange, mode="listen")
    ended = threading.Event()
    arrivals = Arrivals(ended.set)
    arrivals.listen()
    image = len(stream.shape) == 3
    while not ended.is_set():
        arrivals.wanted.wait()
        (value,) = bench.exchange()
        if value is not None:
            arrivals.add(value if image else value["numpy"])


if __name__ == "__main__":
    logging.disable(logging.CRITICAL)
    main({"send": send, "receive": receive})
