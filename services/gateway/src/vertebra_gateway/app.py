"""The web application: REST, WebSocket, dashboard, and what goes before them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

from fastapi import FastAPI, Request, WebSocket
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.responses import FileResponse, HTMLResponse, Response
from starlette.staticfiles import NotModifiedResponse, PathLike, StaticFiles
from starlette.types import ASGIApp, Scope

from vertebra.errors import VertebraError
from vertebra_gateway import openapi
from vertebra_gateway.auth import Guard, GuardMiddleware
from vertebra_gateway.bodies import JsonResponse
from vertebra_gateway.problems import Problem, problem_of
from vertebra_gateway.rest import Gateway, routes
from vertebra_gateway.yarp import yarp_routes

STATIC: Final = Path(__file__).parent / "static"
_MEDIA_TYPES: Final = {
    ".css": "text/css",
    ".html": "text/html",
    ".ico": "image/x-icon",
    ".js": "text/javascript",
    ".json": "application/json",
    ".png": "image/png",
    ".svg": "image/svg+xml",
}


def make_app(gateway: Gateway, guard: Guard) -> ASGIApp:
    """Return the whole application."""
    app = FastAPI(openapi_url=None, docs_url=None, redoc_url=None)
    app.include_router(routes(gateway))
    app.include_router(yarp_routes(gateway.bus, gateway.fleet))

    @app.get("/openapi.json")
    async def openapi_json() -> Response:
        return JsonResponse(openapi.describe(gateway.robots))

    @app.get("/docs")
    async def docs() -> Response:
        return HTMLResponse(openapi.page(openapi.describe(gateway.robots)))

    @app.websocket("/ws")
    async def ws(websocket: WebSocket) -> None:
        await gateway.clients.serve(websocket)

    app.add_exception_handler(VertebraError, _tell)
    app.add_exception_handler(HTTPException, _tell_http)
    app.add_exception_handler(Exception, _tell_bug)
    app.mount("/", _Dashboard(directory=STATIC, html=True, check_dir=False))
    return GuardMiddleware(app, guard)


class _Dashboard(StaticFiles):
    """The dashboard's files; browsers ask each time whether they changed."""

    def file_response(
        self,
        full_path: PathLike,
        stat_result: os.stat_result,
        scope: Scope,
        status_code: int = 200,
    ) -> Response:
        """Return a file, or that it has not changed."""
        response = FileResponse(
            full_path,
            status_code,
            headers={"cache-control": "no-cache"},
            # Not by the tables of this machine: a browser runs no module of another type.
            media_type=_MEDIA_TYPES.get(Path(full_path).suffix, "application/octet-stream"),
            stat_result=stat_result,
        )
        if self.is_not_modified(response.headers, Headers(scope=scope)):
            return NotModifiedResponse(response.headers)
        return response


async def _tell(_: Request, error: Exception) -> Response:
    assert isinstance(error, VertebraError)  # noqa: S101  - registered for this type only
    return _response(problem_of(error))


async def _tell_http(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)  # noqa: S101  - registered for this type only
    detail = f"{request.method} {request.url.path}: {error.detail}"
    return _response(Problem(status=error.status_code, detail=detail))


async def _tell_bug(_: Request, error: Exception) -> Response:
    detail = f"{type(error).__name__}, a bug in the gateway; its log says more"
    return _response(Problem(status=500, detail=detail))


def _response(problem: Problem) -> Response:
    return Response(problem.body(), problem.status, problem.headers())
