"""The other participant: ROS nodes as rmw_cyclonedds puts them on the wire, in plain `cyclonedds`.

It shares no code with the adapter: types are written by hand, samples are made by the library.
`python -m tests.live.ros2_peer ROLE [ARGUMENT]` prints JSON lines, first "ready", and ends with its
input.
"""

import dataclasses
import json
import os
import struct
import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

from cyclonedds.builtin import (
    BuiltinDataReader,
    BuiltinTopicDcpsPublication,
    BuiltinTopicDcpsSubscription,
)
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from .ros2_types import (
    FACE_PARTS,
    AddReply,
    AddRequest,
    AudioData,
    AudioInfo,
    CancelReply,
    CancelRequest,
    Feedback,
    FeedbackMessage,
    GetParametersReply,
    GetParametersRequest,
    GetResultReply,
    GetResultRequest,
    Gid,
    Goal,
    GoalId,
    GoalInfo,
    GoalStatusArray,
    Header,
    HumbleGid,
    HumbleNode,
    HumbleNodes,
    IdsList,
    Image,
    JointState,
    ListedParameters,
    ListReply,
    ListRequest,
    Node,
    Nodes,
    Parameter,
    ParameterValue,
    RawImage,
    RawNodes,
    RawStrange,
    Result,
    SendGoalReply,
    SendGoalRequest,
    SetEachReply,
    SetEachRequest,
    SetReply,
    SetRequest,
    SetResult,
    Strange,
    String,
    Time,
    Transforms,
    TypesReply,
    TypesRequest,
)

STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
ADD_HASH = "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"
NODES_HASH = "RIHS01_91a0593bacdcc50ea9bdcf849a938b128412cc1ea821245c663bcd26f83c295e"


def qos(said: str = "", *, reliable: bool = True, latched: bool = False, depth: int = 10) -> Qos:
    policies = [
        Policy.Reliability.Reliable(max_blocking_time=duration(seconds=1))
        if reliable
        else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(depth),
        Policy.WriterDataLifecycle(autodispose=False),
    ]
    if latched:
        history = Policy.History.KeepLast(depth)
        policies.append(Policy.DurabilityService(0, history, -1, -1, -1))
    if said:
        policies.append(Policy.Userdata(data=said.encode()))
    return Qos(*policies)


def say(*what: Any) -> None:
    sys.stdout.write(f"{json.dumps(what)}\n")
    sys.stdout.flush()


class Peer:
    def __init__(self, name: str) -> None:
        domain = int(os.environ["ROS_DOMAIN_ID"])
        self.participant = DomainParticipant(domain, qos=Qos(Policy.Userdata(data=b"enclave=/;")))
        self.name = name
        self.done = threading.Event()
        self.readers: list[Any] = []
        self.writers: list[Any] = []
        threading.Thread(target=self._follow_input, daemon=True).start()

    def _follow_input(self) -> None:
        sys.stdin.read()
        self.done.set()

    def write(self, topic: str, kind: Any, settings: Qos) -> Any:
        self.writers.append(
            DataWriter(self.participant, Topic(self.participant, topic, kind), qos=settings)
        )
        return self.writers[-1]

    def read(self, topic: str, kind: Any, settings: Qos) -> Any:
        self.readers.append(
            DataReader(self.participant, Topic(self.participant, topic, kind), qos=settings)
        )
        return self.readers[-1]

    def announce(self, *, humble: bool = False) -> Any:
        """Be a ROS node, with these endpoints."""
        gid: Any = HumbleGid if humble else Gid
        node: Any = HumbleNode if humble else Node
        nodes: Any = HumbleNodes if humble else Nodes
        raw: Any = RawNodes
        said = "" if humble else f"typehash={NODES_HASH};"
        writer = DataWriter(
            self.participant,
            Topic(self.participant, "ros_discovery_info", raw),
            qos=qos(said, latched=True, depth=1),
        )

        def gid_of(entity: Any) -> Any:
            return gid([*entity.guid.bytes, *bytes(8 if humble else 0)])

        own = node(
            "/lab", self.name, *([*map(gid_of, one)] for one in (self.readers, self.writers))
        )
        writer.write(RawNodes(nodes(gid_of(self.participant), [own]).serialize()))
        return writer

    def take(self, reader: Any) -> list[Any]:
        return [one for one in reader.take(100) if one.sample_info.valid_data]


