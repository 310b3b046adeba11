"""OpenAPI 3.1 of what the fleet offers now, and a page to read it."""

from __future__ import annotations

import copy
import html
import json
from collections.abc import Iterator
from typing import Any, Final

from vertebra import __version__
from vertebra_gateway.auth import OPEN_PATHS
from vertebra_gateway.commands import Limit, Limits
from vertebra_gateway.profile import Resource
from vertebra_gateway.resources import Robot, Robots


def _object(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "required": list(properties), "properties": properties}


def _list_of(name: str) -> dict[str, Any]:
    return {"type": "array", "items": {"$ref": f"#/components/schemas/{name}"}}


_TEXT: Final = {"type": "string"}
_NUMBER: Final = {"type": "number"}
_COUNT: Final = {"type": "integer", "minimum": 0}
_FLAG: Final = {"type": "boolean"}
_SCHEMA: Final = {"type": ["object", "null"], "description": "A JSON Schema"}
_LIMIT: Final = {
    "type": "object",
    "required": ["unit"],
    "properties": {"min": _NUMBER, "max": _NUMBER, "unit": _TEXT},
}
_SCHEMAS: Final = {
    "Problem": {
        **_object(type=_TEXT, title=_TEXT, status={"type": "integer"}, detail=_TEXT),
        "description": "Problem details, RFC 9457; it may say more, such as `joint` and `limit`",
    },
    "Value": _object(
        key=_TEXT,
        schema={"type": "string", "description": "vertebra/<Type>/<major>"},
        captured_ns={"type": "string", "description": "Nanoseconds since 1970, UTC"},
        age_s=_NUMBER,
        message={"type": "object"},
    ),
    "Robot": _object(
        name=_TEXT,
        description=_TEXT,
        online=_FLAG,
        reason={"type": "string", "description": "Why it is not online"},
        away={
            "type": "object",
            "description": "Why parts of it are away, by their path",
            "additionalProperties": _TEXT,
        },
        resources=_list_of("Resource"),
    ),
    "Resource": _object(
        path=_TEXT,
        kind={"enum": ["read", "call", "stream"]},
        method={"enum": ["GET", "POST"]},
        url=_TEXT,
        key=_TEXT,
        description=_TEXT,
        content_type=_TEXT,
        input=_SCHEMA,
        output=_SCHEMA,
        limits={
            "type": ["object", "null"],
            "description": "Limits by field of the input, then by joint",
            "additionalProperties": {"type": "object", "additionalProperties": _LIMIT},
        },
        takes={"enum": ["application/json", "audio/wav"]},
        reason={"type": "string", "description": "Why it answers 503 now"},
        control={"enum": ["", "sliders", "form", "drive", "none"]},
    ),
    "Fleet": _object(
        services=_list_of("Service"), streams=_list_of("Stream"), clients=_list_of("Client")
    ),
    "Service": _object(
        service=_TEXT,
        instance=_TEXT,
        present=_FLAG,
        version=_TEXT,
        status={"type": ["object", "null"]},
        status_age_s={"type": ["number", "null"]},
    ),
    "Stream": _object(
        key=_TEXT, encoding=_TEXT, rate_hz=_NUMBER, age_s=_NUMBER, lost=_COUNT, viewers=_COUNT
    ),
    "Client": _object(
        client=_TEXT,
        connected_s=_NUMBER,
        subscriptions=_COUNT,
        sent=_COUNT,
        dropped=_COUNT,
        lost=_COUNT,
    ),
    "Ok": _object(ok=_FLAG),
    "YarpRoute": _object(
        yarp=_TEXT,
        key=_TEXT,
        kind=_TEXT,
        mirrored=_FLAG,
        messages=_COUNT,
        bytes=_COUNT,
        dropped=_COUNT,
        refused=_COUNT,
        connected=_FLAG,
        last_error=_TEXT,
    ),
    "YarpPort": _object(
        name=_TEXT,
        carrier=_TEXT,
        address={"type": "string", "description": "host:tcp_port"},
        alive=_FLAG,
        trouble={"type": "string", "description": "Why it is not alive"},
    ),
    "YarpConnection": _object(**{"from": _TEXT, "to": _TEXT, "carrier": _TEXT}),
    "YarpRoutes": _object(routes=_list_of("YarpRoute")),
    "YarpPorts": _object(ports=_list_of("YarpPort")),
    "YarpConnections": _object(connections=_list_of("YarpConnection"), silent=_list_of("YarpPort")),
}
_PROBLEMS: Final = {
    "default": {
        "description": "A problem",
        "content": {
            "application/problem+json": {"schema": {"$ref": "#/components/schemas/Problem"}}
        },
    }
}
_WIRED: Final = {
    "200": {
        "description": "The connection",
        "content": {
            "application/json": {"schema": {"$ref": "#/components/schemas/YarpConnection"}}
        },
    },
    **_PROBLEMS,
}
_IMAGE_HEADERS: Final = {
    "X-Captured-Ns": {"schema": {"type": "string"}},
    "X-Age-S": {"schema": {"type": "string"}},
}


