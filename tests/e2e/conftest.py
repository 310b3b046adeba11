"""Start the fleet in containers, on the engine at hand or on one that is started for it."""

from __future__ import annotations

import os
import secrets
import subprocess
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Final

import pytest
from testcontainers.compose import DockerCompose

from vertebra.testing.ports import free_tcp_port

from .fleet import ROOT, Fleet, run

ENGINE: Final = ROOT / "deploy/engine"
BASE_IMAGE: Final = "debian:bookworm-slim"
ARTIFACTS: Final = ROOT / "tests/artifacts/e2e"
INSTALL_TIMEOUT_S: Final = 600.0
"""Packages, base image and container images come over networks of any speed."""
TEST_TIMEOUT_S: Final = 180

_failed = pytest.StashKey[bool]()


def pytest_itemcollected(item: pytest.Item) -> None:
    # Containers are slow, and what the session's fixtures install has time limits of its own.
    if item.get_closest_marker("timeout") is None:
        item.add_marker(pytest.mark.timeout(TEST_TIMEOUT_S, func_only=True))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item,
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    item.session.stash[_failed] = item.session.stash.get(_failed, False) or report.failed
    return report


def is_there(*command: str | Path) -> bool:
    """Say whether a command that asks for something finds it."""
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


@pytest.fixture(scope="session")
def engine() -> Iterator[None]:
    """Have a Docker engine with Compose answer at DOCKER_HOST."""
    ours = not is_there(ENGINE, "status")
    if ours and os.geteuid() != 0:
        pytest.skip("no Docker engine answers; start one, or run as root: deploy/engine start")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DOCKER_HOST", run(ENGINE, "start", timeout_s=INSTALL_TIMEOUT_S).strip())
        patch.setenv("TESTCONTAINERS_RYUK_DISABLED", "true")  # its image is in a registry
        patch.setenv("COMPOSE_ANSI", "never")
        yield
    if ours:
        run(ENGINE, "stop")


@pytest.fixture(scope="session")
def images(engine: None) -> None:
    """Have the container images of all services, built from the sources as they are."""
    if not is_there("docker", "image", "inspect", BASE_IMAGE) and not is_there(
        "docker", "pull", BASE_IMAGE
    ):
        if os.geteuid() != 0:
            pytest.skip(f"no {BASE_IMAGE} and no image registry; as root: deploy/base-image")
        run(ROOT / "deploy/base-image", timeout_s=INSTALL_TIMEOUT_S)
    run("docker", "compose", "--profile", "camera", "build", "--quiet", timeout_s=INSTALL_TIMEOUT_S)


@pytest.fixture(scope="session")
def fleet(
    images: None, request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Fleet]:
    """Have the default fleet run and healthy, apart from any other on this machine."""
    folder = tmp_path_factory.mktemp("fleet")
    token = secrets.token_urlsafe(24)
    (folder / "gateway_token").write_text(token, encoding="utf-8")
    tcp_port, router_tcp_port = free_tcp_port(), free_tcp_port()
    project = f"vertebra-e2e-{os.getpid()}"
    variables = {
        "COMPOSE_PROJECT_NAME": project,
        "VERTEBRA_SECRETS": str(folder),
        "VERTEBRA_CAMERA_SOURCE": "key:vizzy/camera/left",
        "VERTEBRA_GATEWAY_TCP_PORT": str(tcp_port),
        "VERTEBRA_BACKBONE_TCP_PORT": str(router_tcp_port),
    }
    settings = folder / "settings.env"
    settings.write_text("".join(f"{name}={value}\n" for name, value in variables.items()))
    compose = DockerCompose(ROOT, compose_file_name="compose.yaml", env_file=str(settings))
    running = Fleet(
        url=f"http://127.0.0.1:{tcp_port}",
        token=token,
        router=f"tcp/127.0.0.1:{router_tcp_port}",
        project=project,
        compose=compose,
    )
    try:
        compose.start()
        yield running
    except subprocess.CalledProcessError as error:
        request.session.stash[_failed] = True
        pytest.fail(
            f"the fleet did not start; its logs are in {ARTIFACTS}:\n{error.stderr.decode()}"
        )
    finally:
        if request.session.stash.get(_failed, False):
            keep_logs(running)
        compose.stop()


def keep_logs(fleet: Fleet) -> None:
    """Save what every service of the fleet has logged."""
    ARTIFACTS.mkdir(parents=True, exist_ok=True)
    for service in fleet.services():
        (ARTIFACTS / f"{service}.log").write_text(fleet.logs(service), encoding="utf-8")
