"""Calls: how requests reach a handler and how failures travel back."""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Callable
from typing import Final

import msgspec

from vertebra.bus.interface import Handler, Reply, Request
from vertebra.errors import BusyError, DeadlineError, RemoteError, VertebraError

log = logging.getLogger(__name__)

ERROR_ENCODING: Final = "application/vnd.vertebra.error"
"""JSON `{"kind": ..., "detail": ...}`."""


class _Failure(msgspec.Struct, frozen=True):
    kind: str
    detail: str


def encode_failure(error: BaseException) -> bytes:
    """Return what the caller is told about `error`."""
    return msgspec.json.encode(_Failure(type(error).__name__, str(error)))


def decode_failure(payload: bytes) -> RemoteError:
    """Return the error in an error reply; a foreign one is quoted as it is."""
    try:
        failure = msgspec.json.decode(payload, type=_Failure)
    except msgspec.DecodeError:
        return RemoteError("UnknownError", payload[:500].decode(errors="replace"))
    return RemoteError(failure.kind, failure.detail)


Respond = Callable[[Reply | BaseException], None]
"""Sends an answer or a failure; called exactly once for each request."""


class Server:
    """Runs a handler for the requests of one served key expression, at most `depth` at a time."""

    def __init__(self, key_expression: str, handler: Handler, depth: int) -> None:
        self._key_expression = key_expression
        self._handler = handler
        self._depth = depth
        self._loop = asyncio.get_running_loop()
        self._lock = threading.Lock()
        self._accepted = 0
        self._closed = False
        self._tasks: set[asyncio.Task[None]] = set()

    def accept(self, request: Request, respond: Respond) -> None:
        """Take a request in or refuse it; called from any thread, never waits."""
        with self._lock:
            full = self._accepted >= self._depth or self._closed
            self._accepted += not full
        if full:
            respond(BusyError(self._key_expression, self._depth))
            return
        try:
            self._loop.call_soon_threadsafe(self._start, request, respond)
        except RuntimeError:  # the loop is closed: this service is gone
            respond(BusyError(self._key_expression, self._depth))

    def close(self) -> None:
        """Refuse from now on and cancel what is being handled."""
        self._closed = True
        for task in self._tasks:
            task.cancel()

    def _start(self, request: Request, respond: Respond) -> None:
        task = self._loop.create_task(self._run(request, respond))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _run(self, request: Request, respond: Respond) -> None:
        answer: Reply | BaseException
        try:
            try:
                async with asyncio.timeout(request.timeout_s):
                    answer = await self._handler(request)
            except TimeoutError as error:
                late = DeadlineError(f"the handler of {request.key}", request.timeout_s)
                answer = error if isinstance(error, VertebraError) else late
            except VertebraError as error:
                answer = error
            except Exception as error:  # a bug in one handler must not end the service
                log.exception("the handler of %s failed", request.key)
                answer = error
            except asyncio.CancelledError:
                respond(BusyError(f"{request.key} (its service stops)", 0))
                raise
            respond(answer)
        finally:
            with self._lock:
                self._accepted -= 1
