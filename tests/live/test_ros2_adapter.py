"""The ROS 2 adapter between other DDS participants on loopback and the backbone in memory."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from vertebra.bus import Delivery, MemoryBus, MemoryNetwork, Reply, Request
from vertebra.errors import ConfigError, RemoteError
from vertebra.messages import Array, AudioChunk, Image, JointState, Native, Text
from vertebra.ros2.cdr import Cdr
from vertebra.ros2.definitions import Types
from vertebra.service import MessagePublisher, run_service
from vertebra.testing.bus_suite import eventually
from vertebra_ros2.adapter import serve
from vertebra_ros2.settings import Ros2Settings

from .ros2_lab import DOMAINS, Lab, adapter, drain, first, lab_with, peer, repeated

pytestmark = pytest.mark.live

ROUTES = """
topics:
  - {ros: /joint_states, key: robot/joints, depth: 200}
  - {ros: /chatter, key: robot/said}
services:
  - {ros: /add_two_ints, key: robot/sum}
actions:
  - {ros: /fibonacci, key: robot/count}
"""


@pytest.fixture
async def lab(tmp_path: Path) -> AsyncIterator[Lab]:
    async with lab_with(tmp_path, ROUTES) as lab:
        yield lab


def replace_routes(lab: Lab, text: str) -> None:
    lab.routes.write_text(text)
    now_ns = time.time_ns()
    os.utime(lab.routes, ns=(now_ns, now_ns))


async def test_topic_arrives_with_its_origin(lab: Lab) -> None:
    reader = lab.read("robot/said", Text)
    async with peer(lab, "talk"):
        received = await first(reader)
    assert isinstance(received.message, Text)
    assert received.message.text.startswith("hello ")
    assert received.header.origin == f"ros2:{lab.domain_id}:/chatter"
    assert received.header.hops == 1
    assert abs(time.time_ns() - received.header.captured_ns) < 10e9


SOUNDS = """
topics:
  - {ros: /audio, key: robot/ear, sound: {rate_hz: 16000, channels: 2}}
  - {ros: /fleet_audio, key: robot/ear/again, type: audio_common_msgs/msg/AudioData,
     direction: outbound}
  - {ros: /fleet_audio_info, key: robot/ear/again, type: audio_common_msgs/msg/AudioInfo,
     direction: outbound}
