"""`vertebra ros2 param`: list, get and set the parameters of nodes."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Any, Final

from vertebra.cli.backbone import table
from vertebra.cli.ros2_session import Session, text_of
from vertebra.errors import CommandRefusedError
from vertebra.ros2.names import check_name
from vertebra.ros2.parameters import KINDS, NOT_SET, SERVICES, plain_of, value_of

ANSWER_WITHIN_S: Final = 5.0
_LIST: Final = "/list_parameters"


async def list_parameters(session: Session) -> int:
    """Print the names of the parameters of a node, or of all nodes that are there."""
    nodes = [session.arguments.node]
    if not session.arguments.node:
        await asyncio.sleep(session.arguments.wait)  # nobody tells when all have been found
        nodes = [
            name.removesuffix(_LIST)
            for name, service in session.transport.graph.services().items()
            if name.endswith(_LIST) and not service.problem
        ]
    rows = [("NODE", "PARAMETER", "TYPE")]
    for node in nodes:
        names = await _names(session, node)
        kinds = await _kinds(session, node, names)
        rows += [(node, name, KINDS[kind]) for name, kind in zip(names, kinds, strict=True)]
    print(table(rows))
    return 0


async def get_parameters(session: Session) -> int:
    """Print parameters of a node as YAML."""
    node, names = session.arguments.node, session.arguments.names
    names = names or await _names(session, node)
    values = (await _ask(session, node, "get_parameters", {"names": names}))["values"]
    if len(values) != len(names):
        raise CommandRefusedError(f"{node} has not all of the parameters {', '.join(names)}")
    print(text_of({name: plain_of(one) for name, one in zip(names, values, strict=True)}))
    return 0


async def set_parameter(session: Session) -> int:
    """Set a parameter of a node, as what it is so far."""
    node, name = session.arguments.node, session.arguments.name
    (kind,) = await _kinds(session, node, [name])
    value = value_of(session.arguments.value, kind)
    parameters = {"parameters": [{"name": name, "value": value}]}
    (result,) = (await _ask(session, node, "set_parameters", parameters))["results"]
    if not result["successful"]:
        reason = result["reason"] or "it gives no reason"
        raise CommandRefusedError(f"{node} does not set {name}: {reason}")
    return 0


async def _names(session: Session, node: str) -> list[str]:
    return sorted((await _ask(session, node, "list_parameters", {}))["result"]["names"])


async def _kinds(session: Session, node: str, names: list[str]) -> list[int]:
    """Return the kinds of parameters, not set for all if the node does not know one of them."""
    answer = await _ask(session, node, "get_parameter_types", {"names": names})
    kinds: list[int] = answer["types"].tolist()
    return kinds if len(kinds) == len(names) else [NOT_SET] * len(names)


async def _ask(
    session: Session, node: str, service: str, request: Mapping[str, Any]
) -> dict[str, Any]:
    name = check_name(f"{node}/{service}")
    await session.type_of(name)  # tells who is not there
    return await session.call(name, request, timeout_s=ANSWER_WITHIN_S, type_name=SERVICES[service])
