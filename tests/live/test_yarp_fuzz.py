"""Bad peers by the thousand against a live YARP port and the name server.

Four seconds each time; `VERTEBRA_FUZZ_S=60 ./vertebra test` takes a minute, and
`VERTEBRA_FUZZ_SEED` other sessions. Targets and fuzzer are processes of their own.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import msgspec
import pytest

from vertebra.testing.bus_suite import eventually
from vertebra.yarp import Contact, Incoming, NameClient, NameServer, Port, Reader, RpcClient, encode

from .yarp_fuzz_target import BYSTANDER, DEPTH, PERIOD_S, PORT, Health

FUZZ_S: Final = float(os.environ.get("VERTEBRA_FUZZ_S", "4"))
SEED: Final = int(os.environ.get("VERTEBRA_FUZZ_SEED", "3"))
HERE: Final = Path(__file__).parent
ROUNDS: Final = 4
"""Between them nobody is left open. The first two bring memory to its working size."""
GROWTH_BYTES: Final = 48 * 2**20
"""In a minute, two kilobytes kept of each bad session would be more."""
PEAK_BYTES: Final = 256 * 2**20
"""Mostly buffers: as many bad peers at a time as a port takes, with up to a megabyte each."""
BUSY_S: Final = 0.25
STUCK_S: Final = 3.0
CALL_S: Final = 10.0


class Target:
    """A process that is fuzzed."""

    def __init__(self, process: asyncio.subprocess.Process, tcp_port: int) -> None:
        self._process = process
        self.tcp_port = tcp_port
        self.resident_bytes: list[int] = []

    async def health(self) -> Health:
        assert self._process.stdin is not None
        self._process.stdin.write(b"\n")
        health = msgspec.json.decode(await _line(self._process), type=Health)
        self.resident_bytes.append(health.resident_bytes)
        return health


async def _line(process: asyncio.subprocess.Process) -> bytes:
    assert process.stdout is not None
    async with asyncio.timeout(CALL_S):
        return await process.stdout.readline()


@asynccontextmanager
async def started(*words: object) -> AsyncIterator[Target]:
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        HERE / "yarp_fuzz_target.py",
        *map(str, words),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
    )
    assert process.stdin is not None
    try:
        yield Target(process, int(await _line(process)))
    finally:
        process.stdin.close()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(CALL_S):
                await process.wait()
        if process.returncode is None:
            process.kill()
        await process.wait()


async def rage(seed: int, *targets: Target) -> Counter[str]:
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        HERE / "yarp_fuzzer.py",
        *map(str, (seed, FUZZ_S / ROUNDS, *(target.tcp_port for target in targets))),
        stdout=asyncio.subprocess.PIPE,
    )
    try:
        async with asyncio.timeout(FUZZ_S + 20):
            out, _ = await process.communicate()
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    assert process.returncode == 0
    return Counter(msgspec.json.decode(out, type=dict[str, int]))


@dataclass
class Bystanders:
    """Good peers, each on the one connection that it had from the beginning.

    They are asked to end, not cancelled: whoever gives up a call gives up its connection.
    """

    leaving: bool = False
    sent: int = 0
    read: list[int] = field(default_factory=list)
    called: int = 0
    asked: int = 0

    async def write(self, port: Port) -> None:
        while not self.leaving:
            port.write(encode([self.sent]))
            self.sent += 1
            await asyncio.sleep(PERIOD_S)

    def take(self, incoming: Incoming) -> None:
        (number,) = incoming.bottle()
        assert isinstance(number, int)
        self.read.append(number)

    async def call(self, client: RpcClient) -> None:
        while not self.leaving:
            assert await client.call([self.called], timeout_s=CALL_S) == [self.called]
            self.called += 1
            await asyncio.sleep(PERIOD_S)

    async def ask(self, client: RpcClient, contact: Contact) -> None:
        while not self.leaving:
            reply = await client.call(["bot", "query", contact.name], timeout_s=CALL_S)
            assert ["port_number", contact.tcp_port] in reply
            self.asked += 1
            await asyncio.sleep(PERIOD_S)


@pytest.mark.timeout(FUZZ_S + 60)
async def test_bad_peers_cost_nothing_and_disturb_nobody() -> None:
    by = Bystanders()
    did = Counter[str]()
    async with contextlib.AsyncExitStack() as stack:
        enter = stack.enter_async_context
        quiet = (await enter(await NameServer.start(tcp_port=0))).client()
        fuzzed_port = await enter(started("port", quiet.tcp_port))
        fuzzed_names = await enter(started("names"))
        names = NameClient("127.0.0.1", fuzzed_names.tcp_port)
        kept = await names.register("/bystander/kept", host="127.0.0.1", tcp_port=9)

        writer = await enter(await Port.open(BYSTANDER, quiet, delivery="queue", depth=DEPTH))
        output = await writer.connect(PORT, "tcp")
        reader = await Reader.dial(PORT, quiet, on_data=by.take, reader_name="/bystander/reader")
        stack.push_async_callback(reader.close)
        caller = await enter(await RpcClient.connect(PORT, quiet))
        asker = await enter(await RpcClient.connect("/root", names))

        async with asyncio.TaskGroup() as group:
            for work in (by.write(writer), by.call(caller), by.ask(asker, kept)):
                group.create_task(work)
            for number in range(ROUNDS):
                did += await rage(SEED + number, fuzzed_port, fuzzed_names)
                for target in (fuzzed_port, fuzzed_names):
                    await target.health()
            by.leaving = True

        await eventually(lambda: output.counters.messages == by.sent)
        assert not any(link.closed for link in (output, reader, caller, asker))
        async with await RpcClient.connect(PORT, quiet) as latecomer:
            assert await latecomer.call(["still"], timeout_s=CALL_S) == ["still"]
        at_port = await fuzzed_port.health()
        assert (at_port.taken, at_port.missed) == (by.sent, False)
        assert (output.counters.dropped, output.counters.refused) == (0, 0)
        assert by.read == [*range(by.read[0], by.read[0] + len(by.read))]
        assert min(by.called, by.asked, len(by.read)) > FUZZ_S / PERIOD_S / 10
        assert did["sessions"] > 100 * FUZZ_S
        for target in (fuzzed_port, fuzzed_names):
            health = await target.health()
            print(did, health, target.resident_bytes)  # noqa: T201 -- with -s
            assert health.tracebacks == []
            assert health.busy_s < BUSY_S
            assert health.stuck_s < STUCK_S
            sizes = target.resident_bytes
            assert max(sizes) < PEAK_BYTES, sizes
            assert sizes[-1] - max(sizes[: ROUNDS // 2]) < GROWTH_BYTES, sizes
