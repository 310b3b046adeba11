"""One suite for all drivers of ROS 2: a driver says how to make a network for two of its nodes."""

from __future__ import annotations

import asyncio
import itertools
import random
import sys
import time
import uuid
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager

import pytest

from vertebra.bus.router import running_router
from vertebra.errors import ConfigError, TransportError
from vertebra.ros2.dds.driver import DdsTransport
from vertebra.ros2.definitions import Types
from vertebra.ros2.driver import Participation
from vertebra.ros2.drivers import open_driver
from vertebra.ros2.qos import Qos
from vertebra.testing.bus_suite import eventually
from vertebra.testing.ports import free_tcp_port
from vertebra.testing.ros2_suite import TEXT, Heard, Pair, TransportSuite, echo, matched, text

DOMAINS = itertools.cycle(random.sample(range(20, 30), 10))


def on_loopback(more: str = "") -> str:
    """Return Cyclone DDS's configuration of a network that is this test's alone."""
    return (
        '<CycloneDDS><Domain Id="any"><General><AllowMulticast>false</AllowMulticast>'
        '<Interfaces><NetworkInterface name="lo"/></Interfaces></General><Discovery>'
        f"{more}<Tag>{uuid.uuid4().hex}</Tag><LeaseDuration>1s</LeaseDuration>"
        '<ParticipantIndex>auto</ParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers>'
        "</Discovery></Domain></CycloneDDS>"
    )


class TestRmwZenoh(TransportSuite):
    """Two sessions that are clients of one router."""

    driver = "rmw_zenoh"
    library = "zenoh"
    remedy = "pip install eclipse-zenoh"
    compares_qos = False
    confirms = False

    @asynccontextmanager
    async def places(self) -> AsyncIterator[tuple[Participation, Participation]]:
        locator = f"tcp/127.0.0.1:{free_tcp_port()}"
        with running_router([locator]):
            yield (
                Participation(node="here", namespace="/suite", router=locator),
                Participation(node="there", namespace="/suite", router=locator),
            )


class TestDds(TransportSuite):
    """Two participants of one process: the same domain on the network, two for the library."""

    driver = "dds"
    library = "cyclonedds"
    remedy = "pip install cyclonedds==11.0.1"

    @asynccontextmanager
    async def places(self) -> AsyncIterator[tuple[Participation, Participation]]:
        domain_id = next(DOMAINS)
        configuration = on_loopback(f"<ExternalDomainId>{domain_id}</ExternalDomainId>")
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("CYCLONEDDS_URI", configuration)
            yield (
                Participation(domain_id=domain_id, node="here", namespace="/suite"),
                Participation(domain_id=domain_id + 100, node="there", namespace="/suite"),
            )

    async def test_what_a_full_reader_refuses_is_counted(
        self, pair: Pair, caplog: pytest.LogCaptureFixture
    ) -> None:
        heard, offered = Heard(), Qos(reliability="best_effort", depth=300)
        reader = pair.here.reader("/suite/full", TEXT, offered, heard)
        writer = pair.there.writer("/suite/full", TEXT, offered)
        await matched(writer)
        with thread_switches_after(60):  # nothing is taken meanwhile
            for number in range(1000):
                writer.write(text(str(number)))
            until_s = time.monotonic() + 0.3
            while time.monotonic() < until_s:
                pass
        await eventually(lambda: len(heard.payloads) + reader.dropped >= 1000)
        assert len(heard.payloads) + reader.dropped == 1000
        assert reader.dropped > 0
        assert "samples of rt/suite/full were lost" in caplog.text

    async def test_topics_of_the_past_take_no_room(self) -> None:
        types = await asyncio.to_thread(Types.standard)
        async with self.places() as (here, _), open_driver("dds", here, types) as transport:
            assert isinstance(transport, DdsTransport)
            before = set(transport._dds._topics)
            for number in range(20):
                first = transport.writer(f"/past{number}", "std_msgs/msg/String", Qos())
                second = transport.reader(
                    f"/past{number}", "std_msgs/msg/String", Qos(), lambda *_: None
                )
                first.close()
                with pytest.raises(TransportError, match="is in use here with another type"):
                    transport.writer(f"/past{number}", "std_msgs/msg/Empty", Qos())
                second.close()
            assert set(transport._dds._topics) == before
            transport.writer("/past1", "std_msgs/msg/Empty", Qos()).close()


class TestRclpy(TransportSuite):
    """Two nodes of a ROS 2 that has been built or installed, on the middleware it is set to."""

    driver = "rclpy"
    library = "rclpy"
    remedy = "source the setup.bash of a ROS 2 whose Python is this one"
    unknown_types = False
    counts_all = False

    @asynccontextmanager
    async def places(self) -> AsyncIterator[tuple[Participation, Participation]]:
        domain_id = next(DOMAINS)
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("CYCLONEDDS_URI", on_loopback())
            patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
            yield (
                Participation(domain_id=domain_id, node="here", namespace="/suite"),
                Participation(domain_id=domain_id, node="there", namespace="/suite"),
            )

    async def test_a_type_that_this_ros_does_not_have_is_told(self, pair: Pair) -> None:
        with pytest.raises(TransportError, match=r"the type lab_msgs/msg/Strange .* install its"):
            pair.here.reader("/suite/strange", "lab_msgs/msg/Strange", Qos(), lambda *_: None)
        with pytest.raises(TransportError, match="lab_msgs/srv/Strange"):
            pair.here.server("/suite/strange", "lab_msgs/srv/Strange", echo)

    async def test_an_interface_is_not_its_matter(self, types: Types) -> None:
        part = Participation(interface="eth7")
        with pytest.raises(ConfigError, match=r"'eth7'.*VERTEBRA_ROS2_INTERFACE to auto"):
            async with open_driver("rclpy", part, types):
                pass


async def test_ros_that_is_missing_is_told_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.startswith("vertebra.ros2.rclpy")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "rclpy", None)
    with pytest.raises(ConfigError, match=r"source its setup.bash.*leave the driver at dds"):
        async with open_driver("rclpy", Participation(), Types()):
            pass


@contextmanager
def thread_switches_after(interval_s: float) -> Iterator[None]:
    """Let no other thread of Python run for so long."""
    before_s = sys.getswitchinterval()
    sys.setswitchinterval(interval_s)
    try:
        yield
    finally:
        sys.setswitchinterval(before_s)
