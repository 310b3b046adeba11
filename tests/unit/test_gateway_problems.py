"""Every error has its status, and who may come in."""

from __future__ import annotations

import inspect
from typing import Any

import pytest
from starlette.types import Scope

from vertebra import errors
from vertebra.errors import (
    BusyError,
    CodecNotFoundError,
    CommandRefusedError,
    ConfigError,
    DeadlineError,
    DecodeError,
    EncodeError,
    NameMappingError,
    NotConnectedError,
    RemoteError,
    TransportError,
    VertebraError,
)
from vertebra_gateway.auth import Guard
from vertebra_gateway.problems import InputRefusedError, ProblemError, problem_of

TOKEN = "0123456789abcdef"


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (ProblemError(418, "teapot"), 418),
        (InputRefusedError("no", joint="pan"), 422),
        (CommandRefusedError("no"), 422),
        (NameMappingError("/a", 0, "no"), 422),
        (EncodeError("no"), 422),
        (BusyError("it", 3), 429),
        (DecodeError("no"), 502),
        (CodecNotFoundError("no"), 502),
        (NotConnectedError("away"), 503),
        (DeadlineError("it", 3), 504),
        (RemoteError("CommandRefusedError", "no"), 422),
        (RemoteError("BusyError", "no"), 429),
        (RemoteError("NotConnectedError", "no"), 503),
        (RemoteError("DeadlineError", "no"), 504),
        (RemoteError("ZeroDivisionError", "no"), 502),
        (TransportError("no"), 502),
    ],
)
def test_status_of_each_error(error: VertebraError, status: int) -> None:
    problem = problem_of(error)
    assert problem.status == status
    document = problem.document()
    assert document["status"] == status
    assert document["title"]
    assert document["detail"] == problem.detail
    assert ("retry-after" in problem.headers()) is (status in (429, 503))


def test_no_error_of_ours_is_an_internal_error() -> None:
    samples: dict[str, tuple[Any, ...]] = {
        "NameMappingError": ("/a", 0, "no"),
        "DeadlineError": ("it", 1.0),
        "BusyError": ("it", 1),
        "RemoteError": ("Kind", "detail"),
    }
    for name, kind in inspect.getmembers(errors, inspect.isclass):
        if issubclass(kind, VertebraError) and not issubclass(kind, ConfigError):
            assert 422 <= problem_of(kind(*samples.get(name, ("no",)))).status <= 504, name


def test_a_refused_input_tells_what_helps() -> None:
    document = problem_of(InputRefusedError("no", joint="pan", limit={"max": 3})).document()
    assert (document["joint"], document["limit"]) == ("pan", {"max": 3})


def scope(path: str = "/api/robots", *subprotocols: str, **headers: str) -> Scope:
    headers = {"host": "lab:8080", **headers}
    raw = [(name.encode(), value.encode("latin-1")) for name, value in headers.items()]
    return {"type": "http", "path": path, "headers": raw, "subprotocols": list(subprotocols)}


GUARD = Guard(TOKEN, ("https://pages.lab", "http://other.lab:3000/"))


@pytest.mark.parametrize(
    ("request_scope", "status"),
    [
        (scope(), 401),
        (scope("/"), 401),
        (scope("/vertebra.js"), 401),
        (scope("/healthz"), None),
        (scope("/readyz"), None),
        (scope("/healthz/../api/robots"), 401),
        (scope(authorization=f"Bearer {TOKEN}"), None),
        (scope(authorization=f"bearer {TOKEN}"), None),
        (scope(authorization=f"Basic {TOKEN}"), 401),
        (scope(authorization=f"Bearer {TOKEN}x"), 401),
        (scope(authorization="Bearer "), 401),
        (scope(authorization="Bearer \xff"), 401),
        (scope(cookie=f"vertebra_token={TOKEN}"), None),
        (scope(cookie=f"a=b; vertebra_token={TOKEN}; c=d"), None),
        (scope(cookie="vertebra_token=wrong"), 401),
        (scope(cookie="\x00;;;="), 401),
        (scope("/ws", "vertebra.v1", f"token.{TOKEN}"), None),
        (scope("/ws", "vertebra.v1", "token.wrong"), 401),
        (scope("/ws", "vertebra.v1", TOKEN), 401),
        (scope(authorization=f"Bearer {TOKEN}", origin="http://lab:8080"), None),
        (scope(authorization=f"Bearer {TOKEN}", origin="https://pages.lab"), None),
        (scope(authorization=f"Bearer {TOKEN}", origin="http://other.lab:3000"), None),
        (scope(authorization=f"Bearer {TOKEN}", origin="http://pages.lab"), 403),
        (scope(authorization=f"Bearer {TOKEN}", origin="http://lab:8081"), 403),
        (scope(authorization=f"Bearer {TOKEN}", origin="http://lab:8080.evil.org"), 403),
        (scope(authorization=f"Bearer {TOKEN}", origin="null"), 403),
        (scope(authorization=f"Bearer {TOKEN}", origin=""), 403),
        (scope(authorization=f"Bearer {TOKEN}", origin="http://[lab"), 403),
        (scope("/healthz", origin="http://evil.org"), 403),
    ],
)
def test_who_may_come_in(request_scope: Scope, status: int | None) -> None:
    problem = GUARD.refusal(request_scope)
    assert (problem.status if problem is not None else None) == status
    assert problem is None or TOKEN not in problem.detail
