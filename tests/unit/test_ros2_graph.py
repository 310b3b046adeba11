"""What DDS tells of endpoints, and what it makes of the ROS graph."""

from __future__ import annotations

from typing import Any

import pytest

from vertebra.errors import DecodeError
from vertebra.ros2.cdr import Cdr
from vertebra.ros2.definitions import Types
from vertebra.ros2.graph import (
    OTHER_MIDDLEWARE,
    Endpoint,
    Graph,
    endpoint_of,
    entries_of,
    nodes_of,
)
from vertebra.ros2.names import DISCOVERY_TYPE
from vertebra.ros2.qos import Qos

CDR = Cdr(Types.standard())
HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


def gid(number: int) -> bytes:
    return bytes(15) + bytes([number])


def endpoint(number: int, **fields: Any) -> Endpoint:
    given: dict[str, Any] = {
        "kind": "writer",
        "topic": "rt/chatter",
        "type_name": "std_msgs::msg::dds_::String_",
        "qos": Qos(),
        "user_data": b"",
    }
    found = endpoint_of(gid=gid(number), **given | fields)
    assert found is not None
    return found


def server(number: int, user_data: bytes, leaf: str = "AddTwoInts") -> Endpoint:
    return endpoint(
        number,
        kind="reader",
        topic="rq/addRequest",
        type_name=f"example_interfaces::srv::dds_::{leaf}_Request_",
        user_data=user_data,
    )


def test_user_data_of_a_server() -> None:
    said = b"serviceid=1.10.a;typehash=RIHS01_00;"
    assert entries_of(said) == {"serviceid": "1.10.a", "typehash": "RIHS01_00"}


def test_noise_is_no_user_data() -> None:
    assert entries_of(b"\xff\x00;;nothing") == {}


def test_topic_of_a_ros_node() -> None:
    found = endpoint(1, user_data=f"typehash={HASH};".encode())
    assert (found.role, found.name, found.type) == ("topic", "/chatter", "std_msgs/msg/String")
    assert found.type_hash == HASH


def test_endpoint_that_is_none_of_ros_is_left_out() -> None:
    given: dict[str, Any] = {"gid": gid(1), "kind": "writer", "qos": Qos(), "user_data": b""}
    assert endpoint_of(topic="Square", type_name="ShapeType", **given) is None
    assert endpoint_of(topic="rt/square", type_name="ShapeType", **given) is None
    wrong_part = "std_srvs::srv::dds_::Empty_Response_"
    assert endpoint_of(topic="rq/aRequest", type_name=wrong_part, **given) is None


def test_service_with_and_without_a_client_in_its_requests() -> None:
    graph = Graph()
    assert graph.service("/add") is None
    graph.add(server(1, b"typehash=RIHS01_00;"))
    found = graph.service("/add")
    assert found is not None
    assert found.type == "example_interfaces/srv/AddTwoInts"
    assert found.problem == OTHER_MIDDLEWARE
    graph.add(server(2, b"serviceid=1.2;typehash=RIHS01_00;"))
    assert graph.services()["/add"].problem == OTHER_MIDDLEWARE
    graph.remove(gid(1))
    assert graph.services()["/add"].problem == ""
    remedies = "RMW_IMPLEMENTATION=rmw_cyclonedds_cpp", "VERTEBRA_ROS2_DRIVER=rclpy"
    assert all(remedy in OTHER_MIDDLEWARE for remedy in remedies)


def test_servers_of_two_types_are_a_problem() -> None:
    graph = Graph()
    graph.add(server(1, b"serviceid=1;"))
    graph.add(server(2, b"serviceid=2;", "Other"))
    assert "do not agree on its type" in graph.services()["/add"].problem


def test_topics_have_the_types_of_all_their_endpoints() -> None:
    graph = Graph()
    graph.add(endpoint(1))
    graph.add(endpoint(2, kind="reader", type_name="std_msgs::msg::dds_::Empty_"))
    assert graph.topics() == {"/chatter": {"std_msgs/msg/String", "std_msgs/msg/Empty"}}
    assert [one.gid for one in graph.writers("/chatter")] == [gid(1)]
    assert graph.remove(gid(1))
    assert not graph.remove(gid(1))
    assert graph.topics() == {"/chatter": {"std_msgs/msg/Empty"}}


def test_endpoint_that_changes_is_known_once() -> None:
    graph = Graph()
    graph.add(endpoint(1))
    graph.add(endpoint(1, topic="rt/other"))
    assert list(graph.topics()) == ["/other"]


def test_nodes_come_and_go_with_their_participant() -> None:
    def of(number: int) -> dict[str, bytes]:
        return {"data": gid(number)}

    def node(namespace: str, name: str, *numbers: int) -> dict[str, Any]:
        writers = [of(number) for number in numbers]
        return {"node_namespace": namespace, "node_name": name, "writer_gid_seq": writers}

    graph = Graph()
    nodes = [node("/", "talker", 1), node("/lab", "camera", 2)]
    record = {"gid": of(9), "node_entities_info_seq": nodes}
    graph.set_nodes(*nodes_of(CDR.encode(record, DISCOVERY_TYPE), CDR))
    assert graph.nodes() == ["/lab/camera", "/talker"]
    assert graph.node_of(endpoint(2)) == "/lab/camera"
    assert graph.node_of(endpoint(3)) == ""
    graph.remove_participant(gid(9))
    assert graph.nodes() == []


HUMBLE = bytes.fromhex(
    "00010000"  # CDR, little endian
    "0110a1b2c3d4e5f60718293a000001c1 0000000000000000"  # participant: a GUID, and 8 bytes more
    "01000000"  # one node
    "05000000 2f6c616200 000000"  # "/lab"
    "07000000 74616c6b657200 00"  # "talker"
    "00000000"  # no readers
    "01000000"  # one writer
    "0110a1b2c3d4e5f60718293a00000103 0000000000000000"
)


def test_nodes_of_humble_have_longer_gids() -> None:
    participant, nodes = nodes_of(HUMBLE, CDR)
    assert participant == bytes.fromhex("0110a1b2c3d4e5f60718293a000001c1")
    assert nodes == {"/lab/talker": {bytes.fromhex("0110a1b2c3d4e5f60718293a00000103")}}
    assert nodes_of(HUMBLE[:28] + bytes(4), CDR) == (participant, {})


@pytest.mark.parametrize("end", range(len(HUMBLE)))
def test_cut_nodes_of_humble_are_refused(end: int) -> None:
    if end not in range(24, 28):  # what is left is what a later release says of no nodes
        with pytest.raises(DecodeError):
            nodes_of(HUMBLE[:end], CDR)
