"""ROS 2 types, known at run time: the standard packages, and folders of `.msg .srv .action .idl`.

A service is three types more than its name says (`_Request`, `_Response`, `_Event`), an action
is nine; they are derived here as rosidl derives them. `Types.hash_of` is RIHS01 of REP 2016.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Container, Iterator
from pathlib import Path
from typing import Any, Final, Self

from rosbags.typesys import Stores, get_typestore

from vertebra.errors import CodecNotFoundError, ConfigError, NameMappingError
from vertebra.ros2.interface_files import (
    PRIMITIVES,
    Definition,
    Field,
    definition_of,
    read_idl,
    read_text,
)
from vertebra.ros2.names import check_type

INTERFACES: Final = Path(__file__).parent / "interfaces"
"""Packages that the type store of rosbags does not hold, or not whole: fields, as of Jazzy.

Services and actions of the standard packages, Nav2's navigation, `audio_common_msgs` 0.4
(ros-drivers) and `hri_msgs` 2.3 (ROS4HRI).
"""

_NESTED: Final = 1
_BOUNDED_TEXT: Final = 4
_PLURAL: Final = {"one": 0, "array": 48, "bounded": 96, "sequence": 144}
_EMPTY: Final[Definition] = (Field("structure_needs_at_least_one_member", "uint8"),)


class Types:
    """Definitions by full name, such as `sensor_msgs/msg/Image`."""

    def __init__(self) -> None:
        self._definitions: dict[str, Definition] = {}
        self._sources: dict[str, str] = {}
        self._hashes: dict[str, str] = {}

    @classmethod
    def standard(cls, *folders: Path) -> Self:
        """Return the types of ROS 2 Jazzy, and those in `folders`; reads files.

        Of the packages that we bring (`INTERFACES`), those that a lab has itself are left out:
        there are others of the same name, such as the `audio_common_msgs` of mgonzs13.

        Raises:
            ConfigError: A file is wrong, or says something else than another one.
        """
        types = cls()
        store = get_typestore(Stores.ROS2_JAZZY)
        for name, (_, members) in store.fielddefs.items():
            types._add(name, definition_of(members, "ROS 2 Jazzy"), "ROS 2 Jazzy")
        jazzy = {name.partition("/")[0] for name in types}
        for folder in folders:
            types.add_folder(folder)
        theirs = {name.partition("/")[0] for name in types} - jazzy
        types.add_folder(INTERFACES, without=theirs)
        return types

    def __contains__(self, name: object) -> bool:
        return name in self._definitions

    def __iter__(self) -> Iterator[str]:
        return iter(self._definitions)

    def definition(self, name: str) -> Definition:
        """Return the fields of a type.

        Raises:
            CodecNotFoundError: It is not known, or one that it is made of.
        """
        try:
            return self._definitions[name]
        except KeyError:
            raise CodecNotFoundError(
                f"the ROS type {name} is not known here; put the folder of its package, with "
                "msg/, srv/ and action/ in it, where VERTEBRA_ROS2_TYPES points"
            ) from None

    def add_folder(self, folder: Path, *, without: Container[str] = ()) -> None:
        """Add every definition in `<folder>/**/<package>/{msg,srv,action}/`.

        Packages in `without` are left out, and so is an `.idl` beside the file it was made of.

        Raises:
            ConfigError: A file is wrong, or says something else than another one.
        """
        if not folder.is_dir():
            raise ConfigError(f"the folder of ROS types {str(folder)!r} does not exist")
        for file in sorted(folder.rglob("*.*")):
            kind = file.parent.name
            if kind not in ("msg", "srv", "action") or file.suffix not in (f".{kind}", ".idl"):
                continue
            if file.parent.parent.name in without:
                continue
            if file.suffix == ".idl" and file.with_suffix(f".{kind}").is_file():
                continue
            text = _read(file)
            if file.suffix == ".idl":
                self.add_idl(text, str(file))
            else:
                self.add_text(f"{file.parent.parent.name}/{kind}/{file.stem}", text, str(file))
        for name in self._definitions:
            self._check_finite(name, ())

    def _check_finite(self, name: str, within: tuple[str, ...]) -> None:
        if name in within:
            raise ConfigError(
                f"{self._sources[name]}: {name} is a part of itself: {' > '.join(within)}"
            )
        for field in self._definitions.get(name, ()):
            if field.type not in PRIMITIVES:
                self._check_finite(field.type, (*within, name))

    def add_text(self, name: str, text: str, where: str) -> None:
        """Add a `.msg`, `.srv` or `.action`; which one is in the middle of `name`.

        Raises:
            ConfigError: A line is wrong, or `name` is known with other fields.
        """
        package, kind, _ = name.split("/")
        parts = {"msg": 1, "srv": 2, "action": 3}[kind]
        definitions = read_text(package, text, where, parts)
        if kind == "msg":
            self._add(name, definitions[0], where)
        elif kind == "srv":
            self._add_service(name, definitions[0], definitions[1], where)
        else:
            goal, result, feedback = definitions
            self._add_action(name, goal, result, feedback, where)

    def add_idl(self, text: str, where: str) -> None:
        """Add the structs of an `.idl`; those of services and actions complete their kind.

        Raises:
            ConfigError: It cannot be read, or a type is known with other fields.
        """
        structs = read_idl(text, where)
        for name, fields in structs.items():
            base, _, part = name.rpartition("_")
            if part == "Request" and f"{base}_Response" in structs:
                self._add_service(base, fields, structs[f"{base}_Response"], where)
            elif part == "Goal" and {f"{base}_Result", f"{base}_Feedback"} <= structs.keys():
                rest = (structs[f"{base}_Result"], structs[f"{base}_Feedback"])
                self._add_action(base, fields, *rest, where)
            else:
                self._add(name, fields, where)

    def _add(self, name: str, fields: Definition, where: str) -> None:
        try:
            check_type(name)
        except NameMappingError as error:
            raise ConfigError(f"{where}: {error}") from error
        fields = fields or _EMPTY
        known = self._definitions.get(name)
        if known is not None and known != fields:
            raise ConfigError(
                f"{where}: {name} is {_words(fields)}, but {self._sources[name]} says it is "
                f"{_words(known)}; remove one of them"
            )
        self._definitions[name] = fields
        self._sources.setdefault(name, where)

    def _add_service(self, name: str, request: Definition, reply: Definition, where: str) -> None:
        self._add(f"{name}_Request", request, where)
        self._add(f"{name}_Response", reply, where)
        event = (
            Field("info", "service_msgs/msg/ServiceEventInfo"),
            Field("request", f"{name}_Request", "bounded", 1),
            Field("response", f"{name}_Response", "bounded", 1),
        )
        self._add(f"{name}_Event", event, where)
        whole = (
            Field("request_message", f"{name}_Request"),
            Field("response_message", f"{name}_Response"),
            Field("event_message", f"{name}_Event"),
        )
        self._add(name, whole, where)

    def _add_action(
        self, name: str, goal: Definition, result: Definition, feedback: Definition, where: str
    ) -> None:
        for part, fields in (("Goal", goal), ("Result", result), ("Feedback", feedback)):
            self._add(f"{name}_{part}", fields, where)
        goal_id = Field("goal_id", "unique_identifier_msgs/msg/UUID")
        accepted = (Field("accepted", "bool"), Field("stamp", "builtin_interfaces/msg/Time"))
        ended = (Field("status", "int8"), Field("result", f"{name}_Result"))
        self._add_service(
            f"{name}_SendGoal", (goal_id, Field("goal", f"{name}_Goal")), accepted, where
        )
        self._add_service(f"{name}_GetResult", (goal_id,), ended, where)
        told = (goal_id, Field("feedback", f"{name}_Feedback"))
        self._add(f"{name}_FeedbackMessage", told, where)
        whole = (
            Field("goal", f"{name}_Goal"),
            Field("result", f"{name}_Result"),
            Field("feedback", f"{name}_Feedback"),
            Field("send_goal_service", f"{name}_SendGoal"),
            Field("get_result_service", f"{name}_GetResult"),
            Field("feedback_message", f"{name}_FeedbackMessage"),
        )
        self._add(name, whole, where)

    def hash_of(self, name: str) -> str:
        """Return the RIHS01 hash of a type; raise `CodecNotFoundError`."""
        if name not in self._hashes:
            self._hashes[name] = self._hash(name)
        return self._hashes[name]

    def _hash(self, name: str) -> str:
        found = {name: self._describe(name)}
        waiting = [name]
        while waiting:
            for field in self.definition(waiting.pop()):
                if field.type not in PRIMITIVES and field.type not in found:
                    found[field.type] = self._describe(field.type)
                    waiting.append(field.type)
        own = found.pop(name)
        document = {
            "type_description": own,
            "referenced_type_descriptions": [found[other] for other in sorted(found)],
        }
        return f"RIHS01_{hashlib.sha256(json.dumps(document).encode()).hexdigest()}"

    def _describe(self, name: str) -> dict[str, Any]:
        fields = [
            {"name": field.name, "type": _describe_type(field)} for field in self.definition(name)
        ]
        return {"type_name": name, "fields": fields}


def _read(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{file}: this cannot be read: {error}") from error


def _describe_type(field: Field) -> dict[str, Any]:
    number = PRIMITIVES.get(field.type, _NESTED)
    return {
        "type_id": number + _PLURAL[field.plural] + (_BOUNDED_TEXT if field.max_text else 0),
        "capacity": field.count,
        "string_capacity": field.max_text,
        "nested_type_name": "" if field.type in PRIMITIVES else field.type,
    }


def _words(fields: Definition) -> str:
    return "{" + ", ".join(map(str, fields)) + "}"
