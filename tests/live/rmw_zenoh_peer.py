"""A ROS 2 node as `rmw_zenoh_cpp` makes it, of eclipse-zenoh alone; it shares no code with ours.

Its session is set up as the default file of rmw_zenoh_cpp says: a peer that knows the router only,
and meets others by its gossip. Messages are packed by hand. What happens is printed in JSON, line
by line; it leaves when its input ends.

    rmw_zenoh_peer.py ROLE [ARGUMENT ...]      with ROS_DOMAIN_ID and ROUTER in the environment
"""

from __future__ import annotations

import json
import os
import struct
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import xxhash
import zenoh
from zenoh import ext

DOMAIN = os.environ.get("ROS_DOMAIN_ID", "0")
HUMBLE = "TypeHashNotSupported"
FIBONACCI = "example_interfaces::action::dds_::Fibonacci_"
STRING = "std_msgs::msg::dds_::String_"
ADD = "example_interfaces::srv::dds_::AddTwoInts_"
JOINTS = "sensor_msgs::msg::dds_::JointState_"
IMAGE = "sensor_msgs::msg::dds_::Image_"
SEND_GOAL, GET_RESULT = f"{FIBONACCI}SendGoal_", f"{FIBONACCI}GetResult_"
STATUS = "action_msgs::msg::dds_::GoalStatusArray_"
FEEDBACK, CANCEL = f"{FIBONACCI}FeedbackMessage_", "action_msgs::srv::dds_::CancelGoal_"
HASHES = {  # as rosidl of Jazzy writes them
    STRING: "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    ADD: "e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a",
    JOINTS: "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    IMAGE: "d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47",
    SEND_GOAL: "d1a57fb2a4afe8c21e34fb10db206f16ce6729b28531141472df92277c55b557",
    GET_RESULT: "1b0de0d5d29dc955d92f546706568428632771db13ec84c15ec1c1a59f424a57",
    FEEDBACK: "c1de71afd52e49a89c53d8262366884185bc0a02f78ce051c4e46b0a7fe59bb2",
    STATUS: "6c1684b00f177d37438febe6e709fc4e2b0d4248dca4854946f9ed8b30cda83e",
    CANCEL: "573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a",
}
HEADER = bytes((0, 1, 0, 0))
DEFAULT, LATCHED, SENSOR = "::,7:,:,:,,", ":1:,1:,:,:,,", "2::,5:,:,:,,"
_printing = threading.Lock()


def say(*words: Any) -> None:
    with _printing:
        sys.stdout.write(json.dumps(words) + "\n")
        sys.stdout.flush()


def text_of(payload: bytes) -> str:
    (length,) = struct.unpack_from("<I", payload, 4)
    return payload[8 : 8 + length - 1].decode()


def string(text: str) -> bytes:
    data = text.encode() + b"\0"
    return HEADER + struct.pack("<I", len(data)) + data


def attachment(sequence: int, gid: bytes) -> bytes:
    return struct.pack("<qqB", sequence, time.time_ns(), 16) + gid


def old_attachment(sequence: int, gid: bytes) -> bytes:
    """Write it as Jazzy's releases 0.2.0 to 0.2.3."""
    named = ((b"sequence_number", sequence), (b"source_timestamp", time.time_ns()))
    parts = [bytes([len(name)]) + name + struct.pack("<q", value) for name, value in named]
    return b"".join(parts) + b"\x0asource_gid\x10" + gid


def sequence_and_gid(carrier: zenoh.Sample | zenoh.Query) -> tuple[int, bytes]:
    """Read it as AttachmentData does: nothing else goes."""
    assert carrier.attachment is not None, "rmw_zenoh drops what has no attachment"
    data = carrier.attachment.to_bytes()
    assert len(data) == 33
    sequence, sent_ns, length = struct.unpack_from("<qqB", data)
    assert length == 16
    assert sequence > 0
    assert abs(sent_ns - time.time_ns()) < 10e9
    return sequence, data[17:]


