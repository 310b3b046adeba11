"""The frame of every service: settings, bus, presence, heartbeat, metrics, orderly stop."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import logging
import os
import signal
import sys
from collections.abc import Awaitable, Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from typing import Any, Final, Generic, Literal, TypeVar

import msgspec
from prometheus_client import CollectorRegistry, Counter, Gauge, generate_latest

from vertebra import __version__, heartbeat
from vertebra.bus import Bus, Priority, Reply, Request, ZenohBus
from vertebra.codec import CodecRegistry
from vertebra.errors import ConfigError, VertebraError
from vertebra.keys import CONTROL_PREFIX
from vertebra.messages import Status
from vertebra.service.logs import configure_logs
from vertebra.service.settings import ServiceSettings, describe, load_settings
from vertebra.service.streams import MessagePublisher

log = logging.getLogger(__name__)

EXIT_CONFIG: Final = 2
STOP_WITHIN_S: Final = 5.0
_BEAT_EVERY_S: Final = 1.0
S = TypeVar("S", bound=ServiceSettings)


def service_key(service: str, instance: str, leaf: str) -> str:
    """Return the control key of a service; `leaf` is alive, status, info, metrics or a call."""
    return f"{CONTROL_PREFIX}/services/{service}/{instance}/{leaf}"


@dataclass(slots=True)
class Context(Generic[S]):
    """What a running service has at hand.

    Attributes:
        name: The service, for example `yarp`.
        settings: Its settings.
        bus: Its membership in the backbone.
        codecs: All codecs that are installed.
        tasks: Where its tasks live; one that fails stops the service.
        metrics: Where its Prometheus metrics live.
        routes: What it carries, for its info; foreign name to key.
        news: Set when the status has to be told before its time.
    """

    name: str
    settings: S
    bus: Bus
    codecs: CodecRegistry
    tasks: asyncio.TaskGroup
    metrics: CollectorRegistry = field(default_factory=CollectorRegistry)
    routes: dict[str, str] = field(default_factory=dict)
    news: asyncio.Event = field(default_factory=asyncio.Event)
    _problems: dict[str, tuple[Literal["warning", "error"], str]] = field(default_factory=dict)
    _values: dict[str, Callable[[], float]] = field(default_factory=dict)
    _ready: bool = False

    def key(self, leaf: str) -> str:
        """Return a control key of this service."""
        return service_key(self.name, self.settings.instance, leaf)

    def publisher(
        self, key: str, *, priority: Priority = Priority.DATA, origin: str = ""
    ) -> MessagePublisher:
        """Return a publisher of messages whose origin is this service unless said otherwise."""
        return MessagePublisher(
            self.bus,
            self.codecs,
            key,
            priority=priority,
            origin=origin or self.name,
        )

    def ready(self) -> None:
        """Say that the service does its work from now on."""
        self._ready = True
        self.news.set()
        log.info("ready")

    def report(self, what: str, level: Literal["ok", "warning", "error"], text: str = "") -> None:
        """Tell operators how one part is doing; it stays so until it is reported otherwise.

        A change is logged once when it goes bad and once when it is well again.
        """
        before = self._problems.get(what)
        if level == "ok":
            if self._problems.pop(what, None) is not None:
                log.info("%s is well again", what)
            return
        self._problems[what] = (level, text)
        if before != (level, text):
            log.log(logging.ERROR if level == "error" else logging.WARNING, "%s: %s", what, text)

    def counter(self, name: str, text: str) -> Counter:
        """Return a Prometheus counter that also shows in the status."""
        counter = Counter(name, text, namespace="vertebra", registry=self.metrics)
        self._values[name] = lambda: float(counter._value.get())  # noqa: SLF001  - no public way
        return counter

    def gauge(self, name: str, text: str, read: Callable[[], float] | None = None) -> Gauge:
        """Return a Prometheus gauge that also shows in the status."""
        gauge = Gauge(name, text, namespace="vertebra", registry=self.metrics)
        if read is not None:
            gauge.set_function(read)
        self._values[name] = read or (lambda: float(gauge._value.get()))  # noqa: SLF001
        return gauge

    def status(self) -> Status:
        """Return how the service is doing now."""
        problems = dict(self._problems)
        if not self.bus.info().connected:
            problems["router"] = ("error", f"not reached at {self.settings.router}")
        if not self._ready:
            problems["start"] = ("error", "not ready yet")
        level: Literal["ok", "warning", "error"] = "ok"
        if problems:
            levels = {problem[0] for problem in problems.values()}
            level = "error" if "error" in levels else "warning"
        return Status(
            level=level,
            text="; ".join(f"{what}: {text}" for what, (_, text) in problems.items()),
            values={name: read() for name, read in self._values.items()},
        )


Serve = Callable[[Context[S]], Awaitable[None]]
"""A service's own work: declares what it offers, calls `context.ready()`, returns or works on."""


Surround = Callable[[S], AbstractContextManager[None]]
"""What has to run around a service, its bus included; the router needs that."""


