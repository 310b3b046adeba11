"""Parameters of ROS nodes as plain calls: `list`, `get`, `set` and `describe` in JSON."""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from typing import Any, Final

import msgspec

from vertebra.bus import Reply, Request
from vertebra.errors import CommandRefusedError, EncodeError
from vertebra.ros2.parameters import KINDS, NOT_SET, plain_of, value_of
from vertebra.service.actions import JSON, json_reply
from vertebra_ros2.carried import Kit
from vertebra_ros2.routes import Parameters
from vertebra_ros2.services import Clients

MIRRORED: Final = "/parameters/"
"""Stands between the name of a node and the word of a call, below `ros2/`."""


class _Some(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Which parameters; all of them if none is named."""

    names: list[str] = []


class _Where(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Below which names, and how deep; everything unless said otherwise."""

    prefixes: list[str] = []
    depth: int = 0


class NodeParameters:
    """The parameters of one ROS node."""

    def __init__(self, clients: Clients, node: str) -> None:
        self._clients = clients
        self._node = node
        self._words: dict[str, Callable[[Request], Awaitable[dict[str, Any]]]] = {
            "list": self._list,
            "get": self._get,
            "set": self._set,
            "describe": self._describe,
        }

    async def call(self, word: str, request: Request) -> Reply:
        """Answer one of the calls; raise `CommandRefusedError` if there is no such one."""
        answer = self._words.get(word)
        if answer is None:
            known = ", ".join(self._words)
            raise CommandRefusedError(f"parameters are asked for by {known}, not by {word!r}")
        return json_reply(await answer(request))

    async def _list(self, request: Request) -> dict[str, Any]:
        where = _read(request, _Where)
        document = {"prefixes": where.prefixes, "depth": where.depth}
        answer = await self._ask("list_parameters", document, request)
        return {"names": sorted(answer["result"]["names"])}

    async def _get(self, request: Request) -> dict[str, Any]:
        names = await self._names(request)
        values = await self._of_each("get_parameters", "values", names, request)
        return {name: plain_of(value) for name, value in zip(names, values, strict=True)}

    async def _describe(self, request: Request) -> dict[str, Any]:
        names = await self._names(request)
        found = await self._of_each("describe_parameters", "descriptors", names, request)
        return {one["name"]: {**one, "type": KINDS[one["type"]]} for one in found}

    async def _set(self, request: Request) -> dict[str, Any]:
        """Set all of `{name: value}`, or none."""
        wanted: dict[str, Any] = _read(request, dict[str, Any])
        names = [*wanted]
        kinds = (await self._ask("get_parameter_types", {"names": names}, request))["types"]
        if len(kinds) != len(names):  # some are new to the node
            kinds = [NOT_SET] * len(names)
        parameters = _records(wanted, kinds)
        answer = await self._ask("set_parameters_atomically", {"parameters": parameters}, request)
        if not answer["result"]["successful"]:
            reason = answer["result"]["reason"] or "the node gives no reason"
            raise CommandRefusedError(f"{self._node} sets none of {', '.join(names)}: {reason}")
        return wanted

    async def _names(self, request: Request) -> list[str]:
        names: list[str] = _read(request, _Some).names
        if names:
            return names
        answer = await self._ask("list_parameters", {}, request)
        return sorted(answer["result"]["names"])

    async def _of_each(
        self, service: str, field: str, names: Sequence[str], request: Request
    ) -> Sequence[Any]:
        answer: Sequence[Any] = (await self._ask(service, {"names": names}, request))[field]
        if len(answer) != len(names):
            raise CommandRefusedError(
                f"{self._node} has not all of the parameters {', '.join(names)}; 'list' says which"
            )
        return answer

    async def _ask(self, service: str, document: Mapping[str, Any], request: Request) -> Any:
        asked = msgspec.structs.replace(
            request, payload=msgspec.json.encode(document), encoding=JSON
        )
        return json.loads((await self._clients.call(f"{self._node}/{service}", "", asked)).payload)


class InboundParameters:
    """The parameters of a ROS node: the calls `list`, `get`, `set` and `describe` below a key."""

    def __init__(self, kit: Kit, route: Parameters, clients: Clients) -> None:
        self._kit = kit
        self._route = route
        self._node = NodeParameters(clients, route.ros)
        self._served = kit.context.bus.serve(f"{route.key}/*", self._answer)

    def look(self) -> None:
        """Tell when the node cannot be asked."""
        offered = self._kit.transport.graph.service(f"{self._route.ros}/get_parameters")
        self._report("it is not there" if offered is None else offered.problem)

    def _report(self, problem: str) -> None:
        self._kit.report(f"parameters of {self._route.ros}", problem)

    async def _answer(self, request: Request) -> Reply:
        return await self._node.call(request.key.rpartition("/")[2], request)

    async def close(self) -> None:
        """End it."""
        self._served.close()
        self._report("")


async def call_mirrored(kit: Kit, clients: Clients, name: str, request: Request) -> Reply:
    """Call what has no route: a ROS service, or the parameters of a node."""
    node, between, word = name.rpartition(MIRRORED)
    graph = kit.transport.graph
    if between and graph.service(name) is None and graph.service(f"{node}/get_parameters"):
        return await NodeParameters(clients, node).call(word, request)
    return await clients.call(name, "", request)


def _records(wanted: Mapping[str, Any], kinds: Iterable[int]) -> list[dict[str, Any]]:
    try:
        return [
            {"name": name, "value": value_of(plain, kind)}
            for (name, plain), kind in zip(wanted.items(), kinds, strict=True)
        ]
    except EncodeError as error:
        raise CommandRefusedError(str(error)) from error


def _read(request: Request, kind: Any) -> Any:
    try:
        return msgspec.json.decode(request.payload or b"{}", type=kind)
    except msgspec.DecodeError as error:
        raise CommandRefusedError(f"this is no request for parameters: {error}") from error