class Node:
    def __init__(self, name: str, *, knows_hashes: bool = True) -> None:
        settings = {
            "mode": "peer",
            "connect/endpoints": [os.environ["ROUTER"]],
            "connect/timeout_ms": {"router": -1, "peer": -1, "client": 0},
            "connect/exit_on_failure": {"router": False, "peer": False, "client": True},
            "listen/endpoints": ["tcp/localhost:0"],
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": True,
            "scouting/gossip/multihop": False,
            "scouting/gossip/target": {"router": ["router", "peer"], "peer": ["router"]},
            "scouting/gossip/autoconnect": {"router": [], "peer": ["router", "peer"]},
            "scouting/gossip/autoconnect_strategy": {
                "peer": {"to_router": "always", "to_peer": "greater-zid"}
            },
            "timestamping/enabled": {"router": True, "peer": True, "client": True},
            "queries_default_timeout": 600_000,
            "transport/link/tx/queue/congestion_control/block/wait_before_close": 60_000_000,
            "transport/shared_memory/enabled": False,
        }
        config = zenoh.Config()
        for path, value in settings.items():
            config.insert_json5(path, json.dumps(value))
        self.session = zenoh.open(config)
        while not self.session.info.routers_zid():  # as its check of the router
            time.sleep(0.05)
        self.name = name
        self.knows_hashes = knows_hashes
        self.place = f"@ros2_lv/{DOMAIN}/{self.session.info.zid()}/0"
        self.entities = 0
        self.kept: list[Any] = []
        self.declare_token("0/NN", "")
        self.done = threading.Event()
        threading.Thread(target=self.wait_for_end, daemon=True).start()

    def wait_for_end(self) -> None:
        sys.stdin.read()
        self.done.set()

    def declare_token(self, entity: str, rest: str) -> str:
        key = f"{self.place}/{entity}/%/%lab/{self.name}{rest}"
        self.kept.append(self.session.liveliness().declare_token(key))
        return key

    def hash_of(self, type_name: str) -> str:
        return f"RIHS01_{HASHES[type_name]}" if self.knows_hashes else HUMBLE

    def announce(self, kind: str, name: str, type_name: str, qos: str) -> bytes:
        """Declare the token of an endpoint and return its gid."""
        self.entities += 1
        rest = f"/{name.replace('/', '%')}/{type_name}/{self.hash_of(type_name)}/{qos}"
        key = self.declare_token(f"{self.entities}/{kind}", rest)
        number = xxhash.xxh3_128_intdigest(key.encode())
        low, high = number & (2**64 - 1), number >> 64
        return struct.pack("<QQ", low, high)

    def key(self, name: str, type_name: str) -> str:
        return f"{DOMAIN}{name}/{type_name}/{self.hash_of(type_name)}"

    def publisher(self, name: str, type_name: str, qos: str = DEFAULT) -> Callable[..., None]:
        extras: dict[str, Any] = {}
        if qos == LATCHED:
            beat = ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=0.5)
            extras = {
                "cache": ext.CacheConfig(max_samples=1),
                "publisher_detection": True,
                "sample_miss_detection": beat,
            }
        publisher = ext.declare_advanced_publisher(
            self.session,
            self.key(name, type_name),
            congestion_control=zenoh.CongestionControl.DROP,
            **extras,
        )
        gid = self.announce("MP", name, type_name, qos)
        sent = 0

        def publish(payload: bytes, form: Callable[[int, bytes], bytes] = attachment) -> None:
            nonlocal sent
            sent += 1
            publisher.put(payload, attachment=form(sent, gid) or None)

        self.kept.append(publisher)
        return publish

    def subscribe(
        self, name: str, type_name: str, heard: Callable[[zenoh.Sample], None], qos: str = DEFAULT
    ) -> None:
        extras: dict[str, Any] = {}
        if qos == LATCHED:
            extras = {
                "history": ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
                "recovery": ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
                "subscriber_detection": True,
            }
        subscriber = ext.declare_advanced_subscriber(
            self.session, self.key(name, type_name), heard, **extras
        )
        self.kept.append(subscriber)
        self.announce("MS", name, type_name, qos)

    def serve(self, name: str, type_name: str, asked: Callable[[bytes, Answer], None]) -> None:
        """Take requests; each `Answer` may be given later, by another thread."""
        key = self.key(name, type_name)

        def came(query: zenoh.Query) -> None:
            assert query.payload is not None
            sequence, gid = sequence_and_gid(query)
            asked(query.payload.to_bytes(), Answer(query, key, sequence, gid))

        self.kept.append(self.session.declare_queryable(key, came, complete=True))
        self.announce("SS", name, type_name, "::,10:,:,:,,")

    def client(self, name: str, type_name: str) -> Callable[[bytes], tuple[bytes, bool]]:
        """Return what asks, and says whether the reply is marked as that of this request."""
        gid = self.announce("SC", name, type_name, "::,10:,:,:,,")
        key = self.key(name, type_name)
        sent = 0

        def ask(payload: bytes) -> tuple[bytes, bool]:
            nonlocal sent
            sent += 1
            replies = self.session.get(
                key,
                target=zenoh.QueryTarget.ALL_COMPLETE,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=600.0,
                payload=payload,
                attachment=attachment(sent, gid),
            )
            (reply,) = [reply.ok for reply in replies if reply.ok is not None]
            assert str(reply.key_expr) == key
            return reply.payload.to_bytes(), sequence_and_gid(reply) == (sent, gid)

        return ask

    def has(self, kind: str, name: str) -> bool:
        """Say whether somebody else is in the graph so, as `wait_for_service` looks."""
        everybody = self.session.liveliness().get(f"@ros2_lv/{DOMAIN}/**")
        keys = [str(reply.ok.key_expr) for reply in everybody if reply.ok is not None]
        mangled = name.replace("/", "%")
        return any(f"/{kind}/" in key and f"/{mangled}/" in key for key in keys)

    def wait_for(self, kind: str, name: str) -> None:
        while not self.has(kind, name):
            if self.done.wait(0.05):
                sys.exit("ended while it waited")


