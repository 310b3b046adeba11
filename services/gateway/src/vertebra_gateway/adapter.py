"""The gateway's work: puts the web application on a socket, between the web and the backbone."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import socket
from collections.abc import Iterator
from functools import partial
from typing import Final

import uvicorn

from vertebra.errors import ConfigError
from vertebra.service import Context
from vertebra_gateway.app import make_app
from vertebra_gateway.auth import Guard
from vertebra_gateway.fleet import Fleet
from vertebra_gateway.link import HttpLink, WebSocketLink, limit_unsent
from vertebra_gateway.profile import load_profiles
from vertebra_gateway.resources import Robots
from vertebra_gateway.rest import Gateway
from vertebra_gateway.settings import GatewaySettings
from vertebra_gateway.streams import Streams
from vertebra_gateway.ws import Clients, TotalName
from vertebra_gateway.ws_protocol import MAX_TEXT_BYTES

log = logging.getLogger(__name__)

_STOP_S: Final = 2
_REMEDIES: Final = {
    errno.EADDRINUSE: "is another gateway running there? Stop it, or set VERTEBRA_GATEWAY_TCP_PORT",
    errno.EACCES: "set VERTEBRA_GATEWAY_TCP_PORT to 1024 or above",
}
_PING_EVERY_S: Final = 20.0
_PONG_WITHIN_S: Final = 60.0


async def serve(context: Context[GatewaySettings]) -> None:
    """Serve the web until cancelled."""
    settings = context.settings
    token = await asyncio.to_thread(settings.read_token)
    guard = Guard(token, settings.allowed_origins)
    profiles = await asyncio.to_thread(load_profiles, settings.robots)
    streams = Streams(
        context.bus, context.codecs, context.tasks, jpeg_quality=settings.jpeg_quality
    )
    robots = Robots(context.bus, context.codecs, profiles)
    fleet = Fleet(context.bus, context.codecs)
    clients = Clients(streams, robots)
    _measure(context, streams, clients)
    for profile in profiles:
        for resource in profile.resources:
            context.routes[f"/api/robots/{profile.robot}/{resource.path}"] = resource.key
    gateway = Gateway(
        bus=context.bus,
        codecs=context.codecs,
        robots=robots,
        streams=streams,
        fleet=fleet,
        clients=clients,
    )
    with listening(settings.host, settings.tcp_port) as listener:
        server = _Server(
            uvicorn.Config(
                make_app(gateway, guard),
                http=HttpLink,
                ws=WebSocketLink,
                ws_max_size=MAX_TEXT_BYTES,
                ws_per_message_deflate=False,
                ws_ping_interval=_PING_EVERY_S,
                ws_ping_timeout=_PONG_WITHIN_S,
                lifespan="off",
                log_config=None,
                log_level="warning",
                access_log=False,
                server_header=False,
                proxy_headers=False,
                timeout_graceful_shutdown=_STOP_S,
            )
        )
        context.tasks.create_task(robots.follow())
        context.tasks.create_task(fleet.follow())
        host, tcp_port = listener.getsockname()[:2]
        log.info("listening on http://%s:%d", host, tcp_port)
        context.ready()
        await _run(server, listener, streams)


async def _run(server: _Server, listener: socket.socket, streams: Streams) -> None:
    """Run the web server; when cancelled, send everybody home in order."""
    running = asyncio.create_task(server.serve(sockets=[listener]))
    try:
        await asyncio.shield(running)
    finally:
        streams.close()
        server.should_exit = True
        await running


class _Server(uvicorn.Server):
    """A web server inside a service, which handles the signals."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Leave the signals to the service."""
        yield


@contextlib.contextmanager
def listening(host: str, tcp_port: int) -> Iterator[socket.socket]:
    """Listen for connections as long as the block runs.

    Raises:
        ConfigError: The address is taken, not allowed, or none of this machine.
    """
    with contextlib.ExitStack() as opened:
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(
                host, tcp_port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
            )[0]
            listener = opened.enter_context(socket.socket(family, kind, protocol))
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            limit_unsent(listener)
            listener.bind(address)
            listener.listen()
        except OSError as error:
            remedy = _REMEDIES.get(
                error.errno or 0, "set VERTEBRA_GATEWAY_HOST to an address of it"
            )
            raise ConfigError(
                f"the gateway cannot listen on {host}:{tcp_port} of this machine: "
                f"{error.strerror}; {remedy}"
            ) from error
        yield listener


def _measure(context: Context[GatewaySettings], streams: Streams, clients: Clients) -> None:
    context.gauge("gateway_clients", "Connected WebSocket clients", lambda: len(clients))
    totals: dict[TotalName, str] = {
        "sent": "Data messages sent to WebSocket clients",
        "dropped": "Data messages let go because a WebSocket client was slow",
        "lost": "Samples that WebSocket clients wanted and that never got to their buffers",
    }
    for name, text in totals.items():
        context.gauge(f"gateway_{name}", text, partial(clients.total, name))
    context.gauge("gateway_jpegs", "Images made into JPEGs", lambda: streams.counts.jpegs)
    context.gauge(
        "gateway_jpegs_skipped",
        "Images that were not made into JPEGs because newer ones came first",
        lambda: streams.counts.jpegs_skipped,
    )
