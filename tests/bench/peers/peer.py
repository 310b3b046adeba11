"""What all peers have in common: orders, answers, and stamps.

A peer is one side of one system in a process of its own: `python -m tests.bench.peers.<system>
<role> <stream as JSON>`. The stamp is written into the data itself, before any conversion, and read
from what comes out on the other side: no system has to carry it, all of them do.
"""

from __future__ import annotations

import math
import os
import struct
import sys
import threading
import time
from array import array
from collections.abc import Callable, Iterator
from typing import Any, Final, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

STAMP: Final = struct.Struct("<qqq")
"""When it was sent (CLOCK_MONOTONIC, the same in all processes), in which run, its number."""
T = TypeVar("T")


class Stream(msgspec.Struct, frozen=True, kw_only=True):
    """What flows between two peers.

    Attributes:
        endpoint: Where they meet, in the words of their system.
        dtype: Item type: `|u1` for images and bytes, `<f8` for arrays.
        shape: (height, width, 3) is an image, one axis is plain bytes, all else is an array.
        key: What it is called on Zenoh; no other pair of peers may use it.
        option: What else a system needs to know.
    """

    endpoint: str
    dtype: str
    shape: tuple[int, ...]
    key: str = "bench"
    option: str = ""

    def memory(self) -> bytearray:
        """Return what to send, noise, as bytes in memory of its own."""
        nbytes = np.dtype(self.dtype).itemsize * math.prod(self.shape)
        return bytearray(np.random.default_rng(seed=1).bytes(nbytes))

    def array(self, payload: Any) -> NDArray[Any]:
        """Look at bytes as an array of this stream."""
        return np.frombuffer(payload, self.dtype).reshape(self.shape)


class Order(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Send `count` messages as run `run`, at `rate_hz` or, if that is 0, as fast as possible.

    A system that is late does not skip: its next message leaves at once. After `limit_s` it stops.
    """

    run: int
    count: int
    rate_hz: float = 0.0
    limit_s: float = math.inf


class Sent(msgspec.Struct, frozen=True, kw_only=True):
    """How many messages were sent, and in which time."""

    count: int
    seconds: float


class Taken(msgspec.Struct, frozen=True, kw_only=True):
    """The arrivals of one run: when each was sent and how long it took."""

    sent_ns: list[int]
    latency_ns: list[int]


# Kept apart from sys.stdin and sys.stdout: what a library prints is no answer, and Wrapyfi's forked
# helpers close sys.stdin, for which they would wait for ever while a thread of ours reads from it.
_orders: Final = os.fdopen(os.dup(0), "rb")
_answers: Final = os.fdopen(os.dup(1), "wb")
os.dup2(2, 1)


def answer(value: object) -> None:
    """Tell the runner."""
    _answers.write(msgspec.json.encode(value) + b"\n")
    _answers.flush()


def orders(kind: type[T]) -> Iterator[T]:
    """Yield what the runner asks for, until it hangs up."""
    for line in _orders:
        yield msgspec.json.decode(line, type=kind)


def follow_orders(perform: Callable[[Order], object]) -> None:
    """Perform the orders of the runner and answer with the outcome, until it hangs up."""
    answer("ready")
    for order in orders(Order):
        answer(perform(order))


def due_times(order: Order) -> Iterator[tuple[int, float]]:
    """Yield the number of each message and how long to wait before it is sent."""
    began_s = time.monotonic()
    for number in range(order.count):
        elapsed_s = time.monotonic() - began_s
        if elapsed_s > order.limit_s:
            return
        due_s = number / order.rate_hz if order.rate_hz else 0.0
        yield number, max(0.0, due_s - elapsed_s)


def send_paced(order: Order, values: Any, send: Callable[[Any], object]) -> Sent:
    """Follow `order` with stamped copies of `values`."""
    began_s = time.monotonic()
    count = 0
    for number, wait_s in due_times(order):
        if wait_s:
            time.sleep(wait_s)
        STAMP.pack_into(values, 0, time.monotonic_ns(), order.run, number)
        send(values)
        count += 1
    return Sent(count=count, seconds=time.monotonic() - began_s)


class Arrivals:
    """Collects what a receiver gets while the runner, heard in a thread of its own, asks for it.

    The runner's words: the number of the run that starts, `"count"`, `"take"`.

    Attributes:
        wanted: Set while a run goes on; a receiver that polls rests otherwise.
    """

    def __init__(self, hung_up: Callable[[], object]) -> None:
        self.wanted = threading.Event()
        self._hung_up = hung_up
        self._run = -1
        self._sent_ns = array("q")
        self._latency_ns = array("q")

    def listen(self) -> None:
        """Begin to obey the runner."""
        threading.Thread(target=self._obey, daemon=True).start()
        answer("ready")

    def add(self, values: Any) -> None:
        """Note an arrival."""
        now_ns = time.monotonic_ns()
        sent_ns, run, _ = STAMP.unpack_from(values)
        if run == self._run:
            self._sent_ns.append(sent_ns)
            self._latency_ns.append(now_ns - sent_ns)

    def _obey(self) -> None:
        for words in orders(object):
            if words == "count":
                answer(len(self._sent_ns))
            elif words == "take":
                self.wanted.clear()
                answer(Taken(sent_ns=self._sent_ns.tolist(), latency_ns=self._latency_ns.tolist()))
            elif isinstance(words, int):
                self._sent_ns, self._latency_ns = array("q"), array("q")
                self._run = words
                self.wanted.set()
                answer("started")
        self.wanted.set()
        self._hung_up()


def main(roles: dict[str, Callable[[Stream], object]]) -> None:
    """Play the role of the command line."""
    roles[sys.argv[1]](msgspec.json.decode(sys.argv[2], type=Stream))
