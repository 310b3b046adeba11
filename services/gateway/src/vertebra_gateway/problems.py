"""Problem details (RFC 9457): what the web is told when something is wrong."""

from __future__ import annotations

import http
from typing import Any, Final

import msgspec
from msgspec import Struct, field

from vertebra.errors import (
    BusyError,
    CommandRefusedError,
    DeadlineError,
    DecodeError,
    EncodeError,
    NameMappingError,
    NotConnectedError,
    RemoteError,
    VertebraError,
)

MEDIA_TYPE: Final = "application/problem+json"
RETRY_AFTER_S: Final = 1
_TITLES: Final = {422: "Unprocessable Content"}  # its name in RFC 9110; Python 3.11 has an older


class Problem(Struct, frozen=True, kw_only=True):
    """What went wrong, for people and for programs.

    Attributes:
        status: HTTP status.
        detail: One sentence with the values and the remedy.
        more: Further members of the problem document, such as `joint` and `limit`.
    """

    status: int
    detail: str
    more: dict[str, Any] = field(default_factory=dict)

    def document(self) -> dict[str, Any]:
        """Return the members of the problem document."""
        title = _TITLES.get(self.status) or http.HTTPStatus(self.status).phrase
        return {
            "type": "about:blank",
            "title": title,
            "status": self.status,
            "detail": self.detail,
            **self.more,
        }

    def headers(self) -> dict[str, str]:
        """Return the headers that go with it."""
        headers = {"content-type": MEDIA_TYPE}
        if self.status in (429, 503):
            headers["retry-after"] = str(RETRY_AFTER_S)
        if self.status == 401:
            headers["www-authenticate"] = "Bearer"
        if allowed := self.more.get("allowed"):
            headers["allow"] = ", ".join(allowed)
        return headers

    def body(self) -> bytes:
        """Return the problem document as JSON."""
        return msgspec.json.encode(self.document())


class ProblemError(VertebraError):
    """A request that cannot be served; `problem` says why.

    Attributes:
        problem: What the client is told.
    """

    def __init__(self, status: int, detail: str, **more: Any) -> None:
        super().__init__(detail)
        self.problem = Problem(status=status, detail=detail, more=more)


class InputRefusedError(CommandRefusedError):
    """An input outside its schema or limits; nothing was sent to the robot.

    Attributes:
        more: What helps: `joint`, `value`, `limit`, `known`, `path`.
    """

    def __init__(self, detail: str, **more: Any) -> None:
        super().__init__(detail)
        self.more = more


_REMOTE: Final = {
    CommandRefusedError.__name__: 422,
    NameMappingError.__name__: 422,
    BusyError.__name__: 429,
    NotConnectedError.__name__: 503,
    DeadlineError.__name__: 504,
}
_LOCAL: Final = (
    (CommandRefusedError, 422),
    (NameMappingError, 422),
    (EncodeError, 422),
    (BusyError, 429),
    (DecodeError, 502),
    (NotConnectedError, 503),
    (DeadlineError, 504),
)


def problem_of(error: VertebraError) -> Problem:
    """Return what the web is told about an error."""
    if isinstance(error, ProblemError):
        return error.problem
    if isinstance(error, InputRefusedError):
        return Problem(status=422, detail=str(error), more=error.more)
    if isinstance(error, RemoteError):
        known = _REMOTE.get(error.kind)
        return Problem(status=known or 502, detail=error.detail if known else str(error))
    for kind, status in _LOCAL:
        if isinstance(error, kind):
            return Problem(status=status, detail=str(error))
    return Problem(status=502, detail=str(error))
