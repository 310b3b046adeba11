"""ZeroMQ by hand: PUB and SUB, connected to each other, raw bytes, one copy by the sender."""

from __future__ import annotations

import threading

import zmq

from .peer import Arrivals, Stream, follow_orders, main, send_paced

POLL_MS = 200


def send(stream: Stream) -> None:
    with zmq.Context() as context, context.socket(zmq.PUB) as socket:
        socket.linger = 0
        socket.bind(stream.endpoint)
        values = stream.array(stream.memory())
        # A copy, because the next message is written into the same memory.
        follow_orders(lambda order: send_paced(order, values, socket.send))


def receive(stream: Stream) -> None:
    with zmq.Context() as context, context.socket(zmq.SUB) as socket:
        socket.connect(stream.endpoint)
        socket.subscribe(b"")
        ended = threading.Event()
        arrivals = Arrivals(ended.set)
        arrivals.listen()
        while not ended.is_set():
            if socket.poll(POLL_MS):
                payload = socket.recv(copy=False).buffer
                arrivals.add(stream.array(payload))


if __name__ == "__main__":
    main({"send": send, "receive": receive})