class Answer:
    """A request that is open."""

    def __init__(self, query: zenoh.Query, key: str, sequence: int, gid: bytes) -> None:
        self.query, self.key, self.sequence, self.gid = query, key, sequence, gid

    def give(self, payload: bytes) -> None:
        with self.query:
            self.query.reply(
                self.key, HEADER + payload, attachment=attachment(self.sequence, self.gid)
            )


def talk(node: Node, form: str = "today", qos: str = DEFAULT) -> None:
    forms: dict[str, Callable[[int, bytes], bytes]] = {
        "today": attachment,
        "old": old_attachment,
        "none": lambda _, __: b"",
        "gaps": lambda sequence, gid: attachment(sequence * 3, gid),
    }
    publish = node.publisher("/chatter", STRING, qos)
    say("ready")
    number = 0
    while not node.done.wait(0.05):
        number += 1
        publish(string(f"hello {number}"), forms[form])


def latch(node: Node) -> None:
    publish = node.publisher("/chatter", STRING, LATCHED)
    publish(string("overwritten"))
    publish(string("from long ago"))
    say("ready")
    node.done.wait()


def listen(node: Node, qos: str = DEFAULT) -> None:
    def heard(sample: zenoh.Sample) -> None:
        sequence, gid = sequence_and_gid(sample)
        say("heard", text_of(sample.payload.to_bytes()), sequence, gid.hex())

    node.subscribe("/chatter", STRING, heard, qos)
    say("ready")
    node.done.wait()


def stream(node: Node, topic: tuple[str, str], count: int, rate: float, body: bytes) -> None:
    name, type_name = topic
    publish = node.publisher(name, type_name, "::,200:,:,:,,")
    node.wait_for("MS", name)
    say("ready")
    started = time.monotonic()
    for number in range(count):
        if node.done.is_set():
            return
        publish(HEADER + struct.pack("<iI", number, 0) + body)
        time.sleep(max(started + (number + 1) / rate - time.monotonic(), 0))
    say("sent", count)
    node.done.wait()


