"""Calls between YARP RPC ports and keys, both ways."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Final

import msgspec

from vertebra.bus import Reply, Request
from vertebra.codec import to_json_value
from vertebra.errors import CodecError, CommandRefusedError, TransportError, VertebraError
from vertebra.messages import Bottle
from vertebra.yarp import Incoming, PortNotFoundError, Value, Vocab, from_text, to_text
from vertebra_yarp import mapping
from vertebra_yarp.carried import Carried, Kit
from vertebra_yarp.driver import Caller, Transport
from vertebra_yarp.links import Redialled
from vertebra_yarp.routes import Call

JSON: Final = "application/json"


class RpcLink(Redialled[Caller]):
    """A connection to an RPC port that is made when needed and again after a loss.

    Args:
        name: Of the port.
        newer_name: What it is called in newer robots; dialled where it is registered.
    """

    def __init__(self, transport: Transport, name: str, newer_name: str = "") -> None:
        super().__init__(self._dial_either)
        self._transport = transport
        self._name = name
        self._newer_name = newer_name

    async def _dial_either(self) -> Caller:
        if self._newer_name:
            with contextlib.suppress(PortNotFoundError):
                return await self._transport.dial(self._newer_name)
        return await self._transport.dial(self._name)

    async def caller(self) -> Caller:
        """Return a connection that was alive a moment ago; raise `TransportError`."""
        return await self.get()

    async def call(self, request: list[Value], *, timeout_s: float) -> list[Value]:
        """Call the port; see `Caller.call`."""
        return await (await self.get()).call(request, timeout_s=timeout_s)


class InboundCall(Carried):
    """A YARP RPC port, called by its key."""

    kind = "inbound call"

    def __init__(self, kit: Kit, route: Call) -> None:
        super().__init__(kit, route.yarp, route.key)
        self.link = RpcLink(kit.transport, route.yarp)
        self._served = kit.context.bus.serve(route.key, self._answer)

    async def work(self) -> None:
        """Wait: calls come to `_answer`."""
        await asyncio.get_running_loop().create_future()

    async def _answer(self, request: Request) -> Reply:
        try:
            reply = await call_yarp(await self.link.caller(), request)
        except VertebraError as error:
            self.refuse(error)
            raise
        finally:
            self.traffic.connected = self.link.connected
        self.traffic.messages += 1
        self.traffic.bytes += len(reply.payload)
        return reply

    async def close(self) -> None:
        """End it."""
        self._served.close()
        await super().close()
        await self.link.close()


class OutboundCall(Carried):
    """A YARP RPC port of ours, whose calls go to a key."""

    kind = "outbound call"

    def __init__(self, kit: Kit, route: Call) -> None:
        super().__init__(kit, route.yarp, route.key)
        self.route = route

    async def work(self) -> None:
        """Open the port; calls come to `_answer`."""
        await self.persist(self._serve)

    async def _serve(self) -> str:
        server = await self.kit.transport.open_server(self.route.yarp, self._answer)
        self.connected()
        try:
            await asyncio.get_running_loop().create_future()
        finally:
            await server.close()
        return "closed"

    async def _answer(self, incoming: Incoming) -> list[Value]:
        route = self.route
        plain = mapping.plain_of(incoming.bottle())
        try:
            reply = await self.kit.context.bus.call(
                route.key, _json(Bottle(values=plain)), encoding=JSON, timeout_s=route.timeout_s
            )
        except TransportError as error:
            self.refuse(error)
            return [Vocab("fail"), str(error)]
        self.traffic.messages += 1
        self.traffic.bytes += len(incoming.payload)
        document = msgspec.json.decode(reply.payload)
        return mapping.values_of(document if isinstance(document, list) else [_text(document)])


async def call_yarp(caller: Caller, request: Request) -> Reply:
    """Put a request to an RPC port; the reply has the form of the request.

    `text/plain` is the text form of a bottle, `application/json` a list of plain values
    (see `Bottle`).

    Raises:
        CommandRefusedError: The request is neither.
    """
    as_text = request.encoding.startswith("text/plain")
    try:
        if as_text:
            values = from_text(request.payload.decode())
        else:
            document = msgspec.json.decode(request.payload, type=list)
            values = mapping.values_of(document)
    except (msgspec.DecodeError, CodecError, UnicodeDecodeError) as error:
        raise CommandRefusedError(
            "a YARP call is text/plain with a bottle in text form, or application/json with a "
            f"list of values: {error}"
        ) from error
    reply = await caller.call(values, timeout_s=request.timeout_s)
    if as_text:
        return Reply(payload=to_text(reply).encode(), encoding="text/plain")
    return Reply(payload=_json(Bottle(values=mapping.plain_of(reply))), encoding=JSON)


def _json(bottle: Bottle) -> bytes:
    document = to_json_value(bottle)
    return msgspec.json.encode(document["values"])


def _text(document: object) -> str:
    return document if isinstance(document, str) else msgspec.json.encode(document).decode()