"""


async def test_sound_goes_both_ways(tmp_path: Path) -> None:
    routes = tmp_path / "routes.yaml"
    await asyncio.to_thread(routes.write_text, SOUNDS)
    async with adapter(MemoryNetwork(), next(DOMAINS), routes) as lab, peer(lab, "hear") as node:
        chunk = (await first(lab.read("robot/ear", AudioChunk))).message
        assert chunk == AudioChunk(samples=Array(bytes(range(8)), "<i2", (2, 2)), rate_hz=16000)
        publisher = lab.publisher("robot/ear/again")

        async def speak() -> None:
            while True:
                publisher.publish(chunk, captured_ns=time.time_ns())
                await asyncio.sleep(0.02)

        speaking = asyncio.create_task(speak())
        assert await node.until("sound") == ["sound", list(range(8))]
        _, info = await node.until("info")
        assert (info["channels"], info["sample_rate"], info["sample_format"]) == (2, 16000, "S16LE")
        speaking.cancel()
        await asyncio.wait([speaking])


async def test_topic_is_left_alone_until_someone_subscribes(lab: Lab) -> None:
    async with peer(lab, "talk"), peer(lab, "watch") as watch:
        await watch.until("endpoint", "writer", "rt/chatter")
        await asyncio.sleep(0.5)
        seen = []
        while not watch.lines.empty():
            seen.append(watch.lines.get_nowait())
        assert not [line for line in seen if line[:3] == ["endpoint", "reader", "rt/chatter"]]
        reader = lab.read("robot/said", Text)
        line = await watch.until("endpoint", "reader", "rt/chatter")
        assert line[5] == (
            "typehash=RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18;"
        )
        await first(reader)
        reader.subscription.close()


async def test_best_effort_publisher_is_heard(lab: Lab) -> None:
    reader = lab.read("robot/said", Text)
    async with peer(lab, "talk_best_effort"):
        await first(reader)


async def test_best_effort_publisher_that_comes_later_is_heard_too(lab: Lab) -> None:
    reader = lab.read("robot/said", Text)
    async with peer(lab, "talk") as reliable:
        await first(reader)
        async with peer(lab, "talk_best_effort") as late:
            await late.until("ready")
            reliable.process.send_signal(signal.SIGKILL)
            await asyncio.sleep(0.5)
            drain(reader)
            await first(reader)


async def test_latched_message_reaches_us_late(lab: Lab) -> None:
    async with peer(lab, "latch") as latch:
        await latch.until("ready")
        received = await first(lab.read("robot/said", Text))
    assert isinstance(received.message, Text)
    assert received.message.text == "from long ago"


async def test_restarted_publisher_is_heard_again(lab: Lab) -> None:
    reader = lab.read("robot/said", Text)
    for _ in range(2):
        async with peer(lab, "talk"):
            await first(reader)
        drain(reader)


async def test_topic_without_route_is_mirrored_and_goes(lab: Lab) -> None:
    async with peer(lab, "images", "100000", "30"):
        received = await first(lab.read("ros2/image", Image))
        assert isinstance(received.message, Image)
        assert received.message.pixels.shape == (480, 640, 3)
        assert (await lab.carried())["/image"] == "ros2/image"
    async with asyncio.timeout(5):
        while "/image" in await lab.carried():
            await asyncio.sleep(0.05)


async def test_unknown_type_passes_as_its_bytes(lab: Lab) -> None:
    async with (
        peer(lab, "strange"),
        asyncio.timeout(10),
        lab.bus.subscribe("ros2/strange", Delivery.latest()) as subscription,
    ):
        sample = await anext(aiter(subscription))
    assert sample.encoding == "application/cdr;lab_msgs/msg/Strange"
    assert sample.payload == bytes.fromhex("00010000 01000000 02000000")


async def test_folder_of_a_lab_makes_a_type_known(tmp_path: Path) -> None:
    folder = tmp_path / "lab_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Strange.msg").write_text("int32 left\nint32 right\n")
    async with (
        lab_with(tmp_path, types=(tmp_path,)) as lab,
        peer(lab, "strange_typed"),
    ):
        received = await first(lab.read("ros2/strange", Native))
    assert received.message == Native(value={"left": 1, "right": 2})


async def test_other_definition_of_a_type_is_refused_by_name(lab: Lab) -> None:
    reader = lab.read("robot/said")
    async with peer(lab, "talk_other_hash"):
        text = await lab.told(lambda text: "another definition" in text)
    assert "/lab/talk_other_hash has another definition of std_msgs/msg/String" in text
    assert f"RIHS01_{'0' * 64}" in text
    assert "RIHS01_df668c74" in text
    reader.subscription.close()


OUTBOUND = """
topics:
  - {ros: /chatter, key: robot/words, type: std_msgs/msg/String, direction: outbound,
     delivery: queue, depth: 64}
