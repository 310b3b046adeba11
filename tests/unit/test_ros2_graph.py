"""What DDS tells of endpoints, and what it makes of the ROS graph."""

from __future__ import annotations

from typing import Any

from vertebra.messages import Array
from vertebra.ros2.graph import (
    OTHER_MIDDLEWARE,
    Endpoint,
    Graph,
    endpoint_of,
    entries_of,
    nodes_of,
)
from vertebra.ros2.qos import Qos

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
    def of(number: int) -> dict[str, Array]:
        return {"data": Array(gid(number), "|u1", (16,))}

    def node(namespace: str, name: str, *numbers: int) -> dict[str, Any]:
        return {
            "node_namespace": namespace,
            "node_name": name,
            "reader_gid_seq": [],
            "writer_gid_seq": [of(number) for number in numbers],
        }

    graph = Graph()
    nodes = [node("/", "talker", 1), node("/lab", "camera", 2)]
    graph.set_nodes(*nodes_of({"gid": of(9), "node_entities_info_seq": nodes}))
    assert graph.nodes() == ["/lab/camera", "/talker"]
    assert graph.node_of(endpoint(2)) == "/lab/camera"
    assert graph.node_of(endpoint(3)) == ""
    graph.remove_participant(gid(9))
    assert graph.nodes() == []
