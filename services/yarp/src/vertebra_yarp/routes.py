"""Routes: which YARP name is which key; read from YAML, with errors that point at the line."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final, Literal

import msgspec
import yaml
from msgspec import Struct, field

from vertebra.errors import ConfigError, VertebraError
from vertebra.keys import check_key
from vertebra.yarp import from_text
from vertebra.yarp.names import check_name

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


class Stream(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Messages one way between a YARP port and a key.

    Attributes:
        yarp: The YARP port: the robot's output port (inbound), or one that we open (outbound).
        key: Where the messages are on the backbone.
        type: What they are; `auto` tells by their bytes.
        direction: `inbound` is from YARP to the backbone.
        delivery: What an outbound route keeps for a slow reader.
        depth: How many messages of it.
        max_rate_hz: Thins the stream out; 0 carries everything.
        frame_id: The coordinate frame of the messages, which YARP's objects do not name.
        dialect: YARP generation of the other side, 3 or 4; `auto` finds it out.
    """

    yarp: str
    key: str
    type: StreamType = "auto"
    direction: Direction = "inbound"
    delivery: Literal["latest", "queue"] = "latest"
    depth: int = 1
    max_rate_hz: float = 0.0
    frame_id: str = ""
    dialect: DialectChoice = "auto"


class Call(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Calls one way: a YARP RPC port that is called by its key, or a key called through YARP.

    Attributes:
        yarp: The robot's RPC port (inbound), or one that we open (outbound).
        key: Served by us (inbound), or called by us (outbound).
        direction: `inbound` offers what YARP has on the backbone.
        timeout_s: Deadline of an outbound call; inbound ones bring their own.
        dialect: As in a stream.
    """

    yarp: str
    key: str
    direction: Direction = "inbound"
    timeout_s: float = 5.0
    dialect: DialectChoice = "auto"


class ControlBoard(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A robot part behind YARP's control board server.

    Attributes:
        yarp: Name of the part, such as `/icub/head`; its ports are `/icub/head/state:o` and so on.
        key: Where the part is on the backbone: `<key>/state`, the stream of commands
            `<key>/command`, and the calls `limits`, `modes`, `speeds`, `move`, `move_by`,
            `velocity`, `direct`, `stop`.
        dialect: As in a stream.
    """

    yarp: str
    key: str
    dialect: DialectChoice = "auto"


class GazeRoute(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A gaze controller.

    Attributes:
        yarp: Its name, such as `/iKinGazeCtrl`, below which its ports are.
        key: Where it is on the backbone: the calls `<key>/look_at`, `look`, `look_at_pixel`,
            `stop`.
        controller: Whose words it understands: `iKinGazeCtrl`, or R1's `cer_gaze-controller`.
    """

    yarp: str
    key: str
    controller: Literal["ikin", "cer"] = "ikin"


class FaceRoute(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A face that shows expressions; by default in the words of iCub's `emotionInterface`.

    Attributes:
        yarp: Its RPC port.
        key: Where it is on the backbone: the call `<key>/express`.
        say: What is said to it, as the text of a bottle with `{part}` and `{expression}` in it.
        expressions: Its words for expressions, by the names that callers use.
        parts: Its words for parts of the face, likewise; `all` has to be there.
    """

    yarp: str
    key: str
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


class SpeakerRoute(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A speaker.

    Attributes:
        yarp: Its input port, such as `/icub/speaker/audio:i`.
        key: Where it is on the backbone: the call `<key>/play`, and the stream `<key>/audio`.
    """

    yarp: str
    key: str


Route = Stream | Call | ControlBoard | GazeRoute | FaceRoute | SpeakerRoute
_KINDS: Final[dict[str, type[Route]]] = {
    "streams": Stream,
    "calls": Call,
    "control_boards": ControlBoard,
    "gazes": GazeRoute,
    "faces": FaceRoute,
    "speakers": SpeakerRoute,
}


class Routes(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All explicit routes of the adapter."""

    streams: tuple[Stream, ...] = ()
    calls: tuple[Call, ...] = ()
    control_boards: tuple[ControlBoard, ...] = ()
    gazes: tuple[GazeRoute, ...] = ()
    faces: tuple[FaceRoute, ...] = ()
    speakers: tuple[SpeakerRoute, ...] = ()

    def __iter__(self) -> Iterator[Route]:
        for kind in _KINDS:
            yield from getattr(self, kind)


def read_routes(path: Path | None) -> Routes:
    """Return the routes in a YAML file, none if `path` is None.

    Raises:
        ConfigError: A line is wrong; the text says which and why.
    """
    if path is None:
        return Routes()
    try:
        return parse_routes(path.read_text(encoding="utf-8"), str(path))
    except OSError as error:
        raise ConfigError(f"the routes in {str(path)!r} cannot be read: {error}") from error


def parse_routes(text: str, where: str) -> Routes:
    """Return the routes in YAML text; `where` names it in errors. Raises `ConfigError`."""
    try:
        root = yaml.compose(text, yaml.SafeLoader)
        document = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ConfigError(f"{where} is no YAML: {error}") from error
    if document is None:
        return Routes()
    if not isinstance(document, dict) or not document.keys() <= _KINDS.keys():
        raise ConfigError(f"{where}: expected a map with the keys {', '.join(_KINDS)}")
    found: dict[str, list[Any]] = {kind: [] for kind in _KINDS}
    taken: dict[tuple[str, str], int] = {}
    for kind, item, line in _items(root, document):
        try:
            route = msgspec.convert(item, _KINDS[kind])
            check_name(route.yarp)
            check_key(route.key)
        except (msgspec.ValidationError, VertebraError) as error:
            raise ConfigError(f"{where}:{line}: {error}") from error
        direction = getattr(route, "direction", "inbound")
        for claim in ((direction, f"YARP port {route.yarp}"), (direction, f"key {route.key}")):
            first = taken.setdefault(claim, line)
            if first != line:
                raise ConfigError(f"{where}:{line}: {claim[1]} has a route in line {first} already")
        found[kind].append(route)
    return Routes(**{kind: tuple(routes) for kind, routes in found.items()})


def _items(root: yaml.Node | None, document: Mapping[str, Any]) -> Iterator[tuple[str, Any, int]]:
    if not isinstance(root, yaml.MappingNode):
        return
    for key_node, value_node in root.value:
        kind = str(key_node.value)
        items = document[kind]
        if items is None:
            continue
        if not isinstance(value_node, yaml.SequenceNode):
            line = value_node.start_mark.line + 1
            raise ConfigError(f"line {line}: {kind} is a list of routes")
        for node, item in zip(value_node.value, items, strict=True):
            yield kind, item, node.start_mark.line + 1
