"""One suite for all drivers of ROS 2: a driver says how to make a network for two of its nodes."""

from __future__ import annotations

import itertools
import random
import uuid
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from vertebra.bus.router import running_router
from vertebra.ros2.drivers import Participation
from vertebra.testing.ports import free_tcp_port
from vertebra.testing.ros2_suite import TransportSuite

DOMAINS = itertools.cycle(random.sample(range(20, 30), 10))


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
        configuration = (
            '<CycloneDDS><Domain Id="any"><General><AllowMulticast>false</AllowMulticast>'
            '<Interfaces><NetworkInterface name="lo"/></Interfaces></General><Discovery>'
            f"<ExternalDomainId>{domain_id}</ExternalDomainId><Tag>{uuid.uuid4().hex}</Tag>"
            "<LeaseDuration>1s</LeaseDuration>"
            '<ParticipantIndex>auto</ParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers>'
            "</Discovery></Domain></CycloneDDS>"
        )
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("CYCLONEDDS_URI", configuration)
            yield (
                Participation(domain_id=domain_id, node="here", namespace="/suite"),
                Participation(domain_id=domain_id + 100, node="there", namespace="/suite"),
            )