def talk(peer: Peer, settings: Qos, word: str = "hello", *, humble: bool = False) -> None:
    writer = peer.write("rt/chatter", String, settings)
    node = peer.announce(humble=humble)
    say("ready", str(node.guid))
    number = 0
    while not peer.done.wait(0.02):
        writer.write(String(f"{word} {number}"))
        number += 1


def latch(peer: Peer) -> None:
    writer = peer.write(
        "rt/chatter", String, qos(f"typehash={STRING_HASH};", latched=True, depth=1)
    )
    writer.write(String("from long ago"))
    say("ready")
    peer.done.wait()


def strange(peer: Peer, sample: Any) -> None:
    writer = peer.write("rt/strange", type(sample), qos())
    say("ready")
    while not peer.done.wait(0.02):
        writer.write(sample)


def listen(peer: Peer, settings: Qos, topic: str = "/chatter") -> None:
    reader = peer.read(f"rt{topic}", String, settings)
    node = peer.announce()
    say("ready", str(node.guid))
    while not peer.done.wait(0.005):
        for sample in peer.take(reader):
            say("heard", sample.data)


def joints(peer: Peer, count: int, rate_hz: float) -> None:
    writer = peer.write("rt/joint_states", JointState, qos(depth=200))
    say("ready")
    while not writer.get_matched_subscriptions():
        time.sleep(0.01)
    began_s = time.monotonic()
    for number in range(count):
        now_ns = time.time_ns()
        stamp = Time(now_ns // 10**9, now_ns % 10**9)
        values = [float(number)] * 6
        names = [f"joint{index}" for index in range(6)]
        writer.write(JointState(Header(stamp, "base"), names, values, values, []))
        if peer.done.wait(max(0.0, began_s + (number + 1) / rate_hz - time.monotonic())):
            return
    say("sent", count)
    peer.done.wait()


def images(peer: Peer, count: int, rate_hz: float) -> None:
    writer = peer.write("rt/image", RawImage, qos())
    pixels = os.urandom(640 * 480 * 3)
    empty = Image(Header(Time(0, 0), "cam"), 480, 640, "rgb8", 0, 1920, []).serialize()
    tail = empty[12:-4] + struct.pack("<I", len(pixels)) + pixels
    say("ready")
    while not writer.get_matched_subscriptions():
        time.sleep(0.01)
    began_s = time.monotonic()
    for number in range(count):
        now_ns = time.time_ns()
        stamp = struct.pack("<iI", now_ns // 10**9, now_ns % 10**9)
        writer.write(RawImage(b"\x00\x01\x00\x00" + stamp + tail))
        if peer.done.wait(max(0.0, began_s + (number + 1) / rate_hz - time.monotonic())):
            return
    say("sent", count)
    peer.done.wait()


def hear_streams(peer: Peer) -> None:
    """Say the number in each joint state, and in the first pixels of each VGA image."""
    joints = peer.read("rt/joints_in", JointState, qos(depth=200))
    images = peer.read("rt/image_in", RawImage, qos(depth=10))
    say("ready")
    while not peer.done.wait(0.002):
        for state in peer.take(joints):
            say("joints", round(state.effort[0]))
        for image in peer.take(images):
            say("image", int.from_bytes(image.payload[-640 * 480 * 3 :][:8], "little"))


def serve_sum(peer: Peer, *, as_fast_dds: bool) -> None:
    identity = "" if as_fast_dds else "serviceid=1.2.3.4.5.6.7.8.9.a.b.c.0.0.0.1;"
    settings = qos(f"{identity}typehash={ADD_HASH};")
    reader = peer.read("rq/add_two_intsRequest", AddRequest, settings)
    writer = peer.write("rr/add_two_intsReply", AddReply, settings)
    node = peer.announce()
    say("ready", str(node.guid))
    while not peer.done.wait(0.001):
        for request in peer.take(reader):
            say("asked", request.a, request.b)
            if request.a >= 0:  # what is negative gets no answer
                hold(writer, reader)
                writer.write(AddReply(request.guid, request.seq, request.a + request.b))


def hold(writer: Any, reader: Any) -> None:
    """Wait for the reader of a client's replies, as rmw_cyclonedds does."""
    until_s = time.monotonic() + 0.1
    while time.monotonic() < until_s and len(writer.get_matched_subscriptions()) < len(
        reader.get_matched_publications()
    ):
        time.sleep(0.001)


def count_up(peer: Peer, *, deaf: bool = False) -> None:
    """Serve the action Fibonacci: one number each 50 ms; an order below 0 is refused.

    The deaf one does what it is asked for, but does not say that it has accepted it.
    """

    def pair(part: str, number: int, request: Any, reply: Any) -> tuple[Any, Any]:
        settings = qos(f"serviceid=1.2.3.4.5.6.7.8.9.a.b.c.0.0.1.{number};")
        name = f"fibonacci/_action/{part}"
        return (
            peer.read(f"rq/{name}Request", request, settings),
            peer.write(f"rr/{name}Reply", reply, settings),
        )

    goals, accepts = pair("send_goal", 1, SendGoalRequest, SendGoalReply)
    asks, results = pair("get_result", 2, GetResultRequest, GetResultReply)
    cancels, cancelled = pair("cancel_goal", 3, CancelRequest, CancelReply)
    told = peer.write("rt/fibonacci/_action/feedback", FeedbackMessage, qos())
    node = peer.announce()
    say("ready", str(node.guid))
    running: dict[bytes, tuple[int, list[int]]] = {}
    ended: dict[bytes, tuple[int, list[int]]] = {}
    waiting: list[Any] = []
    while not peer.done.wait(0.05):
        for one in peer.take(goals):
            accepted = one.goal.order >= 0
            if accepted:
                running[bytes(one.goal_id.uuid)] = (one.goal.order, [0, 1])
            if not deaf:
                hold(accepts, goals)
                accepts.write(SendGoalReply(one.guid, one.seq, accepted, Time(0, 0)))
        for one in peer.take(cancels):
            goal = bytes(one.goal_info.goal_id.uuid)
            stopped = [goal] if any(goal) else list(running)
            stopped = [goal for goal in stopped if goal in running]
            for goal in stopped:
                ended[goal] = (5, running.pop(goal)[1])
                say("cancelled", goal.hex())
            hold(cancelled, cancels)
            infos = [GoalInfo(GoalId(list(goal)), Time(0, 0)) for goal in stopped]
            cancelled.write(CancelReply(one.guid, one.seq, 0 if infos else 2, infos))
        for goal, (order, numbers) in list(running.items()):
            numbers.append(numbers[-1] + numbers[-2] if len(numbers) < 40 else 0)
            told.write(FeedbackMessage(GoalId(list(goal)), Feedback(numbers)))
            if len(numbers) > order:
                ended[goal] = (4, running.pop(goal)[1])
        waiting += peer.take(asks)
        for one in [one for one in waiting if bytes(one.goal_id.uuid) not in running]:
            waiting.remove(one)
            status, numbers = ended.get(bytes(one.goal_id.uuid), (0, []))
            hold(results, asks)
            results.write(GetResultReply(one.guid, one.seq, status, Result(numbers)))


class ActionClient:
    """An action client as rclpy has it: three clients, and the topics feedback and status."""

    def __init__(self, peer: Peer, action: str) -> None:
        self.peer = peer
        self.sent = 0
        self.guid = int.from_bytes(os.urandom(8), "little")
        self.pairs = {
            "send_goal": self._pair(f"{action}/_action/send_goal", SendGoalRequest, SendGoalReply),
            "get_result": self._pair(
                f"{action}/_action/get_result", GetResultRequest, GetResultReply
            ),
            "cancel_goal": self._pair(f"{action}/_action/cancel_goal", CancelRequest, CancelReply),
        }
        self.feedback = peer.read(f"rt/{action}/_action/feedback", FeedbackMessage, qos())
        self.status = peer.read(
            f"rt/{action}/_action/status", GoalStatusArray, qos(latched=True, depth=1)
        )
        self.node = peer.announce()

    def _pair(self, name: str, request: Any, reply: Any) -> tuple[Any, Any]:
        said = ".".join(f"{one:x}" for one in os.urandom(16))
        settings = qos(f"clientid={said};")
        return (
            self.peer.write(f"rq/{name}Request", request, settings),
            self.peer.read(f"rr/{name}Reply", reply, settings),
        )

    def wait_for_server(self) -> None:
        while not all(
            writer.get_matched_subscriptions() and reader.get_matched_publications()
            for writer, reader in self.pairs.values()
        ):
            time.sleep(0.001)

    def ask(self, part: str, kind: Any, *fields: Any) -> Any:
        """Call a service of the action; say meanwhile what its topics tell."""
        writer, reader = self.pairs[part]
        self.sent += 1
        writer.write(kind(self.guid, self.sent, *fields))
        until_s = time.monotonic() + 8
        while time.monotonic() < until_s and not self.peer.done.is_set():
            self.listen()
            for reply in self.peer.take(reader):
                if (reply.guid, reply.seq) == (self.guid, self.sent):
                    return reply
            time.sleep(0.001)
        say("silence", part)
        raise TimeoutError(part)

    def listen(self) -> bool:
        """Say what the topics tell; return whether there was feedback."""
        heard = self.peer.take(self.feedback)
        for one in heard:
            say("feedback", bytes(one.goal_id.uuid).hex(), list(one.feedback.sequence))
        for array in self.peer.take(self.status):
            say("status", [one.status for one in array.status_list])
        return bool(heard)


def act(peer: Peer, action: str, order: int, then: str = "") -> None:
    """Send a goal and follow it, or cancel it after the first feedback."""
    client = ActionClient(peer, action)
    say("ready")
    client.wait_for_server()
    goal_id = GoalId(list(os.urandom(16)))
    if then == "unknown":
        answer = client.ask("cancel_goal", CancelRequest, GoalInfo(goal_id, Time(0, 0)))
        say("cancel", answer.return_code, len(answer.goals_canceling))
    else:
        accept = client.ask("send_goal", SendGoalRequest, goal_id, Goal(order))
        say("accepted", accept.accepted, accept.stamp.sec, bytes(goal_id.uuid).hex())
    if then == "twice":
        accept = client.ask("send_goal", SendGoalRequest, goal_id, Goal(order))
        say("accepted", accept.accepted, accept.stamp.sec)
    if then in ("cancel", "cancel_all"):
        while not client.listen():
            time.sleep(0.001)
        meant = goal_id if then == "cancel" else GoalId([0] * 16)
        answer = client.ask("cancel_goal", CancelRequest, GoalInfo(meant, Time(0, 0)))
        goals = [bytes(info.goal_id.uuid) == bytes(goal_id.uuid) for info in answer.goals_canceling]
        say("cancel", answer.return_code, goals)
    ended = client.ask("get_result", GetResultRequest, goal_id)
    say("result", ended.status, list(ended.result.sequence))
    if then == "late":
        answer = client.ask("cancel_goal", CancelRequest, GoalInfo(goal_id, Time(0, 0)))
        say("cancel", answer.return_code, len(answer.goals_canceling))
        ended = client.ask("get_result", GetResultRequest, goal_id)
        say("result", ended.status, list(ended.result.sequence))
    while not peer.done.wait(0.01):
        client.listen()


def of_double(value: float) -> ParameterValue:
    return ParameterValue(3, False, 0, value, "", [], [], [], [], [])


def have_parameters(peer: Peer) -> None:
    """Be the node /lab/camera with the parameters rate (double, below 100) and many (one array)."""
    kinds = {
        "list_parameters": (ListRequest, ListReply),
        "get_parameters": (GetParametersRequest, GetParametersReply),
        "get_parameter_types": (TypesRequest, TypesReply),
        "set_parameters_atomically": (SetRequest, SetReply),
        "set_parameters": (SetEachRequest, SetEachReply),
    }
    pairs = []
    for number, (name, (request, reply)) in enumerate(kinds.items()):
        settings = qos(f"serviceid=1.2.3.4.5.6.7.8.9.a.b.c.0.0.2.{number};")
        reader = peer.read(f"rq/lab/camera/{name}Request", request, settings)
        writer = peer.write(f"rr/lab/camera/{name}Reply", reply, settings)
        pairs.append((reader, writer, reply))
    values = {
        "many": ParameterValue(8, False, 0, 0.0, "of many", [], [True, False], [], [1.5], ["a"]),
        "rate": of_double(30.0),
    }

    def answer(request: Any) -> Any:
        if isinstance(request, ListRequest):
            return ListedParameters(list(values), [])
        if isinstance(request, SetEachRequest):
            return [answer(SetRequest(0, 0, [one])) for one in request.parameters]
        if isinstance(request, SetRequest):
            for one in request.parameters:
                if one.name not in values or one.value.double_value >= 100:
                    return SetResult(False, f"{one.name} is below 100")
            values.update({one.name: one.value for one in request.parameters})
            return SetResult(True, "")
        if not all(name in values for name in request.names):
            return []
        found = [values[name] for name in request.names]
        return [one.type for one in found] if isinstance(request, TypesRequest) else found

    say("ready")
    while not peer.done.wait(0.001):
        for reader, writer, reply in pairs:
            for request in peer.take(reader):
                hold(writer, reader)
                writer.write(reply(request.guid, request.seq, answer(request)))


def ask_parameters(peer: Peer, node: str, name: str) -> None:
    """Ask a node what it has, what one of it is, and to change that."""
    kinds: dict[str, tuple[Any, ...]] = {
        "list_parameters": (ListRequest, ListReply, [], 0),
        "get_parameters": (GetParametersRequest, GetParametersReply, [name]),
        "get_parameter_types": (TypesRequest, TypesReply, [name, "unknown"]),
        "set_parameters_atomically": (
            SetRequest,
            SetReply,
            [Parameter(name, of_double(5.0))],
        ),
    }
    for service, (request, reply, *fields) in kinds.items():
        settings = qos("clientid=f.2.3.4.5.6.7.8.9.a.b.c.0.0.0.3;")
        writer = peer.write(f"rq{node}/{service}Request", request, settings)
        reader = peer.read(f"rr{node}/{service}Reply", reply, settings)
        while not (writer.get_matched_subscriptions() and reader.get_matched_publications()):
            time.sleep(0.001)
        writer.write(request(0xFEED, 1, *fields))
        while not (replies := peer.take(reader)):
            time.sleep(0.001)
        said = replies[0]
        if isinstance(said, ListReply):
            say("names", list(said.result.names))
        elif isinstance(said, GetParametersReply):
            say("values", [[one.type, one.integer_value, one.string_value] for one in said.values])
        elif isinstance(said, TypesReply):
            say("types", list(said.types))
        else:
            say("set", said.result.successful, said.result.reason)
    peer.done.wait()


def ask_sum(peer: Peer, count: int, *, as_fast_dds: bool = False) -> None:
    identity = "" if as_fast_dds else "clientid=f.2.3.4.5.6.7.8.9.a.b.c.0.0.0.1;"
    settings = qos(f"{identity}typehash={ADD_HASH};")
    writer = peer.write("rq/fleet_sumRequest", AddRequest, settings)
    reader = peer.read("rr/fleet_sumReply", AddReply, settings)
    while not (writer.get_matched_subscriptions() and reader.get_matched_publications()):
        time.sleep(0.01)
    say("ready")
    for number in range(1, count + 1):
        writer.write(AddRequest(0xABCDEF, number, number, 2))
        until_s = time.monotonic() + 5
        while time.monotonic() < until_s:
            replies = peer.take(reader)
            if replies:
                say("sum", replies[0].guid == 0xABCDEF, replies[0].seq, replies[0].sum)
                break
            time.sleep(0.001)
    peer.done.wait()


def hear(peer: Peer) -> None:
    """Capture sound as audio_capture does, and hear what others make of it."""
    writer = peer.write("rt/audio", AudioData, qos())
    sound = peer.read("rt/fleet_audio", AudioData, qos())
    info = peer.read("rt/fleet_audio_info", AudioInfo, qos())
    say("ready")
    while not peer.done.wait(0.02):
        writer.write(AudioData(list(range(8))))
        for sample in peer.take(sound):
            say("sound", list(sample.data))
        for sample in peer.take(info):
            say("info", dataclasses.asdict(sample))


def know_humans(peer: Peer, wanted: Sequence[str]) -> None:
    """Follow faces as libhri does: what is tracked decides which topics are read."""
    system_default = Qos(Policy.Reliability.BestEffort, Policy.Durability.Volatile)
    tracked = peer.read("rt/humans/faces/tracked", IdsList, system_default)
    transforms = peer.read("rt/tf", Transforms, qos(depth=100))
    faces: dict[str, list[tuple[str, Any]]] = {}
    say("ready")
    while not peer.done.wait(0.005):
        for sample in peer.take(tracked):
            stamp = sample.header.stamp.sec * 10**9 + sample.header.stamp.nanosec
            say("tracked", list(sample.ids), stamp, sample.header.frame_id)
            for lost in faces.keys() - set(sample.ids):
                for _, reader in faces.pop(lost):
                    peer.readers.remove(reader)
                    reader.__del__()
            for new in set(sample.ids) - faces.keys():
                faces[new] = [
                    (part, peer.read(f"rt/humans/faces/{new}/{part}", FACE_PARTS[part], qos()))
                    for part in wanted
                ]
        for face, readers in faces.items():
            for part, reader in readers:
                for sample in peer.take(reader):
                    told = dataclasses.asdict(sample)
                    if part == "cropped":  # its middle row is enough to see
                        told["data"] = list(sample.data)[64 * sample.step : 65 * sample.step]
                    say(part, face, told)
        for sample in peer.take(transforms):
            say("tf", dataclasses.asdict(sample)["transforms"])


def watch(peer: Peer) -> None:
    """Say what others see of the graph, as `ros2 node info` and `ros2 topic info -v` would."""
    reader = peer.read("ros_discovery_info", RawNodes, qos(latched=True, depth=100))
    endpoints = {
        "writer": BuiltinDataReader(peer.participant, BuiltinTopicDcpsPublication),
        "reader": BuiltinDataReader(peer.participant, BuiltinTopicDcpsSubscription),
    }
    own = peer.participant.guid.bytes[:12]
    say("ready")
    while not peer.done.wait(0.02):
        for sample in peer.take(reader):
            for node in sample.node_entities_info_seq:
                gids = [
                    bytes(gid.data).hex() for gid in [*node.reader_gid_seq, *node.writer_gid_seq]
                ]
                say("node", node.node_namespace, node.node_name, gids)
        for kind, builtin in endpoints.items():
            for sample in builtin.take(100):
                if getattr(sample, "qos", None) is None or sample.key.bytes[:12] == own:
                    continue
                said = [bytes(one.data) for one in sample.qos if isinstance(one, Policy.Userdata)]
                text = said[0].decode() if said else ""
                gid = sample.key.bytes.hex()
                say("endpoint", kind, sample.topic_name, sample.type_name, gid, text)


SAID = f"typehash={STRING_HASH};"
DEADLINE = Qos(Policy.Deadline(duration(milliseconds=100)))
STRANGE = bytes.fromhex("00010000 01000000 02000000")
ROLES: dict[str, Callable[..., None]] = {
    "talk": lambda peer, *words: talk(peer, qos(SAID), *words),
    "talk_exclusive": lambda peer: talk(peer, qos(SAID) + Qos(Policy.Ownership.Exclusive)),
    "talk_best_effort": lambda peer: talk(peer, qos(SAID, reliable=False)),
    "talk_other_hash": lambda peer: talk(peer, qos(f"typehash=RIHS01_{'0' * 64};")),
    "talk_humble": lambda peer: talk(peer, qos(), humble=True),
    "latch": latch,
    "strange": lambda peer: strange(peer, RawStrange(STRANGE)),
    "strange_typed": lambda peer: strange(peer, Strange(1, 2)),
    "listen": lambda peer, *topic: listen(peer, qos(SAID), *topic),
    "listen_latched": lambda peer, *topic: listen(peer, qos(SAID, latched=True, depth=1), *topic),
    "listen_with_deadline": lambda peer, *topic: listen(peer, qos(SAID) + DEADLINE, *topic),
    "joints": lambda peer, count, rate_hz: joints(peer, int(count), float(rate_hz)),
    "images": lambda peer, count, rate_hz: images(peer, int(count), float(rate_hz)),
    "hear_streams": hear_streams,
    "serve_sum": lambda peer: serve_sum(peer, as_fast_dds=False),
    "serve_sum_fast_dds": lambda peer: serve_sum(peer, as_fast_dds=True),
    "ask_sum": lambda peer, count: ask_sum(peer, int(count)),
    "ask_sum_fast_dds": lambda peer, count: ask_sum(peer, int(count), as_fast_dds=True),
    "have_parameters": have_parameters,
    "ask_parameters": ask_parameters,
    "count_up": lambda peer, *deaf: count_up(peer, deaf="deaf" in deaf),
    "act": lambda peer, action, order, *then: act(peer, action, int(order), *then),
    "hear": hear,
    "know_humans": lambda peer, *wanted: know_humans(peer, wanted),
    "watch": watch,
}

if __name__ == "__main__":
    ROLES[sys.argv[1]](Peer(sys.argv[1]), *sys.argv[2:])