def main(
    name: str,
    settings_type: type[S],
    serve: Serve[S],
    *,
    surround: Surround[S] = lambda _: nullcontext(),
) -> int:
    """Run a service until SIGTERM or SIGINT; return the exit status of the process.

    `--check` validates the settings and what they name, prints them without secrets and exits.
    """
    parser = argparse.ArgumentParser(prog=f"vertebra_{name}", description=settings_type.__doc__)
    parser.add_argument("--check", action="store_true", help="validate and print the settings")
    arguments = parser.parse_args()
    try:
        settings = load_settings(settings_type)
        settings.check()
    except ConfigError as error:
        sys.stderr.write(f"{name}: {error}\n")
        return EXIT_CONFIG
    if arguments.check:
        sys.stdout.write(describe(settings))
        return 0
    configure_logs(name, settings.log_level, settings.log_format)
    try:
        with surround(settings):
            asyncio.run(_run(name, settings, serve))
    except ConfigError as error:
        log.error("%s", error)  # noqa: TRY400  - the text is the remedy, the trace would hide it
        return EXIT_CONFIG
    except VertebraError as error:
        log.error("stopped: %s", error)  # noqa: TRY400
        return 1
    except Exception:
        log.exception("stopped by a bug")
        return 1
    return 0


async def _run(name: str, settings: S, serve: Serve[S]) -> None:
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for signal_number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(signal_number, stop.set)
    work = asyncio.create_task(run_service(name, settings, serve), name=name)
    stopping = asyncio.create_task(stop.wait())
    await asyncio.wait([work, stopping], return_when=asyncio.FIRST_COMPLETED)
    stopping.cancel()
    if not work.done():
        log.info("stopping")
        loop.call_later(STOP_WITHIN_S, _give_up, name)
        work.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await work


def _give_up(name: str) -> None:
    log.error("%s did not stop within %g s; it ends now", name, STOP_WITHIN_S)
    logging.shutdown()
    os._exit(1)


async def run_service(name: str, settings: S, serve: Serve[S], *, bus: Bus | None = None) -> None:
    """Run a service on `bus` (by default the backbone of its settings) until cancelled.

    Raises:
        VertebraError: What stopped it; an error in any of its tasks does.
    """
    codecs = await asyncio.to_thread(CodecRegistry.installed)
    if bus is None:
        await _beat(name, "waiting for the router")
        waiting = asyncio.create_task(_keep_beating(name))
        try:
            bus = await ZenohBus.open(settings.router, shared_memory=settings.shared_memory)
        finally:
            waiting.cancel()
    try:
        async with asyncio.TaskGroup() as tasks:
            context = Context(
                name=name,
                settings=settings,
                bus=bus,
                codecs=codecs,
                tasks=tasks,
            )
            _declare(context)
            tasks.create_task(_beat_and_tell(context))
            await serve(context)
    except BaseExceptionGroup as group:
        raise _first(group) from group
    finally:
        await bus.close()


def _first(group: BaseExceptionGroup[Any]) -> BaseException:
    inner: BaseException = group
    while isinstance(inner, BaseExceptionGroup):
        inner = inner.exceptions[0]
    return inner


def _declare(context: Context[Any]) -> None:
    async def info(_: Request) -> Reply:
        bus_info = context.bus.info()
        document = {
            "service": context.name,
            "instance": context.settings.instance,
            "version": __version__,
            "routes": context.routes,
            "settings": context.settings.model_dump(mode="json"),
            "encodings": context.codecs.encodings,
            "shared_memory": bus_info.shared_memory,
            "pid": os.getpid(),
        }
        return Reply(payload=msgspec.json.encode(document), encoding="application/json")

    async def metrics(_: Request) -> Reply:
        return Reply(payload=generate_latest(context.metrics), encoding="text/plain")

    context.gauge(
        "shared_memory_misses",
        "Large payloads that went by copy because the pool was full",
        lambda: context.bus.info().shared_memory_misses,
    )
    context.bus.serve(context.key("info"), info)
    context.bus.serve(context.key("metrics"), metrics)
    context.bus.declare_presence(context.key("alive"))


async def _beat_and_tell(context: Context[Any]) -> None:
    """Write the heartbeat and publish the status; a loop that is blocked does neither."""
    publisher = context.publisher(context.key("status"), priority=Priority.CONTROL)
    while True:
        context.news.clear()
        status = context.status()
        await _beat(context.name, status.text if status.level == "error" else "")
        publisher.publish(status)
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(context.news.wait(), _BEAT_EVERY_S)


async def _keep_beating(name: str) -> None:
    while True:
        await asyncio.sleep(_BEAT_EVERY_S)
        await _beat(name, "waiting for the router")


async def _beat(name: str, problem: str) -> None:
    try:
        await asyncio.to_thread(heartbeat.beat, name, problem)
    except OSError as error:
        raise ConfigError(
            f"the heartbeat cannot be written: {error}; set VERTEBRA_HEARTBEAT_DIR to a folder "
            "that this service may write to"
        ) from error