_FIXED: Final = {
    "/healthz": ("Whether the gateway runs", {"$ref": "#/components/schemas/Ok"}),
    "/readyz": ("Whether it reaches the backbone", {"$ref": "#/components/schemas/Ok"}),
    "/metrics": ("Metrics of the whole fleet, as Prometheus text", None),
    "/api/fleet": (
        "Services, streams and clients as they are now",
        {"$ref": "#/components/schemas/Fleet"},
    ),
    "/api/robots": ("All robots and what they offer", _list_of("Robot")),
    "/api/robots/{robot}": (
        "One robot and what it offers",
        {"$ref": "#/components/schemas/Robot"},
    ),
    "/api/yarp/routes": (
        "What the YARP adapter carries, and has carried",
        {"$ref": "#/components/schemas/YarpRoutes"},
    ),
    "/api/yarp/ports": (
        "All registered YARP ports, each asked whether it is alive",
        {"$ref": "#/components/schemas/YarpPorts"},
    ),
    "/api/yarp/connections": (
        "All connections between YARP ports, and the ports that did not answer",
        {"$ref": "#/components/schemas/YarpConnections"},
    ),
}
_WIRING: Final[dict[str, dict[str, Any]]] = {
    "post": {
        "operationId": "api-yarp-connect",
        "summary": "Connect two YARP ports, as `yarp connect` does",
        "requestBody": {
            "required": True,
            "content": {
                "application/json": {
                    "schema": {
                        **_object(**{"from": _TEXT, "to": _TEXT}),
                        "properties": {
                            "from": _TEXT,
                            "to": _TEXT,
                            "carrier": {"type": "string", "default": "tcp"},
                        },
                    }
                }
            },
        },
    },
    "delete": {
        "operationId": "api-yarp-disconnect",
        "summary": "Disconnect two YARP ports, as `yarp disconnect` does",
        "parameters": [
            {"name": name, "in": "query", "required": True, "schema": _TEXT}
            for name in ("from", "to")
        ],
    },
}


def describe(robots: Robots) -> dict[str, Any]:
    """Return the OpenAPI document: the fixed paths, and those of each robot."""
    paths: dict[str, Any] = {
        path: {"get": _fixed_operation(path, summary, schema)}
        for path, (summary, schema) in _FIXED.items()
    }
    for method, operation in _WIRING.items():
        paths["/api/yarp/connections"][method] = {**operation, "responses": _WIRED}
    for robot in robots:
        for resource in robot.profile.resources:
            path = f"/api/robots/{robot.profile.robot}/{resource.path}"
            paths[path] = {resource.http_method.lower(): _operation(robot, resource, "")}
            if resource.kind != "call":
                paths[f"{path}/stream"] = {"get": _operation(robot, resource, "stream")}
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "Vertebra",
            "version": __version__,
            "description": "The robots of this fleet. Streams over WebSocket: see PROTOCOL.md.",
        },
        "paths": paths,
        "components": {
            "schemas": _SCHEMAS,
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
        },
        "security": [{"token": []}],
    }


def _fixed_operation(path: str, summary: str, schema: dict[str, Any] | None) -> dict[str, Any]:
    media_type = "text/plain" if schema is None else "application/json"
    answer = {"description": summary, "content": {media_type: {"schema": schema or _TEXT}}}
    operation: dict[str, Any] = {
        "operationId": path.strip("/").replace("/", "-").replace("{robot}", "one"),
        "summary": summary,
        "responses": {"200": answer, **_PROBLEMS},
    }
    if "{robot}" in path:
        operation["parameters"] = [
            {"name": "robot", "in": "path", "required": True, "schema": _TEXT}
        ]
    if path in OPEN_PATHS:
        operation["security"] = []
    return operation