def joints(node: Node, count: int, rate: float) -> None:
    names = b"".join(struct.pack("<I", 4) + name + b"\0" for name in (b"pan", b"yaw"))
    frame = struct.pack("<I", 1) + bytes(4)  # an empty text, and up to a multiple of 4
    of_two = struct.pack("<I", 2)
    head = frame + of_two + names  # ends at 40
    positions = of_two + bytes(-(4 + len(head) + 8) % 8) + struct.pack("<dd", 0.5, -0.5)
    stream(node, ("/joint_states", JOINTS), count, rate, head + positions + bytes(8))


def images(node: Node, count: int, rate: float) -> None:
    width, height = 640, 480
    body = struct.pack("<I", 1) + bytes(4) + struct.pack("<II", height, width)
    body += struct.pack("<I", 5) + b"rgb8\0" + b"\0"  # the text, and is_bigendian
    body += bytes(-(8 + len(body)) % 4) + struct.pack("<II", 3 * width, 3 * width * height)
    stream(node, ("/image", IMAGE), count, rate, body + bytes(3 * width * height))


def serve_sum(node: Node) -> None:
    def asked(request: bytes, answer: Answer) -> None:
        a, b = struct.unpack_from("<qq", request, 4)
        if a == 666:
            os._exit(1)  # with the request open
        if a >= 0:  # from a thread of its own, as rclcpp's executor does
            threading.Timer(0.02, answer.give, [struct.pack("<q", a + b)]).start()
        else:
            node.kept.append(answer)

    node.serve("/add_two_ints", ADD, asked)
    say("ready")
    node.done.wait()


def ask_sum(node: Node, count: int) -> None:
    ask = node.client("/fleet_sum", ADD)
    node.wait_for("SS", "/fleet_sum")
    for number in range(1, count + 1):
        reply, is_ours = ask(HEADER + struct.pack("<qq", number, 2))
        say("sum", is_ours, number, struct.unpack_from("<q", reply, 4)[0])
    node.done.wait()


def ask_badly(node: Node) -> None:
    """Ask what no node of rmw_zenoh asks: without an attachment, with half of one, for nothing."""
    node.wait_for("SS", "/fleet_sum")
    whole = attachment(1, bytes(16))
    request = HEADER + struct.pack("<qq", 1, 2)
    for payload, told in (
        (request, None), (request, whole[:20]), (None, whole), (b"", whole), (request[:9], whole),
    ):  # fmt: skip
        replies = node.session.get(
            node.key("/fleet_sum", ADD), timeout=5.0, payload=payload, attachment=told
        )
        say("replies", len([reply for reply in replies if reply.ok is not None]))
    say("done")
    node.done.wait()


