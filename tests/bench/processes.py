"""Peers as processes: started anew (never forked), told what to do, ended with all theirs."""

from __future__ import annotations

import asyncio
import math
import os
import signal
import sys
import time
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, TypeVar

import msgspec

from vertebra.testing.ports import free_tcp_port

from .peers.peer import Order, Sent, Stream, Taken

ROOT: Final = Path(__file__).parents[2]
START_S: Final = 60.0
STOP_S: Final = 5.0
QUIET_S: Final = 1.0
_LINE_BYTES: Final = 64 << 20
T = TypeVar("T")


class Peer:
    """One peer, in a process session of its own."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process

    async def ask(self, words: object, kind: type[T], *, timeout_s: float = START_S) -> T:
        """Send `words` and return the answer as a `kind`."""
        assert self._process.stdin is not None
        self._process.stdin.write(msgspec.json.encode(words) + b"\n")
        return await self.hear(kind, timeout_s=timeout_s)

    async def hear(self, kind: type[T], *, timeout_s: float = START_S) -> T:
        """Return the next answer as a `kind`."""
        assert self._process.stdout is not None
        async with asyncio.timeout(timeout_s):
            line = await self._process.stdout.readline()
        if not line:
            raise RuntimeError("a peer ended too early; its words are above")
        return msgspec.json.decode(line, type=kind)

    def resident_bytes(self) -> int:
        """Return the memory of the peer and of all processes it has started."""
        return sum(int(stat[21]) for stat in self._stats()) * os.sysconf("SC_PAGESIZE")

    def cpu_s(self) -> float:
        """Return the CPU time of the peer and of all processes it has started."""
        ticks = sum(int(stat[11]) + int(stat[12]) for stat in self._stats())
        return ticks / os.sysconf("SC_CLK_TCK")

    def _stats(self) -> Iterator[list[str]]:
        for process in Path("/proc").glob("[0-9]*"):
            try:
                stat = (process / "stat").read_text().rpartition(")")[2].split()
            except (FileNotFoundError, ProcessLookupError):  # ended in the meantime
                continue
            if int(stat[3]) == self._process.pid:  # its session
                yield stat

    async def end(self) -> None:
        """Hang up, and end by force what does not end by itself; Wrapyfi's helpers never do."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        with suppress(TimeoutError):
            async with asyncio.timeout(STOP_S):
                await self._process.wait()
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        await self._process.wait()


@asynccontextmanager
async def started(
    system: str, role: str, stream: Stream | None = None, environment: Mapping[str, str] = {}
) -> AsyncIterator[Peer]:
    """Run a peer until the block ends; it is ready when the block begins."""
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        f"tests.bench.peers.{system}",
        role,
        msgspec.json.encode(stream).decode(),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        cwd=ROOT,
        env={**os.environ, **environment},
        start_new_session=True,
        limit=_LINE_BYTES,
    )
    peer = Peer(process)
    try:
        await peer.hear(str)
        yield peer
    finally:
        await peer.end()


@asynccontextmanager
async def router() -> AsyncIterator[tuple[str, Peer]]:
    """Run the fleet's Zenoh router; give its locator and its process."""
    locator = f"tcp/127.0.0.1:{free_tcp_port()}"
    async with started("router", "route", Stream(endpoint=locator, dtype="|u1", shape=())) as peer:
        yield locator, peer


@asynccontextmanager
async def name_server() -> AsyncIterator[str]:
    """Run a YARP name server; give its address."""
    endpoint = f"127.0.0.1:{free_tcp_port()}"
    async with started("yarp", "names", Stream(endpoint=endpoint, dtype="|u1", shape=())):
        yield endpoint


@dataclass(slots=True)
class Exchange:
    """What came of one run.

    Attributes:
        latency_ns: Of each message that arrived, in the order of arrival.
        sent_ns: When it was sent.
        sent: How many were.
        sent_hz: The rate that the sender reached.
        received_hz: The rate at which messages arrived, from the first to the last.
        resident_bytes: Memory of all processes of the system, at regular intervals.
    """

    latency_ns: list[int]
    sent_ns: list[int]
    sent: int
    sent_hz: float
    received_hz: float
    resident_bytes: list[int] = field(default_factory=list)

    @property
    def lost(self) -> int:
        return self.sent - len(self.latency_ns)


class Pair:
    """A sender and a receiver of one system; `async with Pair.of(...) as pair`."""

    def __init__(self, sender: Peer, receiver: Peer, helpers: Sequence[Peer]) -> None:
        self.sender = sender
        self.receiver = receiver
        self._all = (sender, receiver, *helpers)
        self._run = 0

    @classmethod
    @asynccontextmanager
    async def of(
        cls, system: str, stream: Stream, helpers: Sequence[Peer] = ()
    ) -> AsyncIterator[Pair]:
        """Start both sides and wait until messages arrive.

        The memory of `helpers`, for example a router, counts as memory of the system.
        """
        environment = {
            f"WRAPYFI_ZEROMQ_SOCKET_{side}_PORT": str(free_tcp_port()) for side in ("PUB", "SUB")
        }
        async with (
            started(system, "send", stream, environment) as sender,
            started(system, "receive", stream, environment) as receiver,
        ):
            pair = cls(sender, receiver, helpers)
            await pair.meet()
            yield pair

    async def meet(self) -> None:
        """Send until something arrives: none of these systems says when it is ready."""
        deadline_s = time.monotonic() + START_S
        while not (await self.exchange(10, rate_hz=50, quiet_s=0.3)).latency_ns:
            if time.monotonic() > deadline_s:
                raise RuntimeError("the two peers do not find each other; their words are above")

    async def exchange(
        self,
        count: int,
        *,
        rate_hz: float = 0.0,
        limit_s: float = math.inf,
        quiet_s: float = QUIET_S,
        watch_s: float = 0.0,
    ) -> Exchange:
        """Send messages (see `Order`) and wait for them.

        What has not arrived `quiet_s` after the last arrival is lost. Memory is looked at every
        `watch_s` if that is given.
        """
        self._run += 1
        await self.receiver.ask(self._run, str)
        order = Order(run=self._run, count=count, rate_hz=rate_hz, limit_s=limit_s)
        memory: list[int] = []
        watch = asyncio.create_task(self._watch(memory, watch_s)) if watch_s else None
        sent = await self.sender.ask(order, Sent, timeout_s=10 * START_S)
        await self._settle(sent.count, quiet_s)
        if watch is not None:
            watch.cancel()
        taken = await self.receiver.ask("take", Taken)
        received_ns = [sum(pair) for pair in zip(taken.sent_ns, taken.latency_ns, strict=True)]
        seconds = (max(received_ns) - min(received_ns)) / 1e9 if received_ns else 0.0
        return Exchange(
            latency_ns=taken.latency_ns,
            sent_ns=taken.sent_ns,
            sent=sent.count,
            sent_hz=sent.count / sent.seconds,
            received_hz=(len(received_ns) - 1) / seconds if seconds else 0.0,
            resident_bytes=memory,
        )

    async def _settle(self, count: int, quiet_s: float) -> None:
        arrived = -1
        quiet_since_s = time.monotonic()
        while arrived < count and time.monotonic() - quiet_since_s < quiet_s:
            now = await self.receiver.ask("count", int)
            if now != arrived:
                arrived, quiet_since_s = now, time.monotonic()
            else:
                await asyncio.sleep(0.05)

    async def _watch(self, memory: list[int], interval_s: float) -> None:
        while True:
            memory.append(sum(peer.resident_bytes() for peer in self._all))
            await asyncio.sleep(interval_s)