"""


async def test_key_reaches_a_ros_subscriber(tmp_path: Path) -> None:
    async with (
        lab_with(tmp_path, OUTBOUND) as lab,
        peer(lab, "listen") as listener,
    ):
        await listener.until("ready")
        publisher = lab.publisher("robot/words")
        async with repeated(lambda: publisher.publish(Text(text="hello from the fleet"))):
            assert await listener.until("heard") == ["heard", "hello from the fleet"]


async def test_publisher_that_is_kept_apart_by_its_qos_is_told(lab: Lab) -> None:
    reader = lab.read("robot/said", Text)
    async with peer(lab, "talk_exclusive"):
        await lab.told(lambda text: "/chatter: a publisher is not heard: its ownership" in text)
        await lab.told(lambda text: "/chatter: 0 messages in 5 s: the ownership" in text)
        async with peer(lab, "talk"):  # another one is heard, and the first one still told
            await first(reader)
            await lab.told(lambda text: "/chatter: a publisher is not heard" in text)
    await lab.told(lambda text: "/chatter" not in text)
    reader.subscription.close()


async def test_subscriber_that_is_kept_apart_by_its_qos_is_told(tmp_path: Path) -> None:
    routes = tmp_path / "routes.yaml"
    routes.write_text(OUTBOUND)
    async with (
        adapter(MemoryNetwork(), next(DOMAINS), routes) as lab,
        peer(lab, "listen_with_deadline") as listener,
    ):
        text = await lab.told(lambda text: "/chatter: a subscriber does not hear us" in text)
        assert "its deadline differs" in text
        assert listener.process.stdin is not None
        listener.process.stdin.close()
        await lab.told(lambda text: "/chatter" not in text)


async def test_nothing_is_carried_out_for_nobody(tmp_path: Path) -> None:
    wanted: list[bool] = []
    async with lab_with(tmp_path, OUTBOUND) as lab:
        lab.bus.follow_demand("robot/words", wanted.append)
        await asyncio.sleep(0.2)
        assert wanted in ([], [False])
        async with peer(lab, "listen"):
            await eventually(lambda: wanted[-1:] == [True])
        await eventually(lambda: wanted[-1:] == [False])


async def test_latched_subscriber_gets_what_was_before_it(tmp_path: Path) -> None:
    retained = OUTBOUND.replace("delivery: queue, depth: 64", "retain: true, depth: 1")
    async with lab_with(tmp_path, retained) as lab:
        lab.publisher("robot/words").publish(Text(text="before"))
        await asyncio.sleep(0.2)
        async with peer(lab, "listen_latched") as listener:
            assert await listener.until("heard") == ["heard", "before"]


async def test_what_came_from_ros_does_not_go_back(tmp_path: Path) -> None:
    async with (
        lab_with(tmp_path, OUTBOUND) as lab,
        peer(lab, "listen") as listener,
    ):
        await listener.until("ready")
        echo = MessagePublisher(
            lab.bus, lab.codecs, "robot/words", origin=f"ros2:{lab.domain_id}:/other"
        )
        own = lab.publisher("robot/words")
        async with repeated(
            lambda: echo.publish(Text(text="echo")), lambda: own.publish(Text(text="own"))
        ):
            heard = [(await listener.until("heard"))[1] for _ in range(5)]
    assert heard == ["own"] * 5


async def test_message_of_another_kind_is_refused_and_the_route_lives(tmp_path: Path) -> None:
    async with (
        lab_with(tmp_path, OUTBOUND) as lab,
        peer(lab, "listen") as listener,
    ):
        await listener.until("ready")
        publisher = lab.publisher("robot/words")
        async with repeated(
            lambda: publisher.publish(Native(value=5)), lambda: publisher.publish(Text(text="fine"))
        ):
            assert (await listener.until("heard"))[1] == "fine"
        metrics = await lab.bus.call("@vertebra/services/ros2/1/metrics", timeout_s=5)
        assert b"vertebra_ros2_refused_total 0.0" not in metrics.payload


async def test_ros_service_is_called_by_its_key(lab: Lab) -> None:
    async with peer(lab, "serve_sum") as server:
        await server.until("ready")
        assert await lab.call("robot/sum", {"a": 40, "b": 2}) == {"sum": 42}
        assert await lab.call("ros2/add_two_ints", {"a": 1}) == {"sum": 1}


async def test_parameters_of_a_node_are_read(lab: Lab) -> None:
    async with peer(lab, "have_parameters") as node:
        await node.until("ready")
        reply = await lab.call("ros2/lab/camera/get_parameters", {"names": ["many"]})
    (value,) = reply["values"]
    assert value["string_value"] == "of many"
    assert value["bool_array_value"] == [True, False]
    assert value["double_array_value"] == [1.5]


async def test_many_calls_at_once_get_their_own_answers(lab: Lab) -> None:
    async with peer(lab, "serve_sum") as server:
        await server.until("ready")
        calls = (lab.call("robot/sum", {"a": number, "b": 1}) for number in range(50))
        sums = await asyncio.gather(*calls)
    assert sums == [{"sum": number + 1} for number in range(50)]


async def test_call_passes_as_its_bytes(lab: Lab) -> None:
    cdr = Cdr(Types.standard())
    name = "example_interfaces/srv/AddTwoInts"
    async with peer(lab, "serve_sum") as server:
        await server.until("ready")
        reply = await lab.bus.call(
            "robot/sum",
            cdr.encode({"a": 40, "b": 2}, f"{name}_Request"),
            encoding="application/cdr",
            timeout_s=5,
        )
    assert reply.encoding == f"application/cdr;{name}_Response"
    assert cdr.decode(reply.payload, f"{name}_Response") == {"sum": 42}


async def test_call_that_is_no_request_is_refused(lab: Lab) -> None:
    async with peer(lab, "serve_sum") as server:
        await server.until("ready")
        with pytest.raises(RemoteError, match="there is no field 'c'; known: a, b") as caught:
            await lab.call("robot/sum", {"c": 1})
        assert caught.value.kind == "CommandRefusedError"
        with pytest.raises(RemoteError, match=r"AddTwoInts_Request\.a: is int64, not 'x'"):
            await lab.call("robot/sum", {"a": "x"})


async def test_call_without_an_answer_has_a_deadline(lab: Lab) -> None:
    async with peer(lab, "serve_sum") as server:
        await server.until("ready")
        assert await lab.call("robot/sum", {"a": 1}) == {"sum": 1}
        with pytest.raises((RemoteError, TimeoutError)) as caught:
            await lab.call("robot/sum", {"a": -1}, timeout_s=0.5)
        assert "DeadlineError" in str(caught.value) or isinstance(caught.value, TimeoutError)
        assert await lab.call("robot/sum", {"a": 2}) == {"sum": 2}


async def test_call_of_nobody_says_so(lab: Lab) -> None:
    with pytest.raises(RemoteError, match="nobody offers the ROS service /add_two_ints"):
        await lab.call("robot/sum", {"a": 1})


async def test_restarted_server_is_called_again(lab: Lab) -> None:
    for _ in range(2):
        async with peer(lab, "serve_sum") as server:
            await server.until("ready")
            assert await lab.call("robot/sum", {"a": 40, "b": 2}) == {"sum": 42}


async def test_service_of_fast_dds_is_recognised(lab: Lab) -> None:
    async with peer(lab, "serve_sum_fast_dds") as server:
        await server.until("ready")
        text = await lab.told(lambda text: "ROS services: 1 cannot be called" in text)
        assert "/add_two_ints" in text
        assert "RMW_IMPLEMENTATION=rmw_cyclonedds_cpp" in text
        began_s = time.monotonic()
        with pytest.raises(RemoteError, match="RMW_IMPLEMENTATION=rmw_cyclonedds_cpp"):
            await lab.call("ros2/add_two_ints", {"a": 1})
        assert time.monotonic() - began_s < 1


async def test_action_is_started_and_followed_to_its_result(lab: Lab) -> None:
    feedback = lab.read("robot/count/feedback", Native)
    async with peer(lab, "count_up") as server:
        await server.until("ready")
        await lab.told(lambda text: "action /fibonacci" not in text)
        started = await lab.call("robot/count/goal", {"order": 6})
        received = await first(feedback)
        ended = await lab.call("robot/count/result", started)
    assert isinstance(received.message, Native)
    told = received.message.value
    assert told["goal_id"] == started["goal_id"]
    assert told["feedback"]["sequence"].tolist()[:3] == [0, 1, 1]
    assert ended == {"status": "succeeded", "result": {"sequence": [0, 1, 1, 2, 3, 5, 8]}}


async def test_action_is_cancelled(lab: Lab) -> None:
    async with peer(lab, "count_up") as server:
        await server.until("ready")
        await lab.told(lambda text: "action /fibonacci" not in text)
        started = await lab.call("robot/count/goal", {"order": 1000})
        cancelled = await lab.call("robot/count/cancel", started)
        assert cancelled == {"cancelling": [started["goal_id"]]}
        assert (await lab.call("robot/count/result", started))["status"] == "canceled"
        with pytest.raises(RemoteError, match="does not know this goal"):
            await lab.call("robot/count/cancel", started)


async def test_goal_that_is_refused_or_no_goal_says_so(lab: Lab) -> None:
    with pytest.raises(
        RemoteError, match="nobody offers the ROS service /fibonacci/_action/send_goal"
    ):
        await lab.call("robot/count/goal", {"order": 6})
    async with peer(lab, "count_up") as server:
        await server.until("ready")
        await lab.told(lambda text: "action /fibonacci" not in text)
        with pytest.raises(RemoteError, match="refuses this goal"):
            await lab.call("robot/count/goal", {"order": -1})
        with pytest.raises(RemoteError, match="there is no field 'ordr'; known: order"):
            await lab.call("robot/count/goal", {"ordr": 1})
        with pytest.raises(RemoteError, match="say which goal"):
            await lab.call("robot/count/result", {})


OFFERED = """
services:
  - {ros: /fleet_sum, key: robot/sum, type: example_interfaces/srv/AddTwoInts,
     direction: outbound, timeout_s: 1}
