"""A YARP port in a process of its own, which a test can kill: `yarp_peer.py ROLE NAME TCP_PORT`.

Roles: `write` sends [number] a thousand times per second, `read` counts what it gets. Prints
`ready` when its port is registered at the name server on TCP_PORT.
"""

from __future__ import annotations

import asyncio
import itertools
import sys

from vertebra.yarp import NameClient, Port, encode


async def main(role: str, name: str, tcp_port: int) -> None:
    async with await Port.open(
        name, NameClient("127.0.0.1", tcp_port), on_data=lambda _: None
    ) as port:
        sys.stdout.write("ready\n")
        sys.stdout.flush()
        for number in itertools.count():
            if role == "write":
                port.write(encode([number]), envelope=f"{number} 0.5")
            await asyncio.sleep(0.001)


asyncio.run(main(sys.argv[1], sys.argv[2], int(sys.argv[3])))
