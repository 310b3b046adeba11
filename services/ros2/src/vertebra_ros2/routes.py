"""Routes: which ROS name is which key."""

from __future__ import annotations

import math
from typing import Final, Literal

from vertebra.errors import ConfigError
from vertebra.keys import check_key
from vertebra.ros2 import humans
from vertebra.ros2.mapping import Sound
from vertebra.ros2.names import check_name, check_type
from vertebra.service.routes import Route

Direction = Literal["inbound", "outbound"]


class Topic(Route, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Messages one way between a ROS topic and a key.

    Attributes:
        ros: The topic.
        key: Where the messages are on the backbone.
        type: Its ROS type; inbound, empty takes what its publishers say.
        direction: `inbound` is from ROS to the backbone.
        delivery: What an outbound route keeps for a slow ROS subscriber.
        depth: How many messages of it; inbound, how many may wait for us, 64 at least.
        retain: Outbound, late joiners get the last `depth` messages (transient_local).
        max_rate_hz: Thins the stream out; 0 carries everything.
        sound: What the bytes of an inbound `AudioData` are.
    """

    ros: str
    type: str = ""
    direction: Direction = "inbound"
    delivery: Literal["latest", "queue"] = "latest"
    depth: int = 10
    retain: bool = False
    max_rate_hz: float = 0.0
    sound: Sound | None = None

    @property
    def claims(self) -> tuple[str, ...]:
        """What no other route may have, in words."""
        _check(self.ros, self.type, "msg", needs_type=self.direction == "outbound")
        if self.depth < 1:
            raise ConfigError(f"a depth is at least 1, not {self.depth}")
        topic = f"the ROS topic {self.ros} ({self.direction})"
        key = f"the key {check_key(self.key)} (inbound)"
        return (topic,) if self.direction == "outbound" else (topic, key)

    @property
    def needs(self) -> tuple[str, ...]:
        """Types that have to be known, because nobody else says what they are."""
        return (self.type,) if self.direction == "outbound" else ()


class Service(Route, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Calls one way: a ROS service that is called by its key, or a key called through ROS.

    Attributes:
        ros: The ROS service of a node (inbound), or one that we offer (outbound).
        key: Served by us (inbound), or called by us (outbound).
        type: Its ROS type; inbound, empty takes what its servers say.
        direction: `inbound` offers what ROS has on the backbone.
        timeout_s: Deadline of an outbound call; inbound ones bring their own.
    """

    ros: str
    type: str = ""
    direction: Direction = "inbound"
    timeout_s: float = 5.0

    @property
    def claims(self) -> tuple[str, ...]:
        """What no other route may have, in words."""
        _check(self.ros, self.type, "srv", needs_type=self.direction == "outbound")
        ends = (f"the ROS service {self.ros}", f"the key {check_key(self.key)}")
        return tuple(f"{end} ({self.direction})" for end in ends)

    @property
    def needs(self) -> tuple[str, ...]:
        """Types that have to be known, because nobody else says what they are."""
        ours = self.type if self.direction == "outbound" else ""
        return (f"{ours}_Request", f"{ours}_Response") if ours else ()


class Action(Route, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Goals one way: an action of a ROS node, driven by keys, or one of the fleet, driven by ROS.

    On the backbone it is the keys `goal`, `result`, `cancel` and `feedback` below `key`.

    Attributes:
        ros: The ROS action of a node (inbound), or one that we offer (outbound).
        key: Where the action is on the backbone.
        type: Its ROS type, such as `nav2_msgs/action/NavigateToPose`; only outbound.
        direction: `inbound` offers what ROS has on the backbone.
        timeout_s: Outbound, deadline for accepting a goal, and for cancelling one.
    """

    ros: str
    type: str = ""
    direction: Direction = "inbound"
    timeout_s: float = 5.0

    @property
    def claims(self) -> tuple[str, ...]:
        """What no other route may have, in words."""
        _check(self.ros, self.type, "action", needs_type=self.direction == "outbound")
        ends = (f"the ROS action {self.ros}", f"the key {check_key(self.key)}")
        return tuple(f"{end} ({self.direction})" for end in ends)

    @property
    def needs(self) -> tuple[str, ...]:
        """Types that have to be known, because nobody else says what they are."""
        return (f"{self.type}_Goal",) if self.direction == "outbound" else ()


class Parameters(Route, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The parameters of a ROS node: the calls `list`, `get`, `set` and `describe` below `key`.

    Attributes:
        ros: The node.
        key: Where its parameters are on the backbone.
    """

    ros: str

    @property
    def claims(self) -> tuple[str, ...]:
        """What no other route may have, in words."""
        return (
            f"the parameters of the ROS node {check_name(self.ros)}",
            f"the key {check_key(self.key)}",
        )

    @property
    def needs(self) -> tuple[str, ...]:
        """The types that have to be known: those of parameters always are."""
        return ()


class Base(Route, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A mobile base that takes velocities: the calls `drive`, `stop` and `limits` below `key`.

    Attributes:
        ros: The topic on which it takes them.
        key: Where it is on the backbone.
        max_linear_m_s: Fastest that it may be told to drive, ahead or back.
        max_angular_deg_s: Fastest that it may be told to turn.
        type: ROS type of the topic, a twist with or without a stamp.
        actions: What drives it by itself: `stop` cancels all their goals.
    """

    ros: str
    max_linear_m_s: float
    max_angular_deg_s: float
    type: Literal["geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"] = (
        "geometry_msgs/msg/Twist"
    )
    actions: tuple[str, ...] = ()

    @property
    def claims(self) -> tuple[str, ...]:
        """What no other route may have, in words."""
        for action in self.actions:
            check_name(action)
        for name in ("max_linear_m_s", "max_angular_deg_s"):
            if not 0 < getattr(self, name) < math.inf:
                raise ConfigError(f"{name} is above 0, not {getattr(self, name)}")
        ends = (f"the ROS topic {check_name(self.ros)}", f"the key {check_key(self.key)}")
        return (f"{ends[0]} (outbound)", ends[1])

    @property
    def needs(self) -> tuple[str, ...]:
        """Types that have to be known, because nobody else says what they are."""
        return (self.type,)


class Humans(Route, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The faces that a camera sees, as ROS4HRI has them: `/humans/faces/...`.

    Attributes:
        key: The `Faces` of the camera.
        expressions: Key of their `Expressions`.
        head_poses: Key of their `HeadPoses`; they become transforms.
        image: Key of the camera's `Image`, of which the faces are cropped.
        frame_id: Optical frame of the camera, if its images do not say it.
        field_of_view_deg: Of the camera, from the left to the right of its image; transforms
            need it.
    """

    expressions: str = ""
    head_poses: str = ""
    image: str = ""
    frame_id: str = ""
    field_of_view_deg: float = 0.0

    @property
    def ros(self) -> str:
        """The namespace of the faces."""
        return humans.FACES

    @property
    def claims(self) -> tuple[str, ...]:
        """What no other route may have, in words."""
        for key in (self.key, self.expressions, self.head_poses, self.image):
            if key or key is self.key:
                check_key(key)
        if not 0 <= self.field_of_view_deg < 180:
            raise ConfigError(f"a field of view is below 180 degrees, not {self.field_of_view_deg}")
        if self.head_poses and not self.field_of_view_deg:
            raise ConfigError("head poses become transforms: add 'field_of_view_deg: ...'")
        return (f"the ROS topic {humans.TRACKED} (outbound)",)

    @property
    def needs(self) -> tuple[str, ...]:
        """Types that have to be known, because nobody else says what they are."""
        return (humans.TRACKED_TYPE, *humans.PARTS.values())


def _check(name: str, type_name: str, kind: str, *, needs_type: bool) -> None:
    check_name(name)
    said = check_type(type_name).split("/")[1] if type_name else kind
    if said == "msg" and kind == "srv":
        raise ConfigError(f"{type_name} is a message, a service is called as in a/srv/B")
    if said != kind == "action":
        raise ConfigError(f"{type_name} is no action, which is called as in a/action/B")
    if needs_type and not type_name:
        raise ConfigError(f"an outbound route says the ROS type of {name}: add 'type: ...'")


AnyRoute = Topic | Service | Action | Parameters | Base | Humans
KINDS: Final[dict[str, type[AnyRoute]]] = {
    "topics": Topic,
    "services": Service,
    "actions": Action,
    "parameters": Parameters,
    "bases": Base,
    "humans": Humans,
}
