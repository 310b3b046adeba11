"""What the parts of `vertebra ros2` do."""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from typing import Any, Final, TypeVar

from vertebra.cli.backbone import as_yaml, readable, table
from vertebra.errors import CodecError, ConfigError, NotConnectedError
from vertebra.messages import Native
from vertebra.ros2.cdr import Cdr
from vertebra.ros2.definitions import Types
from vertebra.ros2.driver import Transport
from vertebra.ros2.drivers import Participation, open_driver
from vertebra.ros2.graph import Endpoint
from vertebra.ros2.names import check_name, check_type
from vertebra.ros2.qos import Qos, for_reader

_ACTION: Final = "/_action/send_goal"
_ECHO_DEPTH: Final = 100
_OPEN_WITHIN_S: Final = 3.0
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Session:
    """Our participant, and what reads and writes its messages."""

    transport: Transport
    types: Types
    cdr: Cdr
    arguments: argparse.Namespace


async def run(tool: str, arguments: argparse.Namespace) -> int:
    """Do one part; return the exit status."""
    async with _session(arguments) as session:
        return await _TOOLS[tool](session)


@asynccontextmanager
async def _session(arguments: argparse.Namespace) -> AsyncIterator[Session]:
    types = await asyncio.to_thread(Types.standard, *arguments.types)
    part = Participation(
        domain_id=arguments.domain,
        node="vertebra_tool",
        interface="" if arguments.interface == "auto" else arguments.interface,
        peers=tuple(arguments.peer),
        router=arguments.router,
    )
    async with AsyncExitStack() as stack:
        try:
            async with asyncio.timeout(_OPEN_WITHIN_S):
                driver = open_driver(arguments.driver, part, types)
                transport = await stack.enter_async_context(driver)
        except TimeoutError as error:
            raise NotConnectedError(
                f"no Zenoh router answers at {arguments.router}; start the fleet with ./vertebra "
                "up, or name the router of the ROS nodes with --router"
            ) from error
        yield Session(transport, types, Cdr(types), arguments)


async def _topics(session: Session) -> int:
    await asyncio.sleep(session.arguments.wait)  # nobody tells when all have been found
    graph = session.transport.graph
    rows = [("TOPIC", "TYPE", "PUBLISHERS", "SUBSCRIBERS")]
    rows += [
        (name, " ".join(sorted(types)), _nodes(session, graph.writers(name)),
         _nodes(session, graph.readers(name)))
        for name, types in graph.topics().items()
    ]  # fmt: skip
    print(table(rows))
    return 0


def _nodes(session: Session, endpoints: list[Endpoint]) -> str:
    names = (session.transport.graph.node_of(one) or "?" for one in endpoints)
    return " ".join(sorted(names)) or "-"


async def _services(session: Session) -> int:
    await asyncio.sleep(session.arguments.wait)
    services = session.transport.graph.services()
    rows = [("SERVICE", "TYPE", "")]
    rows += [(name, one.type or "?", one.problem) for name, one in services.items()]
    print(table(rows))
    return 0


async def _actions(session: Session) -> int:
    await asyncio.sleep(session.arguments.wait)
    rows = [("ACTION", "TYPE", "")]
    rows += [
        (name.removesuffix(_ACTION), one.type.removesuffix("_SendGoal"), one.problem)
        for name, one in session.transport.graph.services().items()
        if name.endswith(_ACTION)
    ]
    print(table(rows))
    return 0


async def _echo(session: Session) -> int:
    name, left = check_name(session.arguments.name), session.arguments.n
    graph = session.transport.graph
    writers = await _until(session, lambda: graph.writers(name))
    type_name = session.arguments.type or writers[0].type
    session.types.definition(type_name)
    payloads: asyncio.Queue[bytes] = asyncio.Queue()
    reader = session.transport.reader(
        name,
        type_name,
        for_reader((one.qos for one in writers), _ECHO_DEPTH),
        lambda payload, _: payloads.put_nowait(payload),
    )
    while left is None or left > 0:
        payload = await payloads.get()
        try:
            print(f"---\n{_text(session.cdr.decode(payload, type_name))}", flush=True)
        except CodecError as error:
            print(f"--- {error}", flush=True)
        left = None if left is None else left - 1
    reader.close()
    return 0


def _text(record: dict[str, Any]) -> str:
    plain = readable(Native(value=record))["value"]
    return as_yaml(plain)


async def _pub(session: Session) -> int:
    arguments = session.arguments
    if arguments.rate is not None and arguments.rate <= 0:
        raise ConfigError(f"a rate is more than 0 Hz, not {arguments.rate:g}")
    type_name = check_type(arguments.type)
    payload = session.cdr.encode(arguments.fields, type_name)
    name = check_name(arguments.name)
    writer = session.transport.writer(name, type_name, Qos(durability="transient_local", depth=1))
    if arguments.rate is None:
        try:
            async with asyncio.timeout(arguments.wait):
                await writer.matched()
        except TimeoutError as error:
            raise NotConnectedError(
                f"nobody subscribes to {name}; wait longer with --wait, or publish with --rate"
            ) from error
        writer.write(payload)
        await writer.delivered(arguments.wait)
        return 0
    while True:
        writer.write(payload)
        await asyncio.sleep(1 / arguments.rate)


async def _until(session: Session, find: Callable[[], T | None]) -> T:
    """Return what `find` finds in the graph, when it is there."""
    changed = asyncio.Event()
    session.transport.on_graph(changed.set)
    while not (found := find()):
        changed.clear()
        await changed.wait()
    return found


async def _call(session: Session) -> int:
    arguments = session.arguments
    name = check_name(arguments.name)
    type_name = check_type(arguments.type) if arguments.type else await _type_of(session, name)
    payload = session.cdr.encode(arguments.fields, f"{type_name}_Request")
    client = session.transport.client(name, type_name)
    answer = await client.call(payload, timeout_s=arguments.timeout)
    print(_text(session.cdr.decode(answer, f"{type_name}_Response")))
    client.close()
    return 0


async def _type_of(session: Session, name: str) -> str:
    try:
        async with asyncio.timeout(session.arguments.wait):
            service = await _until(session, lambda: session.transport.graph.service(name))
    except TimeoutError as error:
        raise NotConnectedError(f"nobody offers the ROS service {name}") from error
    if service.problem:
        raise NotConnectedError(f"the ROS service {name}: {service.problem}")
    return service.type


_TOOLS: Final[dict[str, Callable[[Session], Awaitable[int]]]] = {
    "topics": _topics,
    "services": _services,
    "actions": _actions,
    "echo": _echo,
    "pub": _pub,
    "call": _call,
}
