"""The template is a whole service."""

from __future__ import annotations

import asyncio

from vertebra.bus import Delivery, MemoryBus, MemoryNetwork
from vertebra.codec import CodecRegistry
from vertebra.messages import JointState, Text
from vertebra.service import MessagePublisher, MessageReader, run_service
from vertebra_template.adapter import serve
from vertebra_template.settings import TemplateSettings


async def test_names_are_greeted_and_rubbish_is_refused() -> None:
    network = MemoryNetwork()
    bus, codecs = MemoryBus(network), CodecRegistry()
    greetings = MessageReader(bus.subscribe("template/greetings", Delivery.queue(4)), codecs, Text)
    names = MessagePublisher(bus, codecs, "template/names")
    service = asyncio.create_task(
        run_service("template", TemplateSettings(), serve, bus=MemoryBus(network))
    )
    async with asyncio.timeout(5), bus.presence("@vertebra/services/template/*/alive") as present:
        await anext(present)
        bus.publisher("template/names", encoding="image/jpeg").put(b"no name")
        names.publish(JointState(names=(), positions_deg=()))
        names.publish(Text(text=" Ada "), captured_ns=42)
        received = await anext(aiter(greetings))
    assert received.message == Text(text="Hello, Ada!")
    assert received.header.captured_ns == 42
    service.cancel()
    await asyncio.wait([service])
    await bus.close()