def _operation(robot: Robot, resource: Resource, leaf: str) -> dict[str, Any]:
    name = "-".join([robot.profile.robot, *resource.path.split("/"), *([leaf] if leaf else [])])
    reason = robot.reason_of(resource)
    operation: dict[str, Any] = {
        "operationId": name,
        "tags": [robot.profile.robot],
        "summary": resource.description or resource.path,
        "description": f"Bound to the key `{resource.key}`."
        + (f" Answers 503 now: {reason}." if reason else ""),
        "responses": {"200": _answer(resource, leaf), **_PROBLEMS},
    }
    if resource.http_method == "POST":
        schema = narrowed(
            resource.input or {"type": "object", "maxProperties": 0},
            robot.limits.get(resource.path, {}),
        )
        if resource.takes == "audio/wav":
            schema = {"type": "string", "format": "binary"}
        operation["requestBody"] = {
            "required": resource.input is not None or resource.takes == "audio/wav",
            "content": {resource.takes: {"schema": schema}},
        }
    return operation


def _answer(resource: Resource, leaf: str) -> dict[str, Any]:
    if leaf:
        if resource.content_type == "image/jpeg":
            described, content = "Images (MJPEG)", "multipart/x-mixed-replace"
            schema = {"type": "string", "format": "binary"}
        else:
            described, content = "Values, each the `data` of an event", "text/event-stream"
            schema = _TEXT
        return {
            "description": f"{described}, the newest at the reader's pace",
            "content": {content: {"schema": schema}},
        }
    if resource.content_type == "image/jpeg":
        return {
            "description": "The newest image",
            "headers": _IMAGE_HEADERS,
            "content": {"image/jpeg": {"schema": {"type": "string", "format": "binary"}}},
        }
    if resource.kind == "call":
        return {
            "description": "What the robot did",
            "content": {"application/json": {"schema": resource.output or {}}},
        }
    return {
        "description": "The newest value",
        "content": {"application/json": {"schema": {"$ref": "#/components/schemas/Value"}}},
    }


def narrowed(schema: dict[str, Any], limits: Limits) -> dict[str, Any]:
    """Return an input's schema with the robot's limits written into it."""
    schema = copy.deepcopy(schema)
    for field, by_joint in limits.items():
        wanted = schema.get("properties", {}).get(field)
        if not isinstance(wanted, dict) or not by_joint:
            continue
        if wanted.get("type") == "object":
            wanted["properties"] = {joint: _number(limit) for joint, limit in by_joint.items()}
            wanted["additionalProperties"] = False
        else:
            lowest = [limit.min for limit in by_joint.values() if limit.min is not None]
            highest = [limit.max for limit in by_joint.values() if limit.max is not None]
            if lowest:
                wanted["minimum"] = min(lowest)
            if highest:
                wanted["maximum"] = max(highest)
    return schema


def _number(limit: Limit) -> dict[str, Any]:
    bounds = {"minimum": limit.min, "maximum": limit.max}
    return {
        "type": "number",
        "description": limit.unit,
        **{name: bound for name, bound in bounds.items() if bound is not None},
    }


def page(document: dict[str, Any]) -> str:
    """Return the document as a page without any script."""
    body = "".join(_page_parts(document))
    title = html.escape(document["info"]["title"])
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}</title>'
        f'<meta name="viewport" content="width=device-width"><h1>{title}</h1>'
        '<p>As a document: <a href="openapi.json">openapi.json</a></p>'
        f"{body}</html>"
    )


def _page_parts(document: dict[str, Any]) -> Iterator[str]:
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            call = html.escape(f"{method.upper()} {path}")
            yield f"<h2><code>{call}</code></h2><p>{html.escape(operation.get('summary', ''))}</p>"
            yield f"<p>{html.escape(operation.get('description', ''))}</p>"
            content = operation.get("requestBody", {}).get("content", {})
            for media_type, described in content.items():
                schema = html.escape(json.dumps(described["schema"], indent=2))
                yield f"<p>{html.escape(media_type)}</p><pre>{schema}</pre>"
