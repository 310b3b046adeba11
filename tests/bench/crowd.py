"""Two hundred connections of one YARP port at 50 Hz, for the bench and for the live lane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from .peers.peer import Stream
from .processes import Exchange, Pair, name_server

SIZE: Final = 200
RATE_HZ: Final = 50.0
NBYTES: Final = 56
"""In a bottle of 64."""


@dataclass(slots=True)
class Crowded:
    """What came of it, and what it cost the process of the one port."""

    exchange: Exchange
    cpu: float
    resident_bytes: int


async def crowd(direction: Literal["in", "out"], seconds: float) -> Crowded:
    """Let 200 write to one port, or read from it."""
    async with name_server() as endpoint:
        stream = Stream(endpoint=endpoint, dtype="|u1", shape=(SIZE, NBYTES), option=direction)
        async with Pair.of("yarp_crowd", stream) as pair:
            one = pair.sender if direction == "out" else pair.receiver
            cpu_s = one.cpu_s()
            exchange = await pair.exchange(round(seconds * RATE_HZ), rate_hz=RATE_HZ)
            cpu = (one.cpu_s() - cpu_s) / seconds
            return Crowded(exchange, cpu, one.resident_bytes())
