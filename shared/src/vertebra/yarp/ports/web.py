"""The carrier http: what a port shows to a browser, and how scripts call its owner.

    GET /                      a page that describes the port
    GET /data=list             a page with the owner's reply to the bottle `list`
    POST /form  data=list      the same, from the field on that page
    GET /?req=bot%20list       the reply as JSON; with `&admin=1` that of the port itself

Pages and JSON look as YARP makes them. YARP answers everybody; a browser however also asks for
what some other site wants. That is refused, and over http a port tells, but changes nothing.
"""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable, Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING, Final
from urllib.parse import parse_qsl

from vertebra.yarp.naming.names import Contact, parse_registration
from vertebra.yarp.ports.admin import administer, describe, fail
from vertebra.yarp.ports.incoming import Reply
from vertebra.yarp.protocol.bottle import Value
from vertebra.yarp.protocol.receiver import Request
from vertebra.yarp.protocol.text import from_text, to_text

if TYPE_CHECKING:
    from vertebra.yarp.ports.switchboard import Switchboard

AskOwner = Callable[[str], Awaitable[Reply]]

_TELLING: Final = frozenset({"help", "ver", "list", "get", "prop"})
_LINK_COLUMN: Final = 30


async def answer(board: Switchboard, request: Request, ask_owner: AskOwner) -> bytes:
    """Return the whole response to a request; the connection ends after it."""
    if _is_from_elsewhere(request):
        return _plain("403 Forbidden", "This YARP port is not for pages of other sites.")
    fields = _fields(request)
    if "req" in fields:
        text = fields["req"]
        reply = await (_tell(board, text) if "admin" in fields else ask_owner(text))
        return _json(reply)
    if "data" in fields:
        text = fields["data"]
        return _page(board, text, _lines(await ask_owner(text)))
    if request.target == "/":
        return _page(board, "", describe(board))
    return _plain("404 Not Found", "A YARP port has / and /data=... and /?req=... and /form.")


def to_json(values: Sequence[Value]) -> object:
    """Return what becomes the JSON of a bottle: an object where YARP sees pairs, else an array."""
    if values[:1] == ["list"]:
        return [_plain_value(value) for value in values[1:]]
    has_type = bool(values) and not isinstance(values[0], list)
    pairs = values[1:] if has_type else values
    is_object = len(values) > 1 and all(isinstance(each, list) and len(each) == 2 for each in pairs)
    if not is_object and values[:1] != ["dict"]:
        return [_plain_value(value) for value in values]
    found = {"type": _plain_value(values[0])} if has_type and values[0] != "dict" else {}
    for pair in pairs:
        if isinstance(pair, list) and len(pair) == 2:
            found[str(_plain_value(pair[0]))] = _plain_value(pair[1])
    return found


def _plain_value(value: Value) -> object:
    if isinstance(value, list):
        return to_json(value)
    if isinstance(value, str | int | float):
        return value
    return to_text([value])


def _is_from_elsewhere(request: Request) -> bool:
    origin = request.headers.get("origin")
    if origin is not None and origin.partition("://")[2] != request.headers.get("host"):
        return True
    return request.headers.get("sec-fetch-site", "none") not in ("none", "same-origin")


def _fields(request: Request) -> dict[str, str]:
    query = request.body if request.method == "POST" else request.target.lstrip("/?")
    return dict(parse_qsl(query, keep_blank_values=True, max_num_fields=100))


async def _tell(board: Switchboard, text: str) -> Reply:
    words = from_text(text)
    if words[:1] and words[0] in _TELLING and "set" not in words[:2]:
        return await administer(board, words)
    return fail("over http a port tells, but changes nothing")


def _json(reply: Reply) -> bytes:
    values = _lines(reply) if isinstance(reply, bytes) else to_json(reply or ())
    head = "HTTP/1.1 200 OK\nContent-Type: application/json\nAccess-Control-Allow-Origin: *\n\n"
    return (head + json.dumps(values, ensure_ascii=False) + "\n\n").encode("utf-8", "replace")


def _lines(reply: Reply) -> list[str]:
    if isinstance(reply, bytes):
        return reply.decode("utf-8", "replace").splitlines()
    return [] if reply is None else [to_text(reply)]


def _page(board: Switchboard, data: str, lines: Iterable[str]) -> bytes:
    own, root = _url(board.contact), f"http://{board.names.host}:{board.names.tcp_port}"
    shown = "".join(filter(None, map(_shown, lines)))
    return (
        "HTTP/1.1 200 OK\r\nContent-Type: text/html\r\n\r\n"
        f'<html><head><link href="{root}/web/main.css" rel="stylesheet" type="text/css"/></head>'
        f"<body bgcolor='#ffffcc'><h1>yarp port {escape(board.name)}</h1>\n"
        f'<p>(<a href="{root}/data=list">All ports</a>)&nbsp;&nbsp;\n'
        f'(<a href="{own}/">connections</a>)&nbsp;&nbsp;\n'
        f'(<a href="{own}/data=help">help</a>)&nbsp;&nbsp;\n'
        f'(<a href="{own}/r">read</a>)&nbsp;&nbsp;\n'
        "</p>\n<p>\n"
        f'<form method="post" action="{own}/form"><input type=text name=data '
        f'value="{escape(data)}"><input type=submit value="send data"></form></p>\n'
        f"<pre>\n\r\n{shown}\n\n"
    ).encode("utf-8", "replace")


def _shown(line: str) -> str:
    """Return a line of a page; a registered port is a link to its own page, others are left out."""
    contact = parse_registration(line)
    if contact is None:
        return escape(line, quote=False) + "\n"
    if contact.carrier != "tcp":
        return ""
    name = escape(contact.name)
    gap = " " * (_LINK_COLUMN - len(contact.name))
    return f'<a href="{_url(contact)}">{name}</A> {gap}(tcp:/{name})\n'


def _url(contact: Contact) -> str:
    return f"http://{contact.host}:{contact.tcp_port}"


def _plain(status: str, text: str) -> bytes:
    return (
        f"HTTP/1.1 {status}\r\nConnection: close\r\nContent-Type: text/plain\r\n\r\n{text}\r\n"
    ).encode()
