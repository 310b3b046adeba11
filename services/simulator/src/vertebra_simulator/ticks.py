"""What happens again and again, in real time."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable


async def ticks(rate_hz: float, skipped: Callable[[int], None]) -> AsyncIterator[int]:
    """Yield the number of each tick when it is due, without drift; `skipped` counts late ones."""
    began_s = time.monotonic()
    count = 0
    while True:
        count += 1
        late = int((time.monotonic() - began_s) * rate_hz) - count
        if late > 0:
            skipped(late)
            count += late
        await asyncio.sleep(began_s + count / rate_hz - time.monotonic())
        yield count
