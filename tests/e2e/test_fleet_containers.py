"""The fleet in containers: it comes up, is locked down, and stops in order."""

from __future__ import annotations

import itertools
import json
import time
from typing import Final

import pytest

from .fleet import ROOT, Fleet, run

SERVICES: Final = ("face_tracking", "gateway", "ros2", "router", "simulator", "yarp")
OVERLAYS: Final = tuple(
    f"deploy/{file.name}" for file in sorted(ROOT.glob("deploy/compose.*.yaml"))
)
STOPPED_WITHIN_S: Final = 10.0
STOPPED_IN_ORDER: Final = {0, 143}
"""Exit statuses after SIGTERM; 137 would be SIGKILL."""
MAX_BYTES: Final = 1 << 30
"""What the whole fleet may hold in memory."""


def test_the_default_fleet_is_healthy(fleet: Fleet) -> None:
    assert fleet.services() == sorted(SERVICES)
    for service in SERVICES:
        fleet.wait_healthy(service)
    assert sum(map(fleet.resident_bytes, SERVICES)) < MAX_BYTES


@pytest.mark.parametrize("service", SERVICES)
def test_a_service_can_do_no_harm_outside_its_container(fleet: Fleet, service: str) -> None:
    inside = (
        "import os; status = open('/proc/self/status').read();"
        "fields = dict(line.split(':', 1) for line in status.splitlines());"
        "print(os.getuid(), int(fields['CapBnd'], 16), fields['NoNewPrivs'].strip(),"
        " [folder for folder in ('/', '/etc', '/opt/vertebra') if os.access(folder, os.W_OK)])"
    )

    assert fleet.inside(service, "python", "-c", inside).split() == ["10001", "0", "1", "[]"]


@pytest.mark.parametrize("service", SERVICES)
def test_the_engine_holds_a_container_to_its_limits(fleet: Fleet, service: str) -> None:
    limits = fleet.inspect(service)["HostConfig"]

    assert limits["ReadonlyRootfs"] is True
    assert limits["Privileged"] is False
    assert limits["CapDrop"] == ["ALL"]
    assert not limits["CapAdd"]
    assert limits["NetworkMode"] == f"{fleet.project}_default"
    assert 0 < limits["Memory"] < MAX_BYTES
    assert limits["RestartPolicy"]["Name"] == "unless-stopped"


def test_only_the_loopback_reaches_the_fleet(fleet: Fleet) -> None:
    published = {
        (service, binding["HostIp"])
        for service in SERVICES
        for bindings in fleet.inspect(service)["NetworkSettings"]["Ports"].values()
        for binding in bindings or ()
    }

    assert published == {("gateway", "127.0.0.1"), ("router", "127.0.0.1")}


def test_the_fleet_stops_in_order(fleet: Fleet) -> None:
    for service in SERVICES:
        fleet.wait_healthy(service)
    began_s = time.monotonic()
    fleet.stop_all()
    took_s = time.monotonic() - began_s

    try:
        statuses = {service: fleet.state(service)["ExitCode"] for service in SERVICES}
        assert set(statuses.values()) <= STOPPED_IN_ORDER, statuses
        assert took_s < STOPPED_WITHIN_S
    finally:
        fleet.start_all()


@pytest.mark.parametrize("overlays", [(), *((each,) for each in OVERLAYS), OVERLAYS], ids=str)
def test_every_profile_and_overlay_is_valid(engine: None, overlays: tuple[str, ...]) -> None:
    files = itertools.chain.from_iterable(("-f", name) for name in ("compose.yaml", *overlays))

    services = run(
        "env", "VERTEBRA_YARP_NAME_SERVER=192.0.2.1:10000", "VERTEBRA_YARP_BIND_HOST=192.0.2.2",
        "docker", "compose", *files, "--profile", "*", "config", "--services",
    )  # fmt: skip

    assert {*SERVICES, "camera"} - set(services.split()) <= {"simulator"}


def test_images_share_their_layers(images: None) -> None:
    layers = [
        set(json.loads(run(
            "docker", "image", "inspect", "--format", "{{json .RootFS.Layers}}",
            f"vertebra/{service}",
        )))
        for service in SERVICES
    ]  # fmt: skip

    assert len(set.intersection(*layers)) >= 3
