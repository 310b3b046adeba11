"""The fleet in containers: it comes up, is locked down, and its services come back."""

from __future__ import annotations

import json

import pytest

from .fleet import Fleet, run

SERVICES = ("face_tracking", "gateway", "router", "simulator", "yarp")


def test_the_default_fleet_is_healthy(fleet: Fleet) -> None:
    assert fleet.services() == sorted(SERVICES)
    for service in SERVICES:
        fleet.wait_healthy(service)


@pytest.mark.parametrize("service", SERVICES)
def test_a_service_that_crashes_comes_back_healthy(fleet: Fleet, service: str) -> None:
    fleet.crash(service)

    fleet.wait_healthy(service)


@pytest.mark.parametrize("service", SERVICES)
def test_a_service_can_do_no_harm_outside_its_container(fleet: Fleet, service: str) -> None:
    inside = (
        "import os; status = open('/proc/self/status').read();"
        "fields = dict(line.split(':', 1) for line in status.splitlines());"
        "print(os.getuid(), int(fields['CapBnd'], 16), fields['NoNewPrivs'].strip(),"
        " os.access('/opt/vertebra', os.W_OK))"
    )

    assert fleet.inside(service, "python", "-c", inside).split() == ["10001", "0", "1", "False"]


def test_images_share_their_layers(images: None) -> None:
    layers = {
        service: json.loads(
            run(
                "docker",
                "image",
                "inspect",
                "--format",
                "{{json .RootFS.Layers}}",
                f"vertebra/{service}",
            )
        )
        for service in SERVICES
    }
    shared = set.intersection(*(set(of_service) for of_service in layers.values()))
    assert len(shared) >= 3
