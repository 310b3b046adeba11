"""Who may come in, and what browsers are told to forbid."""

from __future__ import annotations

import hmac
from http.cookies import CookieError, SimpleCookie
from typing import Final
from urllib.parse import parse_qs

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from vertebra_gateway.problems import Problem

COOKIE: Final = "vertebra_token"
TOKEN_SUBPROTOCOL: Final = "token."  # noqa: S105  - what stands before the token
OPEN_PATHS: Final = frozenset({"/healthz", "/readyz"})
_SECURITY_HEADERS: Final = {
    "content-security-policy": (
        "default-src 'self'; img-src 'self' blob: data:; media-src 'self' blob:; "
        "object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
    ),
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
}


class Guard:
    """Lets in who shows the token and comes from an allowed page."""

    def __init__(self, token: str, allowed_origins: tuple[str, ...] = ()) -> None:
        self._token = token.encode()
        self._allowed_origins = frozenset(origin.rstrip("/") for origin in allowed_origins)

    def knows(self, token: str) -> bool:
        """Say whether `token` is the right one, in a time that tells nothing about it."""
        return hmac.compare_digest(token.encode(errors="surrogateescape"), self._token)

    def refusal(self, scope: Scope) -> Problem | None:
        """Return why a request is refused, None if it may pass."""
        headers = Headers(scope=scope)
        origin = headers.get("origin")
        if origin is not None and not self._allows(origin, headers.get("host", "")):
            return Problem(
                status=403,
                detail=f"pages of {origin!r} may not use this gateway; if they shall, add the "
                "origin to VERTEBRA_GATEWAY_ALLOWED_ORIGINS",
            )
        if scope["path"] in OPEN_PATHS:
            return None
        tokens = _tokens(scope, headers)
        if any(self.knows(token) for token in tokens):
            return None
        why = "this token is not the right one" if tokens else "a token is needed"
        return Problem(
            status=401,
            detail=f"{why}; open the address that ./vertebra up printed (/?token=...), "
            "or send the header 'Authorization: Bearer TOKEN'",
        )

    def _allows(self, origin: str, host: str) -> bool:
        own = host != "" and origin.partition("://")[2] == host
        return own or origin in self._allowed_origins


def _tokens(scope: Scope, headers: Headers) -> list[str]:
    tokens = []
    scheme, _, credentials = headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer":
        tokens.append(credentials.strip())
    try:
        cookie = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
    except CookieError:
        cookie = None
    if cookie is not None:
        tokens.append(cookie.value)
    tokens += [
        offered.removeprefix(TOKEN_SUBPROTOCOL)
        for offered in scope.get("subprotocols", ())
        if offered.startswith(TOKEN_SUBPROTOCOL)
    ]
    return tokens


class GuardMiddleware:
    """Puts a `Guard` before an application and security headers on all its answers.

    `GET /?token=TOKEN` trades the token for a cookie that scripts cannot read.
    """

    def __init__(self, app: ASGIApp, guard: Guard) -> None:
        self._app = app
        self._guard = guard

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """See ASGI."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return

        async def send_guarded(message: Message) -> None:
            if message["type"] in ("http.response.start", "websocket.http.response.start"):
                headers = MutableHeaders(scope=message)
                for name, value in _SECURITY_HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        cookie = self._cookie(scope)
        if cookie is not None:
            await _answer(scope, send_guarded, 303, {"location": "/", "set-cookie": cookie}, b"")
            return
        problem = self._guard.refusal(scope)
        if problem is None:
            await self._app(scope, receive, send_guarded)
        elif scope["type"] == "websocket" and "websocket.http.response" not in scope.get(
            "extensions", {}
        ):
            await send({"type": "websocket.close", "code": 1008, "reason": problem.detail[:120]})
        else:
            await _answer(scope, send_guarded, problem.status, problem.headers(), problem.body())

    def _cookie(self, scope: Scope) -> str | None:
        """Return the cookie for a right token in the address of the dashboard."""
        if scope["type"] != "http" or scope["path"] != "/" or scope["method"] != "GET":
            return None
        for token in parse_qs(scope["query_string"].decode("latin-1")).get("token", ()):
            if self._guard.knows(token):
                secure = "; Secure" if scope["scheme"] == "https" else ""
                return f"{COOKIE}={token}; Path=/; HttpOnly; SameSite=Strict{secure}"
        return None


async def _answer(
    scope: Scope, send: Send, status: int, headers: dict[str, str], body: bytes
) -> None:
    kind = "websocket.http.response" if scope["type"] == "websocket" else "http.response"
    raw = [(name.encode(), value.encode("latin-1", "replace")) for name, value in headers.items()]
    raw.append((b"content-length", str(len(body)).encode()))
    await send({"type": f"{kind}.start", "status": status, "headers": raw})
    await send({"type": f"{kind}.body", "body": body})