"""


async def test_key_is_called_through_ros(tmp_path: Path) -> None:
    async with lab_with(tmp_path, OFFERED) as lab:

        async def add(request: Request) -> Reply:
            terms = json.loads(request.payload)
            return Reply(
                payload=json.dumps({"sum": terms["a"] + terms["b"]}).encode(),
                encoding="application/json",
            )

        lab.bus.serve("robot/sum", add)
        async with peer(lab, "ask_sum", "3") as client:
            for number in (1, 2, 3):
                assert await client.until("sum") == ["sum", True, number, number + 2]


async def test_our_node_is_in_the_graph(tmp_path: Path) -> None:
    async with (
        lab_with(tmp_path, OFFERED, node="fleet", namespace="/lab") as lab,
        peer(lab, "watch") as watch,
    ):
        request = await watch.until("endpoint", "reader", "rq/fleet_sumRequest")
        reply = await watch.until("endpoint", "writer", "rr/fleet_sumReply")
    assert request[3] == "example_interfaces::srv::dds_::AddTwoInts_Request_"
    assert reply[3] == "example_interfaces::srv::dds_::AddTwoInts_Response_"
    said = dict(entry.split("=") for entry in request[5].removesuffix(";").split(";"))
    assert said["typehash"].startswith("RIHS01_e118de6bf5")
    assert len(said["serviceid"].split(".")) == 16
    assert request[5] == reply[5]


async def test_our_node_names_its_endpoints(tmp_path: Path) -> None:
    async with (
        lab_with(tmp_path, OFFERED, node="fleet", namespace="/lab") as lab,
        peer(lab, "watch") as watch,
    ):
        node = await watch.until("node", "/lab", "fleet")
        gids: set[str] = set()
        while len(gids) < 2:
            line = await watch.until("endpoint")
            if line[2].startswith("r") and line[2].endswith(("Request", "Reply")):
                gids.add(line[4])
        while not gids <= set(node[3]):
            node = await watch.until("node", "/lab", "fleet")


async def test_routes_are_taken_over_without_a_restart(lab: Lab) -> None:
    await asyncio.to_thread(replace_routes, lab, "topics: [{ros: /chatter, key: robot/other}]")
    reader = lab.read("robot/other", Text)
    async with peer(lab, "talk"):
        await first(reader)
    assert (await lab.carried()).get("/chatter") == "robot/other"


async def test_faulty_routes_are_reported_and_change_nothing(lab: Lab) -> None:
    await asyncio.to_thread(replace_routes, lab, "topics:\n  - {ros: chatter, key: robot/other}")
    text = await lab.told(lambda text: "routes: kept as they were" in text)
    assert "routes.yaml:2: " in text
    assert (await lab.carried())["/chatter"] == "robot/said"


async def test_route_of_an_unknown_type_does_not_start(tmp_path: Path) -> None:
    routes = tmp_path / "routes.yaml"
    routes.write_text("topics: [{ros: /a, key: a, type: lab/msg/No, direction: outbound}]")
    settings = Ros2Settings(domain_id=next(DOMAINS), routes=routes)
    with pytest.raises(ConfigError, match="the ROS type lab/msg/No is not known"):
        await run_service("ros2", settings, serve, bus=MemoryBus(MemoryNetwork()))


async def test_two_domains_on_one_backbone(tmp_path: Path) -> None:
    network = MemoryNetwork()
    one_file, other_file = tmp_path / "one.yaml", tmp_path / "other.yaml"
    one_file.write_text("topics: [{ros: /chatter, key: one/said}]")
    other_file.write_text("topics: [{ros: /chatter, key: other/said}]")
    async with (
        adapter(network, next(DOMAINS), one_file, automatic=False) as one,
        adapter(network, next(DOMAINS), other_file, automatic=False, instance="2") as other,
    ):
        said_in_one, said_in_other = one.read("one/said", Text), one.read("other/said", Text)
        async with peer(one, "talk"):
            await first(said_in_one)
        assert said_in_other.subscription.take() is None
        async with peer(other, "latch"):
            received = await first(said_in_other)
    assert received.message == Text(text="from long ago")


async def test_killed_publisher_is_missed_and_a_new_one_is_heard(lab: Lab) -> None:
    reader = lab.read("robot/said", Text)
    async with peer(lab, "talk") as killed:
        await first(reader)
        killed.process.kill()
        await killed.process.wait()
    drain(reader)
    async with peer(lab, "talk"):
        await first(reader)


async def test_joint_stream_of_1_khz_loses_nothing(lab: Lab) -> None:
    reader = lab.read("robot/joints", JointState)
    async with peer(lab, "joints", "2000", "1000") as robot:
        received = []
        async with asyncio.timeout(30):
            async for one in reader:
                received.append(one)
                if len(received) == 2000:
                    break
        await robot.until("sent")
    sequences = [one.header.sequence for one in received]
    assert sequences == list(range(2000))
    assert reader.subscription.dropped == 0


async def test_vga_images_at_30_hz_lose_nothing(lab: Lab) -> None:
    reader = lab.read("ros2/image", Image)
    async with peer(lab, "images", "60", "30"):
        delays_ns = []
        async with asyncio.timeout(30):
            async for one in reader:
                delays_ns.append(time.time_ns() - one.header.captured_ns)
                if len(delays_ns) == 60:
                    break
    assert sorted(delays_ns)[30] < 50e6
