"""Routes: which YARP name is which key; read from YAML, with errors that point at the line."""

from __future__ import annotations

from typing import Final, Literal

from msgspec import field

from vertebra.keys import check_key
from vertebra.service.routes import Route
from vertebra.yarp import from_text
from vertebra.yarp.naming.names import check_name

Direction = Literal["inbound", "outbound"]
ICUB_EXPRESSIONS: Final = {
    "neutral": "neu",
    "happy": "hap",
    "sad": "sad",
    "surprised": "sur",
    "angry": "ang",
    "evil": "evi",
    "shy": "shy",
    "cunning": "cun",
    "talking": "ta1",
}
"""The expressions of iCub's `emotions.ini`."""
ICUB_PARTS: Final = {
    "all": "all",
    "mouth": "mou",
    "eyelids": "eli",
    "left_eyebrow": "leb",
    "right_eyebrow": "reb",
}
DialectChoice = Literal["auto", 3, 4]
StreamType = Literal[
    "auto", "AudioChunk", "Bottle", "Image", "Imu", "JointState", "LaserScan", "Native",
    "Odometry", "PointCloud", "Pose", "Tensor", "Text", "Twist",
]  # fmt: skip


class YarpRoute(Route, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What every route has: a name on YARP, and the key that goes with it."""

    yarp: str

    @property
    def claims(self) -> tuple[str, ...]:
        """What no other route may have, in words."""
        return self._ends("inbound")

    def _ends(self, direction: Direction) -> tuple[str, ...]:
        ends = (f"the YARP port {check_name(self.yarp)}", f"the key {check_key(self.key)}")
        return tuple(f"{end} ({direction})" for end in ends)


class OneWay(YarpRoute, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A route of one port in one direction.

    Attributes:
        direction: `inbound` offers on the backbone what YARP has.
        dialect: YARP generation of the other side, 3 or 4; `auto` finds it out.
    """

    direction: Direction = "inbound"
    dialect: DialectChoice = "auto"

    @property
    def claims(self) -> tuple[str, ...]:
        """What no other route may have, in words."""
        return self._ends(self.direction)


class Stream(OneWay, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Messages one way between a YARP port and a key.

    Attributes:
        yarp: The YARP port: the robot's output port (inbound), or one that we open (outbound).
        key: Where the messages are on the backbone.
        type: What they are; `auto` tells by their bytes.
        delivery: What an outbound route keeps for a slow reader.
        depth: How many messages of it.
        max_rate_hz: Thins the stream out; 0 carries everything.
        frame_id: The coordinate frame of the messages, which YARP's objects do not name.
    """

    type: StreamType = "auto"
    delivery: Literal["latest", "queue"] = "latest"
    depth: int = 1
    max_rate_hz: float = 0.0
    frame_id: str = ""


class Call(OneWay, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Calls one way: a YARP RPC port that is called by its key, or a key called through YARP.

    Attributes:
        yarp: The robot's RPC port (inbound), or one that we open (outbound).
        key: Served by us (inbound), or called by us (outbound).
        timeout_s: Deadline of an outbound call; inbound ones bring their own.
    """

    timeout_s: float = 5.0


class ControlBoard(YarpRoute, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A robot part behind YARP's control board server.

    Attributes:
        yarp: Name of the part, such as `/icub/head`; its ports are `/icub/head/state:o` and so on.
        key: Where the part is on the backbone: `<key>/state`, the stream of commands
            `<key>/command`, and the calls `limits`, `modes`, `speeds`, `move`, `move_by`,
            `velocity`, `direct`, `stop`.
        dialect: As that of a single port.
    """

    dialect: DialectChoice = "auto"


class GazeRoute(YarpRoute, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A gaze controller.

    Attributes:
        yarp: Its name, such as `/iKinGazeCtrl`, below which its ports are.
        key: Where it is on the backbone: the calls `<key>/look_at`, `look`, `look_at_pixel`,
            `stop`.
        controller: Whose words it understands: `iKinGazeCtrl`, or R1's `cer_gaze-controller`.
    """

    controller: Literal["ikin", "cer"] = "ikin"


class FaceRoute(YarpRoute, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A face that shows expressions; by default in the words of iCub's `emotionInterface`.

    Attributes:
        yarp: Its RPC port.
        key: Where it is on the backbone: the call `<key>/express`.
        say: What is said to it, as the text of a bottle with `{part}` and `{expression}` in it.
        expressions: Its words for expressions, by the names that callers use.
        parts: Its words for parts of the face, likewise; `all` has to be there.
    """

    say: str = "set {part} {expression}"
    expressions: dict[str, str] = field(default_factory=lambda: {**ICUB_EXPRESSIONS})
    parts: dict[str, str] = field(default_factory=lambda: {**ICUB_PARTS})

    def __post_init__(self) -> None:
        if "all" not in self.parts or not self.expressions:
            raise ValueError("a face has expressions, and among its parts one named all")
        try:
            from_text(self.say.format(part="x", expression="y"))
        except (KeyError, ValueError, IndexError) as error:
            raise ValueError(f"{self.say!r} is no text with {{part}} and {{expression}}") from error

    def __hash__(self) -> int:
        return hash((self.yarp, self.key))


class SpeakerRoute(YarpRoute, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A speaker.

    Attributes:
        yarp: Its input port, such as `/icub/speaker/audio:i`.
        key: Where it is on the backbone: the call `<key>/play`, and the stream `<key>/audio`.
    """


AnyRoute = Stream | Call | ControlBoard | GazeRoute | FaceRoute | SpeakerRoute
KINDS: Final[dict[str, type[AnyRoute]]] = {
    "streams": Stream,
    "calls": Call,
    "control_boards": ControlBoard,
    "gazes": GazeRoute,
    "faces": FaceRoute,
    "speakers": SpeakerRoute,
}
