"""How ROS 2 names and types are called on DDS, and where they are on the backbone.

A ROS topic `/a/b` is the DDS topic `rt/a/b`; a ROS service `/add` is the pair `rq/addRequest` and
`rr/addReply`. A type `std_msgs/msg/String` is the DDS type `std_msgs::msg::dds_::String_`.
On the backbone, what no route claims is below `ros2/`: `/a/b` is the key `ros2/a/b`.
"""

from __future__ import annotations

import re
from typing import Final, Literal, NamedTuple

from vertebra.errors import NameMappingError
from vertebra.keys import map_name, unmap_name

MAX_NAME: Final = 247
"""DDS names have at most 255 characters; ROS keeps 8 of them for its prefix and suffix."""
DISCOVERY_TOPIC: Final = "ros_discovery_info"
DISCOVERY_TYPE: Final = "rmw_dds_common/msg/ParticipantEntitiesInfo"
DISCOVERY_TYPE_HUMBLE: Final = "rmw_dds_common_humble/msg/ParticipantEntitiesInfo"

Role = Literal["topic", "request", "reply"]
_NAME: Final = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
_TYPE: Final = re.compile(r"[a-z][a-z0-9_]*/(msg|srv|action)/[A-Za-z][A-Za-z0-9_]*")
_DDS_TYPE: Final = re.compile(
    r"([a-z][a-z0-9_]*)::(msg|srv|action)::dds_::([A-Za-z][A-Za-z0-9_]*)_"
)
_AFFIXES: Final[dict[Role, tuple[str, str]]] = {
    "topic": ("rt", ""),
    "request": ("rq", "Request"),
    "reply": ("rr", "Reply"),
}


class DdsName(NamedTuple):
    """What a DDS topic is to ROS."""

    role: Role
    name: str


def check_name(name: str) -> str:
    """Return `name` if it is a fully qualified ROS name, else raise `NameMappingError`."""
    if len(name) > MAX_NAME:
        raise NameMappingError(name, MAX_NAME, f"a ROS name has at most {MAX_NAME} characters")
    match = _NAME.match(name)
    if match is None or match.end() != len(name):
        raise NameMappingError(
            name,
            match.end() if match else 0,
            "a ROS name is '/' and tokens of letters, digits and '_' that begin with no digit",
        )
    return name


def check_type(name: str) -> str:
    """Return `name` if it has the form `package/msg/Type`, else raise `NameMappingError`."""
    if not _TYPE.fullmatch(name):
        raise NameMappingError(name, 0, "a ROS type is called as in 'std_msgs/msg/String'")
    return name


def dds_name(role: Role, name: str) -> str:
    """Return the DDS topic of a ROS topic, or of one direction of a ROS service."""
    prefix, suffix = _AFFIXES[role]
    return f"{prefix}{check_name(name)}{suffix}"


def ros_name(topic: str) -> DdsName | None:
    """Return what a DDS topic is to ROS; None if it is none of ROS."""
    for role, (prefix, suffix) in _AFFIXES.items():
        if topic.startswith(f"{prefix}/") and topic.endswith(suffix):
            name = topic[len(prefix) : len(topic) - len(suffix)]
            return DdsName(role, name) if _NAME.fullmatch(name) else None
    return None


def dds_type(name: str) -> str:
    """Return the DDS name of a ROS type."""
    package, kind, leaf = check_type(name).split("/")
    return f"{package}::{kind}::dds_::{leaf}_"


def ros_type(name: str) -> str | None:
    """Return the ROS name of a DDS type; None if it is none of ROS."""
    match = _DDS_TYPE.fullmatch(name)
    return "/".join(match.groups()) if match else None


def key_of(name: str, mirror: str = "ros2") -> str:
    """Return the key of a ROS name below that of the mirror."""
    return map_name(mirror, check_name(name))


def name_of(key: str, mirror: str = "ros2") -> str:
    """Return the ROS name behind a key of the mirror; raise `NameMappingError`."""
    return check_name(unmap_name(mirror, key))
