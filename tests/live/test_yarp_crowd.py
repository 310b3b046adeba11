"""Two hundred connections of one YARP port at 50 Hz lose nothing; the bench says what they cost."""

from __future__ import annotations

from typing import Literal

import pytest

from ..bench.crowd import RATE_HZ, SIZE, crowd  # noqa: TID252 -- tests are no package that is installed

SECONDS = 3.0


@pytest.mark.parametrize("direction", ["out", "in"])
async def test_strict_connections_lose_nothing(direction: Literal["in", "out"]) -> None:
    exchange = (await crowd(direction, SECONDS)).exchange
    assert exchange.sent == SIZE * RATE_HZ * SECONDS
    assert exchange.lost == 0
