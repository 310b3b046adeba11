"""What the commands that talk to a running fleet have in common."""

from __future__ import annotations

import argparse
import asyncio
import json
import math
import os
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager
from textwrap import indent
from typing import Any, Final

import msgspec
import yaml

from vertebra.bus import DEFAULT_ROUTER, ZenohBus
from vertebra.errors import ConfigError, DeadlineError, EncodeError, NotConnectedError
from vertebra.messages import Array, Message
from vertebra.service.logs import configure_logs

JSON_ENCODING: Final = "application/json"
_OPEN_TIMEOUT_S: Final = 3.0
_SHOWN_ITEMS: Final = 32

Command = Callable[[argparse.Namespace], Awaitable[int]]


def on_backbone(parser: argparse.ArgumentParser, command: Command) -> None:
    """Make `command` what `parser` runs, and let the user say where the router is."""
    parser.add_argument(
        "--router",
        default=os.environ.get("VERTEBRA_ROUTER") or DEFAULT_ROUTER,
        help="Zenoh locator of the router (default: VERTEBRA_ROUTER, or %(default)s)",
    )
    parser.set_defaults(run=lambda arguments: asyncio.run(_run(command, arguments)))


async def _run(command: Command, arguments: argparse.Namespace) -> int:
    configure_logs("vertebra", "error", "text")
    return await command(arguments)


@asynccontextmanager
async def backbone(router: str) -> AsyncIterator[ZenohBus]:
    """Be a member of the backbone while the block runs.

    Raises:
        NotConnectedError: No router answers there.
    """
    try:
        bus = await ZenohBus.open(router, shared_memory=False, timeout_s=_OPEN_TIMEOUT_S)
    except DeadlineError as error:
        raise NotConnectedError(
            f"{error}; start the fleet with ./vertebra up, or name its router with --router"
        ) from error
    try:
        yield bus
    finally:
        await bus.close()


def read_json(text: str) -> Any:
    """Return the value in a JSON text that the user typed; raise `ConfigError`."""
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise ConfigError(f"{text!r} is not JSON: {error}") from error


def readable(message: Message) -> dict[str, Any]:
    """Return the fields of a message as plain values; large arrays and bytes only in words."""
    fields: dict[str, Any] = msgspec.to_builtins(
        message, builtin_types=(bytes, bytearray), str_keys=True, enc_hook=_plain
    )
    return {name: _without_bytes(value) for name, value in fields.items()}


def _plain(value: Any) -> Any:
    if not isinstance(value, Array):
        return f"a {type(value).__qualname__}"
    shape = " x ".join(map(str, value.shape))
    if math.prod(value.shape) > _SHOWN_ITEMS:
        return f"{shape} of {value.dtype}, {value.nbytes} bytes"
    try:
        return value.tolist()
    except EncodeError:
        return f"{shape} of {value.dtype}"


def _without_bytes(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_bytes(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_bytes(item) for item in value]
    if isinstance(value, bytes | bytearray):
        return f"{len(value)} bytes: {value[:_SHOWN_ITEMS].hex(' ')}"
    return value


def as_yaml(fields: dict[str, Any]) -> str:
    """Return fields as YAML for people, small collections on one line."""
    lines = []
    for name, value in fields.items():
        text = yaml.safe_dump(
            value, sort_keys=False, allow_unicode=True, default_flow_style=None, width=100
        )
        text = text.removesuffix("...\n").rstrip()
        is_block = isinstance(value, dict | list) and text[0] not in "{["
        lines.append(f"{name}:\n{indent(text, '  ')}" if is_block else f"{name}: {text}")
    return "\n".join(lines)


def table(rows: Sequence[tuple[str, ...]]) -> str:
    """Return rows as text with aligned columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)
    return "\n".join(lines)
