"""A node in a process of its own, so that it can be stopped or killed.

It copies the topic `/member/in` to `/member/out`, answers at the service `/member/echo`, prints
"ready", and leaves when its input ends.
"""

from __future__ import annotations

import asyncio
import sys

import msgspec

from vertebra.ros2.definitions import Types
from vertebra.ros2.driver import Participation
from vertebra.ros2.drivers import DriverName, open_driver
from vertebra.ros2.qos import Qos

TEXT = "std_msgs/msg/String"
ECHO = "std_srvs/srv/Empty"


class Place(msgspec.Struct, frozen=True):
    """Which driver, and as which node it takes part."""

    driver: DriverName
    part: Participation


async def live(place: Place) -> None:
    """Be the node until the input ends."""

    async def echo(request: bytes) -> bytes:
        return request

    async with open_driver(place.driver, place.part, Types.standard()) as transport:
        out = transport.writer("/member/out", TEXT, Qos(depth=100))
        transport.reader("/member/in", TEXT, Qos(depth=100), lambda it, _: out.write(it))
        transport.server("/member/echo", ECHO, echo)
        sys.stdout.write("ready\n")
        sys.stdout.flush()
        await asyncio.to_thread(sys.stdin.read)


if __name__ == "__main__":
    asyncio.run(live(msgspec.json.decode(sys.argv[1], type=Place)))
