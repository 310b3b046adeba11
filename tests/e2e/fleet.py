"""The fleet in containers, as a test handles it: end and start services, look inside, use it."""

from __future__ import annotations

import contextlib
import json
import re
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Final

import httpx
from testcontainers.compose import DockerCompose

ROOT: Final = Path(__file__).parents[2]
POLL_S: Final = 0.1


def run(*command: str | Path, timeout_s: float = 60.0) -> str:
    """Return what a command prints; fail with all that it complains about."""
    words = [str(word) for word in command]
    done = subprocess.run(
        words, cwd=ROOT, capture_output=True, text=True, timeout=timeout_s, check=False
    )
    if done.returncode:
        problem = f"{' '.join(words)} ended with {done.returncode}:\n{done.stdout}{done.stderr}"
        raise AssertionError(problem)
    return done.stdout


@dataclass(frozen=True, slots=True)
class Fleet:
    """A running fleet.

    Attributes:
        url: Where its gateway is.
        token: What the gateway asks for.
        router: Where its router is.
        project: How Compose names what belongs to it.
        compose: What runs it.
    """

    url: str
    token: str
    router: str
    project: str
    compose: DockerCompose

    def web(self) -> httpx.Client:
        """Return a client of the gateway."""
        return httpx.Client(
            base_url=f"{self.url}/api/",
            headers={"Authorization": f"Bearer {self.token}"},
            timeout=10.0,
            trust_env=False,
        )

    def services(self) -> list[str]:
        """Return the names of all services, of stopped ones too."""
        return sorted(str(c.Service) for c in self.compose.get_containers(include_all=True))

    def logs(self, service: str) -> str:
        """Return all that a service has logged since its container was made."""
        return run("sh", "-c", f"docker logs --timestamps {self._container(service)} 2>&1")

    def inside(self, service: str, *command: str) -> str:
        """Return what a command prints that runs in the container of a service."""
        return run("docker", "exec", self._container(service), *command)

    def crash(self, service: str) -> None:
        """End the processes of a service without warning; the engine starts it anew."""
        before_ns = self.started_ns(service)
        # The shell ends all that it may, which spares itself and the container's init. With its
        # child gone, init ends too; whether the shell gets to tell its end is a race.
        self.inside(service, "sh", "-c", "kill -KILL -1; true")
        self._wait(lambda: self.started_ns(service) != before_ns, f"{service} starts anew")

    def kill(self, service: str) -> None:
        """End the container of a service without warning; it stays away until `start`."""
        run("docker", "kill", self._container(service))

    def start(self, service: str) -> None:
        """Start a service that was killed, without waiting for its health."""
        run("docker", "start", self._container(service))

    @contextlib.contextmanager
    def with_profile(self, service: str) -> Iterator[None]:
        """Have a service run that is off by default."""
        self._compose("--profile", "*", "up", "--detach", "--wait", "--no-deps", service)
        try:
            yield
        finally:
            self._compose("--profile", "*", "rm", "--stop", "--force", service)

    def stop_all(self) -> None:
        """End all services in order, as `docker compose stop` does."""
        self._compose("stop")

    def start_all(self) -> None:
        """Start all services and wait until they are healthy."""
        self._compose("up", "--detach", "--wait")

    def disconnect(self, service: str) -> None:
        """Take a service off the network; it runs on and reaches nobody."""
        run("docker", "network", "disconnect", f"{self.project}_default", self._container(service))

    def connect(self, service: str) -> None:
        """Bring a service that was disconnected back to the network, under its name."""
        run(
            "docker", "network", "connect", "--alias", service,
            f"{self.project}_default", self._container(service),
        )  # fmt: skip

    def state(self, service: str) -> dict[str, Any]:
        """Return the state of a container as the engine sees it."""
        state: dict[str, Any] = self.inspect(service)["State"]
        return state

    def started_ns(self, service: str) -> int:
        """Return when a container was started last."""
        # The engine writes nine digits of a second; Python reads six.
        text = re.sub(r"(\.\d{6})\d*", r"\1", str(self.state(service)["StartedAt"]))
        return int(datetime.fromisoformat(text).timestamp() * 1e9)

    def inspect(self, service: str) -> dict[str, Any]:
        """Return all that the engine knows about a container."""
        found: dict[str, Any] = json.loads(run("docker", "inspect", self._container(service)))[0]
        return found

    def wait_healthy(self, service: str, *, timeout_s: float = 30.0) -> None:
        """Wait for the next good health check of a service."""
        self._wait(
            lambda: self.state(service)["Health"]["Status"] == "healthy",
            f"{service} is healthy",
            timeout_s=timeout_s,
        )

    def resident_bytes(self, service: str) -> int:
        """Return the memory that the process of a service holds."""
        sizes = self.inside(service, "sh", "-c", "cat /proc/[0-9]*/status")
        return max(int(kib) for kib in re.findall(r"VmRSS:\s*(\d+) kB", sizes)) << 10

    def network_bytes(self, service: str) -> tuple[int, int]:
        """Return how many bytes a service has received and sent over the network."""
        line = re.search(r"eth0:\s*(.*)", self.inside(service, "cat", "/proc/net/dev"))
        assert line is not None
        numbers = line[1].split()
        return int(numbers[0]), int(numbers[8])

    def _compose(self, *arguments: str) -> str:
        return run(*self.compose.compose_command_property, *arguments)

    def _container(self, service: str) -> str:
        return f"{self.project}-{service}-1"

    def _wait(self, condition: Callable[[], bool], what: str, *, timeout_s: float = 30.0) -> None:
        deadline_s = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() >= deadline_s:
                raise AssertionError(f"not within {timeout_s:g} s: {what}")
            time.sleep(POLL_S)
