"""A YARP port in a process of its own, which a test can kill: `yarp_peer.py ROLE NAME TCP_PORT`.

Roles: `write` sends [number] a thousand times per second, `read` counts what it gets, `serve` is
the name server itself. Prints `ready` when its port is registered at the name server on TCP_PORT,
for which it waits.
"""

from __future__ import annotations

import asyncio
import itertools
import sys

from vertebra.errors import NotConnectedError
from vertebra.yarp import NameClient, NameServer, Port, encode


async def open_port(role: str, name: str, tcp_port: int) -> Port | NameServer:
    if role == "serve":
        return await NameServer.start(tcp_port=tcp_port)
    names = NameClient("127.0.0.1", tcp_port)
    while True:
        try:
            return await Port.open(name, names, on_data=lambda _: None)
        except NotConnectedError:
            await asyncio.sleep(0.1)


async def main(role: str, name: str, tcp_port: int) -> None:
    async with await open_port(role, name, tcp_port) as port:
        sys.stdout.write("ready\n")
        sys.stdout.flush()
        for number in itertools.count():
            if role == "write" and isinstance(port, Port):
                port.write(encode([number]), envelope=f"{number} 0.5")
            await asyncio.sleep(0.001)


asyncio.run(main(sys.argv[1], sys.argv[2], int(sys.argv[3])))
