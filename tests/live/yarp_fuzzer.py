"""A crowd of bad YARP peers, in a process of its own: `yarp_fuzzer.py SEED SECONDS TCP_PORT...`.

Each session is one that was captured from the real programs, damaged in some of the ways below,
and sent in some manner: at once, drop by drop, without reading, without ever closing. Everything
follows from the seed and the number of the session. Prints what it did as JSON.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import random
import struct
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

CAPTURES: Final = Path(__file__).parents[1] / "conformance" / "yarp" / "sessions.json"
HANDS: Final = 40
"""Sessions at the same time, beside those that were left open."""
LEFT_OPEN: Final = 300
"""More than a port takes (`PeerLimits.max_connections`)."""
ANSWER_S: Final = 0.05
LENGTHS: Final = (-(2**31), -1, 0, 1, 255, 65_536, 2**20, 2**26 - 64, 2**26, 2**31 - 1)
MAX_BYTES: Final = 2**20

Mutation = Callable[[random.Random, list[bytes]], list[bytes]]


def captured_sessions() -> list[list[bytes]]:
    """Return what clients sent, in the pieces in which it came."""
    cases = json.loads(CAPTURES.read_text())["cases"].values()
    sessions = [
        [bytes.fromhex(raw) for _, way, raw, *_ in connection["data"] if way == "c>s"]
        for case in cases
        for connection in case["connections"]
    ]
    return [pieces for pieces in sessions if pieces]


SESSIONS: Final = captured_sessions()


def truncate(chance: random.Random, pieces: list[bytes]) -> list[bytes]:
    place = chance.randrange(len(pieces))
    return [*pieces[:place], pieces[place][: chance.randint(0, len(pieces[place]))]]


def flip(chance: random.Random, pieces: list[bytes]) -> list[bytes]:
    place = chance.randrange(len(pieces))
    raw = bytearray(pieces[place])
    for _ in range(chance.randint(1, 8) if raw else 0):
        raw[chance.randrange(len(raw))] ^= 1 << chance.randrange(8)
    return [*pieces[:place], bytes(raw), *pieces[place + 1 :]]


def stretch(chance: random.Random, pieces: list[bytes]) -> list[bytes]:
    """Write a length where it does not belong, most likely over another one."""
    place = chance.randrange(len(pieces))
    raw = bytearray(pieces[place])
    if len(raw) >= 4:
        where = chance.randrange(0, len(raw) - 3, chance.choice((1, 2, 4)))
        struct.pack_into("<i", raw, where, chance.choice(LENGTHS))
    return [*pieces[:place], bytes(raw), *pieces[place + 1 :]]


def repeat(chance: random.Random, pieces: list[bytes]) -> list[bytes]:
    place = chance.randrange(len(pieces))
    times = min(chance.choice((2, 10, 1000)), MAX_BYTES // (len(pieces[place]) + 1) + 1)
    return [*pieces[:place], pieces[place] * times, *pieces[place + 1 :]]


def splice(chance: random.Random, pieces: list[bytes]) -> list[bytes]:
    other = chance.choice(SESSIONS)
    return [*pieces[: chance.randint(1, len(pieces))], *other[chance.randrange(len(other)) :]]


def invent(chance: random.Random, pieces: list[bytes]) -> list[bytes]:
    place = chance.randint(0, len(pieces))
    return [*pieces[:place], chance.randbytes(chance.choice((1, 8, 100, 70_000))), *pieces[place:]]


def announce(chance: random.Random, pieces: list[bytes]) -> list[bytes]:
    """Promise a message that never comes."""
    length = chance.choice((2**16, 2**20, 2**26 - 64))
    index = yarp_number(10) + b"\1\0" + b"\xff" * 8 + struct.pack("<i", length)
    name = b"anon\0"
    greeting = yarp_number(7777 + 3) + struct.pack("<i", len(name)) + name
    return [greeting, index, pieces[0]]


def yarp_number(value: int) -> bytes:
    return struct.pack("<2si2s", b"YA", value, b"RP")


def remain(_: random.Random, pieces: list[bytes]) -> list[bytes]:
    return pieces


MUTATIONS: Final[tuple[Mutation, ...]] = (
    truncate, flip, stretch, repeat, splice, invent, announce, remain
)  # fmt: skip


class Crowd:
    """All the peers, and the connections that they leave open."""

    def __init__(self, seed: int, tcp_ports: list[int]) -> None:
        self.did = Counter[str]()
        self._seed = seed
        self._tcp_ports = itertools.cycle(tcp_ports)
        self._left_open = deque[asyncio.StreamWriter]()

    async def rage(self, seconds: float) -> None:
        """Run sessions until the time is over."""
        end_s = time.monotonic() + seconds
        numbers = itertools.takewhile(lambda _: time.monotonic() < end_s, itertools.count())
        async with asyncio.TaskGroup() as group:
            for _ in range(HANDS):
                group.create_task(self._run(numbers))
        for writer in self._left_open:
            writer.transport.abort()

    async def _run(self, numbers: Iterator[int]) -> None:
        for number in numbers:
            chance = random.Random(f"{self._seed} {number}")
            pieces = chance.choice(SESSIONS)
            for mutate in chance.choices(MUTATIONS, k=chance.randint(1, 3)):
                pieces = mutate(chance, pieces)
            manner = chance.choices((self.burst, self.drip, self.leave), (8, 1, 3))[0]
            self.did[manner.__name__] += 1
            self.did["sessions"] += 1
            # A peer that is thrown out has what it deserves.
            with contextlib.suppress(ConnectionError, TimeoutError):
                reader, writer = await asyncio.open_connection("127.0.0.1", next(self._tcp_ports))
                await manner(chance, pieces, reader, writer)

    async def burst(
        self,
        chance: random.Random,
        pieces: list[bytes],
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
    ) -> None:
        """Send all, look at the answers or not, and go politely or not."""
        try:
            writer.write(b"".join(pieces))
            async with asyncio.timeout(ANSWER_S):
                await writer.drain()
                if chance.random() < 0.8:
                    while raw := await reader.read(65_536):
                        self.did["bytes answered"] += len(raw)
        finally:
            if chance.random() < 0.5:
                writer.transport.abort()
            else:
                writer.close()

    async def drip(
        self,
        chance: random.Random,
        pieces: list[bytes],
        _: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
    ) -> None:
        """Send a few bytes at a time."""
        try:
            raw = b"".join(pieces)[:2_000]
            step = chance.choice((1, 7, 100))
            for begin in range(0, min(len(raw), 100 * step), step):
                if writer.transport.is_closing():
                    return
                writer.write(raw[begin : begin + step])
                await asyncio.sleep(0.002)
        finally:
            writer.transport.abort()

    async def leave(
        self,
        _: random.Random,
        pieces: list[bytes],
        __: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
    ) -> None:
        """Send all, read nothing, and stay."""
        self._left_open.append(writer)
        writer.write(b"".join(pieces))
        if len(self._left_open) > LEFT_OPEN:
            self._left_open.popleft().transport.abort()


def main(seed: str, seconds: str, *tcp_ports: str) -> None:
    crowd = Crowd(int(seed), [*map(int, tcp_ports)])
    asyncio.run(crowd.rage(float(seconds)))
    sys.stdout.write(json.dumps(crowd.did))


if __name__ == "__main__":
    main(*sys.argv[1:])
