"""Robot profiles: what a robot offers, read from YAML; errors point at file and line."""

from __future__ import annotations

import re
from collections.abc import Hashable
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Final, Literal

import msgspec
import yaml
from jsonschema import Draft202012Validator
from jsonschema.exceptions import SchemaError
from msgspec import Struct, field

from vertebra.errors import ConfigError, NameMappingError
from vertebra.keys import check_key, check_key_expression, intersects

Kind = Literal["read", "call", "stream"]
Place = tuple[str | int, ...]
"""Keys and indices from the root of a YAML document to a value."""

_STEP: Final = re.compile(r"\.(?P<name>\w+)|\[(?P<index>\d+)\]")
_NAME: Final = re.compile(r"[a-z0-9][a-z0-9_-]*")
_ANNOUNCED: Final = frozenset({"control_board", "base"})
_PATH: Final = re.compile(r"[a-z0-9][a-z0-9_-]*(/[a-z0-9][a-z0-9_-]*)*")


class LimitFields(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How the limits of a joint apply to one field of a command.

    Attributes:
        unit: Unit of the field and of its limits.
        min: Name of the lower limit in the robot's answer; None if there is none.
        max: Name of the upper limit in the robot's answer; None if there is none.
    """

    unit: str
    min: str | None = None
    max: str | None = None


class LimitSource(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where the limits of a command come from.

    Attributes:
        source: Path of the resource (`from` in YAML) that answers
            `{"joints": [{"name": ..., <limit>: ...}, ...]}`.
        fields: The limited fields of the input: a number, or a map from joint to number.
    """

    source: str = field(name="from")
    fields: dict[str, LimitFields]


class Part(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A part of a robot that offers what all parts of its kind offer.

    Attributes:
        kind: Name of the file in `parts/` that lists its resources.
        path: Where it is below the robot; theirs are below it.
        key: Where it is on the backbone; theirs are below it.
        goal: JSON Schema of the goals of an action.
    """

    kind: Literal["control_board", "gaze", "face", "speaker", "base", "action"]
    path: str
    key: str
    goal: dict[str, Any] | None = None

    @property
    def presence(self) -> str:
        """The key at which its adapter announces it, empty for kinds that nobody announces."""
        return f"@vertebra/parts/{self.key}" if self.kind in _ANNOUNCED else ""


class Resource(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One thing that a robot offers.

    Attributes:
        path: Where it is below the robot.
        kind: `read` is the newest value of a key, `stream` the same for bulky data (it is not
            kept at hand between two reads), `call` asks the robot to do or tell something.
        key: The key it is bound to.
        method: `GET` makes a call that takes no input and changes nothing.
        content_type: What reading it gives; `image/jpeg` for cameras.
        input: JSON Schema of a call's input, None if it takes none.
        output: JSON Schema of the answer, for documentation.
        takes: What a call is sent: JSON, or a sound that reaches the robot as an `AudioChunk`.
        limits: What bounds the input of a call.
        control: How the dashboard offers a call; by default sliders for joints that move between
            limits, else a form, or a button if there is no input. `drive` is a pad and a map.
        timeout_s: Longest time a call may take.
    """

    path: str
    kind: Kind
    key: str
    description: str = ""
    method: Literal["GET", "POST", ""] = ""
    content_type: Literal["application/json", "image/jpeg"] = "application/json"
    input: dict[str, Any] | None = None
    output: dict[str, Any] | None = None
    takes: Literal["application/json", "audio/wav"] = "application/json"
    limits: LimitSource | None = None
    control: Literal["", "sliders", "form", "drive", "none"] = ""
    timeout_s: float = 10.0

    @property
    def http_method(self) -> str:
        """How it is asked for over HTTP."""
        return self.method or ("POST" if self.kind == "call" else "GET")


class Profile(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One robot.

    Attributes:
        robot: Its name.
        resources: What it offers.
        parts: Its parts; their resources come before the others.
        presence: Key expression of which at least one presence must be there for the robot to be
            online, for example its adapter's; empty if nothing announces it. A part whose own
            presence it matches is away by itself, with all that is below its key.
    """

    robot: str
    resources: tuple[Resource, ...] = ()
    parts: tuple[Part, ...] = ()
    description: str = ""
    presence: str = ""

    def resource(self, path: str) -> Resource | None:
        """Return the resource at `path`."""
        return next((found for found in self.resources if found.path == path), None)

    def watched_parts(self) -> tuple[Part, ...]:
        """Return the parts of which `presence` tells whether they are there."""
        return tuple(
            part
            for part in self.parts
            if self.presence and part.presence and intersects(self.presence, part.presence)
        )


def load_profiles(folder: Path) -> tuple[Profile, ...]:
    """Read all `*.yaml` in a folder, or the one file that it is.

    Raises:
        ConfigError: A profile is wrong or two name the same robot; it says where.
    """
    if not folder.exists():
        raise ConfigError(
            f"there is no folder {str(folder)!r} of robot profiles; set VERTEBRA_GATEWAY_ROBOTS"
        )
    profiles: dict[str, tuple[Profile, Path]] = {}
    for path in sorted(folder.glob("*.yaml")) if folder.is_dir() else [folder]:
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(f"the profile {path} cannot be read: {error}") from error
        profile = parse_profile(text, str(path))
        _, earlier = profiles.setdefault(profile.robot, (profile, path))
        if earlier != path:
            raise ConfigError(f"{path}: robot {profile.robot!r} is described in {earlier} already")
    return tuple(profile for profile, _ in profiles.values())


def parse_profile(text: str, file: str) -> Profile:
    """Return the profile in a YAML text; `file` is named in errors.

    Raises:
        ConfigError: What is wrong and in which line.
    """
    document = _Document(text, file)
    try:
        profile = msgspec.convert(document.value, Profile)
    except msgspec.ValidationError as error:
        reason, _, path = str(error).partition(" - at `$")
        raise document.error(_place(path), reason) from error
    if _NAME.fullmatch(profile.robot) is None:
        raise document.error(
            ("robot",), f"{profile.robot!r} is no robot name; use a-z 0-9 _ - in it"
        )
    if profile.presence:
        _check_expression(document, profile.presence)
    for index, part in enumerate(profile.parts):
        _check_part(document, ("parts", index), part)
    places: list[Place] = [("resources", index) for index in range(len(profile.resources))]
    for index, part in reversed([*enumerate(profile.parts)]):
        offered = resources_of(part)
        places[:0] = [("parts", index)] * len(offered)
        profile = msgspec.structs.replace(profile, resources=(*offered, *profile.resources))
    if not profile.resources:
        raise document.error((), "a robot has parts or resources; this one offers nothing")
    seen: set[str] = set()
    for place, resource in zip(places, profile.resources, strict=True):
        if resource.path in seen:
            raise document.error((*place, "path"), f"resource {resource.path!r} exists already")
        seen.add(resource.path)
        _check_resource(document, place, resource, profile)
    return profile


@cache
def _offered(kind: str) -> tuple[Resource, ...]:
    """Return what parts of a kind offer, with paths and keys below the part."""
    file = resources.files("vertebra_gateway") / "parts" / f"{kind}.yaml"
    return msgspec.convert(yaml.safe_load(file.read_text(encoding="utf-8")), tuple[Resource, ...])


def resources_of(part: Part) -> tuple[Resource, ...]:
    """Return the resources of a part."""
    return tuple(
        msgspec.structs.replace(
            offered,
            path=f"{part.path}/{offered.path}",
            key=f"{part.key}/{offered.key}",
            input=part.goal if part.goal and offered.path == "goal" else offered.input,
            limits=offered.limits
            and msgspec.structs.replace(
                offered.limits, source=f"{part.path}/{offered.limits.source}"
            ),
        )
        for offered in _offered(part.kind)
    )


def _check_expression(document: _Document, expression: str) -> None:
    try:
        check_key_expression(expression)
    except NameMappingError as error:
        raise document.error(("presence",), str(error)) from error


def _check_part(document: _Document, place: Place, part: Part) -> None:
    if part.goal is None:
        return
    if part.kind != "action":
        raise document.error((*place, "goal"), "goal belongs to a part of kind action")
    _check_schema(document, (*place, "goal"), part.goal)


def _check_resource(
    document: _Document, place: Place, resource: Resource, profile: Profile
) -> None:
    if _PATH.fullmatch(resource.path) is None or resource.path.endswith("/stream"):
        raise document.error(
            (*place, "path"),
            f"{resource.path!r} is no path; use chunks of a-z 0-9 _ - with '/' between them, "
            "the last of which is not 'stream'",
        )
    try:
        check_key(resource.key)
    except NameMappingError as error:
        raise document.error((*place, "key"), str(error)) from error
    if resource.kind != "call":
        for name in ("method", "input", "limits", "control"):
            if getattr(resource, name):
                raise document.error((*place, name), f"{name} belongs to a resource of kind call")
    elif resource.input is not None and resource.method == "GET":
        raise document.error((*place, "input"), "a call by GET takes no input")
    if resource.takes == "audio/wav" and (resource.kind != "call" or resource.input is not None):
        raise document.error((*place, "takes"), "a sound is taken by a call, which has no input")
    if not 0.0 < resource.timeout_s <= 600.0:
        raise document.error((*place, "timeout_s"), "timeout_s is above 0 and at most 600")
    for name in ("input", "output"):
        schema = getattr(resource, name)
        if schema is not None:
            _check_schema(document, (*place, name), schema)
    if resource.limits is not None:
        source = profile.resource(resource.limits.source)
        if source is None or source.kind != "call" or source.input is not None:
            raise document.error(
                (*place, "limits", "from"),
                f"{resource.limits.source!r} is no resource of kind call without input here",
            )


def _check_schema(document: _Document, place: Place, schema: dict[str, Any]) -> None:
    try:
        Draft202012Validator.check_schema(schema)
    except SchemaError as error:
        raise document.error(
            (*place, *error.absolute_path), f"this is no JSON Schema: {error.message}"
        ) from error


class _Document:
    """A YAML document of which it is known in which line everything stands."""

    def __init__(self, text: str, file: str) -> None:
        self._file = file
        self._lines: dict[Place, int] = {}
        try:
            self.value = self._parse(text)
        except yaml.MarkedYAMLError as error:
            mark = error.problem_mark
            line = mark.line + 1 if mark is not None else 1
            raise ConfigError(f"{file}, line {line}: this is no YAML: {error.problem}") from error
        except (yaml.YAMLError, RecursionError) as error:
            raise ConfigError(f"{file}: this is no YAML: {error}") from error

    def _parse(self, text: str) -> Any:
        loader = yaml.SafeLoader(text)
        try:
            node = loader.get_single_node()
            return self._read(loader, node, ()) if node is not None else None
        finally:
            loader.dispose()

    def error(self, place: Place, reason: str) -> ConfigError:
        """Return the error that something at `place` is wrong, or near it if it is missing."""
        while place not in self._lines and place:
            place = place[:-1]
        return ConfigError(f"{self._file}, line {self._lines.get(place, 1)}: {reason}")

    def _read(self, loader: yaml.SafeLoader, node: yaml.Node, place: Place) -> Any:
        self._lines[place] = node.start_mark.line + 1
        if isinstance(node, yaml.SequenceNode):
            return [
                self._read(loader, item, (*place, index)) for index, item in enumerate(node.value)
            ]
        if not isinstance(node, yaml.MappingNode):
            return loader.construct_object(node)
        result: dict[Hashable, Any] = {}
        for key_node, value_node in node.value:
            key = loader.construct_object(key_node)
            if not isinstance(key, str) or key in result:
                fault = "is given twice" if key in result else "is no text; write it in quotes"
                line = key_node.start_mark.line + 1
                raise ConfigError(f"{self._file}, line {line}: {key!r} {fault}")
            result[key] = self._read(loader, value_node, (*place, key))
        return result


def _place(path: str) -> Place:
    return tuple(
        step["name"] if step["name"] is not None else int(step["index"])
        for step in _STEP.finditer(path)
    )
