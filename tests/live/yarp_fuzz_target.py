"""What is fuzzed, in a process of its own: `yarp_fuzz_target.py names` or `... port TCP_PORT`.

`names` is a name server. `port` is a YARP port, registered at the name server on TCP_PORT, that
streams numbers, echoes calls, and notes what the writer BYSTANDER sends. Prints its TCP port;
then answers each line with its `Health` as JSON, until there is no more.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import sys
import time
from collections.abc import AsyncIterator
from pathlib import Path

import msgspec

from vertebra.errors import BusyError
from vertebra.yarp import Incoming, NameClient, NameServer, Port, Value, encode

PORT = "/fuzzed"
BYSTANDER = "/bystander/writer"
PERIOD_S = 0.01
DEPTH = 1000


class Health(msgspec.Struct):
    """How the process does.

    Attributes:
        resident_bytes: Its memory.
        busy_s: The longest time that the event loop worked without coming round; waiting for
            a turn on the CPU does not count.
        stuck_s: The longest time that it did not come round, whatever the reason.
        tracebacks: What was logged with one, or by asyncio itself.
        taken: How many numbers BYSTANDER has sent, up to the first that was not the next.
        missed: Whether there was such a one.
    """

    resident_bytes: int = 0
    busy_s: float = 0.0
    stuck_s: float = 0.0
    tracebacks: list[str] = msgspec.field(default_factory=list)
    taken: int = 0
    missed: bool = False


class Tracebacks(logging.Handler):
    """Keeps the log records that nobody should see."""

    def __init__(self, health: Health) -> None:
        super().__init__()
        self._health = health
        self.setFormatter(logging.Formatter("%(name)s: %(message)s"))

    def emit(self, record: logging.LogRecord) -> None:
        if record.exc_info or (record.name == "asyncio" and record.levelno >= logging.WARNING):
            self._health.tracebacks.append(self.format(record))


async def watch_loop(health: Health) -> None:
    while True:
        worked_s, passed_s = time.thread_time(), time.monotonic()
        await asyncio.sleep(PERIOD_S)
        health.busy_s = max(health.busy_s, time.thread_time() - worked_s)
        health.stuck_s = max(health.stuck_s, time.monotonic() - passed_s - PERIOD_S)


@contextlib.asynccontextmanager
async def name_server() -> AsyncIterator[int]:
    async with await NameServer.start(tcp_port=0) as server:
        yield server.contact.tcp_port


@contextlib.asynccontextmanager
async def streaming_port(names: NameClient, health: Health) -> AsyncIterator[int]:
    def note(incoming: Incoming) -> None:
        values = incoming.bottle()
        if incoming.sender == BYSTANDER and not health.missed:
            health.missed = values != [health.taken]
            health.taken += not health.missed

    async def echo(incoming: Incoming) -> list[Value]:
        return incoming.bottle()

    async def stream(port: Port) -> None:
        number = 0
        while True:
            # A bad peer does not read; if a good one misses something, the test sees it.
            with contextlib.suppress(BusyError):
                port.write(encode([number]), envelope=f"{number} 0.5")
            number += 1
            await asyncio.sleep(PERIOD_S)

    async with await Port.open(
        PORT, names, on_data=note, on_call=echo, delivery="queue", depth=DEPTH
    ) as port:
        streaming = asyncio.create_task(stream(port))
        yield port.contact.tcp_port
        streaming.cancel()


def resident_bytes() -> int:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGESIZE")


def say(line: bytes) -> None:
    sys.stdout.buffer.write(line + b"\n")
    sys.stdout.buffer.flush()


async def main(role: str, tcp_port: int = 0) -> None:
    health = Health()
    logging.basicConfig(handlers=[Tracebacks(health), logging.StreamHandler()], level="WARNING")
    target = (
        name_server()
        if role == "names"
        else streaming_port(NameClient("127.0.0.1", tcp_port), health)
    )
    async with target as own_tcp_port:
        watching = asyncio.create_task(watch_loop(health))
        say(str(own_tcp_port).encode())
        while await asyncio.to_thread(sys.stdin.readline):
            health.resident_bytes = resident_bytes()
            say(msgspec.json.encode(health))
        watching.cancel()


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], *map(int, sys.argv[2:])))
