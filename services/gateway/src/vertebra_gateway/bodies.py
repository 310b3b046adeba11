"""What REST takes and gives: JSON, of bounded size."""

from __future__ import annotations

from typing import Any, Final

import msgspec
from fastapi import Request
from starlette.responses import Response

from vertebra_gateway.problems import InputRefusedError, ProblemError

MAX_BODY_BYTES: Final = 1 << 20


class JsonResponse(Response):
    """JSON by msgspec."""

    media_type = "application/json"

    def render(self, content: Any) -> bytes:
        """Return the JSON text."""
        return content if isinstance(content, bytes) else msgspec.json.encode(content)


async def read_body(request: Request) -> Any:
    """Return the JSON value in the body of a request, `{}` if there is none.

    Raises:
        ProblemError: It is too long.
        InputRefusedError: It is no JSON.
    """
    raw = await read_bytes(request)
    if not raw:
        return {}
    try:
        return msgspec.json.decode(raw)
    except (msgspec.MsgspecError, UnicodeError, RecursionError) as error:
        raise InputRefusedError(f"the body is no JSON: {error}") from error


async def read_bytes(request: Request) -> bytes:
    """Return the body of a request; raise `ProblemError` if it is too long."""
    raw = bytearray()
    async for chunk in request.stream():
        raw += chunk
        if len(raw) > MAX_BODY_BYTES:
            raise ProblemError(413, f"the body is longer than {MAX_BODY_BYTES} bytes")
    return bytes(raw)
