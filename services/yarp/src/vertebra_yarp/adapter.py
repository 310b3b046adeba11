"""The adapter: which routes there are now, and how they come and go."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator, Sequence
from typing import Any, Final

import msgspec

from vertebra.bus import Closeable, Reply, Request
from vertebra.errors import TransportError
from vertebra.keys import map_name, unmap_name
from vertebra.service import Context
from vertebra.service.routes import follow_routes, read_routes
from vertebra.yarp import Dialect, NameClient
from vertebra_yarp.calls import InboundCall, OutboundCall, call_yarp
from vertebra_yarp.carried import OWN_NAMES, Carried, Kit
from vertebra_yarp.desk import Desk
from vertebra_yarp.devices import Face, Gaze, Speaker
from vertebra_yarp.driver import NativeDriver, Transport, name_service
from vertebra_yarp.metrics import RouteMetrics
from vertebra_yarp.part import Part
from vertebra_yarp.routes import (
    KINDS,
    AnyRoute,
    Call,
    ControlBoard,
    FaceRoute,
    GazeRoute,
    OneWay,
    SpeakerRoute,
    Stream,
)
from vertebra_yarp.settings import YarpSettings
from vertebra_yarp.streams import InboundStream, OutboundStream

log = logging.getLogger(__name__)

MIRROR_PREFIX: Final = "yarp"
"""YARP ports that no route claims are below this chunk."""
LOOK_EVERY_S: Final = 1.0


async def serve(context: Context[YarpSettings]) -> None:
    """Carry routes until cancelled."""
    settings = context.settings
    routes = read_routes(settings.routes, KINDS)
    async with (
        name_service(
            name_server=settings.name_server,
            serve_names_on=settings.name_server_bind,
            advertise_host=settings.advertise_host,
        ) as names,
        open_driver(settings, names) as transport,
    ):
        adapter = Adapter(context, transport)
        served = Desk(context, transport, adapter.describe)
        try:
            await adapter.carry(routes)
            context.ready()
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(adapter.follow_names())
                if settings.routes is not None:
                    tasks.create_task(follow_routes(context, settings.routes, KINDS, adapter.carry))
        finally:
            served.close()
            await adapter.close()


@contextlib.asynccontextmanager
async def open_driver(settings: YarpSettings, names: NameClient) -> AsyncIterator[Transport]:
    """Yield the driver that was chosen."""
    if settings.driver == "bindings":
        from vertebra_yarp.driver_bindings import bindings_driver  # noqa: PLC0415 - only if chosen

        async with bindings_driver(names, advertise_host=settings.advertise_host) as transport:
            yield transport
        return
    yield NativeDriver(
        names, bind_host=settings.bind_host, advertise_host=settings.advertise_host or None
    )


class Adapter:
    """All routes that are carried now, and how they come and go."""

    def __init__(self, context: Context[YarpSettings], transport: Transport) -> None:
        self.context = context
        self.transport = transport
        self._kit = Kit(context, transport)
        self._explicit: dict[AnyRoute, Carried] = {}
        self._mirrored: dict[str, InboundStream] = {}
        self._served_mirror: Closeable | None = None
        context.metrics.register(RouteMetrics(self._kit.carried))
        if context.settings.automatic:
            self._served_mirror = context.bus.serve(f"{MIRROR_PREFIX}/**", self._call_mirrored)

    async def carry(self, routes: Sequence[AnyRoute]) -> None:
        """Carry exactly these explicit routes: those that stay are not touched."""
        wanted = set(routes)
        self.transport.names.dialects.told = dialects(self.context.settings, routes)
        for route in [route for route in self._explicit if route not in wanted]:
            await self._explicit.pop(route).close()
            self.context.routes.pop(route.yarp, None)
            log.info("route %s ends", route.yarp)
        for route in wanted - self._explicit.keys():
            mirrored = self._mirrored.pop(route.yarp, None)
            if mirrored is not None:
                await mirrored.close()
            self._explicit[route] = carried = make(self._kit, route)
            carried.start()
            self.context.routes[route.yarp] = route.key
            log.info("route %s <-> %s", route.yarp, route.key)

    async def follow_names(self) -> None:
        """Mirror the YARP ports that no route claims, as they come and go."""
        while True:
            try:
                contacts = await self.transport.names.list_ports()
            except TransportError as error:
                self.context.report("name server", "error", str(error))
            else:
                self.context.report("name server", "ok")
                if self.context.settings.automatic:
                    await self._mirror({contact.name for contact in contacts})
            await asyncio.sleep(LOOK_EVERY_S)

    async def _mirror(self, names: set[str]) -> None:
        own = (f"{self._kit.own_name}/", OWN_NAMES)
        claimed = {
            name
            for route in self._explicit
            for name in (route.yarp, *(f"{route.yarp}/{leaf}" for leaf in leaves_of(route)))
        }
        wanted = {
            name
            for name in names - claimed
            if name.startswith("/") and not name.startswith(own) and name != "/root"
        }
        for name in self._mirrored.keys() - wanted:
            if self._mirrored[name].traffic.connected and name not in claimed:
                continue  # the name server has forgotten it, as a restarted one does
            await self._mirrored.pop(name).close()
            self.context.routes.pop(name, None)
        for name in wanted - self._mirrored.keys():
            route = Stream(yarp=name, key=map_name(MIRROR_PREFIX, name))
            self._mirrored[name] = InboundStream(self._kit, route)
            self._mirrored[name].start()
            self.context.routes[name] = route.key

    def describe(self) -> list[dict[str, Any]]:
        """Return the table of routes: what each carries, and what it has carried."""
        rows = [
            {
                "yarp": carried.name,
                "key": carried.key,
                "kind": carried.kind,
                "mirrored": carried.name in self._mirrored,
                **msgspec.to_builtins(carried.traffic),
            }
            for carried in self._kit.carried
        ]
        return sorted(rows, key=lambda row: (row["yarp"], row["key"]))

    async def _call_mirrored(self, request: Request) -> Reply:
        name = unmap_name(MIRROR_PREFIX, request.key)
        caller = await self.transport.dial(name)
        try:
            return await call_yarp(caller, request)
        finally:
            await caller.close()

    async def close(self) -> None:
        """End all routes."""
        if self._served_mirror is not None:
            self._served_mirror.close()
        for carried in [*self._explicit.values(), *self._mirrored.values()]:
            await carried.close()


def dialects(settings: YarpSettings, routes: Sequence[AnyRoute]) -> dict[str, Dialect]:
    """Return what settings and routes tell about the YARP generation of ports."""
    given = {"/": settings.dialect} | {
        route.yarp: str(route.dialect)
        for route in routes
        if isinstance(route, OneWay | ControlBoard)
    }
    return {name: Dialect[f"V{dialect}"] for name, dialect in given.items() if dialect != "auto"}


def make(kit: Kit, route: AnyRoute) -> Carried:
    """Return what carries a route."""
    match route:
        case ControlBoard():
            return Part(kit, route)
        case GazeRoute():
            return Gaze(kit, route)
        case FaceRoute():
            return Face(kit, route)
        case SpeakerRoute():
            return Speaker(kit, route)
        case Stream():
            inbound = route.direction == "inbound"
            return InboundStream(kit, route) if inbound else OutboundStream(kit, route)
        case Call():
            inbound = route.direction == "inbound"
            return InboundCall(kit, route) if inbound else OutboundCall(kit, route)


def leaves_of(route: AnyRoute) -> tuple[str, ...]:
    """Return the YARP ports below the name of a route that it cares for."""
    match route:
        case ControlBoard():
            return ("state:o", "stateExt:o", "rpc:i", "nws/rpc:i", "command:i")
        case GazeRoute():
            return ("rpc", "xd:i", "angles:i", "mono:i", "target:i")
    return ()
