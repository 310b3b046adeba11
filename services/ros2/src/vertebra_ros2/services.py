"""Services: calls between ROS services and keys, both ways."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Any, Final

import msgspec

from vertebra.bus import Reply, Request
from vertebra.errors import (
    CodecError,
    CommandRefusedError,
    EncodeError,
    NotConnectedError,
    VertebraError,
)
from vertebra.messages import Array
from vertebra.ros2.driver import Client
from vertebra.ros2.graph import OTHER_MIDDLEWARE
from vertebra.ros2.graph import Service as OfferedService
from vertebra_ros2.carried import Kit
from vertebra_ros2.routes import Service
from vertebra_ros2.topics import CDR_ENCODING

JSON: Final = "application/json"
FIND_WITHIN_S: Final = 2.0
"""So long a call waits for a service that is not there yet."""
_REFUSAL: Final = {"success": "bool", "message": "string"}


class Clients:
    """Our clients of ROS services: made at the first call, ended when their service is gone."""

    def __init__(self, kit: Kit) -> None:
        self._kit = kit
        self._clients: dict[tuple[str, str], Client] = {}
        self._changed = asyncio.Event()
        kit.transport.on_graph(self._changed.set)

    async def call(self, name: str, type_name: str, request: Request) -> Reply:
        """Call a ROS service; the reply has the form of the request.

        `application/json` is the record of the request, empty for all defaults;
        `application/cdr` is the payload itself.

        Raises:
            CommandRefusedError: The request is no record of this service.
            NotConnectedError: Nobody offers it, or not so that we can call it.
            DeadlineError: No answer in time.
        """
        offered = await self._find(name, min(FIND_WITHIN_S, request.timeout_s))
        if offered.problem:
            raise NotConnectedError(f"the ROS service {name}: {offered.problem}")
        type_name = type_name or offered.type
        cdr = self._kit.cdr
        is_raw = request.encoding.startswith(CDR_ENCODING)
        payload = request.payload
        if not is_raw:
            payload = self._request(type_name, request)
        client = self._clients.get((name, type_name))
        if client is None:
            client = self._kit.transport.client(name, type_name)
            self._clients[name, type_name] = client
        answer = await client.call(payload, timeout_s=request.timeout_s)
        if is_raw:
            return Reply(payload=answer, encoding=f"{CDR_ENCODING};{type_name}_Response")
        return Reply(payload=to_json(cdr.decode(answer, f"{type_name}_Response")), encoding=JSON)

    async def _find(self, name: str, timeout_s: float) -> OfferedService:
        """Return a service, once it has been discovered."""
        try:
            async with asyncio.timeout(timeout_s):
                while (offered := self._kit.transport.graph.service(name)) is None:
                    self._changed.clear()
                    await self._changed.wait()
                return offered
        except TimeoutError as error:
            raise NotConnectedError(
                f"nobody offers the ROS service {name}; start its node, and look whether "
                "'vertebra ros2 services' lists it"
            ) from error

    def _request(self, type_name: str, request: Request) -> bytes:
        try:
            record = msgspec.json.decode(request.payload) if request.payload else {}
            return self._kit.cdr.encode(record, f"{type_name}_Request")
        except (msgspec.DecodeError, EncodeError) as error:
            raise CommandRefusedError(
                f"a call of {type_name} is a JSON object with the fields of its request: {error}"
            ) from error

    def look(self) -> None:
        """End the clients of services that are gone."""
        services = self._kit.transport.graph.services()
        for name, type_name in [one for one in self._clients if one[0] not in services]:
            self._clients.pop((name, type_name)).close()

    def close(self) -> None:
        """End all."""
        for client in self._clients.values():
            client.close()
        self._clients.clear()


class InboundService:
    """A ROS service, called by its key."""

    def __init__(self, kit: Kit, route: Service, clients: Clients) -> None:
        self._kit = kit
        self._route = route
        self._clients = clients
        self._served = kit.context.bus.serve(route.key, self._answer)

    def look(self) -> None:
        """Tell when the service cannot be called."""
        route = self._route
        offered = self._kit.transport.graph.service(route.ros)
        problem = "nobody offers it" if offered is None else offered.problem
        self._kit.report(f"service {route.ros}", problem)

    async def _answer(self, request: Request) -> Reply:
        return await self._clients.call(self._route.ros, self._route.type, request)

    async def close(self) -> None:
        """End it."""
        self._served.close()
        self._kit.report(f"service {self._route.ros}", "")


class OutboundService:
    """A ROS service of ours, whose calls go to a key."""

    def __init__(self, kit: Kit, route: Service) -> None:
        self._kit = kit
        self._route = route
        self._can_refuse = _REFUSAL.items() <= {
            field.name: field.type for field in kit.types.definition(f"{route.type}_Response")
        }.items()  # fmt: skip
        self._server = kit.transport.server(route.ros, route.type, self._answer)

    def look(self) -> None:
        """Tell of clients that cannot be answered."""
        clients = self._kit.transport.graph.writers(self._route.ros, "request")
        problem = OTHER_MIDDLEWARE if any(not one.identity for one in clients) else ""
        self._report(f"a client cannot be answered: {problem}" if problem else "")

    def _report(self, problem: str) -> None:
        self._kit.report(f"service {self._route.ros}", problem)

    async def _answer(self, payload: bytes) -> bytes | None:
        """Return the reply. What fails is told in the reply where its type can say so.

        ROS knows no other way to refuse: without these fields the caller gets no answer.
        """
        kit, route = self._kit, self._route
        try:
            record = kit.cdr.decode(payload, f"{route.type}_Request")
            reply = await kit.context.bus.call(
                route.key, to_json(record), encoding=JSON, timeout_s=route.timeout_s
            )
            answer = msgspec.json.decode(reply.payload) if reply.payload else {}
            return kit.cdr.encode(answer, f"{route.type}_Response")
        except (VertebraError, msgspec.DecodeError) as error:
            kit.refused.inc()
            if not self._can_refuse:
                self._report(f"a call got no answer: {error}")
                return None
            refusal = {"success": False, "message": str(error)}
            return kit.cdr.encode(refusal, f"{route.type}_Response")

    async def close(self) -> None:
        """End it."""
        self._server.close()
        self._report("")


def to_json(record: Mapping[str, Any]) -> bytes:
    """Return a record as JSON; arrays are lists of numbers."""
    return msgspec.json.encode(record, enc_hook=_items)


def _items(value: Any) -> Any:
    if isinstance(value, Array):
        return value.tolist()
    raise CodecError(f"a {type(value).__name__} has no JSON")
