"""YARP's own C++ library through its Python bindings, used as its documentation does it.

A bottle is seven 64-bit integers, which are 64 bytes on the wire. An image is sent out of a numpy
array, and looked at where the library has received it. Calls that wait let go of Python's lock.
"""

from __future__ import annotations

import os
import time
from ctypes import c_char
from typing import Any

from vertebra.testing.ports import free_tcp_port
from vertebra_yarp.driver_bindings import load_bindings

from .peer import STAMP, Arrivals, Order, Stream, follow_orders, main, send_paced
from .yarp import OUTPUT, RPC

yarp = load_bindings()

INPUT = "/bench/in"
INTEGERS = 7


def open_port(stream: Stream, name: str) -> Any:
    """Return a port that is registered with the name server at the endpoint."""
    yarp.Network.init()
    yarp.Network.setVerbosity(-1)
    host, _, tcp_port = stream.endpoint.partition(":")
    yarp.Network.setNameServerContact(yarp.Contact("/root", "tcp", host, int(tcp_port)))
    port = yarp.Port()
    # A tcp_port of our choice: those that a name server hands out may be taken on this machine.
    if not port.open(yarp.Contact(name, "tcp", "", free_tcp_port())):
        raise RuntimeError(f"YARP does not open the port {name}")
    return port


def fill(bottle: Any, stamp: bytes | bytearray) -> Any:
    bottle.clear()
    for number in STAMP.unpack_from(stamp):
        bottle.addInt64(number)
    for number in range(INTEGERS - bottle.size()):
        bottle.addInt64(number)
    return bottle


def send(stream: Stream) -> None:
    port = open_port(stream, OUTPUT)
    pixels = stream.array(stream.memory())
    if len(stream.shape) == 3:
        height, width, _ = stream.shape
        image = yarp.ImageRgb()
        image.setExternal(pixels, width, height)
        follow_orders(lambda order: send_paced(order, pixels, lambda _: port.write(image)))
    else:
        bottle = yarp.Bottle()
        follow_orders(
            lambda order: send_paced(order, pixels, lambda values: port.write(fill(bottle, values)))
        )
    port.close()


def receive(stream: Stream) -> None:
    port = open_port(stream, INPUT)
    if not yarp.Network.connect(OUTPUT, INPUT, stream.option):
        raise RuntimeError(f"YARP does not connect {OUTPUT} over {stream.option}")
    arrivals = Arrivals(lambda: os._exit(0))  # a read that waits ends with the process only
    arrivals.listen()
    if len(stream.shape) == 3:
        image = yarp.ImageRgb()
        while port.read(image):
            arrivals.add((c_char * STAMP.size).from_address(int(image.getRawImage())))
    bottle = yarp.Bottle()
    while port.read(bottle):
        arrivals.add(STAMP.pack(*(bottle.get(index).asInt64() for index in range(3))))


def serve(stream: Stream) -> None:
    port = open_port(stream, RPC)
    Arrivals(lambda: os._exit(0)).listen()
    request = yarp.Bottle()
    while port.read(request, True):  # will reply
        port.reply(request)


def call(stream: Stream) -> None:
    port = open_port(stream, "/bench/caller")
    if not yarp.Network.connect("/bench/caller", RPC):
        raise RuntimeError(f"YARP does not connect to {RPC}")
    request, reply = fill(yarp.Bottle(), bytes(STAMP.size)), yarp.Bottle()

    def perform(order: Order) -> list[int]:
        round_trips_ns = []
        for _ in range(order.count):
            began_ns = time.monotonic_ns()
            if not port.write(request, reply):
                raise RuntimeError("a call failed")
            round_trips_ns.append(time.monotonic_ns() - began_ns)
        return round_trips_ns

    follow_orders(perform)
    port.close()


if __name__ == "__main__":
    main({"send": send, "receive": receive, "serve": serve, "call": call})
