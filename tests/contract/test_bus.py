"""Both buses behave alike."""

from __future__ import annotations

from collections.abc import AsyncIterator

from vertebra.bus import Bus, MemoryBus, MemoryNetwork, ZenohBus
from vertebra.bus.router import running_router
from vertebra.testing.bus_suite import BusSuite
from vertebra.testing.ports import free_tcp_port


class TestMemoryBus(BusSuite):
    async def buses(self) -> AsyncIterator[tuple[Bus, Bus]]:
        network = MemoryNetwork()
        here, there = MemoryBus(network), MemoryBus(network)
        yield here, there
        await here.close()
        await there.close()


class TestZenohBus(BusSuite):
    shared_memory = False

    async def buses(self) -> AsyncIterator[tuple[Bus, Bus]]:
        locator = f"tcp/127.0.0.1:{free_tcp_port()}"
        with running_router([locator]):
            here = await ZenohBus.open(locator, shared_memory=self.shared_memory, timeout_s=5)
            there = await ZenohBus.open(locator, shared_memory=self.shared_memory, timeout_s=5)
            yield here, there
            await here.close()
            await there.close()


class TestZenohBusWithSharedMemory(TestZenohBus):
    shared_memory = True
