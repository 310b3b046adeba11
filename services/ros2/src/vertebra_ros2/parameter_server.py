"""The parameters of our node: its settings, to be read by `ros2 param` and not to be set."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any, Final

import msgspec

from vertebra.errors import CodecError, EncodeError
from vertebra.ros2.actions import stamp_of
from vertebra.ros2.parameters import EVENT_TYPE, EVENTS, SERVICES, value_of
from vertebra.ros2.qos import Qos
from vertebra_ros2.carried import Kit
from vertebra_ros2.settings import Ros2Settings

EVENTS_DEPTH: Final = 1000
"""As ROS keeps them."""
_SIMULATED_TIME: Final = "use_sim_time"
"""Every ROS node has this parameter; our stamps are those of the clock."""


class Parameter(msgspec.Struct, frozen=True, kw_only=True):
    """A parameter of our node."""

    value: Mapping[str, Any]
    description: str
    remedy: str


def parameters_of(settings: Ros2Settings) -> dict[str, Parameter]:
    """Return the settings as parameters."""
    prefix = settings.model_config.get("env_prefix", "")
    found = {
        _SIMULATED_TIME: Parameter(
            value=value_of(plain=False), description="", remedy="this node has no simulated time"
        )
    }
    for name, plain in settings.model_dump(mode="json").items():
        field = type(settings).model_fields[name]
        variable = field.validation_alias or f"{prefix}{name.upper()}"
        found[name] = Parameter(
            value=_value(plain),
            description=field.description or "",
            remedy=f"set {variable} and restart the service",
        )
    return found


def _value(plain: Any) -> dict[str, Any]:
    try:
        return value_of(plain) if plain != [] else {"type": 9, "string_array_value": []}
    except EncodeError:
        return value_of(msgspec.json.encode(plain).decode())


class ParameterServer:
    """Answers the services by which ROS asks our node for its parameters."""

    def __init__(self, kit: Kit) -> None:
        settings = kit.context.settings
        node = f"{settings.namespace.rstrip('/')}/{settings.node}"
        self._kit = kit
        self._parameters = parameters_of(settings)
        answers: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
            "list_parameters": self._list,
            "get_parameters": self._get,
            "get_parameter_types": self._types,
            "describe_parameters": self._describe,
            "set_parameters": self._set,
            "set_parameters_atomically": self._set_atomically,
        }
        self._servers = [
            kit.transport.server(f"{node}/{name}", SERVICES[name], self._serve(name, answer))
            for name, answer in answers.items()
        ]
        self._events = kit.transport.writer(EVENTS, EVENT_TYPE, Qos(depth=EVENTS_DEPTH))
        event = {
            "stamp": stamp_of(time.time_ns()),
            "node": node,
            "new_parameters": [
                {"name": name, "value": one.value} for name, one in self._parameters.items()
            ],
        }
        self._events.write(kit.cdr.encode(event, EVENT_TYPE))

    def _serve(self, name: str, answer: Callable[[dict[str, Any]], dict[str, Any]]) -> Any:
        cdr, type_name = self._kit.cdr, SERVICES[name]

        async def serve(payload: bytes) -> bytes | None:
            try:
                request = cdr.decode(payload, f"{type_name}_Request")
            except CodecError as error:
                self._kit.refused.inc()
                self._kit.report("parameters", f"a request got no answer: {error}")
                return None
            return cdr.encode(answer(request), f"{type_name}_Response")

        return serve

    def _list(self, request: dict[str, Any]) -> dict[str, Any]:
        """Our names have no dots: none is below a prefix but the name itself."""
        prefixes = request["prefixes"]
        names = [name for name in self._parameters if not prefixes or name in prefixes]
        return {"result": {"names": sorted(names), "prefixes": []}}

    def _known(self, request: dict[str, Any]) -> list[tuple[str, Parameter]]:
        """Return what is asked for; nothing if one name of it is unknown, as rclpy does."""
        names = request["names"]
        if not all(name in self._parameters for name in names):
            return []
        return [(name, self._parameters[name]) for name in names]

    def _get(self, request: dict[str, Any]) -> dict[str, Any]:
        return {"values": [one.value for _, one in self._known(request)]}

    def _types(self, request: dict[str, Any]) -> dict[str, Any]:
        return {"types": [one.value["type"] for _, one in self._known(request)]}

    def _describe(self, request: dict[str, Any]) -> dict[str, Any]:
        descriptors = [
            {
                "name": name,
                "type": one.value["type"],
                "description": one.description,
                "additional_constraints": one.remedy,
                "read_only": True,
            }
            for name, one in self._known(request)
        ]
        return {"descriptors": descriptors}

    def _set(self, request: dict[str, Any]) -> dict[str, Any]:
        return {"results": [self._refusal(one["name"]) for one in request["parameters"]]}

    def _set_atomically(self, request: dict[str, Any]) -> dict[str, Any]:
        refusals = [self._refusal(one["name"]) for one in request["parameters"]]
        return {"result": refusals[0] if refusals else {"successful": True}}

    def _refusal(self, name: str) -> dict[str, Any]:
        known = self._parameters.get(name)
        reason = f"{name} is read-only: {known.remedy}" if known else f"{name} was not declared"
        return {"successful": False, "reason": reason}

    def close(self) -> None:
        """End it."""
        for server in self._servers:
            server.close()
        self._events.close()
