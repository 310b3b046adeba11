"""Typed streams: bad samples are refused and told, the stream lives on."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest

from vertebra.bus import Delivery, MemoryBus, Sample
from vertebra.codec import CodecRegistry
from vertebra.errors import CodecNotFoundError, DecodeError, EncodeError, NotConnectedError
from vertebra.messages import Header, Imu, Text
from vertebra.service import MessagePublisher, MessageReader


@pytest.fixture
async def bus() -> AsyncIterator[MemoryBus]:
    bus = MemoryBus()
    yield bus
    await bus.close()


async def test_bad_samples_are_refused_counted_and_logged_once(
    bus: MemoryBus, caplog: pytest.LogCaptureFixture
) -> None:
    raw = bus.publisher("a/words", encoding="")
    words = MessagePublisher(bus, CodecRegistry(), "a/words")
    samples = bus.subscribe("a/*", Delivery.queue(10))
    reader = MessageReader(samples, CodecRegistry(), Text)
    words.publish(Text(text="one"))
    raw.put(b"VTB\x01rubbish", encoding="application/vnd.vertebra.frame;Text/1")
    raw.put(b"?", encoding="application/x-unknown")
    MessagePublisher(bus, CodecRegistry(), "a/words").publish(Imu())
    words.publish(Text(text="two"))
    samples.close()
    assert [received.message.text async for received in reader] == ["one", "two"]
    assert reader.refused == 3
    assert reader.refusal == "a/words: Text was expected, Imu arrived"
    errors = [record.getMessage() for record in caplog.records if record.levelname == "ERROR"]
    assert len(errors) == 1
    assert errors[0].startswith("refused sample 1 of a/words: ")


async def test_an_encoding_without_header_takes_the_time_of_sending(bus: MemoryBus) -> None:
    reader = MessageReader(bus.subscribe("a", Delivery.latest()), CodecRegistry(), Text)
    sample = Sample(key="a", payload=b"hello", encoding="text/plain", sent_ns=99)
    assert reader.read(sample).header == Header(captured_ns=99)


async def test_read_raises_what_is_wrong(bus: MemoryBus) -> None:
    reader = MessageReader(bus.subscribe("a", Delivery.latest()), CodecRegistry(), Text)
    with pytest.raises(DecodeError):
        reader.read(Sample(key="a", payload=b"\xff", encoding="text/plain"))
    with pytest.raises(CodecNotFoundError):
        reader.read(Sample(key="a", payload=b"", encoding=""))


async def test_a_message_without_a_form_is_refused_and_not_numbered(bus: MemoryBus) -> None:
    async with bus.subscribe("a", Delivery.queue(2)) as samples:
        publisher = MessagePublisher(bus, CodecRegistry(), "a", encoding="text/plain")
        with pytest.raises(EncodeError):
            publisher.publish(Imu())
        publisher.publish(Text(text="fine"))
        sample = await asyncio.wait_for(anext(samples), 5)
    assert (sample.payload, sample.encoding) == (b"fine", "text/plain")


async def test_a_closed_bus_refuses(bus: MemoryBus) -> None:
    publisher = MessagePublisher(bus, CodecRegistry(), "a")
    await bus.close()
    with pytest.raises(NotConnectedError):
        publisher.publish(Text(text="late"))
    publisher.close()
