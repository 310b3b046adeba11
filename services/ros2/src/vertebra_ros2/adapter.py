"""The adapter: which routes there are now, and how they come and go."""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections.abc import Mapping, Sequence
from typing import Final

from vertebra.errors import CodecError, ConfigError, TransportError
from vertebra.ros2.definitions import Types
from vertebra.ros2.driver import Participation, Transport
from vertebra.ros2.drivers import open_driver
from vertebra.service import Context
from vertebra.service.routes import follow_routes, read_routes
from vertebra_ros2.action_servers import OutboundAction
from vertebra_ros2.actions import InboundAction
from vertebra_ros2.bases import DrivenBase
from vertebra_ros2.carried import Carried, Kit
from vertebra_ros2.humans import OutboundHumans
from vertebra_ros2.mirror import Mirror
from vertebra_ros2.parameter_server import ParameterServer
from vertebra_ros2.parameters import InboundParameters
from vertebra_ros2.routes import KINDS, Action, AnyRoute, Base, Humans, Parameters, Topic
from vertebra_ros2.services import Clients, InboundService, OutboundService
from vertebra_ros2.settings import Ros2Settings
from vertebra_ros2.topics import InboundTopic, OutboundTopic
from vertebra_ros2.turns import Claim, Turns

log = logging.getLogger(__name__)

LOOK_EVERY_S: Final = 2.0
LOOK_AT_MOST_EVERY_S: Final = 0.05
FIND_WITHIN_S: Final = 5.0
"""So long two participants of one ROS domain take at most to find each other."""


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
        router=settings.zenoh_router or settings.router,
    )
    async with open_driver(settings.driver, part, types) as transport:
        adapter = Adapter(context, transport, types)
        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(_end_with(transport))
                tasks.create_task(adapter.follow_turns())
                await adapter.carry(read_routes(settings.routes, KINDS))
                context.ready()
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
        self._parameters = ParameterServer(self._kit)
        self._wanted: tuple[AnyRoute, ...] = ()
        self._explicit: dict[AnyRoute, Carried] = {}
        self._refused: set[AnyRoute] = set()
        self._changed = asyncio.Event()
        transport.on_graph(self._changed.set)
        self._apart_since_s = math.inf
        settings = context.settings
        self._turns = Turns(
            context.bus, settings.domain_id, transport.participant, self._changed.set
        )
        self._mirror = Mirror(self._kit, self._clients, self._turns) if settings.automatic else None

    async def follow_turns(self) -> None:
        """Hear of other adapters; runs until cancelled."""
        await self._turns.follow()

    async def carry(self, wanted: Sequence[AnyRoute]) -> None:
        """Carry exactly these explicit routes, as far as no other adapter of this domain does.

        Raises:
            ConfigError: A route names a type that is not known.
        """
        for route in wanted:
            try:
                for name in route.needs:
                    self._kit.types.definition(name)
            except CodecError as error:
                raise ConfigError(f"the route of {route.ros}: {error}") from error
        self._wanted = tuple(wanted)
        for route in self._refused - set(wanted):
            self._refused.remove(route)
            self._kit.report(f"route {route.ros}", "")
        works = list(map(self._work, wanted))
        if self._mirror is not None:
            works.append(self._mirror.work)
            for route in wanted:
                await self._mirror.drop(route.ros)
        await self._turns.claim(works)
        await self._take_turns()

    def _work(self, route: AnyRoute) -> str:
        return f"{' and '.join(route.claims)} in domain {self.context.settings.domain_id}"

    async def _take_turns(self) -> None:
        """Begin the explicit routes that are ours now and end those that are not."""
        others = self._turns.others()
        self._graph.ignore(others)
        self._tell_apart(others)
        ours = [route for route in self._wanted if self._turns.is_ours(self._work(route))]
        for route in [route for route in self._explicit if route not in ours]:
            await self._explicit.pop(route).close()
            self.context.routes.pop(route.ros, None)
        for route in ours:
            if route in self._explicit or route in self._refused:
                continue
            try:
                self._explicit[route] = self._make(route)
            except TransportError as error:  # a ROS without this type: the other routes live on
                self._refused.add(route)
                self._kit.report(f"route {route.ros}", str(error))
                continue
            self.context.routes[route.ros] = route.key
            log.info("route %s <-> %s", route.ros, route.key)

    def _make(self, route: AnyRoute) -> Carried:
        if isinstance(route, Topic):
            return (InboundTopic if route.direction == "inbound" else OutboundTopic)(
                self._kit, route
            )
        if isinstance(route, Action):
            if route.direction == "outbound":
                return OutboundAction(self._kit, route)
            return InboundAction(self._kit, route, self._clients)
        if isinstance(route, Parameters):
            return InboundParameters(self._kit, route, self._clients)
        if isinstance(route, Base):
            return DrivenBase(self._kit, route, self._clients)
        if isinstance(route, Humans):
            return OutboundHumans(self._kit, route)
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
        await self._take_turns()
        if self._mirror is not None:
            await self._mirror.look({one.ros for one in self._wanted if isinstance(one, Topic)})
        self._clients.look()
        for carried in self._explicit.values():
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

    def _tell_apart(self, others: Mapping[bytes, Claim]) -> None:
        """Tell if an adapter says that it is in our domain, and is not."""
        domain_id = self.context.settings.domain_id
        apart = [
            participant
            for participant, claim in others.items()
            if claim.domain_id == domain_id and not self._graph.knows(participant)
        ]
        now_s = time.monotonic()
        self._apart_since_s = min(self._apart_since_s, now_s) if apart else math.inf
        problem = ""
        if now_s > self._apart_since_s + FIND_WITHIN_S:
            problem = (
                f"another adapter is in domain {domain_id} as well, but not in our ROS network; "
                "what both could carry, only one does. Give one network another domain id"
            )
        self._kit.report("other adapters", problem)

    async def close(self) -> None:
        """End all routes."""
        if self._mirror is not None:
            await self._mirror.close()
        for carried in self._explicit.values():
            await carried.close()
        self._clients.close()
        self._parameters.close()
        self._turns.close()