def count_up(node: Node) -> None:
    """Serve the action Fibonacci: one number each 50 ms; an order below 0 is refused."""
    running: dict[bytes, tuple[int, list[int]]] = {}
    ended: dict[bytes, tuple[int, list[int]]] = {}
    waiting: list[tuple[bytes, Answer]] = []
    lock = threading.Lock()

    def send_goal(request: bytes, answer: Answer) -> None:
        goal, (order,) = request[4:20], struct.unpack_from("<i", request, 20)
        if order >= 0:
            with lock:
                running[goal] = (order, [0, 1])
        answer.give(struct.pack("<?3xiI", order >= 0, 0, 0))

    def get_result(request: bytes, answer: Answer) -> None:
        with lock:
            waiting.append((request[4:20], answer))

    def cancel(request: bytes, answer: Answer) -> None:
        goal = request[4:20]
        with lock:
            known = running.pop(goal, None)
            if known is not None:
                ended[goal] = (5, known[1])
        found = goal + bytes(8) if known is not None else b""
        answer.give(struct.pack("<b3xI", 0 if found else 2, len(found) // 24) + found)

    publish = node.publisher("/fibonacci/_action/feedback", FEEDBACK)
    node.serve("/fibonacci/_action/send_goal", SEND_GOAL, send_goal)
    node.serve("/fibonacci/_action/get_result", GET_RESULT, get_result)
    node.serve("/fibonacci/_action/cancel_goal", CANCEL, cancel)
    say("ready")
    while not node.done.wait(0.05):
        with lock:
            for goal, (order, numbers) in list(running.items()):
                numbers.append(numbers[-1] + numbers[-2])
                publish(HEADER + goal + struct.pack(f"<I{len(numbers)}i", len(numbers), *numbers))
                if len(numbers) > order:
                    ended[goal] = (4, running.pop(goal)[1])
            for goal, answer in [one for one in waiting if one[0] in ended]:
                waiting.remove((goal, answer))
                status, numbers = ended[goal]
                answer.give(struct.pack(f"<b3xI{len(numbers)}i", status, len(numbers), *numbers))


def act(node: Node, name: str, order: int) -> None:
    """Be a client of the action Fibonacci and see a goal to its end."""
    goal = os.urandom(16)

    def went_on(sample: zenoh.Sample) -> None:
        payload = sample.payload.to_bytes()
        (count,) = struct.unpack_from("<I", payload, 20)
        say("feedback", payload[4:20] == goal, *struct.unpack_from(f"<{count}i", payload, 24))

    def changed(sample: zenoh.Sample) -> None:
        payload = sample.payload.to_bytes()
        (count,) = struct.unpack_from("<I", payload, 4)
        for number in range(count):  # 16 bytes, a time, and a state filled up to 4 bytes each
            start = 8 + 28 * number
            if payload[start : start + 16] == goal:
                say("state", payload[start + 24])

    node.subscribe(f"/{name}/_action/feedback", FEEDBACK, went_on)
    node.subscribe(f"/{name}/_action/status", STATUS, changed, LATCHED)
    send_goal = node.client(f"/{name}/_action/send_goal", SEND_GOAL)
    get_result = node.client(f"/{name}/_action/get_result", GET_RESULT)
    node.wait_for("SS", f"/{name}/_action/send_goal")
    node.wait_for("SS", f"/{name}/_action/get_result")
    reply, is_ours = send_goal(HEADER + goal + struct.pack("<i", order))
    say("accepted", is_ours, reply[4])
    reply, is_ours = get_result(HEADER + goal)
    (count,) = struct.unpack_from("<I", reply, 8)
    say("result", is_ours, reply[4], *struct.unpack_from(f"<{count}i", reply, 12))
    node.done.wait()


def watch(node: Node) -> None:
    """Say what comes and goes in the graph."""

    def changed(sample: zenoh.Sample) -> None:
        is_there = sample.kind == zenoh.SampleKind.PUT
        say("token" if is_there else "gone", *str(sample.key_expr).split("/")[5:])

    tokens = node.session.liveliness().declare_subscriber(
        f"@ros2_lv/{DOMAIN}/**", changed, history=True
    )
    say("ready")
    node.done.wait()
    tokens.undeclare()


def peers(node: Node) -> None:
    """Say to how many other peers there are links, as it changes."""
    before = -1
    while not node.done.wait(0.05):
        now = len(node.session.info.peers_zid())
        if now != before:
            say("peers", now)
            before = now


ROLES: dict[str, Callable[..., None]] = {
    "talk": talk,
    "talk_best_effort": lambda node: talk(node, qos=SENSOR),
    "latch": latch,
    "listen": listen,
    "listen_latched": lambda node: listen(node, LATCHED),
    "joints": lambda node, count, rate: joints(node, int(count), float(rate)),
    "images": lambda node, count, rate: images(node, int(count), float(rate)),
    "serve_sum": serve_sum,
    "ask_sum": lambda node, count: ask_sum(node, int(count)),
    "ask_badly": ask_badly,
    "count_up": count_up,
    "act": lambda node, name, order: act(node, name, int(order)),
    "watch": watch,
    "peers": peers,
}


def main() -> None:
    role, *arguments = sys.argv[1:]
    humble = role.endswith("_humble")
    role = role.removesuffix("_humble")
    node = Node(role, knows_hashes=not humble)
    ROLES[role](node, *arguments)
    node.session.close()


if __name__ == "__main__":
    main()
