"""The backbone: Zenoh, and its twin in memory, behind one interface."""

from vertebra.bus.interface import (
    Bus,
    BusInfo,
    Closeable,
    Gatherable,
    Handler,
    OnWanted,
    Payload,
    PresenceEvent,
    Priority,
    Publisher,
    Reply,
    Request,
)
from vertebra.bus.links import DEFAULT_ROUTER
from vertebra.bus.memory_bus import MemoryBus, MemoryNetwork
from vertebra.bus.sample import Delivery, Sample
from vertebra.bus.subscription import Subscription
from vertebra.bus.zenoh_bus import ZenohBus

__all__ = [
    "DEFAULT_ROUTER",
    "Bus",
    "BusInfo",
    "Closeable",
    "Delivery",
    "Gatherable",
    "Handler",
    "MemoryBus",
    "MemoryNetwork",
    "OnWanted",
    "Payload",
    "PresenceEvent",
    "Priority",
    "Publisher",
    "Reply",
    "Request",
    "Sample",
    "Subscription",
    "ZenohBus",
]
