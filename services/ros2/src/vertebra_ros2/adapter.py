"""The adapter: which routes there are now, and how they come and go."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Sequence
from typing import Final

from vertebra.bus import Closeable, Reply, Request
from vertebra.errors import CodecError, ConfigError
from vertebra.ros2.definitions import Types
from vertebra.ros2.driver import Transport
from vertebra.ros2.drivers import Participation, open_driver
from vertebra.ros2.names import MIRROR_PREFIX, key_of, name_of
from vertebra.service import Context
from vertebra.service.routes import follow_routes, read_routes
from vertebra_ros2.action_servers import OutboundAction
from vertebra_ros2.actions import InboundAction
from vertebra_ros2.carried import Carried, Kit
from vertebra_ros2.routes import KINDS, Action, AnyRoute, Topic
from vertebra_ros2.services import Clients, InboundService, OutboundService
from vertebra_ros2.settings import Ros2Settings
from vertebra_ros2.topics import InboundTopic, OutboundTopic

log = logging.getLogger(__name__)

LOOK_EVERY_S: Final = 2.0
LOOK_AT_MOST_EVERY_S: Final = 0.05


async def serve(context: Context[Ros2Settings]) -> None:
    """Carry routes until cancelled."""
    settings = context.settings
    types = await asyncio.to_thread(Types.standard, *settings.types)
    part = Participation(
        domain_id=settings.domain_id,
        node=settings.node,
        namespace=settings.namespace,
        interface="" if settings.interface == "auto" else settings.interface,
        peers=settings.peers,
    )
    async with open_driver(settings.driver, part, types) as transport:
        adapter = Adapter(context, transport, types)
        try:
            await adapter.carry(read_routes(settings.routes, KINDS))
            context.ready()
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(_end_with(transport))
                tasks.create_task(adapter.follow_graph())
                if settings.routes is not None:
                    tasks.create_task(follow_routes(context, settings.routes, KINDS, adapter.carry))
        finally:
            await adapter.close()


async def _end_with(transport: Transport) -> None:
    await transport.failed


class Adapter:
    """All routes that are carried now, and how they come and go."""

    def __init__(self, context: Context[Ros2Settings], transport: Transport, types: Types) -> None:
        self.context = context
        self._kit = Kit(context, transport, types)
        self._graph = transport.graph
        self._clients = Clients(self._kit)
        self._explicit: dict[AnyRoute, Carried] = {}
        self._mirrored: dict[str, InboundTopic] = {}
        self._changed = asyncio.Event()
        transport.on_graph(self._changed.set)
        self._served_mirror: Closeable | None = None
        if context.settings.automatic:
            self._served_mirror = context.bus.serve(f"{MIRROR_PREFIX}/**", self._call_mirrored)

    async def carry(self, wanted: Sequence[AnyRoute]) -> None:
        """Carry exactly these explicit routes: those that stay are not touched.

        Raises:
            ConfigError: A route names a type that is not known.
        """
        for route in [route for route in self._explicit if route not in wanted]:
            await self._explicit.pop(route).close()
            self.context.routes.pop(route.ros, None)
        for route in wanted:
            if route in self._explicit:
                continue
            mirrored = self._mirrored.pop(route.ros, None)
            if mirrored is not None:
                await mirrored.close()
            try:
                self._explicit[route] = self._make(route)
            except CodecError as error:
                raise ConfigError(f"the route of {route.ros}: {error}") from error
            self.context.routes[route.ros] = route.key
            log.info("route %s <-> %s", route.ros, route.key)
        self._changed.set()

    def _make(self, route: AnyRoute) -> Carried:
        if isinstance(route, Topic):
            return (InboundTopic if route.direction == "inbound" else OutboundTopic)(
                self._kit, route
            )
        if isinstance(route, Action):
            if route.direction == "outbound":
                return OutboundAction(self._kit, route)
            return InboundAction(self._kit, route, self._clients)
        if route.direction == "inbound":
            return InboundService(self._kit, route, self._clients)
        return OutboundService(self._kit, route)

    async def follow_graph(self) -> None:
        """Do what changes of the ROS graph make necessary, many at a time."""
        while True:
            await self._look()
            await asyncio.sleep(LOOK_AT_MOST_EVERY_S)  # what comes meanwhile is looked at once
            try:
                async with asyncio.timeout(LOOK_EVERY_S):
                    await self._changed.wait()
            except TimeoutError:
                continue  # also without news: what was dropped, which QoS does not match
            finally:
                self._changed.clear()

    async def _look(self) -> None:
        if self.context.settings.automatic:
            await self._mirror()
        self._clients.look()
        for carried in [*self._explicit.values(), *self._mirrored.values()]:
            carried.look()
        problems = {
            name: service.problem
            for name, service in self._graph.services().items()
            if service.problem
        }
        text = ""
        if problems:
            name, problem = next(iter(problems.items()))
            text = f"{len(problems)} cannot be called, among them {name}: {problem}"
        self._kit.report("ROS services", text)

    async def _mirror(self) -> None:
        claimed = {route.ros for route in self._explicit if isinstance(route, Topic)}
        wanted = {
            name for name in self._graph.topics() if self._graph.writers(name)
        } - claimed  # fmt: skip
        for name in self._mirrored.keys() - wanted:
            await self._mirrored.pop(name).close()
            self.context.routes.pop(name, None)
        for name in wanted - self._mirrored.keys():
            route = Topic(ros=name, key=key_of(name))
            self._mirrored[name] = InboundTopic(self._kit, route)
            self.context.routes[name] = route.key

    async def _call_mirrored(self, request: Request) -> Reply:
        return await self._clients.call(name_of(request.key), "", request)

    async def close(self) -> None:
        """End all routes."""
        if self._served_mirror is not None:
            self._served_mirror.close()
        for carried in [*self._explicit.values(), *self._mirrored.values()]:
            await carried.close()
        self._clients.close()
