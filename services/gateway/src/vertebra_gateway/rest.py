"""REST: what the robots offer, under paths; see PROTOCOL.md."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from fastapi import APIRouter, Request
from starlette.responses import Response

from vertebra.bus import Bus
from vertebra.codec import CodecRegistry
from vertebra.errors import NotConnectedError
from vertebra_gateway.bodies import JsonResponse, read_body, read_bytes
from vertebra_gateway.fleet import Fleet
from vertebra_gateway.live import EventsResponse, MjpegResponse
from vertebra_gateway.problems import ProblemError
from vertebra_gateway.profile import Resource
from vertebra_gateway.resources import Robots
from vertebra_gateway.streams import Streams, to_document
from vertebra_gateway.ws import Clients

FIRST_VALUE_WITHIN_S: Final = 2.0
IMAGE_MAX_AGE_S: Final = 2.0
READ_KEPT_S: Final = 10.0
"""So long after a read the next one finds its value at hand."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Gateway:
    """Everything that the web can reach."""

    bus: Bus
    codecs: CodecRegistry
    robots: Robots
    streams: Streams
    fleet: Fleet
    clients: Clients


def routes(gateway: Gateway) -> APIRouter:
    """Return the REST paths."""
    robots, streams = gateway.robots, gateway.streams
    router = APIRouter(default_response_class=JsonResponse)

    @router.get("/healthz")
    async def healthz() -> Response:
        return JsonResponse({"ok": True})

    @router.get("/readyz")
    async def readyz() -> Response:
        if not gateway.bus.info().connected:
            raise NotConnectedError("the router is not reached")
        return JsonResponse({"ok": True})

    @router.get("/metrics")
    async def metrics() -> Response:
        return Response(
            await gateway.fleet.metrics(), media_type="text/plain; version=0.0.4; charset=utf-8"
        )

    @router.get("/api/fleet")
    async def get_fleet() -> Response:
        return JsonResponse(
            {
                "services": gateway.fleet.describe(),
                "streams": streams.describe(),
                "clients": gateway.clients.describe(),
            }
        )

    @router.get("/api/robots")
    async def get_robots() -> Response:
        return JsonResponse(robots.describe())

    @router.get("/api/robots/{robot}")
    async def get_robot(robot: str) -> Response:
        return JsonResponse(robots.robot(robot).describe())

    @router.get("/api/robots/{robot}/{path:path}/stream")
    async def get_stream(robot: str, path: str) -> Response:
        resource = readable(robot, path)
        if resource.content_type != "image/jpeg":
            return EventsResponse(streams, resource.key)
        await streams.newest(
            resource.key, "jpeg", max_age_s=IMAGE_MAX_AGE_S, within_s=FIRST_VALUE_WITHIN_S
        )
        return MjpegResponse(streams, resource.key)

    @router.get("/api/robots/{robot}/{path:path}")
    async def get_resource(robot: str, path: str) -> Response:
        found = robots.robot(robot).resource(path)
        if found.kind == "call":
            if found.http_method != "GET":
                raise ProblemError(405, f"{path!r} is called with POST", allowed=["POST"])
            return JsonResponse(await robots.call(robot, path, {}))
        resource = readable(robot, path)
        if resource.kind == "read":
            streams.keep(resource.key, READ_KEPT_S)
        if resource.content_type != "image/jpeg":
            item = await streams.newest(resource.key, "frame", within_s=FIRST_VALUE_WITHIN_S)
            return JsonResponse(to_document(item, gateway.codecs).payload)
        image = await streams.newest(
            resource.key, "jpeg", max_age_s=IMAGE_MAX_AGE_S, within_s=FIRST_VALUE_WITHIN_S
        )
        return Response(
            image.payload,
            media_type="image/jpeg",
            headers={
                "cache-control": "no-store",
                "x-captured-ns": str(image.captured_ns),
                "x-age-s": f"{image.age_s:.3f}",
            },
        )

    def readable(robot: str, path: str) -> Resource:
        found = robots.robot(robot)
        resource = found.resource(path)
        if resource.kind == "call":
            raise ProblemError(404, f"{path!r} is a call, not a stream")
        found.require(resource)
        return resource

    @router.post("/api/robots/{robot}/{path:path}")
    async def post_resource(robot: str, path: str, request: Request) -> Response:
        found = robots.robot(robot).resource(path)
        if found.http_method != "POST":
            raise ProblemError(405, f"{path!r} is read with GET", allowed=["GET"])
        if found.takes == "audio/wav":
            return JsonResponse(await robots.play(robot, path, await read_bytes(request)))
        return JsonResponse(await robots.call(robot, path, await read_body(request)))

    return router
