"""Shared memory under a memory-lock limit: as much as fits, and no sample is ever lost for it."""

from __future__ import annotations

import asyncio
import contextlib
import json
import shutil
import sys
from asyncio.subprocess import PIPE

import pytest

from vertebra.bus.router import running_router
from vertebra.testing.ports import free_tcp_port

pytestmark = [
    pytest.mark.live,
    pytest.mark.skipif(
        shutil.which("setpriv") is None or shutil.which("prlimit") is None,
        reason="setpriv and prlimit are missing: apt-get install util-linux",
    ),
]

IMAGES = 30
PROGRAM = """
import asyncio, json, sys
from vertebra.bus import Delivery, ZenohBus

async def publish(bus, number):
    wanted = asyncio.Event()
    bus.follow_demand(f"large/{number}", lambda _: wanted.set())
    publisher = bus.publisher(f"large/{number}", encoding="")
    await wanted.wait()
    for _ in range(int(sys.argv[4])):
        publisher.put(bytes(230_460))
        await asyncio.sleep(0.1)
    info = bus.info()
    return {"shared_memory": info.shared_memory, "misses": info.shared_memory_misses}

async def count(bus, total):
    async with bus.subscribe("large/*", Delivery.queue(1000)) as subscription:
        print("ready", flush=True)
        try:
            while subscription.received < total:
                await asyncio.wait_for(anext(subscription), 5)
        except TimeoutError:
            pass
    return {"received": subscription.received, "lost": subscription.lost}

async def main():
    bus = await ZenohBus.open(sys.argv[1], timeout_s=5)
    work = publish if sys.argv[2] == "publish" else count
    print(json.dumps(await work(bus, int(sys.argv[3]))), flush=True)
    await bus.close()

asyncio.run(main())
"""


async def start(limit_bytes: int, *arguments: str) -> asyncio.subprocess.Process:
    limited = ["setpriv", "--bounding-set", "-ipc_lock", "prlimit", f"--memlock={limit_bytes}"]
    return await asyncio.create_subprocess_exec(
        *limited, sys.executable, "-c", PROGRAM, *arguments, stdout=PIPE
    )


@pytest.mark.parametrize(
    ("limit_bytes", "pools"), [(1 << 20, 0), (8 << 20, 2)], ids=["1 MiB", "8 MiB"]
)
async def test_nothing_is_lost_whatever_the_limit(limit_bytes: int, pools: int) -> None:
    locator = f"tcp/127.0.0.1:{free_tcp_port()}"
    publishers = 3
    with running_router([locator]):
        reader = await start(limit_bytes, locator, "count", str(publishers * IMAGES))
        assert reader.stdout is not None
        started = [reader]
        try:
            assert await reader.stdout.readline() == b"ready\n"
            started += [
                await start(limit_bytes, locator, "publish", str(number), str(IMAGES))
                for number in range(publishers)
            ]
            outputs = await asyncio.wait_for(
                asyncio.gather(*(process.communicate() for process in started)), 40
            )
        finally:
            for process in started:
                with contextlib.suppress(ProcessLookupError):
                    process.kill()
                await process.wait()
    counted, *published = (json.loads(output) for output, _ in outputs)
    # A busy machine may drop a copy on the link, which is counted when the next one arrives. What
    # must not be is what a reader that cannot lock a segment does: lose all of a publisher's
    # images, and count nothing.
    assert counted["received"] + counted["lost"] >= publishers * (IMAGES - 1)
    assert counted["received"] >= 0.9 * publishers * IMAGES
    using = [report for report in published if report["shared_memory"].startswith("on")]
    assert len(using) == pools
    assert all(report["misses"] < IMAGES for report in using)
