"""compose.yaml describes every service, locks each one down, and fits ./vertebra up as it is."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Final

import pytest
import yaml

ROOT: Final = Path(__file__).parents[2]
COMPOSE: Final[dict[str, Any]] = yaml.safe_load((ROOT / "compose.yaml").read_text("utf-8"))
SERVICES: Final[dict[str, Any]] = COMPOSE["services"]
DOCKERFILE: Final = (ROOT / "deploy/Dockerfile").read_text("utf-8")
LOCAL_ENV: Final = (ROOT / "deploy/local.env").read_text("utf-8")
OVERLAYS: Final = sorted(ROOT.glob("deploy/compose.*.yaml"))
LAYERS: Final = ("base", "arrays", "pictures", "vision")
"""The stages of the Dockerfile that services build on."""
VARIABLE: Final = re.compile(r"\$\{(?P<name>\w+)(?P<default>:-)?")

IMAGES_OF: Final = {"ros2_rclpy": "ros2"}
"""Services that are another one in another image."""

every_service = pytest.mark.parametrize("name", sorted(SERVICES))


def pins(requirements: str) -> set[str]:
    """Return the `name==version` lines of one set of requirements."""
    text = (ROOT / "deploy/requirements" / f"{requirements}.txt").read_text("utf-8")
    return set(re.findall(r"^\S+==\S+", text, flags=re.MULTILINE))


def stages() -> dict[str, str]:
    """Return the stage or image that each stage of the Dockerfile builds on."""
    found = re.findall(r"^FROM (\S+) AS (\S+)$", DOCKERFILE, flags=re.MULTILINE)
    return {stage: parent for parent, stage in found}


def layers_below(layer: str) -> list[str]:
    """Return a layer and all those it builds on that have requirements of their own."""
    parents = stages()
    chain = []
    while layer != "system":
        chain.append(layer)
        layer = parents[layer]
    return chain


def test_every_service_folder_is_in_the_fleet() -> None:
    folders = {
        file.parent.name
        for file in ROOT.glob("services/*/pyproject.toml")
        if not file.parent.name.startswith("_")
    }

    assert set(SERVICES) - set(IMAGES_OF) == folders
    assert set(IMAGES_OF.values()) <= folders


def test_what_is_off_by_default_has_a_profile() -> None:
    profiles = {name: one["profiles"] for name, one in SERVICES.items() if "profiles" in one}

    assert profiles == {"camera": ["camera"], "ros2_rclpy": ["rclpy"]}


def test_ros_itself_takes_the_place_of_our_own_node() -> None:
    ours, theirs = SERVICES["ros2"]["environment"], SERVICES["ros2_rclpy"]["environment"]

    assert theirs["VERTEBRA_ROS2_DRIVER"] == "rclpy"
    assert {name for name in ours if theirs[name] != ours[name]} == {"VERTEBRA_ROS2_DRIVER"}
    assert theirs["VERTEBRA_INSTANCE"] != "1", "both may run, and must know of each other"
    assert stages()["ros2_rclpy"] == "ros:jazzy-ros-base"


@every_service
def test_a_service_runs_its_own_module(name: str) -> None:
    service = SERVICES[name]

    folder = IMAGES_OF.get(name, name)

    assert service["command"] == ["python", "-m", f"vertebra_{folder}"]
    assert (ROOT / f"services/{folder}/src/vertebra_{folder}/__main__.py").is_file()
    assert service["image"] == f"vertebra/{name}"
    assert service["build"]["args"]["SERVICE"] == folder


@every_service
def test_a_service_is_locked_down(name: str) -> None:
    service = SERVICES[name]

    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert f"\nUSER {service['user']}\n" in DOCKERFILE
    assert not service["user"].startswith("0")
    assert service["tmpfs"] == ["/tmp:size=64m"]
    refused = {"privileged", "cap_add", "network_mode", "pid", "ipc", "devices"}
    assert not refused & set(service)
    shared_memory, *folders = service["volumes"]
    assert shared_memory == "shm:/dev/shm"
    assert all(folder.startswith("./deploy/") and folder.endswith(":ro") for folder in folders)


@every_service
def test_a_service_is_looked_after(name: str) -> None:
    service = SERVICES[name]

    assert service["healthcheck"]["test"] == ["CMD", "python", "-m", "vertebra.heartbeat"]
    assert service["init"] is True
    assert service["restart"] == "unless-stopped"
    assert service["logging"]["options"]["max-size"]
    assert service["mem_limit"]
    assert "depends_on" not in service, "services start in any order"


@every_service
def test_published_ports_are_on_the_loopback(name: str) -> None:
    for mapping in SERVICES[name].get("ports", []):
        assert mapping.startswith("127.0.0.1:")


@every_service
def test_the_environment_is_a_map_of_texts(name: str) -> None:
    environment = SERVICES[name]["environment"]

    assert all(isinstance(value, str) for value in environment.values()), environment
    assert {"VERTEBRA_ROUTER", "VERTEBRA_LOG_LEVEL"} <= set(environment)


def test_every_variable_has_a_default_and_a_local_value_with_its_reason() -> None:
    written = [line for line in (ROOT / "compose.yaml").read_text("utf-8").splitlines()
               if not line.lstrip().startswith("#")]  # fmt: skip
    used = {match["name"]: match["default"] for match in VARIABLE.finditer("\n".join(written))}
    blocks = [block.splitlines() for block in LOCAL_ENV.split("\n\n")]
    documented = [
        line.partition("=")[0]
        for block in blocks
        if block[0].startswith("#")
        for line in block
        if "=" in line and not line.startswith("#")
    ]

    assert sorted(documented) == sorted(used)
    assert all(used.values()), "a variable without a default breaks the whole file"


@pytest.mark.parametrize("name", sorted(set(SERVICES) - set(IMAGES_OF)))
def test_an_image_holds_what_its_service_needs_and_no_more(name: str) -> None:
    layers = layers_below(SERVICES[name]["build"]["args"]["LAYER"])
    below = set().union(*(pins(layer) for layer in layers))

    assert below <= pins(name)
    deeper = [
        stage for stage, parent in stages().items() if parent == layers[0] and stage in LAYERS
    ]
    assert not [layer for layer in deeper if pins(layer) <= pins(name)], "a deeper layer is shared"


@pytest.mark.parametrize("overlay", OVERLAYS, ids=lambda path: path.name)
def test_overlays_change_services_that_exist(overlay: Path) -> None:
    content = yaml.safe_load(overlay.read_text("utf-8"))

    assert set(content["services"]) <= set(SERVICES)
