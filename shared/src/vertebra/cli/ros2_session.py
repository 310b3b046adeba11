"""Our participant in the ROS graph, for the parts of `vertebra ros2`."""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from typing import Any, Final, TypeVar

from vertebra.cli.backbone import as_yaml, readable
from vertebra.errors import NotConnectedError
from vertebra.messages import Native
from vertebra.ros2.cdr import Cdr
from vertebra.ros2.definitions import Types
from vertebra.ros2.driver import Participation, Transport
from vertebra.ros2.drivers import open_driver

_OPEN_WITHIN_S: Final = 3.0
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Session:
    """Our participant, and what reads and writes its messages."""

    transport: Transport
    types: Types
    cdr: Cdr
    arguments: argparse.Namespace

    async def until(self, find: Callable[[], T | None]) -> T:
        """Return what `find` finds in the graph, when it is there."""
        changed = asyncio.Event()
        self.transport.on_graph(changed.set)
        while not (found := find()):
            changed.clear()
            await changed.wait()
        return found

    async def type_of(self, name: str) -> str:
        """Return the type of a service; raise `NotConnectedError` if it cannot be called."""
        try:
            async with asyncio.timeout(self.arguments.wait):
                service = await self.until(lambda: self.transport.graph.service(name))
        except TimeoutError as error:
            raise NotConnectedError(f"nobody offers the ROS service {name}") from error
        if service.problem:
            raise NotConnectedError(f"the ROS service {name}: {service.problem}")
        return service.type

    async def call(
        self, name: str, fields: Mapping[str, Any], *, timeout_s: float, type_name: str = ""
    ) -> dict[str, Any]:
        """Call a service, of the type that its servers say unless it is given."""
        type_name = type_name or await self.type_of(name)
        payload = self.cdr.encode(fields, f"{type_name}_Request")
        client = self.transport.client(name, type_name)
        try:
            answer = await client.call(payload, timeout_s=timeout_s)
        finally:
            client.close()
        return self.cdr.decode(answer, f"{type_name}_Response")


@asynccontextmanager
async def opened(arguments: argparse.Namespace) -> AsyncIterator[Session]:
    """Be a node while the block runs; raise `NotConnectedError` if the driver finds nobody."""
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


def text_of(record: Mapping[str, Any]) -> str:
    """Return a record as YAML."""
    return as_yaml(readable(Native(value=record))["value"])
