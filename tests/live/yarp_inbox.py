"""What tests of YARP ports let a port do with what comes."""

from __future__ import annotations

from vertebra.testing.bus_suite import eventually
from vertebra.yarp import Incoming, Value


class Inbox:
    """Takes messages and lets a test wait for them."""

    def __init__(self) -> None:
        self.got: list[Incoming] = []

    def __call__(self, incoming: Incoming) -> None:
        self.got.append(incoming)

    async def wait(self, count: int) -> list[Incoming]:
        await eventually(lambda: len(self.got) >= count)
        return self.got

    @property
    def bottles(self) -> list[list[Value]]:
        return [incoming.bottle() for incoming in self.got]


async def echo(incoming: Incoming) -> list[Value]:
    return incoming.bottle()
