"""`yarp read`, `write` and `rpc`: bottles as lines of text on standard output and input."""

from __future__ import annotations

import argparse
import asyncio
import os
import sys
import threading
from collections.abc import AsyncIterator, Iterator
from typing import Final

from vertebra.errors import ConfigError, NotConnectedError
from vertebra.yarp.naming.addresses import address_towards
from vertebra.yarp.naming.names import CHOOSE_FOR_ME, NameClient
from vertebra.yarp.ports.client import RpcClient
from vertebra.yarp.ports.connections import connect
from vertebra.yarp.ports.incoming import Incoming, OnData
from vertebra.yarp.ports.port import Port
from vertebra.yarp.protocol.bottle import Value, Vocab, encode
from vertebra.yarp.protocol.text import from_text, to_text

_READ_AHEAD_LINES: Final = 64
_WAITING_MESSAGES: Final = 1000
_LOOK_AGAIN_S: Final = 0.01
_RESENDS: Final = 3
_EVERYWHERE: Final = "0.0.0.0"  # noqa: S104 -- only where the user has set YARP_IP


# --- read ---


async def read(arguments: argparse.Namespace, names: NameClient) -> int:
    """Print bottles as they arrive."""
    options = {"envelope", "once"} & {*arguments.words}
    sources = [word for word in arguments.words if word not in options]
    over = asyncio.Event()

    def show(incoming: Incoming) -> None:
        if not over.is_set():
            is_last = _show(incoming, with_envelope="envelope" in options)
            if is_last or "once" in options:
                over.set()

    async with await _open(arguments.port, names, show) as port:
        for source in sources:
            await connect(names, source, port.name)
        await over.wait()
    return 0


def _show(incoming: Incoming, *, with_envelope: bool) -> bool:
    """Print a message; return whether it ends the stream."""
    values = incoming.bottle()
    text = to_text(values)
    match values:
        case [int() as code, str() as line] if not isinstance(line, Vocab):
            # What `yarp write` sends when it is told to write verbatim.
            if code == 1:
                return True
            text = line
    print(f"{_stamp(incoming.envelope)}     {text}" if with_envelope else text, flush=True)
    return False


def _stamp(envelope: str) -> str:
    match from_text(envelope):
        case [int() as count, float() as time_s]:
            return f"{count} {time_s:.4f}"
        case values:
            return to_text(values)


# --- write ---


async def write(arguments: argparse.Namespace, names: NameClient) -> int:
    """Send lines of standard input as bottles, none of them dropped."""
    async with await _open(arguments.port, names) as port:
        for target in arguments.targets:
            carrier, _, name = target.rpartition(":/")
            await connect(names, port.name, name, carrier or "tcp")
        handed_over = 0
        async for line in _lines_of_stdin():
            handed_over += len(port.outputs)
            port.write(encode(from_text(line)))
            await _until_at_most(_WAITING_MESSAGES, port, handed_over)
        await _until_at_most(0, port, handed_over)
    return 0


async def _until_at_most(waiting: int, port: Port, handed_over: int) -> None:
    while port.outputs:
        sent = port.sent
        if handed_over - sent.messages - sent.refused <= waiting:
            return
        await asyncio.sleep(_LOOK_AGAIN_S)


# --- rpc ---


async def rpc(arguments: argparse.Namespace, names: NameClient) -> int:
    """Call a port with each line of standard input and print the replies."""
    client = await RpcClient.connect(arguments.port, names)
    try:
        async for line in _lines_of_stdin():
            for attempt in range(_RESENDS + 1):
                try:
                    reply = await _call(client, from_text(line), arguments)
                except NotConnectedError:
                    if attempt == _RESENDS:
                        raise
                    print("Target disappeared, reconnecting...", file=sys.stderr)
                    client = await RpcClient.connect(arguments.port, names)
                else:
                    _show_reply(reply)
                    break
    finally:
        await client.close()
    return 0


async def _call(
    client: RpcClient, request: list[Value], arguments: argparse.Namespace
) -> list[Value]:
    ask = client.administer if arguments.admin else client.call
    return await ask(request, timeout_s=arguments.timeout)


def _show_reply(reply: list[Value]) -> None:
    if reply[:1] != [Vocab("many")]:
        print(f"Response: {to_text(reply)}", flush=True)
        return
    lines = reply[1] if len(reply) == 2 and isinstance(reply[1], list) else reply[1:]
    print("Responses:")
    for line in lines:
        text = (
            line if isinstance(line, str) else to_text(line if isinstance(line, list) else [line])
        )
        print(f"  {text}", flush=True)


# --- both ---


async def _open(name: str, names: NameClient, on_data: OnData | None = None) -> Port:
    """Open a port where those who reach the name server reach it, too."""
    if name != CHOOSE_FOR_ME and await names.exists(name):
        raise ConfigError(f"port {name} already exists; take another name, or ... for any")
    bind_host = _EVERYWHERE if os.environ.get("YARP_IP") else address_towards(names.host)
    port = await Port.open(
        name,
        names,
        on_data=on_data,
        delivery="queue",
        depth=2 * _WAITING_MESSAGES,
        bind_host=bind_host,
    )
    where = port.contact
    print(f"Port {port.name} active at tcp://{where.host}:{where.tcp_port}/", file=sys.stderr)
    return port


async def _lines_of_stdin() -> AsyncIterator[str]:
    """Yield lines until the end of standard input, be it a file, a pipe or a terminal."""
    loop = asyncio.get_running_loop()
    lines: asyncio.Queue[str | None] = asyncio.Queue()
    room = threading.Semaphore(_READ_AHEAD_LINES)

    def pump() -> None:
        # In a thread: files cannot be waited for. A daemon: nothing ends the read of a terminal.
        for line in _split_lines():
            room.acquire()
            try:
                loop.call_soon_threadsafe(lines.put_nowait, line)
            except RuntimeError:  # the command has ended
                return

    threading.Thread(target=pump, name="stdin", daemon=True).start()
    while (line := await lines.get()) is not None:
        room.release()
        if line.strip():
            yield line


def _split_lines() -> Iterator[str | None]:
    rest = b""
    while chunk := os.read(sys.stdin.fileno(), 65536):
        *lines, rest = (rest + chunk).split(b"\n")
        for raw in lines:
            yield raw.decode("utf-8", "surrogateescape")
    yield rest.decode("utf-8", "surrogateescape")
    yield None
