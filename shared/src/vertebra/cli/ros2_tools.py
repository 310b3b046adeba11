"""What the parts of `vertebra ros2` do."""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import Awaitable, Callable
from typing import Final

from vertebra.cli.backbone import table
from vertebra.cli.ros2_goals import send_goal
from vertebra.cli.ros2_parameters import get_parameters, list_parameters, set_parameter
from vertebra.cli.ros2_session import Session, opened, text_of
from vertebra.errors import CodecError, ConfigError, NotConnectedError
from vertebra.ros2.graph import Endpoint
from vertebra.ros2.names import check_name, check_type
from vertebra.ros2.qos import Qos, for_reader

_ACTION: Final = "/_action/send_goal"
_ECHO_DEPTH: Final = 100


async def run(tool: str, arguments: argparse.Namespace) -> int:
    """Do one part; return the exit status."""
    async with opened(arguments) as session:
        return await _TOOLS[tool](session)


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
    writers = await session.until(lambda: graph.writers(name))
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
            print(f"---\n{text_of(session.cdr.decode(payload, type_name))}", flush=True)
        except CodecError as error:
            print(f"--- {error}", flush=True)
        left = None if left is None else left - 1
    reader.close()
    return 0


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


async def _call(session: Session) -> int:
    arguments = session.arguments
    type_name = check_type(arguments.type) if arguments.type else ""
    answer = await session.call(
        check_name(arguments.name),
        arguments.fields,
        timeout_s=arguments.timeout,
        type_name=type_name,
    )
    print(text_of(answer))
    return 0


_TOOLS: Final[dict[str, Callable[[Session], Awaitable[int]]]] = {
    "topics": _topics,
    "services": _services,
    "actions": _actions,
    "echo": _echo,
    "pub": _pub,
    "call": _call,
    "send_goal": send_goal,
    "param_list": list_parameters,
    "param_get": get_parameters,
    "param_set": set_parameter,
}
