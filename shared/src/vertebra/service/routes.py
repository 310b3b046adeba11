"""Routes in YAML files, with errors that point at the line."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final, TypeVar

import msgspec
import yaml

from vertebra.errors import ConfigError, VertebraError
from vertebra.service.run import Context

LOOK_EVERY_S: Final = 1.0


class Route(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One mapping between a foreign name and a key; adapters say what else it has."""

    key: str

    @property
    def claims(self) -> tuple[str, ...]:
        """What no other route may have, in words; raises `VertebraError` for a bad name."""
        raise NotImplementedError


R = TypeVar("R", bound=Route)


def read_routes(path: Path | None, kinds: Mapping[str, type[R]]) -> tuple[R, ...]:
    """Return the routes in a YAML file, none if `path` is None.

    Args:
        path: The file; it holds a list of routes for each kind.
        kinds: The kinds that there are.

    Raises:
        ConfigError: A line is wrong; the text says which and why.
    """
    if path is None:
        return ()
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"the routes in {str(path)!r} cannot be read: {error}") from error
    return parse_routes(text, str(path), kinds)


def parse_routes(text: str, where: str, kinds: Mapping[str, type[R]]) -> tuple[R, ...]:
    """Return the routes in YAML text; `where` names it in errors. Raises `ConfigError`."""
    try:
        root = yaml.compose(text, yaml.SafeLoader)
        document = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ConfigError(f"{where} is no YAML: {error}") from error
    if root is None or document is None:
        return ()
    if not isinstance(document, dict) or not document.keys() <= kinds.keys():
        raise ConfigError(f"{where}: expected a map with the keys {', '.join(kinds)}")
    routes: list[R] = []
    taken: dict[str, int] = {}
    for kind, item, line in _items(root, document, where):
        try:
            route = msgspec.convert(item, kinds[kind])
            claims = route.claims
        except (msgspec.ValidationError, VertebraError) as error:
            raise ConfigError(f"{where}:{line}: {error}") from error
        for claim in claims:
            first = taken.setdefault(claim, line)
            if first != line:
                raise ConfigError(f"{where}:{line}: {claim} has a route in line {first} already")
        routes.append(route)
    return tuple(routes)


def _items(
    root: yaml.Node, document: Mapping[str, Any], where: str
) -> Iterator[tuple[str, Any, int]]:
    for key_node, value_node in root.value:
        kind = str(key_node.value)
        items = document[kind]
        if items is None:
            continue
        if not isinstance(value_node, yaml.SequenceNode):
            line = value_node.start_mark.line + 1
            raise ConfigError(f"{where}:{line}: {kind} is a list of routes")
        for node, item in zip(value_node.value, items, strict=True):
            yield kind, item, node.start_mark.line + 1


async def follow_routes(
    context: Context[Any],
    path: Path,
    kinds: Mapping[str, type[R]],
    carry: Callable[[tuple[R, ...]], Awaitable[None]],
) -> None:
    """Let changes of a routes file be carried; a faulty one is reported and changes nothing."""
    seen_ns = (await asyncio.to_thread(path.stat)).st_mtime_ns
    while True:
        await asyncio.sleep(LOOK_EVERY_S)
        try:
            now_ns = (await asyncio.to_thread(path.stat)).st_mtime_ns
            if now_ns == seen_ns:
                continue
            seen_ns = now_ns
            await carry(await asyncio.to_thread(read_routes, path, kinds))
        except (OSError, ConfigError) as error:
            context.report("routes", "warning", f"kept as they were: {error}")
        else:
            context.report("routes", "ok")
