"""The web application: REST, WebSocket, dashboard, and what goes before them."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from fastapi import FastAPI, Request, WebSocket
from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp

from vertebra import __version__
from vertebra.errors import VertebraError
from vertebra_gateway.auth import Guard, GuardMiddleware
from vertebra_gateway.problems import Problem, problem_of
from vertebra_gateway.rest import Gateway, routes

STATIC: Final = Path(__file__).parent / "static"


def make_app(gateway: Gateway, guard: Guard) -> ASGIApp:
    """Return the whole application."""
    app = FastAPI(
        title="Vertebra",
        version=__version__,
        description="The robots of this fleet. See PROTOCOL.md of the gateway.",
        docs_url=None,
        redoc_url=None,
    )
    app.include_router(routes(gateway))

    @app.websocket("/ws")
    async def ws(websocket: WebSocket) -> None:
        await gateway.clients.serve(websocket)

    app.add_exception_handler(VertebraError, _tell)
    app.add_exception_handler(HTTPException, _tell_http)
    app.mount("/", _Dashboard(directory=STATIC, html=True))
    return GuardMiddleware(app, guard)


class _Dashboard(StaticFiles):
    """The dashboard's files; browsers ask each time whether they changed."""

    def file_response(self, *arguments: object, **options: object) -> Response:
        """Return a file or that it has not changed."""
        response = super().file_response(*arguments, **options)  # type: ignore[arg-type]
        response.headers["cache-control"] = "no-cache"
        return response


async def _tell(_: Request, error: Exception) -> Response:
    assert isinstance(error, VertebraError)  # noqa: S101  - registered for this type only
    return _response(problem_of(error))


async def _tell_http(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)  # noqa: S101  - registered for this type only
    detail = f"{request.method} {request.url.path}: {error.detail}"
    return _response(Problem(status=error.status_code, detail=detail))


def _response(problem: Problem) -> Response:
    return Response(problem.body(), problem.status, problem.headers())
