"""REST paths of the YARP network: its ports, and the connections between any two of them.

The YARP adapter does the work; here its calls get paths. Where a fleet has several adapters, each
with a YARP network of its own, `?instance=` says which.
"""

from __future__ import annotations

from typing import Annotated, Any, Final

import msgspec
from fastapi import APIRouter, Query, Request
from starlette.responses import Response

from vertebra.bus import Bus
from vertebra.errors import NotConnectedError, RemoteError
from vertebra.service import service_key
from vertebra_gateway.bodies import JsonResponse, read_body
from vertebra_gateway.fleet import Fleet
from vertebra_gateway.problems import ProblemError

CALL_TIMEOUT_S: Final = 10.0
_ADAPTER: Final = "yarp"
_UNKNOWN: Final = frozenset({"PortNotFoundError", "NoSuchConnectionError"})
"""What the adapter calls the errors of a request for something that does not exist."""


def yarp_routes(bus: Bus, fleet: Fleet) -> APIRouter:
    """Return the REST paths below `/api/yarp`."""
    router = APIRouter(prefix="/api/yarp", default_response_class=JsonResponse)

    @router.get("/routes")
    async def get_routes(instance: str = "") -> Response:
        return await ask(instance, "routes")

    @router.get("/ports")
    async def get_ports(instance: str = "") -> Response:
        return await ask(instance, "ports")

    @router.get("/connections")
    async def get_connections(instance: str = "") -> Response:
        return await ask(instance, "connections")

    @router.post("/connections")
    async def post_connection(request: Request, instance: str = "") -> Response:
        return await ask(instance, "connect", await read_body(request))

    @router.delete("/connections")
    async def delete_connection(
        source: Annotated[str, Query(alias="from")] = "",
        dest: Annotated[str, Query(alias="to")] = "",
        instance: str = "",
    ) -> Response:
        return await ask(instance, "disconnect", {"from": source, "to": dest})

    async def ask(instance: str, leaf: str, body: Any = None) -> Response:
        key = service_key(_ADAPTER, adapter(instance), leaf)
        payload = msgspec.json.encode(body)
        try:
            reply = await bus.call(
                key, payload, encoding="application/json", timeout_s=CALL_TIMEOUT_S
            )
        except RemoteError as error:
            if error.kind in _UNKNOWN:
                raise ProblemError(404, error.detail) from error
            raise
        return JsonResponse(reply.payload)

    def adapter(wanted: str) -> str:
        present = fleet.instances(_ADAPTER)
        if wanted in present:
            return wanted
        if wanted:
            raise ProblemError(404, f"there is no YARP adapter {wanted!r}", known=present)
        if not present:
            raise NotConnectedError("no YARP adapter is there; start the service yarp")
        if len(present) > 1:
            raise ProblemError(
                422, "there are several YARP adapters; choose one: ?instance=...", known=present
            )
        return present[0]

    return router
